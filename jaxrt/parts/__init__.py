"""The parts a scene is described with: plain numpy on the host, checked when they are made.

A loader turns a file into these parts and `Scene.build` packs them into tables, so a scene made in
Python and one read from a file take the same way. Angles are in degrees, lengths in metres, colours
linear. A wrong value raises `SceneError`, which says what is wrong and what to do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from .checks import LARGEST, SceneError, check, matrix, scalar, spectrum, unit, varying
from .composites import Blend, BumpMap, Mask, NormalMap
from .lamps import LAMPS, Directional, Enclosure, Goniometric, Lamp, Point, Projector, Spot, Sun, brightness
from .principled import Principled, PrincipledThin
from .reflectances import Bsdf, Conductor, Dielectric, Diffuse, Null, Plastic, Row, TwoSided
from .sensors import Film, Sensor
from .shapes import Cube, Cylinder, Disk, Group, Instance, Mesh, Rectangle, SdfGrid, Shape, Sphere
from .sky import Sky
from .textures import LUMINANCE, Bitmap, Checkerboard, MeshAttribute, Product, Texture
from .web import PhotometricWeb


@dataclasses.dataclass
class Integrator:
    """What a scene file asks of the method: depth as Mitsuba counts it (1: emission only; -1: no end), samples a pixel,
    and of what pixels see first, as `render` takes it."""

    max_depth: int = -1
    rr_depth: int = 5
    hide_emitters: bool = False
    spp: int = 16
    aovs: tuple[str, ...] = ()

    def __post_init__(self):
        check(self.max_depth >= -1, "integrator.max_depth", f"is {self.max_depth}; give -1 or more")
        check(self.rr_depth >= 1, "integrator.rr_depth", f"is {self.rr_depth}; give 1 or more")
        check(1 <= self.spp < 1 << 31, "sampler.sample_count", f"is {self.spp}; give 1 or more, below {1 << 31}")


@dataclasses.dataclass
class Description:
    """A whole scene as parts. `notes`: what the loader wants said on stderr (fallbacks it took)."""

    shapes: Sequence[Shape | Instance]
    sensors: Sequence[Sensor] = ()
    enclosure: Enclosure | None = None
    lamps: Sequence[Lamp] = ()
    integrator: Integrator = dataclasses.field(default_factory=Integrator)
    notes: Sequence[str] = ()


__all__ = [
    "LAMPS",
    "LARGEST",
    "LUMINANCE",
    "Bitmap",
    "Blend",
    "Bsdf",
    "BumpMap",
    "Checkerboard",
    "Conductor",
    "Cube",
    "Cylinder",
    "Description",
    "Dielectric",
    "Diffuse",
    "Directional",
    "Disk",
    "Enclosure",
    "Film",
    "Goniometric",
    "Group",
    "Instance",
    "Integrator",
    "Lamp",
    "Mask",
    "Mesh",
    "MeshAttribute",
    "NormalMap",
    "Null",
    "PhotometricWeb",
    "Plastic",
    "Point",
    "Principled",
    "PrincipledThin",
    "Product",
    "Projector",
    "Rectangle",
    "Row",
    "SceneError",
    "SdfGrid",
    "Sensor",
    "Shape",
    "Sky",
    "Sphere",
    "Spot",
    "Sun",
    "Texture",
    "TwoSided",
    "brightness",
    "check",
    "matrix",
    "scalar",
    "spectrum",
    "unit",
    "varying",
]
