"""The boundary term of the film: edges of M as a camera sees them, directly or in flat mirrors.

dI_p = ∫ h_p(q) (L₋ − L₊) (q̇·N̂) |dq/dt| dt along the images q(t) of edges; see `visibility`. One sequence of samples for
the whole picture; each adds to the pixels whose filters reach it.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..sampling.sobol import Stream, combine
from ..sensor import camera, film
from ..solver import path
from ..vector import Vec3, where
from ..world import World
from . import contours
from . import edges as edge
from .edges import Edges
from .visibility import Mirror, along, choose, follow, owned, zero_valued

ASIDE, NEAR = 0.01, 2e-5
"""How far beside an edge to look, in pixels; and beside curved ones at most, in widths of the picture: light
from a sphere differs from that at its outline by the square root of this (by .01 of 16 pixels: 3 % of a derivative)."""

LANES = 4096


class OnFilm(eqx.Module):
    """Edges on the picture, as the middle of the lens sees them: lengths inside it (pixels), and their sums; `inside`:
    the range of that, as shares of the image of the part before the near plane; `cut`: that part, as a range of t;
    `z`: how far in front of the camera its ends are (m)."""

    long: Any
    sums: Any
    inside: Any
    cut: Any
    z: Any

    @classmethod
    def of(cls, view: Any, edges: Edges) -> OnFilm:
        to_local, filter_ = jnp.linalg.inv(view.to_world), film.Filter(*view.sensor.film[2:])
        margin = filter_.radius if filter_.border else 0.0
        at = lambda p: camera.position(view.sensor, to_local, view.lens, view.window, p, None)
        near, eye = jnp.maximum(view.lens[1], 1e-6), Vec3(*(view.to_world[k, 3] for k in range(3)))

        def one(j: Any) -> Any:
            p, q = edge.two_points(edges.ends[j])
            (_, z0), (_, z1) = at(p), at(q)
            span = jnp.where(z0 == z1, 1.0, z0 - z1)
            gone = (z0 < near) & (z1 < near)
            start = jnp.where((z0 < near) & ~gone, (z0 - near) / span, 0.0)
            stop = jnp.where(gone, 0.0, jnp.where(z1 < near, (z0 - near) / span, 1.0))
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
            seen = ~gone & edges.there[j] & jnp.isfinite(long)
            if view.sensor.kind == "perspective":  # else an edge is seen from several sides
                outline = edges.crease[j] | edge.hides(edges, j, eye, edge.arc_of((p, q), eye, None).pole)
                if edges.faint is None:
                    seen &= outline
                else:
                    long = long * jnp.where(outline, 1.0, edges.faint[j])
            else:
                z0, z1 = (z0, z1) if view.sensor.kind == "thinlens" else (jnp.ones_like(z0), jnp.ones_like(z1))
            z = jnp.stack([z0, z1])
            return jnp.where(seen, long, 0.0), jnp.stack([low, high]), jnp.stack([start, stop]), z

        long, inside, cut, z = jax.vmap(one)(jnp.arange(len(edges.ends)))
        return cls(long, jnp.cumsum(long), inside, cut, z)

    def choose(self, u: Any) -> tuple[Any, Any, Any]:
        """An edge by its length in the picture, a place t on it, and the inverse of the density of both."""
        u = u * self.sums[-1]
        j = jnp.minimum(jnp.searchsorted(self.sums, u, side="right"), len(self.sums) - 1)
        ok = self.long[j] > 0
        chance = jnp.where(ok, self.long[j], 1.0)
        (low, high), (start, stop), (z0, z1) = self.inside[j], self.cut[j], self.z[j]
        along = low + (high - low) * jnp.clip((u - (self.sums[j] - self.long[j])) / chance, 0.0, 1.0)
        over = z1 + (z0 - z1) * along
        t, slope = along * z0 / over, z0 * z1 / (over * over) * (high - low)
        weight = jnp.where(ok, slope * (stop - start) * self.sums[-1] / chance, 0.0)
        return j, start + (stop - start) * t, weight


def _beside(
    world: World,
    edges: Edges,
    view: Any,
    depths: path.Depths,
    j: Any,
    q: Any,
    n: Any,
    lens: Any,
    s: Stream,
    mirror: Any,
    further: bool,
    aside: Any = ASIDE,
) -> Any:
    """L₋ − L₊ beside the place q of an edge on the film, where that edge (or its image in a mirror) is what parts them.

    `mirror`: nothing, or a mirror and whether it is meant. `further`: as of `follow`.
    """

    near = jnp.minimum(ASIDE, NEAR * jnp.maximum(view.width, view.height))
    far = jnp.where(j >= len(edges.ends), near, aside)

    def one(side: Any) -> Any:
        ray = lambda q: camera.ray(view.sensor, view.to_world, view.lens, view.window, q, lens)
        o, d = ray((q[0] + far * side * n[0], q[1] + far * side * n[1]))
        edge_ray = where(j >= len(edges.ends), (o, d), ray(q))
        y, light = follow(world, depths, o, d, s, jnp.int32(0), further, True, edge_ray)
        return y if mirror is None else where(mirror[1], mirror[0].behind(world, d, y), y), light

    y, light = jax.vmap(one)(jnp.array([-1.0, 1.0], world.faces.dtype))
    minus, plus = (jax.tree.map(lambda a, k=k: a[k], y) for k in (0, 1))
    own = (minus.face == edges.faces_at(j)[0]) | (minus.face == edges.faces_at(j)[1])
    r = jnp.where(own, minus.distance, plus.distance)
    share = owned(world, edges, j, r, 1e-3 * r, minus, plus)
    return light.map(lambda c: (c[0] - c[1]) * share)


def picture(
    world: World, edges: Edges, view: Any, motion: Any, steps: int, depths: path.Depths, seed: Any, n: int, samples: int
) -> Any:
    """The term for all pixels, (n, C): its derivative by `motion`, tangents of world and view. `samples`: points on
    edges, of straight ones, of outlines of curved faces, and of both in mirrors, as far as there are such."""
    fixed, plan, still = sg(world), world.plan, sg(view)
    filter_, central = still.sensor.film, still.sensor.kind != "orthographic"
    straight, curved = len(edges.ends) > 0, central and edges.curved
    mirrors = central and edges.mirrors is not None
    n_ways = straight + curved + mirrors
    on_film, still_eye = OnFilm.of(still, edges) if straight else None, Vec3(*(still.to_world[k, 3] for k in range(3)))
    middle = still.lens * jnp.array([1.0, 0.0, 1.0, 1.0, 1.0])
    seed, reach = combine(seed, 0xED6E), int(np.ceil(filter_[3] + 0.5))

    def outline(world: World, view: Any, to_local: Any, s: Stream) -> tuple[Any, Any]:
        """A place of the film on an edge, and the term there."""
        lens = s.pair_at(1) if camera.uses_lens(still.sensor) else None
        ways = s.child(2).pair_at(0)[0] * n_ways
        found: list[tuple[Any, Any, Any, Any]] = []
        if on_film is not None:
            found.append((*on_film.choose(s.child(1).pair_at(0)[0]), still_eye))
        eye = camera.ray(still.sensor, still.to_world, middle, still.window, (0.0, 0.0), lens)[0]
        if curved:
            seen = choose(fixed, edges, eye, None, s.child(1), straight=False)
            found.append((seen.edge, seen.t, seen.weight * seen.slope, seen.x))
        image, mirror = lambda world, p: p, None
        if mirrors:
            mirror = Mirror.choose(fixed, edges, eye, s.child(1).pair_at(2)[0])
            seen = choose(fixed, edges, eye, None, s.child(1), mirror.cone, mirror.plane)
            found.append((seen.edge, seen.t, seen.weight * seen.slope * mirror.weight, seen.x))
            meant, face = ways >= n_ways - 1, mirror.face
            image = lambda world, p: where(meant, edge.Plane.of(world, face).image(p), p)
            mirror = mirror, meant
        chosen = found[0]
        for k, other in enumerate(found[1:], 1):
            chosen = where(ways >= k, other, chosen)
        j, t, weight, x = chosen[0], chosen[1], chosen[2] * n_ways, chosen[3]

        def at(view: Any, world: World, to_local: Any, t: Any) -> Any:
            p = image(world, edges.point(world, j, t, Vec3(*x)))
            return camera.position(view.sensor, to_local, view.lens, view.window, p, lens)

        ((q, z), (dq, _)) = jax.jvp(lambda t: at(still, fixed, sg(to_local), t), (t,), (jnp.ones_like(t),))
        speed = jnp.sqrt(dq[0] * dq[0] + dq[1] * dq[1])
        normal = -dq[1] / jnp.maximum(speed, 1e-30), dq[0] / jnp.maximum(speed, 1e-30)

        def across(p: Vec3) -> Any:
            to, _ = camera.position(still.sensor, sg(to_local), still.lens, still.window, image(fixed, p), lens)
            return jnp.abs(normal[0] * (to[0] - q[0]) + normal[1] * (to[1] - q[1]))

        aside = ASIDE
        if plan.smooth_normals and straight:  # where even faces that look narrow are met
            wide = jnp.stack([across(p) for p in edge.two_points(edges.beside[jnp.minimum(j, len(edges.ends) - 1)])])
            aside = jnp.where(j < len(edges.ends), jnp.clip(0.003 * wide.min(), 1e-5 * still.width, ASIDE), ASIDE)
        jump = _beside(fixed, edges, still, depths, j, q, normal, lens, s, mirror, steps > 1, aside)
        scale = jnp.where((weight > 0) & (z > 0), weight * speed, 0.0)
        moved, _ = at(view, world, to_local, sg(t))
        return q, zero_valued(jump * scale, normal[0] * moved[0] + normal[1] * moved[1])

    def contour(world: World, view: Any, _: Any, s: Stream) -> tuple[Any, Any]:
        """The same on a contour of vertex normals, or its image in a mirror."""
        lens = s.pair_at(1) if camera.uses_lens(still.sensor) else None
        through = lambda view, q: camera.ray(view.sensor, view.to_world, view.lens, view.window, q, lens)
        eye = camera.ray(still.sensor, still.to_world, middle, still.window, (0.0, 0.0), lens)[0]
        mirror, meant, weight = None, False, 1.0
        if mirrors:
            mirror, meant = Mirror.choose(fixed, edges, eye, s.child(1).pair_at(2)[0]), s.child(2).pair_at(0)[0] < 0.5
            weight = 2.0 * jnp.where(meant, mirror.weight, 1.0)
        image = lambda p: p if mirror is None else where(meant, mirror.plane.image(p), p)
        found = contours.choose(fixed, image(eye), None, s.child(1), mirror is None and lens is None)
        to_local = jnp.linalg.inv(still.to_world)
        at = lambda p: camera.position(still.sensor, to_local, still.lens, still.window, image(p), lens)[0]

        def look(y: Vec3) -> Any:
            o, d = through(still, at(y))
            met, light = follow(fixed, depths, o, d, s, jnp.int32(0), True, True)
            return (met if mirror is None else where(meant, mirror.behind(fixed, d, met), met)).face, light

        face, light = jax.vmap(look)(jax.tree.map(lambda *a: jnp.stack(a), found.dark, found.light))
        place = lambda u, v: at(contours.at(fixed, found.face, (u, v)))
        q, (qx, qy) = place(*found.uv), jax.jacfwd(place, (0, 1))(*found.uv)
        area = jnp.abs(qx[0] * qy[1] - qx[1] * qy[0])
        scale = jnp.where((face == found.face).all(), found.weight * weight * area, 0.0)
        o, d = through(view, q)
        if mirror is not None:
            plane = edge.Plane.of(world, mirror.face)
            o, d = where(meant, (plane.image(o), plane.turned(d)), (o, d))
        jump = light.map(lambda c: (c[1] - c[0]) * scale)
        return q, zero_valued(jump, contours.level(world, found.face, o, d))

    def one(term: Any, world: World, view: Any, to_local: Any, i: Any) -> tuple[Any, Any]:
        q, value = term(world, view, to_local, Stream(i.astype(jnp.uint32), seed))
        value = value.array()
        places, parts = [], []
        for a in range(1 - reach, reach):
            for b in range(1 - reach, reach):
                x, y = jnp.floor(q[0]) + a, jnp.floor(q[1]) + b
                pixel = film.pixel(filter_, x, y, still.width, still.height)
                within = (x >= 0) & (x < still.width) & (y >= 0) & (y < still.height)
                h = jnp.where(within, film.density(filter_, pixel, q), 0.0)
                places.append(jnp.where(within, y * still.width + x, n).astype(jnp.int32))
                parts.append(value * sg(h))
        return jnp.stack(places), jnp.stack(parts)

    terms_of = [outline, contour] if plan.smooth_normals and steps > 1 else [outline]
    samples *= n_ways
    lanes = min(samples, LANES)
    batches = max(1, round(samples / lanes))
    zero = jnp.zeros((n, plan.channels), fixed.faces.dtype)

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def batch(motion: Any, first: Any) -> Any:
        def terms(world: World, view: Any) -> Any:
            to_local, numbers = jnp.linalg.inv(view.to_world), first + jnp.arange(lanes, dtype=jnp.int32)
            total = zero
            for term in terms_of:
                places, parts = jax.vmap(lambda i, term=term: one(term, world, view, to_local, i))(numbers)
                total = total.at[places].add(parts, mode="drop")
            return total

        return along(terms, (world, view), motion)[1]

    add = lambda total, k: (total + batch(motion, k * lanes), None)
    return jax.lax.scan(add, zero, jnp.arange(batches, dtype=jnp.int32))[0] / (batches * lanes)
