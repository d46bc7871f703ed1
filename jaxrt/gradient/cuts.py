"""Where faces cut through each other: lines that no shape has as an edge, and that move with both faces."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..vector import Vec3, cross, dot, normalise

FACES = 192
"""Up to so many triangles and parallelograms each is tried with each."""

MOST = 16
"""Lines of a scene, the longest ones."""

TOUCH = 1e-4
"""Faces that go through another's plane by less, in units of their size, touch it."""


def lines(geometry: Any, blocks: tuple[int, ...], real: Any) -> tuple[Any, ...] | None:
    """Ends (m), coordinates of both on the first face, both faces, and which of the rows are lines; None where there
    are too many faces to look. `real`: which of the flat faces exist, (F,)."""
    n = sum(blocks[:2])
    if not 1 < n <= FACES:
        return None
    first, second = np.triu_indices(n, 1)
    o, a, b = (geometry[:n, k : k + 3] for k in (0, 3, 6))
    four = jnp.asarray(np.arange(n) >= blocks[0])[:, None]
    corners = jnp.stack([o, o + a, o + b, o + a + jnp.where(four, b, 0.0)], 1)  # (F, 4, 3)
    area = jnp.cross(a, b)
    size2 = (area * area).sum(-1, keepdims=True)
    size = jnp.maximum(_norm(a), _norm(b))[:, 0]
    unit = area / jnp.sqrt(jnp.where(size2 > 0, size2, 1.0))
    tolerance = TOUCH * jnp.maximum(size[first], size[second])

    def through(i: Any, j: Any) -> Any:
        """Whether faces j lie on both sides of faces i."""
        height = ((corners[j] - o[i][:, None]) * unit[i][:, None]).sum(-1)
        return (height.min(-1) < -tolerance) & (height.max(-1) > tolerance)

    along = jnp.cross(unit[first], unit[second])
    sine2 = (along * along).sum(-1, keepdims=True)
    offset = (unit[second] * (o[second] - o[first])).sum(-1, keepdims=True)
    start = o[first] + jnp.cross(along, unit[first]) * (offset / jnp.where(sine2 > 0, sine2, 1.0))
    along = along / jnp.sqrt(jnp.where(sine2 > 0, sine2, 1.0))

    def coordinates(face: Any, p: Any) -> tuple[Any, Any]:
        n, over = area[face], jnp.where(size2 > 0, size2, 1.0)[face, 0]
        return (jnp.cross(p, b[face]) * n).sum(-1) / over, (jnp.cross(a[face], p) * n).sum(-1) / over

    low, high = jnp.full(len(first), -jnp.inf), jnp.full(len(first), jnp.inf)
    for face in (first, second):
        (u, v), (du, dv), far = coordinates(face, start - o[face]), coordinates(face, along), four[face, 0]
        bounds = [(u, du), (v, dv)]
        bounds += [(1.0 - u - jnp.where(far, 0.0, v), -du - jnp.where(far, 0.0, dv)), (1.0 - v, -dv)]
        for value, slope in bounds:
            at = -value / jnp.where(slope == 0, 1.0, slope)
            low = jnp.maximum(low, jnp.where(slope > 0, at, jnp.where((slope == 0) & (value < 0), jnp.inf, -jnp.inf)))
            high = jnp.minimum(high, jnp.where(slope < 0, at, jnp.inf))
    there = through(first, second) & through(second, first) & (sine2[:, 0] > 1e-6) & (high - low > tolerance)
    there &= real[first] & real[second]
    longest = jnp.argsort(jnp.where(there, low - high, jnp.inf))[:MOST]
    first, second = jnp.asarray(first)[longest], jnp.asarray(second)[longest]
    start, along, there = start[longest], along[longest], there[longest]
    low, high = (jnp.where(there, s[longest], 0.0)[:, None] for s in (low, high))
    p, q = start + along * low, start + along * high
    uv = jnp.stack([*coordinates(first, p - o[first]), *coordinates(first, q - o[first])], -1)
    return jnp.concatenate([p, q], -1), uv, jnp.stack([first, second], -1).astype(jnp.int32), there


def _norm(a: Any) -> Any:
    return jnp.sqrt((a * a).sum(-1, keepdims=True))


def attach(face: tuple[Vec3, Vec3, Vec3], other: tuple[Vec3, Vec3, Vec3], y: Vec3) -> Vec3:
    """A point y of a line that moves with the first face, made to move with the other's plane too: it slides in the
    first face, across the line. Faces are given by origin, e₁ and e₂."""
    m, n = normalise(cross(face[1], face[2])), normalise(cross(other[1], other[2]))
    across = sg(cross(cross(m, n), m))
    rise, gap = dot(sg(n), across), dot(n, other[0] - y)
    ok = jnp.abs(rise) > 1e-6
    return y + across * jnp.where(ok, (gap - sg(gap)) / jnp.where(ok, rise, 1.0), 0.0)
