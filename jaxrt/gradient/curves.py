"""Outlines of curved faces: rims of disks and cylinders, and where spheres and cylinders turn away from who looks.

A curve is y(u), u in [0, 1], of one face as seen from a point x. Where it is an outline because the face turns away,
the points of M on it change as x moves; only their motion along the normal counts, and that is the face's own.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..scene import KINDS
from ..vector import Vec3, cross, dot, length, normalise, safe_sqrt, where
from ..world import World

PARTS = 8
"""Parts of even u that a curve is chosen by."""

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


def corners(world: World, face: Any) -> tuple[Vec3, Vec3, Vec3]:
    """Origin, e₁ and e₂ of a face, attached."""
    row = world.geometry.at[face].get(mode="clip", wrap_negative_indices=False)
    return tuple(Vec3(row[k], row[k + 1], row[k + 2]) for k in (0, 3, 6))  # pyright: ignore[reportReturnType]


def _turn(u: Any) -> tuple[Any, Any]:
    return jnp.cos(2 * np.pi * u), jnp.sin(2 * np.pi * u)


def point(world: World, face: Any, name: str, x: Vec3, u: Any) -> tuple[Vec3, Vec3, Vec3]:
    """y(u) that moves with the face, dy/du, and a point of M (m) beside the curve; x and normals are held fixed.

    Where there is no such curve dy/du is 0.
    """
    o, a, b = corners(world, face)
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


class Parts(eqx.Module):
    """Even parts of all curves as seen from a point x: directions of their middles, radii of what they take about
    these (radians), and the angles they take over their distances."""

    w: Vec3
    reach: Any
    rate: Any

    @property
    def count(self) -> int:
        return len(self.rate)

    def seen_in(self, plane: Any) -> Parts:
        """As a mirror shows them, if x is the image of a point there."""
        return Parts(self.w - plane.n * (2.0 * dot(plane.n, self.w)), self.reach, self.rate)

    def weigh(self, cones: Any) -> Any:
        """How often to choose each, where it may be inside all of some cones."""
        weight = self.rate
        for cone in cones:
            if cone is not None:
                half = jnp.arcsin(jnp.minimum(cone.sine, 1.0))
                off = jnp.arctan2(length(cross(self.w, cone.axis)), dot(self.w, cone.axis))
                near = off < half + self.reach
                weight = jnp.where(near | (cone.sine >= 1.0), weight, 0.0)
        return weight


def parts(world: World, blocks: tuple[int, ...], x: Vec3) -> Parts:
    """Those of all curves: of `listed` the first's parts first."""
    kinds, faces, names = listed(blocks)
    middles = (np.arange(PARTS) + 0.5) / PARTS
    found = []
    for k, name in enumerate(names):
        mine = jnp.asarray(np.repeat(faces[kinds == k], PARTS))
        u = jnp.asarray(np.tile(middles, int((kinds == k).sum())), world.faces.dtype)

        def one(face: Any, u: Any, name: str = name) -> Parts:
            y, along, _ = point(world, face, name, x, u)
            to, long = y - x, length(along) / PARTS
            r = jnp.maximum(length(to), world.epsilon)
            # A part that is seen end-on in its middle is seen from the side elsewhere.
            angle = jnp.maximum(length(cross(to, along)) / (r * r * PARTS), 0.2 * long / r)
            reach = jnp.arctan2(0.6 * long, r)
            return Parts(to * (1.0 / r), jnp.where(long > r, np.pi, reach), angle / r)

        found.append(jax.vmap(one)(mine, u))
    if not found:
        zero = jnp.zeros(0, world.faces.dtype)
        return Parts(Vec3(zero, zero, zero), zero, zero)
    return jax.tree.map(lambda *a: jnp.concatenate(a), *found)
