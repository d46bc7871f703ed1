"""Intensity of a lamp by direction, looked up in the photometric web that it was measured in."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..sampling.warp import invert
from ..texture import _row, _texel
from ..vector import Spectrum, Vec3, cross, dot, normalise, safe_sqrt
from ..world import World


def intensity(world: World, number: Any, axis: Vec3, up: Vec3, to: Vec3) -> Spectrum:
    """The intensity of web `number` (0: none) of a lamp along `axis` towards a point that lies `to` away from it.

    Bilinear in the vertical angle θ, from `axis`, and the horizontal one φ, from `up`, folded to where it was measured.
    """
    assert world.textures is not None
    layout, texels = _row(world.textures.layout, sg(number).astype(jnp.int32)), world.textures.texels
    offset, v, h = layout[1], layout[2], layout[3]
    at = lambda k: sg(_row(texels, k)[0])
    left = normalise(cross(up, axis))
    a, b, c = dot(to, left), dot(to, cross(axis, left)), dot(to, axis)
    pole = a * a + b * b <= 1e-12 * c * c
    theta = jnp.arctan2(safe_sqrt(a * a + b * b), c)
    phi = jnp.arctan2(jnp.where(pole, 0.0, a), jnp.where(pole, 1.0, b))
    first = at(offset + v)
    span = at(offset + v + h - 1) - first
    span = jnp.where(span > 0, span, 1.0)
    turned = jnp.mod(phi - first, 2.0 * np.pi) + span
    folded = first + jnp.abs(jnp.mod(turned, 2.0 * span) - span)
    most = world.plan.web
    row, y = invert(lambda k: at(offset + k), v, most, theta)
    plane, x = invert(lambda k: at(offset + v + k), h, most, folded)
    inside = (theta >= at(offset)) & (theta <= at(offset + v - 1))
    start = offset + v + h
    low, high = (start + v * jnp.maximum(plane - k, 0) for k in (1, 0))
    a, b, c, d = (_texel(texels, p + jnp.maximum(row - k, 0)) for p in (low, high) for k in (1, 0))
    near, far = a + (b - a) * y, c + (d - c) * y
    return (near + (far - near) * x).map(lambda i: jnp.where(inside, i, 0.0))
