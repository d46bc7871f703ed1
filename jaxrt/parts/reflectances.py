"""Reflectances: what a surface does with light."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .checks import check, scalar, varying
from .textures import Texture

if TYPE_CHECKING:
    from .composites import Composite
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


def _check_roughness(part: Conductor | Dielectric | Plastic, name: str, *known: str) -> None:
    """`alpha` becomes [α_u, α_v], numbers or textures, from one or two."""
    check(part.distribution in known, f"{name}.distribution", f"{part.distribution!r} is not {' or '.join(known)}")
    value, element = part.alpha, f"{name}.alpha"
    several = isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.size == 2)
    both = [*value, *value][:2] if several and len(value) == 1 else list(value) if several else [value, value]
    check(len(both) == 2, element, "is one roughness or two")
    one = lambda v: varying(v, element, most=1.0) if isinstance(v, Texture) else scalar(v, element, least=0, most=1.0)
    part.alpha = [one(v) for v in both]


def _row(alpha: list[Any], smooth: str, rough: str, fields: dict[str, Any], names: dict[str, str]) -> Row:
    textured = any(isinstance(a, Texture) for a in alpha)
    if not textured and max(alpha) < 1e-3:  # float32 cannot resolve the lobe (oracles, GGX furnace)
        return Row(smooth, fields, names)
    alpha = [a if isinstance(a, Texture) else max(a, 1e-3) for a in alpha]
    return Row(rough, {**fields, "alpha": alpha}, {**names, "alpha": "alpha"})


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
        _check_roughness(self, name, "ggx", "ggx_separable", "beckmann")
        self.eta = varying(self.eta, f"{name}.eta")
        self.k = varying(self.k, f"{name}.k")
        self.specular_reflectance = varying(self.specular_reflectance, f"{name}.specular_reflectance", most=1.0)

    def row(self) -> Row:
        fields = {"reflectance": self.specular_reflectance, "eta": self.eta, "k": self.k}
        names = {"specular_reflectance": "reflectance", "eta": "eta", "k": "k"}
        return _row(self.alpha, "mirror", self.distribution, fields, names)


def _check_boundary(part: Dielectric | Plastic, name: str, *albedos: str) -> None:
    for key in ("int_ior", "ext_ior"):
        n = scalar(getattr(part, key), f"{name}.{key}")
        check(0 < n <= 1e3, f"{name}.{key}", f"is {n:g}; give an index of refraction above 0, and at most 1000")
        setattr(part, key, n)
    for key in albedos:
        setattr(part, key, varying(getattr(part, key), f"{name}.{key}", most=1.0))


_NAMES = {"ggx": "", "beckmann": "_beckmann"}
"""Distributions of boundaries, and how the names of their lobes end."""


@dataclasses.dataclass
class Dielectric:
    """A boundary between two media, as of glass: it reflects and transmits. Shapes of it have to be closed.

    `int_ior`, `ext_ior`: indices of refraction behind and before the front side. `thin`: both faces of a thin sheet
    at once, which does not bend light. It is smooth (alpha 0) or has microfacets of roughness `alpha` = (α_u, α_v).
    `distribution`: ggx or beckmann, with separable masking as Mitsuba has it.
    """

    int_ior: float = 1.5046
    ext_ior: float = 1.000277
    specular_reflectance: Any = 1.0
    specular_transmittance: Any = 1.0
    thin: bool = False
    alpha: Any = 0.0
    distribution: Literal["ggx", "beckmann"] = "ggx"
    id: str = ""

    def __post_init__(self):
        name = self.id or "dielectric"
        _check_boundary(self, name, "specular_reflectance", "specular_transmittance")
        _check_roughness(self, name, *_NAMES)
        smooth = self.alpha == [0.0, 0.0]
        check(smooth or not self.thin, f"{name}.alpha", "a thin sheet is smooth; leave out alpha")

    def row(self) -> Row:
        fields = {"reflectance": self.specular_reflectance, "transmittance": self.specular_transmittance}
        fields["ior"] = self.int_ior / self.ext_ior
        names = {"specular_reflectance": "reflectance", "specular_transmittance": "transmittance", "eta": "ior"}
        smooth = "thin_glass" if self.thin else "glass"
        return _row(self.alpha, smooth, "rough_glass" + _NAMES[self.distribution], fields, names)


@dataclasses.dataclass
class Plastic:
    """Diffuse paint below a clear coat, smooth (alpha 0) or with microfacets of roughness `alpha`, alike in all
    directions. `nonlinear`: colours shift as light is reflected inside many times. `distribution` as of `Dielectric`.
    """

    diffuse_reflectance: Any = 0.5
    specular_reflectance: Any = 1.0
    int_ior: float = 1.49
    ext_ior: float = 1.000277
    nonlinear: bool = False
    alpha: Any = 0.0
    distribution: Literal["ggx", "beckmann"] = "ggx"
    id: str = ""

    def __post_init__(self):
        name = self.id or "plastic"
        _check_boundary(self, name, "diffuse_reflectance", "specular_reflectance")
        _check_roughness(self, name, *_NAMES)
        same = self.alpha[0] == self.alpha[1] and not isinstance(self.alpha[0], Texture)
        check(same, f"{name}.alpha", "is one roughness, alike in all directions, and no texture")

    def row(self) -> Row:
        fields = {"reflectance": self.diffuse_reflectance, "specular": self.specular_reflectance}
        fields |= {"ior": self.int_ior / self.ext_ior, "nonlinear": float(self.nonlinear)}
        names = {"diffuse_reflectance": "reflectance", "specular_reflectance": "specular", "eta": "ior"}
        return _row(self.alpha, "plastic", "rough_plastic" + _NAMES[self.distribution], fields, names)


@dataclasses.dataclass
class Null:
    """A surface that light passes as if it were not there. It still counts as one reflection."""

    id: str = ""

    def row(self) -> Row:
        return Row("nothing", {"transmittance": np.ones(1)}, {})


@dataclasses.dataclass
class TwoSided:
    """The same reflection on both sides of the surface, or that of `back` behind it."""

    bsdf: Bsdf
    back: Bsdf | None = None
    id: str = ""

    def __post_init__(self):
        from .composites import transmits

        for part in (self.bsdf, self.back):
            opaque = part is None or not (isinstance(part, (Null, TwoSided)) or transmits(part))
            check(opaque, self.id or "twosided", "holds what transmits, or another twosided; leave out this one")

    def parts(self) -> list[Bsdf]:
        return [self.bsdf] if self.back is None else [self.bsdf, self.back]

    def row(self) -> Row:
        return Row("sides", {}, {})


Bsdf: TypeAlias = (
    "Diffuse | Conductor | Dielectric | Plastic | Principled | PrincipledThin | Null | TwoSided | Composite"
)
