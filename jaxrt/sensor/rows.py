"""Sensors as rows of a scene's tables, and names of their parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..parts import Diffuse, SceneError, Sensor, Shape
from ..scene import CAMERAS, SensorStructure
from .film import Filter

_LENS = {"fov": "fov", "near_clip": "near", "far_clip": "far", "aperture_radius": "aperture_radius"}
_LENS |= {"focus_distance": "focus_distance"}


class Rows:
    """Tables of all sensors: one row each, members of a batch included, and the targets of those that have one."""

    def __init__(self, names: Any, faces_of: Callable[[Shape], tuple[str, int, int] | None]):
        self.names, self.faces_of = names, faces_of
        self.ids: list[str] = []
        self.to_world: list[np.ndarray] = []
        self.lens: list[tuple[float, ...]] = []
        self.targets: list[np.ndarray] = []

    def structures(self, sensors: Sequence[Sensor]) -> tuple[SensorStructure, ...]:
        made = []
        for sensor in sensors:
            made.append(self._structure(sensor))
            self.ids.append(self.name)
        return tuple(made)

    def _structure(self, s: Sensor) -> SensorStructure:
        name = self.names.part(s.id or "sensor")
        film = s.film
        x, y, w, h = film.crop or (0, 0, film.width, film.height)
        window = (x + s.principal_point[0] * w, y + s.principal_point[1] * h, float(w), float(h))
        bc = (float(film.bc[0]), float(film.bc[1]))
        shape = Filter(film.filter, float(film.radius or 0.5), float(film.stddev), bc, bool(film.border))
        made = (film.width, film.height, *shape)
        if s.kind == "batch":
            each = film.width // len(s.sensors)
            parts = tuple(self._structure(part).sized(each, film.height) for part in s.sensors)
            self.name = name
            return SensorStructure(s.kind, "", made, window, parts=parts, grey=film.grey)
        self.name, row = name, len(self.to_world)
        if s.kind != "irradiancemeter":
            self.names.add(f"{name}.to_world", "sensor_to_world", row)
        for column, key in enumerate(_LENS) if s.kind in CAMERAS else ():
            self.names.add(f"{name}.{key}", "lens", row, (column, column + 1), True)
        self.to_world.append(s.to_world)
        self.lens.append(tuple(getattr(s, field) for field in _LENS.values()))
        axis = s.fov_axis if s.kind in CAMERAS else ""
        area = self._area(s.target, f"{name}.target")
        return SensorStructure(s.kind, axis, made, window, row, area, grey=film.grey)

    def _area(self, target: Any, name: str) -> tuple[str, str, int, int] | None:
        """Where the faces are that a sensor measures over: in the scene, or in a table of targets."""
        if target is None:
            return None
        first = sum(map(len, self.targets))
        if isinstance(target, Shape):
            found = self.faces_of(target)
            if found is not None:
                return ("faces", *found)
            kind, rows = _faces(target, name)
            self.names.add(name, "targets", (first, first + len(rows)), (0, 9))
        else:
            kind, rows = "parallelogram", np.array([[*target, *np.zeros(6), 1.0]])
            self.names.add(name, "targets", first, (0, 3))
        self.targets.append(rows)
        return "targets", kind, first, first + len(rows)


def _faces(shape: Shape, name: str) -> tuple[str, np.ndarray]:
    """Kind and rows (origin, e₁, e₂, side) in the world of a shape that is not in the scene."""
    from ..build import build
    from ..effects import plan
    from ..world import front_and_faces

    try:
        scene = build([dataclasses.replace(shape, emission=None, bsdf=Diffuse())])
    except SceneError as problem:
        raise SceneError(f"{name}: {problem}") from None
    _, kind, first, stop = scene.structure.shapes[0]
    return kind, np.asarray(front_and_faces(scene, plan(scene)), np.float64)[first:stop]
