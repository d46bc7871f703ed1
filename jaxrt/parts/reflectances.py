"""Reflectances: what a surface does with light."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .checks import check, scalar, varying
from .textures import Texture

if TYPE_CHECKING:
    from .principled import Principled, PrincipledThin


class Row(NamedTuple):
    """What a reflectance puts into the material table: its lobe, values of fields, and parameters (name: field)."""

    lobe: str
    fields: dict[str, Any]
    parameters: dict[str, str]


@dataclasses.dataclass
class Diffuse:
    """Lambertian reflection, f_r = reflectance / π (notes, 1.3)."""

    reflectance: Any = 0.5
    id: str = ""

    def __post_init__(self):
        self.reflectance = varying(self.reflectance, f"{self.id or 'diffuse'}.reflectance", most=1.0)

    def row(self) -> Row:
        return Row("diffuse", {"reflectance": self.reflectance}, {"reflectance": "reflectance"})


def roughness(value: Any, element: str) -> list[Any]:
    """[α_u, α_v], numbers or textures, from one or two."""
    several = isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.size == 2)
    both = [*value, *value][:2] if several and len(value) == 1 else list(value) if several else [value, value]
    check(len(both) == 2, element, "is one roughness or two")
    one = lambda v: v if isinstance(v, Texture) else scalar(v, element, least=0.0, most=1.0)
    return [varying(one(v), element, most=1.0) if isinstance(v, Texture) else one(v) for v in both]


@dataclasses.dataclass
class Conductor:
    """A metal: a smooth mirror (alpha 0) or microfacets of roughness `alpha` = (α_u, α_v).

    `eta`, `k`: complex index of refraction, relative to the outside. eta 0 and k 1 reflect everything.
    `distribution`: ggx (height-correlated masking, Heitz 2014), or ggx_separable and beckmann as Mitsuba has them.
    """

    alpha: Any = 0.0
    eta: Any = 0.0
    k: Any = 1.0
    specular_reflectance: Any = 1.0
    distribution: Literal["ggx", "ggx_separable", "beckmann"] = "ggx"
    id: str = ""

    def __post_init__(self):
        name = self.id or "conductor"
        known = ("ggx", "ggx_separable", "beckmann")
        check(self.distribution in known, f"{name}.distribution", f"{self.distribution!r} is not {' or '.join(known)}")
        self.alpha = roughness(self.alpha, f"{name}.alpha")
        self.eta = varying(self.eta, f"{name}.eta")
        self.k = varying(self.k, f"{name}.k")
        self.specular_reflectance = varying(self.specular_reflectance, f"{name}.specular_reflectance", most=1.0)

    def row(self) -> Row:
        # below, float32 cannot resolve the lobe (oracles, GGX furnace)
        rough = any(isinstance(a, Texture) or a >= 1e-3 for a in self.alpha)
        fields = {"reflectance": self.specular_reflectance, "eta": self.eta, "k": self.k}
        names = {"specular_reflectance": "reflectance", "eta": "eta", "k": "k"}
        if not rough:
            return Row("mirror", fields, names)
        return Row(
            self.distribution,
            {**fields, "alpha": [a if isinstance(a, Texture) else max(a, 1e-3) for a in self.alpha]},
            {**names, "alpha": "alpha"},
        )


def _check_boundary(part: Dielectric | Plastic, name: str, *albedos: str) -> None:
    for key in ("int_ior", "ext_ior"):
        n = scalar(getattr(part, key), f"{name}.{key}")
        check(0 < n <= 1e3, f"{name}.{key}", f"is {n:g}; give an index of refraction above 0, and at most 1000")
        setattr(part, key, n)
    for key in albedos:
        setattr(part, key, varying(getattr(part, key), f"{name}.{key}", most=1.0))


@dataclasses.dataclass
class Dielectric:
    """A smooth boundary between two media, as of glass: it reflects and transmits. Shapes of it have to be closed.

    `int_ior`, `ext_ior`: indices of refraction behind and before the front side. `thin`: both faces of a thin sheet
    at once, which does not bend light.
    """

    int_ior: float = 1.5046
    ext_ior: float = 1.000277
    specular_reflectance: Any = 1.0
    specular_transmittance: Any = 1.0
    thin: bool = False
    id: str = ""

    def __post_init__(self):
        _check_boundary(self, self.id or "dielectric", "specular_reflectance", "specular_transmittance")

    def row(self) -> Row:
        fields = {"reflectance": self.specular_reflectance, "transmittance": self.specular_transmittance}
        names = {"specular_reflectance": "reflectance", "specular_transmittance": "transmittance", "eta": "ior"}
        return Row("thin_glass" if self.thin else "glass", {**fields, "ior": self.int_ior / self.ext_ior}, names)


@dataclasses.dataclass
class Plastic:
    """Diffuse paint below a smooth clear coat. `nonlinear`: colours shift as light is reflected inside many times."""

    diffuse_reflectance: Any = 0.5
    specular_reflectance: Any = 1.0
    int_ior: float = 1.49
    ext_ior: float = 1.000277
    nonlinear: bool = False
    id: str = ""

    def __post_init__(self):
        _check_boundary(self, self.id or "plastic", "diffuse_reflectance", "specular_reflectance")

    def row(self) -> Row:
        fields = {"reflectance": self.diffuse_reflectance, "specular": self.specular_reflectance}
        fields |= {"ior": self.int_ior / self.ext_ior, "nonlinear": float(self.nonlinear)}
        names = {"diffuse_reflectance": "reflectance", "specular_reflectance": "specular", "eta": "ior"}
        return Row("plastic", fields, names)


@dataclasses.dataclass
class Null:
    """A surface that light passes as if it were not there. It still counts as one reflection."""

    id: str = ""

    def row(self) -> Row:
        return Row("nothing", {"transmittance": np.ones(1)}, {})


@dataclasses.dataclass
class TwoSided:
    """The same reflection on both sides of the surface."""

    bsdf: Bsdf
    id: str = ""

    def __post_init__(self):
        opaque = not isinstance(self.bsdf, (Dielectric, Null, TwoSided)) and not getattr(self.bsdf, "transmits", False)
        check(opaque, self.id or "twosided", "holds what transmits, or another twosided; leave out this one")


Bsdf: TypeAlias = "Diffuse | Conductor | Dielectric | Plastic | Principled | PrincipledThin | Null | TwoSided"
