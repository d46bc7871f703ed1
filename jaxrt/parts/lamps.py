"""Lamps without extent, the sun, and the enclosure. Emission of surfaces belongs to their shapes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .checks import LARGEST, SceneError, check, matrix, scalar, spectrum, unit, varying
from .sky import Sky
from .textures import Bitmap, Texture
from .web import PhotometricWeb

LAMPS = ("point", "spot", "directional", "projector", "goniometric", "sun")
"""Kinds of lamps that are no surfaces, in the order of their numbers in tables."""


def brightness(lamp: Any) -> str:
    """The field that says how bright a lamp is."""
    return next(key for key in ("intensity", "irradiance", "radiance") if hasattr(lamp, key))


@dataclasses.dataclass
class Point:
    """A lamp at a point, of `intensity` (W·sr⁻¹) in all directions."""

    position: Any = (0.0, 0.0, 0.0)
    intensity: Any = 1.0
    id: str = ""

    def __post_init__(self):
        name = self.id or "point"
        self.position = np.asarray(self.position, np.float64)
        good = self.position.shape == (3,) and bool((np.abs(self.position) <= LARGEST).all())
        check(good, f"{name}.position", "is no point; give three finite numbers")
        self.intensity = spectrum(self.intensity, f"{name}.intensity")

    def row(self) -> np.ndarray:
        return np.array([*self.position, 0, 0, 1, 0, 0, LAMPS.index("point"), 0, 0, 0], float)


@dataclasses.dataclass
class Spot(Point):
    """A point lamp that shines into a cone around `direction`: `intensity` up to `beam_width` (degrees from its axis),
    from there on less, in proportion to the angle, to nothing at `cutoff_angle`."""

    direction: Any = (0.0, 0.0, 1.0)
    cutoff_angle: float = 20.0
    beam_width: float | None = None

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "spot"
        self.direction = unit(self.direction, f"{name}.direction")
        self.cutoff_angle = scalar(self.cutoff_angle, f"{name}.cutoff_angle", least=0.0, most=180.0)
        width = 0.75 * self.cutoff_angle if self.beam_width is None else self.beam_width
        self.beam_width = scalar(width, f"{name}.beam_width", least=0.0, most=self.cutoff_angle)

    def row(self) -> np.ndarray:
        cutoff, beam = np.radians(self.cutoff_angle), np.radians(self.beam_width or 0.0)
        return np.array([*self.position, *self.direction, cutoff, beam, LAMPS.index("spot"), 0, 0, 0], float)


@dataclasses.dataclass
class Directional:
    """Light from infinitely far away along `direction`, of `irradiance` (W·m⁻²) on a surface across it."""

    direction: Any = (0.0, 0.0, 1.0)
    irradiance: Any = 1.0
    id: str = ""

    def __post_init__(self):
        name = self.id or "directional"
        self.direction = unit(self.direction, f"{name}.direction")
        self.irradiance = spectrum(self.irradiance, f"{name}.irradiance")

    def row(self) -> np.ndarray:
        return np.array([0, 0, 0, *self.direction, 0, 0, LAMPS.index("directional"), 0, 0, 0], float)


@dataclasses.dataclass
class Projector:
    """A picture thrown from a point, as a camera there sees it: `irradiance` (W·m⁻²) on a plane across its axis, +z of
    its own space, at distance 1; `fov`: degrees along the picture's width, +y up, +x left."""

    irradiance: Any
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    fov: float = 50.0
    id: str = ""

    def __post_init__(self):
        name = self.id or "projector"
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        self.fov = scalar(self.fov, f"{name}.fov")
        check(0 < self.fov < 180, f"{name}.fov", f"is {self.fov:g}; give an angle between 0 and 180 degrees")
        self.irradiance = varying(self.irradiance, f"{name}.irradiance")
        if not isinstance(self.irradiance, Bitmap):
            raise SceneError(f"{name}.irradiance: is no Bitmap; give one")

    def row(self) -> np.ndarray:
        m, (height, width) = self.to_world, self.irradiance.data.shape[:2]
        half, number = np.tan(np.radians(self.fov / 2)), LAMPS.index("projector")
        axis, up = (m[:3, k] / np.linalg.norm(m[:3, k]) for k in (2, 1))
        return np.array([*m[:3, 3], *axis, half, half * height / width, number, *up], float)


@dataclasses.dataclass
class Goniometric:
    """A lamp at a point whose `intensity` (W·sr⁻¹) is a `PhotometricWeb`, as of `jaxrt.load_ies`.

    In its own space vertical angle 0 is +z, where spots shine as well; there, horizontal angle 0 is +y and 90 is +x.
    `to_world` places and turns it; its scale does not count.
    """

    intensity: Any
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    id: str = ""

    def __post_init__(self):
        name = self.id or "goniometric"
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        if not isinstance(self.intensity, PhotometricWeb):
            raise SceneError(f"{name}.intensity: is no PhotometricWeb; give one, as of jaxrt.load_ies")

    def row(self) -> np.ndarray:
        m, number = self.to_world, LAMPS.index("goniometric")
        axis, up = (m[:3, k] / np.linalg.norm(m[:3, k]) for k in (2, 1))
        return np.array([*m[:3, 3], *axis, 0, 0, number, *up], float)


@dataclasses.dataclass
class Sun:
    """A disc infinitely far away whose light travels along `direction`, of `radiance` (W·m⁻²·sr⁻¹) all over; `angle`:
    its diameter, degrees. Of the disc only what lies on the side of `horizon`, a direction upwards, is there.

    Rays that leave the scene towards it meet it, other than lamps without extent. A scene has one at most.
    """

    direction: Any = (0.0, 0.0, -1.0)
    radiance: Any = 1.0
    angle: float = 0.5358
    horizon: Any = None
    id: str = ""

    def __post_init__(self):
        name = self.id or "sun"
        self.direction = unit(self.direction, f"{name}.direction")
        self.radiance = spectrum(self.radiance, f"{name}.radiance")
        self.angle = scalar(self.angle, f"{name}.angle")
        check(0 < self.angle < 180, f"{name}.angle", f"is {self.angle:g}; give an angle between 0 and 180 degrees")
        if self.horizon is not None:
            self.horizon = unit(self.horizon, f"{name}.horizon")

    def row(self) -> np.ndarray:
        up = np.zeros(3) if self.horizon is None else self.horizon
        height = 2 * np.sin(np.radians(self.angle / 4)) ** 2
        return np.array([0, 0, 0, *self.direction, height, 0, LAMPS.index("sun"), *up], float)


Lamp = Point | Spot | Directional | Projector | Goniometric | Sun


@dataclasses.dataclass
class Enclosure:
    """The surface around the scene on which every ray lands: it emits `radiance` and reflects nothing.

    A `Bitmap` is a map of all directions: its columns go around +y of its own space, from −z over +x, its rows from +y
    down to −y. Its `to_uv` and wrapping have no use here. A `Sky` has its zenith at +y. `to_world` turns either.
    """

    radiance: Any = 0.0
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    id: str = ""

    def __post_init__(self):
        name = self.id or "enclosure"
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        if isinstance(self.radiance, Sky):
            return
        self.radiance = varying(self.radiance, f"{name}.radiance")
        if isinstance(self.radiance, Texture):
            if not isinstance(self.radiance, Bitmap):
                raise SceneError(f"{name}.radiance: is no Bitmap; give one, or a colour")
            rows = self.radiance.data.shape[0]
            check(rows > 1, f"{name}.radiance", "has one row; give at least two")
            middle = [[1.0, 0, 0], [0, (rows - 1) / rows, 0.5 / rows]]  # the first and last row lie on the poles
            self.radiance = dataclasses.replace(self.radiance, to_uv=middle, wrap="repeat", filter="bilinear")
