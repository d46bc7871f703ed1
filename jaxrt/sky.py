"""Radiance of a clear sky from all directions above the horizon (Hosek and Wilkie 2012, "An analytic model for full
spectral sky-dome radiance", equation 8): nine coefficients and a scale a channel, as `jaxrt.parts.Sky` has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .vector import Spectrum, Vec3, cross, dot, safe_sqrt


def radiance(c: Sequence[Any], cos_theta: Any, gamma: Any, xp: Any = jnp) -> Any:
    """Radiance by the coefficients c: θ from the zenith, γ from the sun. They stand in the order of the authors' data:
    the eighth multiplies √cosθ, the ninth is that of χ. `xp`: numpy, on the host, or jax.numpy."""
    cos_gamma = xp.cos(gamma)
    horizon = 1 + c[0] * xp.exp(c[1] / (cos_theta + 0.01))
    bent = 1 + c[8] * (c[8] - 2 * cos_gamma)
    chi = (1 + cos_gamma * cos_gamma) / (bent * xp.sqrt(bent))
    sun = c[2] + c[3] * xp.exp(c[4] * gamma) + c[5] * (cos_gamma * cos_gamma) + c[6] * chi
    return xp.maximum(horizon * (sun + c[7] * xp.sqrt(cos_theta)) * c[9], 0.0)


def look_up(rows: Sequence[Spectrum], u: Any, v: Any) -> Spectrum:
    """The sky where an enclosure has its coordinates (u, v); black below the horizon. `rows`: a `Sky`'s values."""
    phi, theta = 2.0 * np.pi * u, np.pi * v
    s = jnp.sin(theta)
    w, sun = Vec3(jnp.sin(phi) * s, jnp.cos(theta), -jnp.cos(phi) * s), Vec3(*(row.channels[0] for row in rows[10:]))
    across = cross(w, sun)
    gamma = jnp.arctan2(safe_sqrt(dot(across, across)), dot(w, sun))  # precise near the sun as well
    above = v <= 0.5
    cos_theta = jnp.where(above, jnp.maximum(w.y, 1e-7), 1.0)  # at 0 the root has no slope
    of_channel = zip(*(row.channels for row in rows[:10]), strict=True)
    return Spectrum(tuple(jnp.where(above, radiance(c, cos_theta, gamma), 0.0) for c in of_channel))
