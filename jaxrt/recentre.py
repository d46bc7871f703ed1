"""Scenes far from the origin are moved there on the host, in float64, before float32 has to hold where they are."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .files.view import used_vertices
from .parts import Cylinder, Description, Goniometric, Instance, Mesh, Point, Projector, Sphere

FAR = 16.0
"""Radii of a scene from the origin to its middle from where on it is moved: float32 loses four bits to that."""

COARSE = 4096.0
"""Steps of float32 to the size of a mesh, below which it is said that its vertices are as coarse as that."""


def recentred(description: Description, points: np.ndarray) -> tuple[Description, np.ndarray]:
    """A description counted from an origin (3,) near the middle of its points (N, 3), in float64; that is 0 unless
    they are far from there."""
    low, high = points.min(0), points.max(0)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    if not np.linalg.norm(middle) > FAR * radius > 0:
        return description, np.zeros(3)
    step = 2.0 ** np.ceil(np.log2(radius))  # so that a scene is the same bits wherever it stands
    origin = step * np.round(middle / step)
    to = _shift(-origin)
    shapes: dict[int, Any] = {id(s): _moved(s, to) for s in description.shapes}

    def sensor(s: Any) -> Any:
        target = s.target
        if isinstance(target, np.ndarray):
            target = target - origin
        elif target is not None:
            target = shapes[id(target)] if id(target) in shapes else _moved(target, to)
        parts = [sensor(part) for part in s.sensors]
        return dataclasses.replace(s, to_world=to @ s.to_world, target=target, sensors=parts)

    name = ", ".join(f"{v:g}" for v in origin)
    note = f"lies {np.linalg.norm(middle):.3g} from the origin, {radius:.3g} in radius; all is counted from ({name})"
    return dataclasses.replace(
        description,
        shapes=[shapes[id(s)] for s in description.shapes],
        sensors=[sensor(s) for s in description.sensors],
        lamps=[_lamp(lamp, to) for lamp in description.lamps],
        notes=[*description.notes, note],
    ), origin


def coarse(description: Description) -> list[str]:
    """Of meshes whose file holds vertices in float32 too far from its origin, how coarse these are."""
    notes = []
    groups = {id(s.group): s.group for s in description.shapes if isinstance(s, Instance)}
    members = [s for group in groups.values() for s in group.shapes]
    for shape in (*description.shapes, *members):
        if not isinstance(shape, Mesh):
            continue
        v = used_vertices(shape)
        size, step = float(np.ptp(v, axis=0).max()), float(np.abs(v).max()) * 2.0**-23
        if size < COARSE * step and (v == v.astype(np.float32)).all():
            notes.append(
                f"{shape.id or 'mesh'}: its vertices are {size:.2g} apart and known to {step:.1g}, for float32 holds "
                "no more so far from the origin; store them about their middle and move them by to_world"
            )
    return notes


def _shift(by: Any) -> np.ndarray:
    m = np.eye(4)
    m[:3, 3] = by
    return m


def _moved(shape: Any, to: np.ndarray) -> Any:
    """A shape in another place, its own coordinates about their middle where they are far from 0."""
    place = to @ shape.to_world
    if isinstance(shape, Mesh):
        low, high = shape.vertices.min(0), shape.vertices.max(0)
        middle, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low)
        rest = lambda c: {"vertices": shape.vertices - c}
    elif isinstance(shape, Sphere):
        middle, radius = shape.center, shape.radius
        rest = lambda c: {"center": shape.center - c}
    elif isinstance(shape, Cylinder):
        middle, radius = 0.5 * (shape.p0 + shape.p1), shape.radius
        rest = lambda c: {"p0": shape.p0 - c, "p1": shape.p1 - c}
    else:
        return dataclasses.replace(shape, to_world=place)
    if np.linalg.norm(middle) <= FAR * radius:
        return dataclasses.replace(shape, to_world=place)
    return dataclasses.replace(shape, to_world=place @ _shift(middle), **rest(middle))


def _lamp(lamp: Any, to: np.ndarray) -> Any:
    if isinstance(lamp, Point):
        return dataclasses.replace(lamp, position=lamp.position + to[:3, 3])
    if isinstance(lamp, (Projector, Goniometric)):
        return dataclasses.replace(lamp, to_world=to @ lamp.to_world)
    return lamp


__all__ = ["coarse", "recentred"]
