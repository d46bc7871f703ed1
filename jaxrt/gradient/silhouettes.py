"""The boundary term of the film: edges of M as the camera sees them, sampled by their length on the picture.

dI_p = ∫ h_p(q) (L₋ − L₊) (q̇·N̂) dl along the images q of edges; see `visibility`. One sequence of samples for the whole
picture; each adds to the pixels whose filters reach it.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..sampling.sobol import Stream, combine
from ..sensor import camera, film
from ..solver import path
from ..surface import surface_point
from ..vector import Vec3, length
from ..world import World
from . import edges as edge
from .edges import Edges
from .visibility import follow, owned

ASIDE = 0.01
"""How far beside an edge to look, in pixels."""


def _on_film(view: Any, edges: Edges) -> tuple[Any, Any, Any]:
    """Of each edge, as the middle of the lens sees it: length inside the picture (pixels), the range of that, as shares
    of the edge's image, and the distances of its ends (m) in front of the camera, after cutting at the near plane."""
    to_local = jnp.linalg.inv(view.to_world)
    margin = view.sensor.film[3]

    def one(ends: Any, j: Any) -> Any:
        p, q = Vec3(ends[0], ends[1], ends[2]), Vec3(ends[3], ends[4], ends[5])
        at = lambda p: camera.position(view.sensor, to_local, view.lens, view.window, p, None)
        near = jnp.maximum(view.lens[1], 1e-6)
        (_, z0), (_, z1) = at(p), at(q)
        span = jnp.where(z0 == z1, 1.0, z0 - z1)
        start = jnp.where(z0 < near, (z0 - near) / span, 0.0)
        stop = jnp.where(z1 < near, (z0 - near) / span, 1.0)
        gone = (z0 < near) & (z1 < near)
        start, stop = jnp.where(gone, 0.0, start), jnp.where(gone, 0.0, stop)
        (a, z0), (b, z1) = at(p + (q - p) * start), at(p + (q - p) * stop)
        low, high = 0.0 * z0, 0.0 * z0 + 1.0
        for k, size in enumerate((view.width, view.height)):
            step = b[k] - a[k]
            over = jnp.where(step == 0, 1.0, step)
            s, t = (-margin - a[k]) / over, (size + margin - a[k]) / over
            out = (step == 0) & ((a[k] < -margin) | (a[k] > size + margin))
            low = jnp.maximum(low, jnp.where(step == 0, jnp.where(out, 1.0, 0.0), jnp.minimum(s, t)))
            high = jnp.minimum(high, jnp.where(step == 0, 1.0, jnp.maximum(s, t)))
        long = jnp.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) * jnp.maximum(high - low, 0.0)
        there = ~gone & (j < edges.count) & jnp.isfinite(long)
        return jnp.where(there, long, 0.0), jnp.stack([low, high]), jnp.stack([start, stop]), jnp.stack([z0, z1])

    return jax.vmap(one)(edges.ends, jnp.arange(len(edges.ends)))


def picture(world: World, edges: Edges, view: Any, depths: path.Depths, seed: Any, n: int, samples: int) -> Any:
    """The term for all pixels, (n, C): 0, with derivatives. `samples` points on edges."""
    fixed, plan, still = sg(world), world.plan, sg(view)
    long, inside, cut, z = _on_film(still, edges)
    eye = Vec3(*(still.to_world[k, 3] for k in range(3)))
    outline = jax.vmap(lambda j: edge.hides(edges, j, eye, edge.arc_of(edges.ends[j], eye, None).pole))
    if still.sensor.kind == "perspective":  # else an edge has no one side
        long = jnp.where(edges.crease | outline(jnp.arange(len(long))), long, 0.0)
    sums = jnp.cumsum(long)
    whole = sums[-1]
    to_local = jnp.linalg.inv(view.to_world)
    seed, lanes = combine(seed, 0xED6E), min(samples, 4096)
    reach = int(np.ceil(still.sensor.film[3] + 0.5))

    def one(i: Any) -> tuple[Any, Any]:
        s = Stream(i.astype(jnp.uint32), seed)
        lens = s.pair_at(1) if camera.uses_lens(still.sensor) else None
        u = s.child(1).pair_at(0)[0] * whole
        j = jnp.minimum(jnp.searchsorted(sums, u, side="right"), len(sums) - 1)
        share = jnp.clip((u - (sums[j] - long[j])) / jnp.maximum(long[j], 1e-30), 0.0, 1.0)
        low, high = inside[j, 0], inside[j, 1]
        along = low + (high - low) * share  # on the image of the part before the camera
        z0, z1 = (z[j, 0], z[j, 1]) if still.sensor.kind != "orthographic" else (jnp.ones_like(u), jnp.ones_like(u))
        t = along * z0 / (z1 + (z0 - z1) * along)
        # dt/dalong = z0 z1 / (z1 + (z0 − z1) along)²; a length of `long` has the chance long/whole.
        slope = z0 * z1 / (z1 + (z0 - z1) * along) ** 2
        t, slope = cut[j, 0] + (cut[j, 1] - cut[j, 0]) * t, slope * (cut[j, 1] - cut[j, 0]) * (high - low)
        uv = edges.uv[j]

        def at(view: Any, world: World, to_local: Any, t: Any) -> Any:
            on_face = uv[0] + (uv[2] - uv[0]) * t, uv[1] + (uv[3] - uv[1]) * t
            p = edge.edge_point(world, edges.faces[j, 0], on_face)
            return camera.position(view.sensor, to_local, view.lens, view.window, p, lens)[0], p

        ((qx, qy), p), ((dx, dy), _) = jax.jvp(lambda t: at(still, fixed, sg(to_local), t), (t,), (jnp.ones_like(t),))
        speed = jnp.sqrt(dx * dx + dy * dy)
        nx, ny = -dy / jnp.maximum(speed, 1e-30), dx / jnp.maximum(speed, 1e-30)

        def beside(side: Any) -> tuple[Any, Any]:
            o, d = camera.ray(
                still.sensor,
                still.to_world,
                still.lens,
                still.window,
                (qx + ASIDE * side * nx, qy + ASIDE * side * ny),
                lens,
            )
            face = fixed.settle(fixed.search.closest(o, d))
            y = surface_point(fixed, face, o, d)
            return (y, length(p - o)), follow(fixed, depths, o, d, face, s, jnp.int32(0), True)

        (y, r), light = jax.vmap(beside)(jnp.array([-1.0, 1.0], fixed.faces.dtype))
        minus, plus = (jax.tree.map(lambda a, k=k: a[k], y) for k in (0, 1))
        own = owned(fixed, edges, j, r[0], 1e-3 * r[0], minus, plus)
        good = (long[j] > 0) & (speed > 0) & (slope > 0)
        scale = jnp.where(good, own * whole / jnp.maximum(long[j], 1e-30) * speed * slope, 0.0)
        jump = light.map(lambda c: (c[0] - c[1]) * scale)
        (mx, my), _ = at(view, world, to_local, sg(t))
        moved = nx * mx + ny * my
        moved = moved - sg(moved)
        value = jnp.stack([sg(jnp.where(jnp.isfinite(c), c, 0.0)) * moved for c in jump.channels])
        column, row = jnp.floor(qx), jnp.floor(qy)
        places, parts = [], []
        for a in range(-reach + 1, reach):
            for b in range(-reach + 1, reach):
                x, y = column + a, row + b
                pixel = film.pixel(still.sensor.film, x, y, still.width, still.height)
                within = (x >= 0) & (x < still.width) & (y >= 0) & (y < still.height)
                h = jnp.where(within, film.density(still.sensor.film, pixel, (qx, qy)), 0.0)
                places.append(jnp.where(within, y * still.width + x, n).astype(jnp.int32))
                parts.append(value * sg(h))
        return jnp.stack(places), jnp.stack(parts)

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def batch(first: Any) -> Any:
        places, parts = jax.vmap(one)(first + jnp.arange(lanes, dtype=jnp.int32))
        return jnp.zeros((n, plan.channels), fixed.faces.dtype).at[places].add(parts, mode="drop")

    batches = max(1, round(samples / lanes))
    zero = jnp.zeros((n, plan.channels), fixed.faces.dtype)
    total = jax.lax.scan(
        lambda total, k: (total + batch(k * lanes), None), zero, jnp.arange(batches, dtype=jnp.int32)
    )[0]
    return total / (batches * lanes)
