"""Meters: sensors without a picture. Radiance along one ray, over a shape, or from far away."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from ..sampling import warp
from ..vector import Frame, Vec3, cross, length, normalise
from ..world import AREA, safe_norm


class Area(eqx.Module):
    """Faces of one kind with their areas: points with even density over all of them.

    `rows`: origin, e₁ and e₂ as in `World.geometry`, and the side that is the front; one of no extent is a point.
    `ends`: sums of areas (m²) up to each face.
    """

    rows: Any
    ends: Any
    kind: str = eqx.field(static=True)

    @classmethod
    def of(cls, rows: Any, kind: str) -> Area:
        return cls(rows, jnp.cumsum(AREA[kind] * safe_norm(jnp.cross(rows[:, 3:6], rows[:, 6:9]))), kind)

    def point(self, u: tuple[Any, Any], v: Any) -> tuple[Vec3, Vec3, Any]:
        """A point, the normal of the front there, and 1, which carries the derivative of the face's share. `u` lies as
        Mitsuba has it on a rectangle, disk or sphere; `v` chooses among faces."""
        n, k, weight = len(self.ends), 0, jnp.ones_like(v)
        if n > 1:
            k = jnp.searchsorted(sg(self.ends), v * sg(self.ends[-1]), side="right", method="scan")
            k = jnp.minimum(k, n - 1)
        row = self.rows[k]
        o, e1, e2 = (Vec3(row[j], row[j + 1], row[j + 2]) for j in (0, 3, 6))
        if n > 1:
            share = AREA[self.kind] * length(cross(e1, e2)) / self.ends[-1]
            weight = share / sg(share)
        if self.kind == "sphere":
            axes = Frame(normalise(e1), normalise(e2), normalise(cross(e1, e2)))
            normal = axes.to_world(warp.uniform_sphere((u[1], u[0])))
            p = o + normal * length(e1)
        elif self.kind == "cylinder":
            (c, s), across = warp.circle(u[1]), normalise(e2)
            normal = across * c + cross(normalise(e1), across) * s
            p = o + e1 * u[0] + normal * length(e2)
        else:
            f, g = warp.FLAT[self.kind](u)
            normal, p = normalise(cross(e1, e2)), o + e1 * f + e2 * g
        return p, normal * row[9], weight


def single(to_world: Any) -> tuple[Vec3, Vec3]:
    """The one ray of a radiancemeter: along +z of its own space."""
    column = lambda j: Vec3(*(to_world[i, j] for i in range(3)))
    return column(3), normalise(column(2))


def from_afar(to_world: Any, sphere: Any, target: Area | None, u: tuple[Any, Any], v: Any) -> tuple[Vec3, Vec3, Any]:
    """A ray of a distant sensor and its weight 1: along +z of its own space, from beyond the scene's `sphere` (centre,
    radius) to a point of `target`; without one, through the sphere's cross section."""
    d, radius = single(to_world)[1], sphere[3]
    if target is not None:
        p, _, weight = target.point(u, v)
        return p - d * (2.0 * radius), d, weight
    a, b = warp.uniform_disk(u)
    frame = Frame.around(d)
    middle = Vec3(sphere[0], sphere[1], sphere[2]) + (frame.s * a + frame.t * b - d) * radius
    return middle, d, jnp.ones_like(v)


__all__ = ["Area", "from_afar", "single"]
