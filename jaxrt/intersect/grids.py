"""Search of grids of signed distances: voxel by voxel along a ray, for the first root of their interpolant.

Along a ray the interpolant is a cubic in each voxel, here by its Bernstein coefficients (H. Hansson-Söderlund, A. Evans
and T. Akenine-Möller, Ray Tracing of Signed Distance Function Grids, 2022). The sign goes with the ray from voxel to
voxel, so that no root is lost between two of them. One ray after the other, so that each takes its own number of steps.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.lax import dynamic_update_slice

from ..compiler import one_function
from ..grids import Grids, trilinear, within
from ..vector import Vec3
from .batch import in_a_row

STEPS = 10
"""Of Newton's method within a bracket: enough for float64 but where a ray all but touches the surface."""


def meet(grids: Grids, k: Any, o: Vec3, d: Vec3, least: Any) -> tuple[Any, Any]:
    """Whether a ray meets grid k beyond `least` (m), and at which distance; else where it comes near it. Held fixed."""
    real = grids.distances.dtype
    row = lambda c, dtype: jnp.asarray(c, dtype).reshape(1)
    ray = tuple(row(c, real) for c in (*o, *d, least))
    t, found = _rays()(*jax.lax.stop_gradient((grids, (row(k, jnp.int32), ray))))
    return found[0] > 0, t[0]


@functools.cache
def _rays() -> Any:
    """`_ray` over n rays, one after the other."""

    def each(grids: Grids, rays: Any) -> Any:
        n = len(rays[0])

        def step(i: Any, done: Any) -> Any:
            k, ray = jax.tree.map(lambda c: c[i], rays)
            found = _ray(grids, k, Vec3(*ray[:3]), Vec3(*ray[3:6]), ray[6])
            return tuple(
                dynamic_update_slice(a, b.astype(a.dtype)[None], (i,)) for a, b in zip(done, found, strict=True)
            )

        return jax.lax.fori_loop(0, n, step, (jnp.zeros(n, rays[1][0].dtype), jnp.zeros(n, jnp.int32)))

    return in_a_row(one_function(each))


def _ray(grids: Grids, k: Any, o: Vec3, d: Vec3, least: Any) -> tuple[Any, Any]:
    q, v = grids.ray(k, o, d)
    inverse = [1.0 / jnp.where(jnp.abs(c) < 1e-20, jnp.where(c < 0, -1e-20, 1e-20), c) for c in v]
    near, far = least, jnp.inf
    for a, (c, i) in enumerate(zip(q, inverse, strict=True)):
        low, high = -c * i, (grids.layout[k, a + 1] - 1 - c) * i
        near, far = jnp.maximum(near, jnp.minimum(low, high)), jnp.minimum(far, jnp.maximum(low, high))
    crosses = near <= far
    near = jnp.where(crosses, near, 0.0)
    start = q + v * near  # distances count from here
    cell, zero = grids.cell(k, start), 0.0 * near
    inside = trilinear(grids.corners(k, cell), within(start, cell))[0] < 0

    def leaves(cell: Any) -> list[Any]:
        return [(c + (i > 0) - p) * i for c, p, i in zip(cell, start, inverse, strict=True)]

    def cubic(corners: Any, cell: Any, t0: Any, t1: Any) -> tuple[Any, Any, Any, Any]:
        return _cubic(corners, within(start + v * t0, cell), within(start + v * t1, cell))

    def search(corners: Any, cell: Any, t0: Any, t1: Any, least_f: Any, touching: Any) -> Any:
        c = cubic(corners, cell, t0, t1)
        stops = _monotone(c)
        values = [_bernstein(c, s)[0] for s in stops]
        # The first piece at whose end the sign is another one.
        low, high, found = zero, zero, (values[0] < 0) != inside
        for before, after, value in zip(stops, stops[1:], values[1:], strict=False):
            new = ~found & ((value < 0) != inside)
            low, high, found = jnp.where(new, before, low), jnp.where(new, after, high), found | new
        for s, value in zip(stops, values, strict=True):
            closer = jnp.abs(value) < least_f
            least_f = jnp.where(closer, jnp.abs(value), least_f)
            touching = jnp.where(closer, t0 + s * (t1 - t0), touching)
        return found, low, high, least_f, touching

    def step(state: Any) -> Any:
        cell, t0, _, _, _, least_f, touching = state
        out = leaves(cell)
        t1 = jnp.maximum(jnp.minimum(jnp.minimum(out[0], out[1]), out[2]), t0)
        corners = grids.corners(k, cell)
        mixed = functools.reduce(jnp.logical_or, [(c < 0) != inside for c in corners])
        skip = lambda *_: (zero != zero, zero, zero, least_f, touching)
        found, low, high, least_f, touching = jax.lax.cond(
            mixed, search, skip, corners, cell, t0, t1, least_f, touching
        )
        x = (out[0] <= out[1]) & (out[0] <= out[2])
        y = ~x & (out[1] <= out[2])
        along = [one & ~found for one in (x, y, ~x & ~y)]
        cell = [c + jnp.where(one, jnp.where(i > 0, 1, -1), 0) for c, i, one in zip(cell, inverse, along, strict=True)]
        return cell, jnp.where(found, t0, t1), found, low, high, least_f, touching

    def goes_on(state: Any) -> Any:
        there = [(c >= 0) & (c < grids.layout[k, a + 1] - 1) for a, c in enumerate(state[0])]
        return crosses & ~state[2] & there[0] & there[1] & there[2]

    state = (cell, zero, zero != zero, zero, zero, zero + jnp.inf, zero)
    cell, t0, found, low, high, _, touching = jax.lax.while_loop(goes_on, step, state)
    out = leaves(cell)
    t1 = jnp.maximum(jnp.minimum(jnp.minimum(out[0], out[1]), out[2]), t0)
    s = _root(cubic(grids.corners(k, cell), cell, t0, t1), low, high, inside)
    return near + jnp.where(found, t0 + s * (t1 - t0), touching), found


def _cubic(v: list[Any], a: Vec3, b: Vec3) -> tuple[Any, Any, Any, Any]:
    """Bernstein coefficients of the interpolant from a to b: means of its values at corners of the box of both."""
    for f, g, step in zip(a, b, (1, 2, 4), strict=True):
        v = [(v[k & ~step] + (v[k | step] - v[k & ~step]) * (g if k & step else f)) for k in range(8)]
    return v[0], (v[1] + v[2] + v[4]) / 3.0, (v[3] + v[5] + v[6]) / 3.0, v[7]


def _bernstein(c: tuple[Any, Any, Any, Any], s: Any) -> tuple[Any, Any]:
    """Value and derivative at s."""
    mix = lambda a, b: a + (b - a) * s
    x, y, z = (mix(c[k], c[k + 1]) for k in range(3))
    x, y = mix(x, y), mix(y, z)
    return mix(x, y), 3.0 * (y - x)


def _monotone(c: tuple[Any, Any, Any, Any]) -> list[Any]:
    """Four places from 0 to 1 between which a cubic turns nowhere."""
    d0, d1, d2 = (c[k + 1] - c[k] for k in range(3))
    a, b, disc = d0 - 2.0 * d1 + d2, d1 - d0, d1 * d1 - d0 * d2
    q = -(b + jnp.where(b >= 0, 1.0, -1.0) * jnp.sqrt(jnp.maximum(disc, 0.0)))
    roots = [n / jnp.where(m == 0, 1.0, m) for n, m in ((q, a), (d0, q))]
    roots = [jnp.where(disc > 0, jnp.clip(r, 0.0, 1.0), 0.0) for r in roots]
    one = 0.0 * d0 + 1.0
    return [0.0 * one, jnp.minimum(*roots), jnp.maximum(*roots), one]


def _root(c: tuple[Any, Any, Any, Any], low: Any, high: Any, inside: Any) -> Any:
    """The root of a cubic in a bracket in which it is monotone; at `low` it is negative if `inside`."""

    def step(_: Any, state: Any) -> Any:
        s, low, high = state
        f, slope = _bernstein(c, s)
        before = (f < 0) == inside
        low, high = jnp.where(before, s, low), jnp.where(before, high, s)
        s = s - f / jnp.where(slope == 0, 1.0, slope)
        return jnp.where((s >= low) & (s <= high), s, 0.5 * (low + high)), low, high

    return jax.lax.fori_loop(0, STEPS, step, (0.5 * (low + high), low, high))[0]
