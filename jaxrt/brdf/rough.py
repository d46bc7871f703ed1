"""Rough conductors as Mitsuba has them: separable Smith masking, GGX or Beckmann normals, single scattering.

f_r = F D G₁(ω_i) G₁(ω_o) / (4 cosθ_i cosθ_o). Both draw directions as `ggx` does: Beckmann's D is nowhere more than
4/e times that of GGX with the same roughness.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..vector import Spectrum, Vec3, normalise
from . import ggx
from .lobe import Lobe


def separable(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    h = normalise(wi + wo)
    masked = lambda w: 1.0 / ggx.positive(w.z + ggx.length(m, w))  # G₁/(2 cosθ)
    return ggx.facet(m, h, wo) * (ggx.distribution(m, h) * masked(wi) * masked(wo))


def _beckmann(m: Any, h: Vec3) -> Any:
    ax, ay = m.alpha
    z2 = jnp.maximum(h.z * h.z, 1e-8)
    t2 = ((h.x / ax) ** 2 + (h.y / ay) ** 2) / z2
    return jnp.exp(-t2) / (np.pi * ax * ay * z2 * z2)


def _masked(m: Any, w: Vec3) -> Any:
    """G₁/(2 cosθ) of Beckmann normals, by Walter's rational fit (2007) in a = 1/(α tanθ)."""
    ax, ay = m.alpha
    across = jnp.sqrt((ax * w.x) ** 2 + (ay * w.y) ** 2 + 1e-30)
    shallow = w.z < 1.6 * across
    across = jnp.where(shallow, across, 1.0)
    a = w.z / across
    fit = (3.535 + 2.181 * a) / (across * (1.0 + a * (2.276 + 2.577 * a)))
    return 0.5 * jnp.where(shallow, fit, 1.0 / ggx.positive(w.z))


def beckmann(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    h = normalise(wi + wo)
    return ggx.facet(m, h, wo) * (_beckmann(m, h) * _masked(m, wi) * _masked(m, wo))


FIELDS = ggx.LOBE.fields
SEPARABLE = Lobe("ggx_separable", 3, FIELDS, ggx.sample, separable, ggx.pdf)
BECKMANN = Lobe("beckmann", 4, FIELDS, ggx.sample, beckmann, ggx.pdf)
