"""Coordinates (u, v) on surfaces, as Mitsuba has them, and the tangents ∂p/∂u and ∂p/∂v.

Flat faces have them by corners. Disks have radius and angle, spheres the angles φ and θ, cylinders φ and height; angles
count from 0 to 1. Grids of distances have (0, 0) everywhere, and no tangents.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from .scene import FACE, KINDS, Scene
from .texture import Place
from .vector import Frame, Vec3, cross, dot, normalise, safe_sqrt, where

NONE = 1e30
"""Coordinates of vertices that have none: such a face counts from its first corner."""

COLUMNS = 6
"""In a face's row. Flat: (u, v) of the first corner, along e₁, along e₂. Spheres: axes x and z; cylinders: axis y."""


def of_corners(scene: Scene) -> Any:
    """(u, v) of each triangle's first corner, and its changes along both edges; 0 and 1 where the mesh has none."""
    uv = scene.uvs[scene.triangles]
    given = (uv < 0.5 * NONE).all((1, 2))[:, None]
    plain = jnp.asarray([[0.0, 0], [1, 0], [0, 1]], uv.dtype)
    uv = jnp.where(given[:, None], uv, plain[None])
    return jnp.concatenate([uv[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], -1)


def of_rows(scene: Scene, kind: str, m: Any, a: Any, b: Any) -> Any:
    """What the rows of a kind hold for their coordinates, (n, `COLUMNS`), for maps m to the world and edges a and b."""
    none, unit = jnp.zeros((len(a), 3), a.dtype), lambda v: v / jnp.maximum(jnp.linalg.norm(v, axis=-1), 1e-30)[:, None]
    if kind == "triangle":
        return of_corners(scene)
    if kind == "parallelogram":
        one, down = (jnp.asarray(row, a.dtype)[None] for row in ([0.0, 0, 1, 0, 0, 1], [0.0, 1, 1, 0, 0, -1]))
        return jnp.where(_of_cube(scene)[:, None], down, one)
    if kind == "sphere":
        return jnp.concatenate([unit(m[:, :, 0]), unit(m[:, :, 2])], -1)
    if kind == "cylinder":
        mirrored = jnp.where(jnp.linalg.det(m) < 0, -1.0, 1.0)[:, None]
        return jnp.concatenate([unit(jnp.cross(a, b)) * mirrored, none], -1)
    return jnp.concatenate([none, none], -1)


def _of_cube(scene: Scene) -> Any:
    """Which parallelograms are sides of cubes, whose v counts against the second edge."""
    return scene.patches[: scene.blocks[1], 2] != 0


def first_axis(d: Any) -> Any:
    """For each axis of a cylinder (n, 3) a unit vector across it, from which its angle counts."""
    return Frame.around(normalise(Vec3.of(d))).s.array()


def tangents(scene: Scene, kind: str, a: Any, b: Any) -> Any:
    """∂p/∂u and ∂p/∂v of flat faces, (n, 6); 0 where a mesh's coordinates do not change, and of curved faces."""
    if kind == "parallelogram":
        return jnp.concatenate([a, jnp.where(_of_cube(scene)[:, None], -b, b)], -1)
    if kind != "triangle":
        return jnp.zeros((len(a), 6), a.dtype)
    corners = of_corners(scene)
    d1, d2 = corners[:, 2:4], corners[:, 4:6]
    det = (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])[:, None]
    safe = jnp.where(det != 0, det, 1.0)
    du, dv = (a * d2[:, 1:] - b * d1[:, 1:]) / safe, (b * d1[:, :1] - a * d2[:, :1]) / safe
    return jnp.where(det != 0, jnp.concatenate([du, dv], -1), 0.0)


def _turn(y: Any, x: Any) -> Any:
    """The angle of (x, y), from 0 to 1, with derivative 0 at the origin."""
    some = x * x + y * y > 0
    angle = jnp.arctan2(jnp.where(some, y, 0.0), jnp.where(some, x, 1.0)) / (2.0 * np.pi)
    return jnp.where(angle < 0, angle + 1.0, angle)


def place(world: Any, row: Any, number: Any, on_face: tuple[Any, Any], out: Vec3, height: Any) -> Place:
    """Where a point lies for textures. `row`: its face's, of number `number`; `on_face`: coordinates on a flat face;
    `out`, `height`: outward normal of a curved one, and how far up a cylinder it is."""
    cells = [row[world.faces.shape[1] - COLUMNS + k] for k in range(COLUMNS)]
    s, t = on_face
    u, v = (cells[k] + cells[k + 2] * s + cells[k + 4] * t for k in range(2))
    for kind in KINDS[2:]:
        if world.blocks[KINDS.index(kind)] == 0:
            continue
        if kind == "disk":
            one = safe_sqrt(s * s + t * t), _turn(t, s)
        elif kind == "sdfgrid":
            one = 0.0 * s, 0.0 * t
        else:
            across = normalise(Vec3(*(row[FACE["v"] + k] for k in range(3))))
            first, second = Vec3(*cells[:3]), Vec3(*cells[3:])
            if kind == "sphere":
                x, y, z = dot(out, first), dot(out, across), dot(out, second)
                polar = jnp.arctan2(safe_sqrt(x * x + y * y), z) / np.pi
                one = _turn(y, x), polar
            else:
                one = _turn(dot(out, first), dot(out, across)), height
        u, v = where(number >= world.first(kind), one, (u, v))
    return Place((u, v), jnp.maximum(number, 0), on_face)


def curved_tangents(
    world: Any, row: Any, p: Vec3, number: Any, on_face: tuple[Any, Any], out: Vec3, flat: tuple[Vec3, Vec3]
) -> Any:
    """∂p/∂u and ∂p/∂v, `flat` on flat faces. p: position from the middle of a curved one; `out`: its outward normal."""
    cells = [row[world.faces.shape[1] - COLUMNS + k] for k in range(COLUMNS)]
    across = normalise(Vec3(*(row[FACE["v"] + k] for k in range(3))))
    first, second = Vec3(*cells[:3]), Vec3(*cells[3:])
    for kind in KINDS[2:]:
        if world.blocks[KINDS.index(kind)] == 0:
            continue
        if kind == "disk":
            r = safe_sqrt(on_face[0] * on_face[0] + on_face[1] * on_face[1])
            radial = p * (1.0 / jnp.where(r > 0, r, 1.0))
            one = radial, cross(out, p) * (2.0 * np.pi)
        elif kind == "sdfgrid":
            one = out * 0.0, out * 0.0
        elif kind == "sphere":
            x, y, z = dot(p, first), dot(p, across), dot(p, second)
            rho = safe_sqrt(x * x + y * y)
            flat_part = first * x + across * y
            inverse = 1.0 / jnp.where(rho > 0, rho, 1.0)
            one = (
                (across * x - first * y) * (2.0 * np.pi),
                (flat_part * (z * inverse) - second * rho) * np.pi,
            )
        else:
            x, y = dot(out, across), dot(out, first)
            r, axis = row[FACE["height"]], Vec3(*(row[FACE["u"] + k] for k in range(3)))
            one = ((first * x - across * y) * (2.0 * np.pi * r), axis)
        flat = where(number >= world.first(kind), one, flat)
    return flat
