"""Triangles and parallelograms sampled by the solid angle that they subtend.

Worth its arithmetic only near large lamps: `jaxrt.near_lamps` compares both ways. A parallelogram is two
spherical triangles. Formulas: van Oosterom and Strackee 1983 (solid angle), Arvo 1995 (sampling).
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..sampling.warp import circle
from ..vector import Vec3, cross, dot, normalise, safe_sqrt, where

SMALLEST = 2e-3
"""Solid angle (sr) below which faces are sampled by area: float32 blurs Arvo's map, and area is as good."""

LARGEST = 6.0
"""Solid angle (sr) above which faces are sampled by area: the point lies all but in the face."""


def _triangle(x: Vec3, o: Vec3, e1: Vec3, e2: Vec3) -> Any:
    """Solid angle of a triangle seen from x, by either side."""
    a = o - x
    b, c = a + e1, a + e2
    na, nb, nc = (safe_sqrt(dot(v, v)) for v in (a, b, c))
    volume = jnp.abs(dot(a, cross(e1, e2)))
    return 2.0 * jnp.arctan2(volume, na * nb * nc + dot(a, b) * nc + dot(b, c) * na + dot(c, a) * nb)


def _halves(x: Vec3, o: Vec3, e1: Vec3, e2: Vec3, four: Any) -> tuple[Any, Any]:
    """Solid angles of the face's triangles; the second is 0 unless the face has four corners."""
    return _triangle(x, o, e1, e2), jnp.where(four, _triangle(x, o + e1 + e2, -e1, -e2), 0.0)


def _density(sigma: Any) -> Any:
    """1/σ, or 0 where the face is to be sampled by area."""
    usable = (sigma > SMALLEST) & (sigma < LARGEST)
    return jnp.where(usable, 1.0 / jnp.where(usable, sigma, 1.0), 0.0)


def per_solid_angle(x: Vec3, o: Vec3, e1: Vec3, e2: Vec3, four: Any) -> Any:
    """1/σ of a face seen from x, or 0 where it is to be sampled by area."""
    return _density(sum(_halves(x, o, e1, e2, four)))


def _beside(a: Vec3, v: Vec3) -> Vec3:
    """The unit vector in the plane of a and v that is perpendicular to the unit vector a."""
    return normalise(v - a * dot(a, v))


def sample(x: Vec3, o: Vec3, e1: Vec3, e2: Vec3, four: Any, u: tuple[Any, Any]) -> tuple[Any, Any, Any]:
    """Coordinates (u, v) on a face of a direction uniform in its solid angle σ from x, and 1/σ.

    Where 1/σ is 0 the face is to be sampled by area, and the coordinates mean nothing.
    """
    first, second = _halves(x, o, e1, e2, four)
    sigma = first + second
    # One of the two triangles, and u[0] made uniform again.
    at = u[0] * sigma
    other = at >= first
    part = jnp.where(other, second, first)
    area = jnp.clip(jnp.where(other, at - first, at), 0.0, part)
    sign = jnp.where(other, -1.0, 1.0)
    corner, s1, s2 = where(other, o + e1 + e2, o), e1 * sign, e2 * sign
    # Arvo: the great circle through B that cuts off `area`, then a point on it.
    to = corner - x
    a, b, c = normalise(to), normalise(to + s1), normalise(to + s2)
    ab, ac = _beside(a, b), _beside(a, c)
    cos_alpha = jnp.clip(dot(ab, ac), -1.0, 1.0)
    sin_alpha = safe_sqrt((1.0 - cos_alpha) * (1.0 + cos_alpha))
    cos_cut, sin_cut = circle(area * (0.5 / np.pi))
    s = sin_cut * cos_alpha - cos_cut * sin_alpha
    t = cos_cut * cos_alpha + sin_cut * sin_alpha
    p, r = t - cos_alpha, s + sin_alpha * dot(a, b)
    below = (r * s + p * t) * sin_alpha
    q = jnp.clip(((r * t - p * s) * cos_alpha - r) / jnp.where(below == 0, 1.0, below), -1.0, 1.0)
    q = jnp.where(below == 0, 1.0, q)
    cut = a * q + ac * safe_sqrt((1.0 - q) * (1.0 + q))
    drop = u[1] * (1.0 - dot(cut, b))
    w = b * (1.0 - drop) + _beside(b, cut) * safe_sqrt(drop * (2.0 - drop))
    # Where the ray (x, w) meets the triangle's plane (Möller and Trumbore).
    across = cross(w, s2)
    det = dot(s1, across)
    inverse = 1.0 / jnp.where(det == 0, 1.0, det)
    f = jnp.clip(-dot(to, across) * inverse, 0.0, 1.0)
    g = jnp.clip(-dot(w, cross(to, s1)) * inverse, 0.0, 1.0)
    f, g = jnp.where(other, 1.0 - f, f), jnp.where(other, 1.0 - g, g)
    return f, g, _density(sigma)
