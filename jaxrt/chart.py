"""Coordinates of faces: a point of any kind of face as a pair in [0, 1]² with the same area everywhere, and back."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from .sampling.warp import circle
from .scene import KINDS
from .surface import SurfacePoint, _row, _vec
from .vector import Vec3, cross, dot, normalise, safe_sqrt, where
from .world import FACE, World


def coordinates(world: World, x: SurfacePoint) -> tuple[Any, Any]:
    """Coordinates in [0, 1]² of a point on its face, with the same area everywhere on it."""
    a, b = x.uv
    turn = lambda s, c: jnp.mod(jnp.arctan2(s, c) / (2 * np.pi), 1.0)
    if world.blocks[KINDS.index("disk")]:
        disk = (x.face >= world.first("disk")) & (x.face < world.first("sphere"))
        a, b = jnp.where(disk, a * a + b * b, a), jnp.where(disk, turn(b, a), b)
    if not sum(world.blocks[KINDS.index("sphere") :]):
        return a, b
    row = _row(world.geometry, jnp.maximum(x.face, 0))
    o, e1, e2 = _vec(row, 0), _vec(row, 3), _vec(row, 6)
    v = x.position - o
    if world.blocks[KINDS.index("sphere")]:
        ball = (x.face >= world.first("sphere")) & (x.face < world.first("cylinder"))
        n = normalise(v)
        a, b = jnp.where(ball, 0.5 + 0.5 * n.z, a), jnp.where(ball, turn(n.y, n.x), b)
    if world.blocks[KINDS.index("cylinder")]:
        tube = x.face >= world.first("cylinder")
        across = cross(normalise(e1), e2)
        height = dot(v, e1) / jnp.where(tube, dot(e1, e1), 1.0)
        a, b = jnp.where(tube, height, a), jnp.where(tube, turn(dot(v, across), dot(v, e2)), b)
    return a, b


def place(world: World, face: Any, a: Any, b: Any) -> tuple[Vec3, Vec3]:
    """Position and normal (of the front) at coordinates of a face: the inverse of `coordinates`."""
    row = _row(world.geometry, face)
    o, e1, e2 = _vec(row, 0), _vec(row, 3), _vec(row, 6)
    table = _row(world.faces, face)
    n, side = _vec(table, FACE["n"]), table[FACE["side"]]
    c, s = circle(b)
    if world.blocks[KINDS.index("disk")]:
        disk, r = face >= world.first("disk"), safe_sqrt(a)
        f, g = jnp.where(disk, r * c, a), jnp.where(disk, r * s, b)
    else:
        f, g = a, b
    y = o + e1 * f + e2 * g
    if world.blocks[KINDS.index("sphere")]:
        ball = face >= world.first("sphere")
        z = 2.0 * a - 1.0
        r = safe_sqrt(1.0 - z * z)
        out = Vec3(r * c, r * s, z)
        y, n = where(ball, o + out * safe_sqrt(dot(e1, e1)), y), where(ball, out * side, n)
    if world.blocks[KINDS.index("cylinder")]:
        tube = face >= world.first("cylinder")
        out = normalise(e2) * c + cross(normalise(e1), normalise(e2)) * s
        y, n = where(tube, o + e1 * a + out * safe_sqrt(dot(e2, e2)), y), where(tube, out * side, n)
    return y, n


def off_surface(world: World, y: Vec3, n: Vec3) -> Vec3:
    """A point so little above one of a surface that a ray back along n lands there, also within a small sphere."""
    return y + n * (4.0 * world.epsilon)


def even_point(world: World, face: Any, u: tuple[Any, Any]) -> tuple[Vec3, Vec3]:
    """A point of a face with even density, and the normal of its front."""
    fold = (face < world.first("parallelogram")) & (u[0] + u[1] > 1.0)
    a, b = (jnp.where(fold, 1.0 - c, c) for c in u)
    return place(world, face, a, b)
