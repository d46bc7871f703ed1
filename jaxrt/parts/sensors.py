"""Cameras, meters and their films."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from .checks import LARGEST, check, matrix, scalar
from .shapes import Disk, Rectangle, Shape, Sphere

_KINDS = ("perspective", "thinlens", "orthographic", "radiancemeter", "irradiancemeter", "distant", "batch")


FILM_FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")


@dataclasses.dataclass
class Film:
    """width x height pixels; `filter` is box, tent, gaussian, mitchell, catmullrom or lanczos; `radius` in pixels,
    `stddev` for gaussian, `bc` for mitchell.

    `border`: samples lie beyond the picture's edge where the filter reaches there; else it is cut off.
    `crop`: the picture is the part of a larger film that starts so many pixels (x, y) from its upper left corner, and
    that film's width and height. `grey`: the picture is luminance alone.
    """

    width: int = 768
    height: int = 576
    filter: Literal["box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"] = "gaussian"
    radius: float | None = None
    stddev: float = 0.5
    bc: tuple[float, float] = (1 / 3, 1 / 3)
    border: bool = False
    crop: tuple[int, int, int, int] | None = None
    grey: bool = False

    def __post_init__(self):
        for key in ("width", "height"):
            n = getattr(self, key)
            check(int(n) == n and 0 < n <= 1 << 15, f"film.{key}", f"is {n}; give a whole number from 1 to 32768")
            setattr(self, key, int(n))
        if self.crop is not None:
            x, y, w, h = self.crop
            inside = 0 <= x and x + self.width <= w and 0 <= y and y + self.height <= h
            check(inside, "film.crop", f"goes beyond the film of {w} x {h} pixels; make it smaller or move it")
        radii = {
            "box": 0.5,
            "tent": 1.0,
            "gaussian": 4 * self.stddev,
            "mitchell": 2.0,
            "catmullrom": 2.0,
            "lanczos": 3.0,
        }
        check(self.filter in radii, "film.filter", f"{self.filter!r} is not one of {', '.join(radii)}")
        check(np.isfinite(self.stddev) and self.stddev > 0, "film.stddev", f"is {self.stddev}; give a positive number")
        if self.radius is None:
            self.radius = radii[self.filter]
        check(0 < self.radius <= 256, "film.radius", f"is {self.radius}; give a positive number of pixels, up to 256")
        cubic = self.filter in ("mitchell", "catmullrom")
        check(not cubic or self.radius == 2, "film.radius", f"is {self.radius}; leave it out, for a cubic's is 2")
        whole = self.radius == int(self.radius)
        check(self.filter != "lanczos" or whole, "film.radius", f"is {self.radius}; give whole lobes")
        check(all(abs(k) <= 1 for k in self.bc), "film.bc", f"is {self.bc}; give two numbers from -1 to 1")


@dataclasses.dataclass
class Sensor:
    """A camera at the origin of its own space, looking along +z with +y up (so +x is left in the picture), or a meter.

    kind: perspective, thinlens or orthographic; radiancemeter, which measures along the one ray from its origin along
    +z; irradiancemeter: mean irradiance on the front of the shape `target`, which need not be in the scene; distant:
    what leaves the scene along −z, averaged over the cross section of the sphere around its bounding box, or over
    `target`, a point or a shape, where that is given; batch: `sensors` side by side in one film. Every pixel of a
    meter measures the same; but those of an irradiancemeter on a rectangle, disk or sphere are laid over it.

    `fov` in degrees along `fov_axis` (x, y, smaller,
    larger or diagonal); `aperture_radius` and `focus_distance` for thinlens. An orthographic camera
    sees [-1, 1] along x of its own space. `principal_point`: what the film is shifted by, in its widths and heights.
    """

    kind: Literal["perspective", "thinlens", "orthographic", "radiancemeter", "irradiancemeter", "distant", "batch"] = (
        "perspective"
    )
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    fov: float = 50.0
    fov_axis: str = "x"
    near: float = 1e-2
    far: float = 1e4
    aperture_radius: float = 0.0
    focus_distance: float = 1.0
    principal_point: tuple[float, float] = (0.0, 0.0)
    film: Film = dataclasses.field(default_factory=Film)
    id: str = ""
    target: Any = None
    sensors: Sequence[Sensor] = ()

    def __post_init__(self):
        name = self.id or "sensor"
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        check(self.kind in _KINDS, name, f"unknown kind {self.kind!r}")
        self._check_target(name)
        self._check_batch(name)
        axes = ("x", "y", "smaller", "larger", "diagonal")
        check(self.fov_axis in axes, f"{name}.fov_axis", f"{self.fov_axis!r} is not one of {', '.join(axes)}")
        self.fov = scalar(self.fov, f"{name}.fov")
        check(0 < self.fov < 180, f"{name}.fov", f"is {self.fov:g}; give an angle between 0 and 180 degrees")
        self.near, self.far = scalar(self.near, f"{name}.near_clip"), scalar(self.far, f"{name}.far_clip")
        check(0 < self.near < self.far, f"{name}.near_clip", "is not between 0 and far_clip")
        self.aperture_radius = scalar(self.aperture_radius, f"{name}.aperture_radius", least=0.0)
        self.focus_distance = scalar(self.focus_distance, f"{name}.focus_distance", least=0.0)
        check(self.focus_distance > 0, f"{name}.focus_distance", "is not positive")
        shift = np.asarray(self.principal_point, float)
        check(
            shift.shape == (2,) and bool(np.isfinite(shift).all()), f"{name}.principal_point", "is two finite numbers"
        )

    def _check_target(self, name: str) -> None:
        self._check_size(name, self.film.width, self.film.height)
        if self.kind == "irradiancemeter":
            check(isinstance(self.target, Shape), f"{name}.target", "is not a shape; give that whose front measures")
        elif self.kind != "distant":
            check(self.target is None, f"{name}.target", f"has no use in a {self.kind}; leave it out")
        elif self.target is not None and not isinstance(self.target, Shape):
            self.target = np.asarray(self.target, np.float64)
            good = self.target.shape == (3,) and bool((np.abs(self.target) <= LARGEST).all())
            check(good, f"{name}.target", "is no target; give a shape, or three finite numbers")

    def _check_size(self, name: str, width: int, height: int) -> None:
        size = f"has {width} x {height} pixels"
        if self.kind in ("radiancemeter", "distant"):
            check(1 in (width, height), f"{name}.film", f"{size} of one value; give it 1 x 1")
        elif self.kind == "irradiancemeter" and not isinstance(self.target, Rectangle | Disk | Sphere):
            mapped = f"{size}, which only go over a rectangle, disk or sphere; give it 1 x 1"
            check(width * height == 1, f"{name}.film", mapped)

    def _check_batch(self, name: str) -> None:
        self.sensors, n = list(self.sensors), len(self.sensors)
        if self.kind != "batch":
            check(n == 0, f"{name}.sensors", f"have no use in a {self.kind}; leave them out")
            return
        check(n > 0, f"{name}.sensors", "are none; give at least one")
        for part in self.sensors:
            good = isinstance(part, Sensor) and part.kind != "batch"
            check(good, f"{name}.sensors", "hold what is no camera or meter; put its sensors there themselves")
        check(not any(s.film.crop for s in (self, *self.sensors)), f"{name}.film", "is cropped; show the whole of it")
        wide = f"is {self.film.width} pixels wide, which {n} views side by side do not share; give a multiple of {n}"
        check(self.film.width % n == 0, f"{name}.film", wide)
        for part in self.sensors:
            if part.kind == "irradiancemeter":
                part._check_size(name, self.film.width // n, self.film.height)
