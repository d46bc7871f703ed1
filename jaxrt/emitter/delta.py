"""Lamps that are no surfaces: points, spots, projectors, beams from afar, which only light samples find; the sun."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from ..parts import LAMPS
from ..surface import _vec, textured
from ..texture import Place
from ..vector import Spectrum, Vec3, cross, dot, normalise, safe_sqrt, where
from ..world import World
from . import goniometric

ALONE = 1e30
"""Stands for the density of a direction that nothing else can draw, in weights against reflection."""


def sample(world: World, x: Vec3, row: Any, u: tuple[Any, Any]) -> tuple[Vec3, Any, Spectrum, Any, Any]:
    """Direction from x to the lamp of a row, distance (m), radiance over solid angle, its chance, and `ALONE`. Of the
    sun the direction alone, drawn by u."""
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
    radiance = Spectrum(tuple(row[14 + c] for c in range(plan.channels)))
    if "projector" in plan.lamp_kinds:
        light, inside = _projected(world, row, axis, -to)
        here = kind == LAMPS.index("projector")
        radiance = where(here, light, radiance)
        seen = jnp.where(here, inside, seen)
    if plan.web:
        here = kind == LAMPS.index("goniometric")
        light = goniometric.intensity(world, jnp.where(here, row[6], 0.0), axis, _vec(row, 9), -to)
        radiance = where(here, light, radiance)
    radiance = radiance * seen
    chance = row[13]
    known = jnp.where(chance > 0, ALONE, 0.0)
    if world.sun is not None:
        here = kind == LAMPS.index("sun")
        w = where(here, world.sun.sample(u), w)
        distance = jnp.where(here, 4.0 * world.radius + 1.0, distance)
    return w, distance, radiance, chance, known


def _projected(world: World, row: Any, axis: Vec3, to: Vec3) -> tuple[Spectrum, Any]:
    """A picture's irradiance towards a point that lies `to` away from its lamp, and what it makes there: 1/(z² cosθ) of
    that, within the picture."""
    up = _vec(row, 9)
    z, across = dot(to, axis), Vec3(dot(to, cross(up, axis)), dot(to, up), 0.0)
    before = z > 0
    depth = jnp.where(before, z, 1.0)
    x, y = across.x / (depth * row[6]), across.y / (depth * row[7])
    uv = 0.5 - 0.5 * x, 0.5 - 0.5 * y
    inside = before & (jnp.abs(x) <= 1) & (jnp.abs(y) <= 1)
    place = Place(uv, jnp.zeros_like(z, jnp.int32), uv)
    dark = Spectrum.full(world.plan.channels, 0.0 * z)
    light = textured(world, row[15 + world.plan.channels], place, dark)
    return light, jnp.where(inside, safe_sqrt(dot(to, to)) / (depth * depth * depth), 0.0)


__all__ = ["ALONE", "sample"]
