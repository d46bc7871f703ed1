"""Maps of the unit square onto what is sampled, each with a known density."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..vector import Vec3, safe_sqrt


def circle(u: Any) -> tuple[Any, Any]:
    """(cos 2πu, sin 2πu) by quarter turns and short polynomials, to 4e-7: a ninth of the library's time."""
    quarter = jnp.round(4.0 * u)
    r = (u - 0.25 * quarter) * (2.0 * np.pi)
    r2 = r * r
    sin = r * (1.0 + r2 * (-1.0 / 6.0 + r2 * (1.0 / 120.0 + r2 * (-1.0 / 5040.0 + r2 / 362880.0))))
    cos = 1.0 + r2 * (-0.5 + r2 * (1.0 / 24.0 + r2 * (-1.0 / 720.0 + r2 / 40320.0)))
    k = quarter.astype(jnp.int32) & 3
    odd = (k & 1) == 1
    c, s = jnp.where(odd, sin, cos), jnp.where(odd, cos, sin)
    return jnp.where((k == 1) | (k == 2), -c, c), jnp.where(k >= 2, -s, s)


def cosine_hemisphere(u: tuple[Any, Any]) -> Vec3:
    """A direction with density cosθ/π per solid angle; never exactly in the plane."""
    r, (c, s) = jnp.sqrt(u[0]), circle(u[1])
    return Vec3(r * c, r * s, jnp.sqrt(1.0 - u[0]))


def uniform_sphere(u: tuple[Any, Any]) -> Vec3:
    """A direction with density 1/4π."""
    z, (c, s) = 1.0 - 2.0 * u[0], circle(u[1])
    r = safe_sqrt((1.0 - z) * (1.0 + z))
    return Vec3(r * c, r * s, z)


def uniform_disk(u: tuple[Any, Any]) -> tuple[Any, Any]:
    """A point of the unit disc, density 1/π, by concentric squares (Shirley and Chiu 1997)."""
    a, b = 2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0
    wide = jnp.abs(a) > jnp.abs(b)
    r = jnp.where(wide, a, b)
    ratio = jnp.where(wide, b, a) / jnp.where(r == 0, 1.0, r)
    c, s = circle(jnp.where(wide, 0.125 * ratio, 0.25 - 0.125 * ratio))
    return r * c, r * s


def uniform_triangle(u: tuple[Any, Any]) -> tuple[Any, Any]:
    """Barycentrics of the second and third vertex, density 2 (Heitz 2019: keeps neighbours together)."""
    a, b = u
    low = a < b
    d = jnp.where(low, 0.5 * a, 0.5 * b)
    return jnp.where(low, d, a - d), jnp.where(low, b - d, d)


def _linear(u: Any, a: Any, b: Any) -> Any:
    """A point of [0, 1] with a density that goes linearly from a to b, both positive."""
    return jnp.minimum(u * (a + b) / (a + jnp.sqrt(a * a + u * (b * b - a * a))), 1.0 - 2.0**-24)


def bilinear(u: tuple[Any, Any], corners: tuple[Any, Any, Any, Any]) -> tuple[tuple[Any, Any], Any]:
    """A point of the unit square and its density, which is bilinear between positive values at (0, 0), (1, 0), (0, 1)
    and (1, 1)."""
    a, b, c, d = corners
    v = _linear(u[1], a + b, c + d)
    low, high = a + (c - a) * v, b + (d - b) * v
    w = _linear(u[0], low, high)
    return (w, v), 4.0 * (low + (high - low) * w) / (a + b + c + d)


def uniform_cone(u: tuple[Any, Any], one_minus_cos: Any) -> Vec3:
    """A direction around +z within a cap, density 1/(2π(1 − cosθ)); takes 1 − cosθ so that small cones are exact."""
    height, (c, s) = u[0] * one_minus_cos, circle(u[1])
    r = safe_sqrt(height * (2.0 - height))
    return Vec3(r * c, r * s, 1.0 - height)


def invert(at: Callable[[Any], Any], n: Any, most: int, u: Any) -> tuple[Any, Any]:
    """The first of n numbers at(0) ≤ at(1) ≤ ... that exceeds u, and where u lies between the one before (before the
    first: 0) and it, in [0, 1). `most`: the largest n that there may be."""
    low, high = jnp.zeros_like(u, jnp.int32), jnp.full_like(u, n - 1, jnp.int32)
    for _ in range(max(most - 1, 1).bit_length()):
        middle = (low + high) // 2
        above = at(middle) > u
        low, high = jnp.where(above, low, jnp.minimum(middle + 1, n - 1)), jnp.where(above, middle, high)
    before = jnp.where(low > 0, at(jnp.maximum(low - 1, 0)), 0.0)
    width = at(low) - before
    return low, jnp.clip((u - before) / jnp.where(width > 0, width, 1.0), 0.0, 1.0 - 2.0**-23)


FLAT = {"triangle": uniform_triangle, "parallelogram": lambda u: u, "disk": uniform_disk}
CORNERS = {
    "triangle": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5)),
    "parallelogram": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)),
    "disk": tuple((a * 0.5**0.5, b * 0.5**0.5) for b in (-1.0, 1.0) for a in (-1.0, 1.0)),
}
"""Maps of the unit square onto flat faces, evenly, and where they take (0, 0), (1, 0), (0, 1) and (1, 1)."""

FAINTEST = 0.05
"""Of the density where a flat lamp is sampled evenly, what is left to its corners that light a point least."""
