"""Lamps without extent: points, spots, and beams from afar. Only light samples find them; nothing can meet them."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from ..parts import LAMPS
from ..surface import _vec
from ..vector import Spectrum, Vec3, dot, normalise, safe_sqrt
from ..world import World

ALONE = 1e30
"""Stands for the density of a direction that nothing else can draw, in weights against reflection."""


def sample(world: World, x: Vec3, row: Any) -> tuple[Vec3, Any, Spectrum, Any, Any]:
    """Direction from x to the lamp of a row, distance (m), radiance over solid angle, its chance, and `ALONE`."""
    plan = world.plan
    position, axis, kind = _vec(row, 0), normalise(_vec(row, 3)), row[8]
    to = position - x
    d2 = dot(to, to)
    w, distance = normalise(to), safe_sqrt(d2)
    seen = 1.0 / jnp.maximum(d2, 1e-30)
    if "spot" in plan.lamp_kinds:
        cosine = -dot(w, axis)
        angle = jnp.arctan2(safe_sqrt((1.0 - cosine) * (1.0 + cosine)), cosine)
        cutoff, beam = row[6], row[7]
        slope = jnp.where(cutoff > beam, cutoff - beam, 1.0)
        share = jnp.where(angle <= beam, 1.0, jnp.where(angle < cutoff, (cutoff - angle) / slope, 0.0))
        seen = seen * jnp.where(kind == LAMPS.index("spot"), share, 1.0)
    if "directional" in plan.lamp_kinds:
        far = kind == LAMPS.index("directional")
        w = Vec3(*(jnp.where(far, -a, b) for a, b in zip(axis, w, strict=True)))
        distance, seen = jnp.where(far, 4.0 * world.radius + 1.0, distance), jnp.where(far, 1.0, seen)
    radiance = Spectrum(tuple(row[14 + c] * seen for c in range(plan.channels)))
    chance = row[13]
    return w, distance, radiance, chance, jnp.where(chance > 0, ALONE, 0.0)


__all__ = ["ALONE", "sample"]
