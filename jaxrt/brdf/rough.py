"""Rough conductors as Mitsuba has them: separable Smith masking, GGX or Beckmann normals, single scattering.

f_r = F D G₁(ω_i) G₁(ω_o) / (4 cosθ_i cosθ_o). Both draw directions as `ggx` does: Beckmann's D is nowhere more than
4/e times that of GGX with the same roughness.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..vector import Spectrum, Vec3, normalise
from . import ggx
from .lobe import Lobe


class Normals(NamedTuple):
    """How facets are turned: D(h), and of a direction above the surface G₁/(2 cosθ); GGX's also of those below."""

    distribution: Callable[[Any, Vec3], Any]
    masked: Callable[[Any, Vec3], Any]


def _smith(m: Any, w: Vec3) -> Any:
    return 1.0 / ggx.positive(jnp.abs(w.z) + ggx.length(m, w))


def _beckmann(m: Any, h: Vec3) -> Any:
    ax, ay = m.alpha
    z2 = jnp.maximum(h.z * h.z, 1e-8)
    t2 = ((h.x / ax) ** 2 + (h.y / ay) ** 2) / z2
    some = t2 < 80.0  # else 0 in float32, but its derivative would be 0/0
    t2, z2 = jnp.where(some, t2, 80.0), jnp.where(some, z2, 1.0)
    return jnp.exp(-t2) / (np.pi * ax * ay * z2 * z2)


def _walter(m: Any, w: Vec3) -> Any:
    """Of Beckmann normals, by Walter's rational fit (2007) in a = 1/(α tanθ)."""
    ax, ay = m.alpha
    across = jnp.sqrt((ax * w.x) ** 2 + (ay * w.y) ** 2 + 1e-30)
    shallow = w.z < 1.6 * across
    across = jnp.where(shallow, across, 1.0)
    a = w.z / across
    fit = (3.535 + 2.181 * a) / (across * (1.0 + a * (2.276 + 2.577 * a)))
    return 0.5 * jnp.where(shallow, fit, 1.0 / ggx.positive(w.z))


GGX = Normals(ggx.distribution, _smith)
BECKMANN = Normals(_beckmann, _walter)


def reflected(normals: Normals, m: Any, h: Vec3, wi: Vec3, wo: Vec3) -> Any:
    """D G₁ G₁ / (4 cosθ_i cosθ_o)."""
    return normals.distribution(m, h) * normals.masked(m, wi) * normals.masked(m, wo)


def _eval(normals: Normals, m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    h = normalise(wi + wo)
    return ggx.facet(m, h, wo) * reflected(normals, m, h, wi, wo)


LOBES = tuple(
    Lobe(name, number, ggx.LOBE.fields, ggx.sample, functools.partial(_eval, normals), ggx.pdf)
    for name, number, normals in (("ggx_separable", 3, GGX), ("beckmann", 4, BECKMANN))
)
