"""Reflectances made of others: mixtures, masks, other sides, and turned normals."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from .checks import check, scalar, varying
from .reflectances import Dielectric, Null, Row
from .textures import Bitmap, Texture

if TYPE_CHECKING:
    from .reflectances import Bsdf


class Composite:
    """A reflectance made of others, its `parts`: light may pass it where it may pass one of those."""

    def parts(self) -> list[Bsdf]:
        raise NotImplementedError

    @property
    def transmits(self) -> bool:
        return any(transmits(part) for part in self.parts())


@dataclasses.dataclass
class Blend(Composite):
    """Two reflectances mixed: (1 − weight) of the first and weight of the second."""

    first: Bsdf
    second: Bsdf
    weight: Any = 0.5
    id: str = ""

    def __post_init__(self):
        self.weight = varying(self.weight, f"{self.id or 'blend'}.weight", most=1.0)

    def parts(self) -> list[Bsdf]:
        return [self.first, self.second]

    def row(self) -> Row:
        return Row("blend", {"weight": _one(self.weight, f"{self.id or 'blend'}.weight")}, {"weight": "weight"})


@dataclasses.dataclass
class Mask(Composite):
    """A surface with holes: it is there by `opacity`, and else light passes."""

    bsdf: Bsdf
    opacity: Any = 0.5
    id: str = ""

    def __post_init__(self):
        self.opacity = varying(self.opacity, f"{self.id or 'mask'}.opacity", most=1.0)
        self._nothing = Null()

    def parts(self) -> list[Bsdf]:
        return [self._nothing, self.bsdf]

    def row(self) -> Row:
        return Row("blend", {"weight": _one(self.opacity, f"{self.id or 'mask'}.opacity")}, {"opacity": "weight"})


@dataclasses.dataclass
class NormalMap(Composite):
    """Normals turned to (2 r − 1, 2 g − 1, 2 b − 1) of a picture, in the frame along ∂p/∂u. `shadowed`: what turned
    normals would let light leak into is darkened (Estevez and others 2019)."""

    bsdf: Bsdf
    normalmap: Any
    shadowed: bool = True
    id: str = ""

    def __post_init__(self):
        name = f"{self.id or 'normalmap'}.normalmap"
        check(isinstance(self.normalmap, Texture), name, "is no texture; give a Bitmap of normals")
        self.normalmap = varying(self.normalmap, name)

    def parts(self) -> list[Bsdf]:
        return [self.bsdf]

    def row(self) -> Row:
        fields = {"reflectance": self.normalmap, "shadowed": float(self.shadowed)}
        return Row("normalmap", fields, {"normalmap": "reflectance"})


@dataclasses.dataclass
class BumpMap(Composite):
    """Normals turned as those of a surface that stands out by `scale` times a picture's luminance (m)."""

    bsdf: Bsdf
    texture: Any
    scale: float = 1.0
    shadowed: bool = True
    id: str = ""

    def __post_init__(self):
        name = f"{self.id or 'bumpmap'}.texture"
        check(isinstance(self.texture, Bitmap), name, "is no Bitmap, whose slope could be taken; give one")
        self.texture = varying(self.texture, name)
        self.scale = scalar(self.scale, f"{self.id or 'bumpmap'}.scale")

    def parts(self) -> list[Bsdf]:
        return [self.bsdf]

    def row(self) -> Row:
        fields = {"roughness": self.texture, "weight": self.scale, "shadowed": float(self.shadowed)}
        return Row("bumpmap", fields, {"scale": "weight", "texture": "roughness"})


def transmits(bsdf: Any) -> bool:
    """Whether light may pass a surface of it."""
    return isinstance(bsdf, (Dielectric, Null)) or getattr(bsdf, "transmits", False)


def _one(value: Any, element: str) -> Any:
    if not isinstance(value, Texture):
        check(np.size(value) == 1, element, "is one number")
        return float(np.ravel(value)[0])
    return value
