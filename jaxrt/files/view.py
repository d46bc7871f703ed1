"""What a scene file leaves out: a view, a light, and the side of a mesh that is outside."""

from __future__ import annotations

import copy
import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..parts import (
    Cylinder,
    Description,
    Dielectric,
    Diffuse,
    Disk,
    Enclosure,
    Film,
    Instance,
    Mesh,
    MeshAttribute,
    Null,
    Rectangle,
    SceneError,
    SdfGrid,
    Sensor,
    Shape,
    Sphere,
    Texture,
    TwoSided,
    brightness,
)
from .transforms import look_at

# The default view. 35 degrees: a short telephoto lens, which shows an object without much perspective.
FOV = 35.0
AZIMUTH = 30.0  # degrees to the right of the front (+z, glTF 3.3), so that two sides are seen
ELEVATION = 20.0  # above the horizon, so that the top is seen too
MARGIN = 0.06  # of half the picture is left free around the object
SIZE = 512

# The default light. The enclosure of radiance 1 gives an irradiance of π on a surface in the open, all alike;
# a key light of half of that shapes the object, yet keeps white (reflectance 0.6) surfaces below radiance 1.
RADIANCE = 1.0
KEY_IRRADIANCE = np.pi / 2


def complete(description: Description, *, light: bool = True, orient: bool = False) -> Description:
    """The description with what it lacks, and one note for each addition.

    A scene without a sensor gets a view of all its shapes from the front right and a little above,
    with +y up. A scene without emission gets an enclosure of radiance 1 and, if its first camera
    stands outside of its shapes, a softbox behind and above left of that camera; with `light` False
    only a note that it is dark. With `orient`, meshes which are not closed and wound outwards reflect
    on both sides. The given description is left as it is.
    """
    shapes, sensors, notes = list(description.shapes), list(description.sensors), list(description.notes)
    enclosure = description.enclosure
    if not shapes:
        raise SceneError("the scene has no shapes; add at least one")
    if orient:
        shapes, turned = _both_sides(shapes)
        if turned:
            notes.append(f"not closed, or not wound outwards, so reflecting on both sides: {', '.join(turned)}")
    with np.errstate(over="ignore", invalid="ignore"):  # absurd places are refused where they matter
        points = scene_points(shapes)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if not sensors:
        if not size < 1e15:  # beyond, squares of lengths overflow in float32
            raise SceneError("the scene is too large to look at; give it a smaller scale")
        sensors = [default_view(points)]
        notes.append(f"no camera: added a view from the front right, {FOV:g} degrees, +y up")
    lit = any(isinstance(s, Shape) and s.emission is not None and _shines(s.emission) for s in shapes)
    lit |= any(_shines(getattr(lamp, brightness(lamp))) for lamp in description.lamps)
    if not (lit or (enclosure is not None and _shines(enclosure.radiance))):
        if light:
            enclosure = Enclosure(RADIANCE, id=enclosure.id if enclosure else "")
            box = softbox(sensors[0], points) if size < 1e15 else None
            shapes += [box] if box else []
            notes.append(
                f"no light: added an enclosure of radiance {RADIANCE:g}" + " and a softbox" * (box is not None)
            )
        else:
            notes.append("no light: nothing emits, so the picture will be black; add an emitter")
    return dataclasses.replace(description, shapes=shapes, sensors=sensors, enclosure=enclosure, notes=notes)


def used_vertices(mesh: Mesh) -> np.ndarray:
    """The vertices (N, 3) that faces use; others may be anywhere."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    return mesh.vertices[used]


def scene_points(shapes: Iterable[Shape | Instance]) -> np.ndarray:
    """Points (N, 3) in the world whose convex hull holds all shapes; those of a group are found once."""
    groups: dict[int, np.ndarray] = {}
    found = []
    for shape in shapes:
        if isinstance(shape, Instance):
            if id(shape.group) not in groups:
                groups[id(shape.group)] = scene_points(shape.group.shapes)
            found.append(groups[id(shape.group)] @ shape.to_world[:3, :3].T + shape.to_world[:3, 3])
        else:
            found.append(world_points(shape))
    return np.concatenate(found)


def world_points(shape: Shape) -> np.ndarray:
    """Points (N, 3) in the world whose convex hull holds the shape; of a mesh the vertices that faces use."""
    unit = lambda *z: np.array(list(itertools.product((-1.0, 1.0), (-1.0, 1.0), z)))
    if isinstance(shape, Mesh):
        local = used_vertices(shape)
    elif isinstance(shape, Sphere):
        local = shape.center + shape.radius * unit(-1, 1)
    elif isinstance(shape, Cylinder):
        local = np.concatenate([p + shape.radius * unit(-1, 1) for p in (shape.p0, shape.p1)])
    elif isinstance(shape, SdfGrid):
        local = 0.5 + 0.5 * unit(-1, 1)
    else:
        local = unit(0) if isinstance(shape, Rectangle | Disk) else unit(-1, 1)
    return local @ shape.to_world[:3, :3].T + shape.to_world[:3, 3]


def default_view(points: np.ndarray) -> Sensor:
    """The view of `points` (N, 3): the nearest on its line of sight that holds them all inside the margin."""
    low, high = points.min(0), points.max(0)
    center = low + (high - low) / 2
    size = float(np.linalg.norm(high - low)) or 1.0
    azimuth, elevation = np.radians(AZIMUTH), np.radians(ELEVATION)
    flat = np.cos(elevation)
    back = np.array([flat * np.sin(azimuth), np.sin(elevation), flat * np.cos(azimuth)])
    axes = look_at(back.tolist(), (0, 0, 0), (0, 1, 0))[:3, :3]
    p = (points - center) @ axes  # in the camera's axes, z away from it
    # p is in the picture from a distance d if |x|, |y| <= t (d + z)
    t = np.tan(np.radians(FOV) / 2) * (1 - MARGIN)
    d = max(float((np.abs(p[:, :2]).max(1) / t - p[:, 2]).max()), 0.55 * size)  # a line seen end-on: stand off too
    pose = look_at((center + d * back).tolist(), center.tolist(), (0, 1, 0))
    return Sensor(to_world=pose, fov=FOV, near=1e-3 * d, far=1e3 * d, film=Film(SIZE, SIZE))


def softbox(sensor: Sensor, points: np.ndarray) -> Rectangle | None:
    """A square light behind and above left of the camera, `KEY_IRRADIANCE` at the centre of `points`.

    None if the camera is within the bounding box of the points, for there it would light walls from outside.
    """
    low, high = points.min(0), points.max(0)
    center = low + (high - low) / 2
    pose = sensor.to_world
    left, up, ahead = (pose[:3, k] / np.linalg.norm(pose[:3, k]) for k in range(3))
    d = float(np.linalg.norm(center - pose[:3, 3]))
    # 40 degrees from the view, as in portraits; a quarter of the distance to a side: soft, but with a direction.
    # Its edges reach .35 d towards the camera's plane at most, so .4 d behind that it is never in the picture.
    origin = pose[:3, 3] - 0.4 * d * ahead + 0.8 * d * left + 0.8 * d * up
    half = 0.25 * d
    inside = ((pose[:3, 3] >= low) & (pose[:3, 3] <= high)).all()
    nearest = np.clip(origin, low, high)
    if inside or np.linalg.norm(nearest - origin) <= 2 * half or not d > 0:
        return None
    to_world = look_at(origin.tolist(), center.tolist(), up.tolist()) @ np.diag([half, half, 1.0, 1.0])
    radiance = KEY_IRRADIANCE * float(np.sum((center - origin) ** 2)) / (2 * half) ** 2
    return Rectangle(
        id="softbox", to_world=to_world, bsdf=Diffuse(0.0), emission=radiance, emission_id="softbox.emitter"
    )


def _both_sides(shapes: list[Shape | Instance]) -> tuple[list[Shape | Instance], list[str]]:
    """The shapes with a `TwoSided` BSDF on each mesh that is not closed and wound outwards, and their names."""
    made: dict[int, TwoSided] = {}
    out, turned = [], []
    for shape in shapes:
        if (
            isinstance(shape, Mesh)
            and not isinstance(bsdf := shape.bsdf, (TwoSided, Dielectric, Null))
            and not closed_outwards(shape)
        ):
            shape = copy.copy(shape)  # shares the arrays
            shape.bsdf = made.setdefault(id(bsdf), TwoSided(bsdf))  # one BSDF for all meshes that share one
            turned.append(shape.id or "mesh")
        out.append(shape)
    return out, turned


def closed_outwards(mesh: Mesh) -> bool:
    """Whether every edge has one face on each side, wound alike, and each connected part a positive volume.

    Vertices at one position count as one. A hollow (a part inside another, wound inwards) answers False
    too: nothing is lost, as reflection on both sides is only more work there.
    """
    position = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    f = position[mesh.faces].astype(np.int64)
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    n = int(position.max(initial=0)) + 1
    a, b = f.reshape(-1), np.roll(f, -1, axis=1).reshape(-1)
    there, back = np.sort(a * n + b), np.sort(b * n + a)
    if not len(f) or (there[1:] == there[:-1]).any() or (there != back).any():
        return False
    part = np.arange(n)  # the least vertex that each is connected to, by jumping to what the neighbours know
    while True:
        least = part.copy()
        np.minimum.at(least, f.reshape(-1), np.repeat(part[f].min(1), 3))
        least = least[least]
        if (least == part).all():
            break
        part = least
    p = mesh.vertices[mesh.faces] - mesh.vertices[mesh.faces].reshape(-1, 3).mean(0)
    volume = np.bincount(
        part[position[mesh.faces[:, 0]]], np.einsum("fi,fi->f", p[:, 0], np.cross(p[:, 1], p[:, 2])), n
    )
    used = np.unique(part[f[:, 0]])
    return bool((volume[used] > 0).all()) and np.linalg.det(mesh.to_world[:3, :3]) > 0


def _shines(radiance: Any) -> bool:
    if isinstance(radiance, MeshAttribute):  # which only a mesh knows
        return radiance.scale > 0
    return bool(np.any((radiance.mean() if isinstance(radiance, Texture) else radiance) > 0))
