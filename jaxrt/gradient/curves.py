"""Outlines of curved faces: rims of disks and cylinders, and where spheres and cylinders turn away from who looks.

A curve is y(u), u in [0, 1], of one face as seen from a point x. Where it is an outline because the face turns away,
the points of M on it change as x moves; only their motion along the normal counts, and that is the face's own.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..scene import KINDS
from ..vector import Vec3, cross, dot, length, normalise, safe_sqrt, where
from ..world import World

PIECES = {"disk": ("rim",), "sphere": ("ring",), "cylinder": ("foot", "top", "left", "right")}


def listed(blocks: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Of every curve of a scene: which of the names that come third is its kind, and its face."""
    kinds, faces, names = [], [], []
    for kind, pieces in PIECES.items():
        k = KINDS.index(kind)
        if blocks[k] == 0:
            continue
        for piece in pieces:
            faces.append(np.arange(sum(blocks[:k]), sum(blocks[: k + 1])))
            kinds.append(np.full(blocks[k], len(names)))
            names.append(piece)
    join = lambda parts: np.concatenate(parts).astype(np.int32) if parts else np.zeros(0, np.int32)
    return join(kinds), join(faces), tuple(names)


def _face(world: World, face: Any) -> tuple[Vec3, Vec3, Vec3]:
    row = world.geometry.at[face].get(mode="clip", wrap_negative_indices=False)
    return tuple(Vec3(row[k], row[k + 1], row[k + 2]) for k in (0, 3, 6))  # pyright: ignore[reportReturnType]


def size(world: World, face: Any, name: Any, x: Vec3) -> tuple[Any, Any]:
    """About how long a curve is, and how far from x (m)."""
    o, a, b = _face(world, face)
    round_ = 2 * np.pi * jnp.maximum(length(a), length(b))
    if name in ("foot", "top"):
        round_ = 2 * np.pi * length(b)
    if name in ("left", "right"):
        return jnp.where(length(b) > 0, length(a), 0.0), length(o + a * 0.5 - x)
    return round_, length((o + a if name == "top" else o) - x)


def _turn(u: Any) -> tuple[Any, Any]:
    return jnp.cos(2 * np.pi * u), jnp.sin(2 * np.pi * u)


def point(world: World, face: Any, name: str, x: Vec3, u: Any) -> tuple[Vec3, Vec3, Vec3]:
    """y(u) that moves with the face, dy/du, and a point of M (m) beside the curve; x and normals are held fixed.

    Where there is no such curve dy/du is 0.
    """
    o, a, b = _face(world, face)
    x, c, s = sg(x), *_turn(u)
    if name == "rim":
        return o + a * c + b * s, sg(b * c - a * s) * (2 * np.pi), sg(o)
    if name == "ring":
        radius, to = length(a), x - sg(o)
        d = length(to)
        share = jnp.minimum(sg(radius) / jnp.maximum(d, 1e-30), 1.0)
        axis = normalise(to)
        first = normalise(cross(axis, where(jnp.abs(axis.x) < 0.5, Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0))))
        second, across = cross(axis, first), safe_sqrt(1.0 - share * share)
        n = axis * share + (first * c + second * s) * across
        along = (second * c - first * s) * (across * sg(radius) * 2 * np.pi)
        return o + n * radius, sg(along), sg(o)
    if name in ("foot", "top"):
        beside = cross(normalise(a), b)
        y = o + b * c + beside * s + (a if name == "top" else a * 0.0)
        return y, sg(beside * c - b * s) * (2 * np.pi), sg(o + a * 0.5)
    radius, axis = length(b), normalise(sg(a))
    to = x - sg(o)
    to = to - axis * dot(to, axis)
    share = jnp.minimum(sg(radius) / jnp.maximum(length(to), 1e-30), 1.0)
    out = normalise(to)
    across = cross(axis, out) * (safe_sqrt(1.0 - share * share) * (1.0 if name == "left" else -1.0))
    n = out * share + across
    return o + a * u + sg(n) * radius, sg(a) * jnp.where(share < 1, 1.0, 0.0), sg(o + a * u)
