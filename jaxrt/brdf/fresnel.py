"""Fresnel reflectance of unpolarised light."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from ..vector import Spectrum, safe_sqrt


def conductor(eta: Spectrum, k: Spectrum, cos_theta: Any) -> Spectrum:
    """Reflectance of a metal of index η + ik (relative to the outside) at incidence cosθ > 0 (Lagarde 2013).

    eta 0 and k 1 reflect exactly 1. The root of a difference is taken in the form that does not cancel,
    which also keeps the derivative with respect to η finite at η = 0.
    """
    grazing = cos_theta <= 0
    cos_theta = jnp.maximum(cos_theta, 1e-9)  # its square is a normal number
    c2 = cos_theta * cos_theta
    s2 = jnp.where(c2 > 1.0, 0.0, 1.0 - c2)

    def one(n: Any, kk: Any) -> Any:
        t0 = (n - 1.0) * (n + 1.0) - kk * kk + c2  # η² − k² − sin²θ, without cancelling at η = 1
        a2b2 = safe_sqrt(t0 * t0 + 4.0 * n * n * kk * kk)
        negative = t0 < 0
        down = n * kk * safe_sqrt(2.0 / jnp.where(negative, a2b2 - t0, 1.0))
        a = jnp.where(negative, down, safe_sqrt(0.5 * (a2b2 + jnp.where(negative, 0.0, t0))))
        t1, t2 = a2b2 + c2, 2.0 * a * cos_theta
        t3, t4 = c2 * a2b2 + s2 * s2, t2 * s2
        sum1, sum2 = t1 + t2, t3 + t4
        rs = jnp.where(sum1 > 0, (t1 - t2) / jnp.where(sum1 > 0, sum1, 1.0), 1.0)
        rp = jnp.where(sum2 > 0, (t3 - t4) / jnp.where(sum2 > 0, sum2, 1.0), 1.0)
        return jnp.where(grazing, 1.0, 0.5 * rs * (1.0 + rp))

    return eta.map(one, k)


def dielectric(eta: Any, cos_theta: Any) -> tuple[Any, Any, Any]:
    """Reflectance of a smooth boundary of index η, inside over outside, at incidence cosθ, below 0 from the inside;
    |cosθ| of the transmitted direction, 0 at total reflection; and the index on the other side over that on this."""
    ratio = jnp.where(cos_theta < 0, 1.0 / eta, eta)
    c = jnp.minimum(jnp.abs(cos_theta), 1.0)
    t2 = 1.0 - (1.0 - c) * (1.0 + c) / (ratio * ratio)
    t, bent = safe_sqrt(t2), t2 > 0
    rs = (c - ratio * t) / jnp.where(bent, c + ratio * t, 1.0)
    rp = (ratio * c - t) / jnp.where(bent, ratio * c + t, 1.0)
    return jnp.where(bent, 0.5 * (rs * rs + rp * rp), 1.0), t, ratio


def diffuse_reflectance(eta: Any) -> Any:
    """Mean reflectance of a smooth boundary for light that is even over the hemisphere, index η of the other side.

    From outside, by the fit of d'Eon and Irving 2011; from inside what follows, for as much light passes both ways but
    for the η² of its radiance.
    """
    e = jnp.where(eta < 1.0, eta, 1.0 / eta)
    outside = 0.919317 + e * (-3.4793 + e * (6.75335 + e * (-7.80989 + e * (4.98554 - 1.36881 * e))))
    return jnp.where(eta < 1.0, 1.0 - (1.0 - outside) * e * e, outside)
