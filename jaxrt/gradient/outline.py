"""Which part of an edge lies before a lamp, or in a mirror: where its great circle crosses a flat face's outline."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..vector import Vec3, dot, where
from ..world import World
from .curves import corners

FLAT = {"triangle", "parallelogram"}


class Outline(eqx.Module):
    """Triangles and parallelograms as seen from a point: their corners, less that point, in order; of other faces
    (`flat` is false; of None all are) the cone around them has to do."""

    corners: tuple[Vec3, Vec3, Vec3, Vec3]
    flat: Any

    @classmethod
    def of(cls, world: World, face: Any, x: Vec3, kinds: Iterable[str]) -> Outline:
        """Of a face; `kinds`: those that it may be of."""
        o, a, b = corners(world, face)
        four, last = face >= world.first("parallelogram"), o + b
        at = o, o + a, where(four, last + a, last), last
        first, second, third, fourth = (sg(p) - x for p in at)
        flat = (face >= 0) & (face < world.first("disk")) if set(kinds) - FLAT else None
        return cls((first, second, third, fourth), flat)

    def cut(self, arc: Any) -> tuple[Any, Any]:
        """The range of φ in which the great circle of an arc lies inside, from the arc's middle; empty: low > high."""
        ends_of = [(p, dot(arc.pole, p)) for p in self.corners]  # and their heights above the circle
        ends, found = [], False
        for up in (True, False):
            place = arc.middle * 0.0
            for k in range(4):
                (p, g), (q, h) = ends_of[k], ends_of[(k + 1) % 4]
                goes = (g < 0) & (h >= 0) if up else (g >= 0) & (h < 0)
                crossing = p + (q - p) * (g / jnp.where(goes, g - h, 1.0))
                place, found = where(goes, crossing, place), found | goes
            ends.append(jnp.arctan2(dot(arc.along, place), dot(arc.middle, place)))
        start, span = ends[0], ends[1] - ends[0]
        stop = start + span - 2 * np.pi * jnp.round(span / (2 * np.pi))
        return jnp.where(found, jnp.minimum(start, stop), 1.0), jnp.where(found, jnp.maximum(start, stop), -1.0)
