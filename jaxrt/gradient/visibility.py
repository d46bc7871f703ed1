"""Boundary terms: how a picture changes because what is seen changes, where samples held fixed know nothing of it.

∫ f over directions of which some see past an edge and some do not has a derivative beside that of f: the edge sweeps
over directions, and on its way replaces what lies on one side of it by what lies on the other. At a point x, with the
edge's point y = x + r ω, N̂ the normal of the plane of x and the edge, φ the angle along it:

    dL_o(x) = ∫ f_r cosθ (L₋ − L₊) (N̂·w)/r dφ,     w = ẏ − ẋ for directions fixed in space (reflected light R)

and for direct light, whose samples z stay on the emitter, w = (ẏ − ẋ) − (r/|z−x|)(ż − ẋ), with −L⁰(z) behind the
edge in place of the difference (see `material`). On the film: dI = ∫ h(q) (L₋ − L₊) (q̇·N̂) dl, q the edge's image.

Each is written as Σ coefficient · position minus its own value: zero, with the right first derivative. Coefficients are
held fixed, so that only positions of edges, of x and of z are differentiated. That is done sample by sample: the value
is no part of any program, and reverse mode only has to transpose a sum.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from .. import brdf
from ..rules import reflected, reflection_node
from ..sampling.sobol import Stream, combine
from ..solver import path
from ..surface import SurfacePoint, choice, leave, radiance_of, shading_at, surface_point
from ..vector import Spectrum, Vec3, cross, dot, length, normalise, where
from ..world import FEW_LIGHTS, World
from . import contours, curves, material
from . import edges as edge
from .edges import CANDIDATES, Edges, candidates, pick, sums_of
from .outline import FLAT, Outline


def aside(world: World, r: Any, curved: Any = False) -> Any:
    """How far beside an edge at distance r to look, in radians: more than rounding moves points, and hardly more.
    `curved`: beside an outline of a curved face, where light differs from that at it by the square root of this."""
    fine = (1e-4 if world.plan.smooth_normals else 3e-4) if world.faces.dtype == jnp.float32 else 1e-5
    fine = jnp.where(curved, min(fine, 2e-5), fine)
    return jnp.minimum(jnp.maximum(fine, 4.0 * world.epsilon / jnp.maximum(r, 1e-30)), 0.05)


class Chosen(eqx.Module):
    """A direction to a point of an edge, or of its image in a mirror; `t` along the edge, and dt/dφ; the inverse of its
    density over φ (radians), 0 if there is none; a point of M beside the edge. `x`: from where it is seen, or that
    point's image. Edges are numbered before outlines of curved faces."""

    edge: Any
    x: Vec3
    beside: Vec3
    w: Vec3
    pole: Vec3
    r: Any
    t: Any
    slope: Any
    weight: Any

    def attached(self, world: World, edges: Edges, mirror: Any = None) -> Vec3:
        """The edge's point, or its image, that moves with M."""
        y = edges.point(world, self.edge, self.t, self.x)
        return y if mirror is None else edge.Plane.of(world, mirror).image(y)


def choose(
    world: World,
    edges: Edges,
    x: Vec3,
    n: Vec3 | None,
    s: Stream,
    cone: edge.Cone | None = None,
    plane: edge.Plane | None = None,
    creases: bool = True,
    straight: bool = True,
    toward: edge.Cone | None = None,
    plain: Vec3 | None = None,
) -> Chosen:
    """An edge as seen from x (above the horizon of n), by the angle it takes over its distance, and an even angle
    along it; or a part of the outline of a curved face, and an even place on it.

    `cone`: the parts of edges inside a cone of directions. `plane`: a mirror, in which they are seen. Without
    `creases`: outlines alone; without `straight`, those of curved faces. `toward`: a cone whose insides half of the
    choices are made from; densities are those of both. `plain`: the normal of the face of x, where n is another: what
    is seen changes at that face's horizon too, which its own edges are.
    """
    u, v = s.pair_at(0)
    total = edges.ends.shape[0] if straight else 0
    if total <= CANDIDATES:
        numbers, scale = jnp.arange(total), jnp.ones(total, world.faces.dtype)
    else:
        numbers, scale = candidates(edges.chance, s.pair_at(1)[0])
    cones = [[cone], [cone, toward]][: 2 if toward is not None else 1]

    def weigh(j: Any, scale: Any) -> list[Any]:
        arc = edge.arc_of(edge.two_points(edges.ends[j], plane), x, n)
        seen = edge.hides(edges, j, x, arc.pole, plane)
        rate = scale / jnp.maximum(arc.distance, world.epsilon)
        if plain is not None and n is not None and plane is None:
            flat, tilt = edge.lies_in(world, edges, j, x, plain), length(cross(n, plain))
            seen, rate = seen | flat, jnp.where(flat, scale * tilt / world.radius, rate)
        if creases:
            seen |= edges.crease[j]
        if creases and edges.faint is not None:
            seen, rate = seen | (edges.faint[j] > 0), jnp.where(seen, rate, rate * edges.faint[j])
        seen &= edges.there[j]
        ranges = [arc.within(c) for c in cones]
        return [jnp.where(seen & (high > low), rate * (high - low), 0.0) for low, high in ranges]

    parts = curves.parts(world, edges.blocks, x if plane is None else plane.image(x))
    if plane is not None:
        parts = parts.seen_in(plane)
    weights = jax.vmap(weigh)(numbers, scale) if total else [jnp.zeros(0, world.faces.dtype)] * len(cones)
    if parts.count:
        weights = [jnp.concatenate([w, parts.weigh(c)]) for w, c in zip(weights, cones, strict=True)]
    sums = [sums_of(w) for w in weights]
    shares = [jnp.ones_like(u)]
    if toward is not None:
        half = jnp.where(sums[1][-1] > 0, 0.5, 0.0)
        second = u < half
        u = jnp.where(second, u / jnp.maximum(half, 0.5), (u - half) / (1.0 - half))
        shares = [1.0 - half, half]
        k = jnp.where(second, pick(sums[1], u), pick(sums[0], u))
    else:
        second, k = False, pick(sums[0], u)
    chances = [a * w[k] / jnp.where(c[-1] > 0, c[-1], 1.0) for a, w, c in zip(shares, weights, sums, strict=True)]
    found: Chosen | None = None
    if total:
        i = jnp.minimum(k, total - 1)
        found = _on_edge(world, edges, numbers[i], x, n, v, cones, plane, second, chances, scale[i])
    if parts.count:
        chance = sum(chances)
        inverse = jnp.where(chance > 0, 1.0 / jnp.where(chance > 0, chance, 1.0), 0.0)
        curved = _on_curve(world, edges, jnp.maximum(k - total, 0), x, v, plane, inverse)
        found = curved if found is None else where(k >= total, curved, found)
    assert found is not None
    return found


def _on_edge(
    world: World, edges: Edges, j: Any, x: Vec3, n: Any, v: Any, cones: Any, plane: Any, second: Any, chances: Any,
    scale: Any,
) -> Chosen:  # fmt: skip
    p, q = edge.two_points(edges.ends[j], plane)
    arc = edge.arc_of((p, q), x, n)
    ranges = [arc.within(c) for c in cones]
    low, high = ranges[0] if len(ranges) == 1 else where(second, ranges[1], ranges[0])
    phi = low + (high - low) * v
    density = 0.0 * phi
    for (a, b), chance in zip(ranges, chances, strict=True):
        inside = (phi >= a) & (phi <= b) & (b > a)
        density += jnp.where(inside, chance / jnp.where(b > a, b - a, 1.0), 0.0)
    w = arc.direction(phi)
    along = q - p
    across, normal = cross(w, along), cross(p - x, along)
    r = length(normal) / jnp.maximum(length(across), 1e-30)
    t = jnp.clip(dot(x + w * r - p, along) / jnp.maximum(dot(along, along), 1e-30), 0.0, 1.0)
    good = (density > 0) & jnp.isfinite(r) & (r > 8.0 * world.epsilon)
    slope = r * r / jnp.maximum(length(normal), 1e-30)
    a, b = edge.two_points(edges.beside[j], plane)
    beside = (a + b) * 0.5
    weight = jnp.where(good, scale / jnp.where(good, density, 1.0), 0.0)
    return Chosen(j, x, beside, w, arc.pole, jnp.where(good, r, 1.0), t, slope, weight)


def _on_curve(world: World, edges: Edges, c: Any, x: Vec3, v: Any, plane: Any, inverse: Any) -> Chosen:
    j, u = c // curves.PARTS + edges.ends.shape[0], (c % curves.PARTS + v) / curves.PARTS
    seen_from = x if plane is None else plane.image(x)
    image = (lambda p: p) if plane is None else plane.image
    y, along, beside = edges.curve(world, c // curves.PARTS, seen_from, u)
    y, along, beside = image(y), image(y + along) - image(y), image(beside)
    to = y - x
    r, normal = length(to), cross(to, along)
    angle = length(normal) / jnp.maximum(r * r, 1e-30)  # dφ/du
    good = (r > 8.0 * world.epsilon) & (angle > 0)
    weight = jnp.where(good, inverse * angle / curves.PARTS, 0.0)
    slope = 1.0 / jnp.maximum(angle, 1e-30)
    return Chosen(j, seen_from, beside, normalise(to), normalise(normal), jnp.where(good, r, 1.0), u, slope, weight)


def borders(world: World, y: Any, reach: Any) -> Any:
    """Whether a point of M lies within `reach` (m) of a border of its face, if that is flat."""
    row = sg(world.geometry).at[jnp.maximum(y.face, 0)].get(mode="clip", wrap_negative_indices=False)
    a, b = (length(Vec3(row[k], row[k + 1], row[k + 2])) for k in (3, 6))
    u, v = y.uv
    four = y.face >= world.first("parallelogram")
    far = jnp.where(four, jnp.minimum((1.0 - u) * a, (1.0 - v) * b), (1.0 - u - v) * jnp.minimum(a, b))
    flat = (y.face >= 0) & (y.face < world.first("disk"))
    return flat & (jnp.minimum(jnp.minimum(u * a, v * b), far) < reach)


def owned(world: World, edges: Edges, j: Any, r: Any, reach: Any, minus: Any, plus: Any) -> Any:
    """The share of an edge in the jump between what is met just beside it on either side.

    All of it, if one of them is a face of the edge, which then is not hidden; half, if the other lies at the edge and
    ends there too: then that one's border is an edge of its own (walls that were built one by one).
    """
    a, b = edges.faces_at(j)
    own = [(y.face == a) | (y.face == b) for y in (minus, plus)]
    tie = [borders(world, y, reach) & (jnp.abs(y.distance - r) < reach) for y in (minus, plus)]
    alone = jnp.where(own[0], tie[1], tie[0])
    share = jnp.where(own[0] & own[1], 1.0, jnp.where(alone, 0.5, 1.0))
    parted = (minus.face != plus.face) | (jnp.abs(minus.distance - plus.distance) > reach)  # two sides of a tube
    parted = parted & (minus.face > -2) & (plus.face > -2)
    return jnp.where((own[0] | own[1]) & parted, share, 0.0)


class Met(eqx.Module):
    """Where a ray beside an edge lands: as much of a `SurfacePoint` as tells which face parts two of them."""

    face: Any
    distance: Any
    uv: Any
    position: Vec3
    normal: Vec3

    @classmethod
    def of(cls, x: SurfacePoint) -> Met:
        return cls(x.face, x.distance, x.uv, x.position, x.normal)


def follow(
    world: World, depths: path.Depths, o: Vec3, d: Vec3, s: Stream, depth: Any, further: bool, sampled: bool,
    edge_ray: tuple[Vec3, Vec3] | None = None,
) -> tuple[Met, Spectrum]:  # fmt: skip
    """Where a ray lands that is edge number `depth` of a path, and an estimate of what arrives along it.

    `further`: whether any such path goes on from there. Without `sampled`, emission that is sampled as light is left
    out where the ray lands. `edge_ray`: that to the edge beside which this one looks, if it does.
    """
    none = Spectrum.full(world.plan.channels, 0.0 * o.x)

    def left_out(x: SurfacePoint) -> Spectrum:
        lamp = (x.light_density > 0) & (x.face >= 0)
        return none if sampled else radiance_of(world, x, -d).map(lambda c: jnp.where(lamp, c, 0.0))

    if not further:
        x = surface_point(world, world.settle(world.search.closest(o, d)), o, d)
        return Met.of(x), radiance_of(world, x, -d) - left_out(x)

    def step(carry: tuple[path.PathState, Met]) -> tuple[path.PathState, Met]:
        p, met = carry
        first, face = p.depth == depth, None
        if edge_ray is not None and world.plan.smooth_normals:
            face = world.settle(world.search.closest(p.o, p.d))
            nearer = contours.short_of(world, face, edge_ray, (p.o, p.d))
            p = replace(p, o=where(first, nearer[0], p.o), d=where(first, nearer[1], p.d))
        landing = path.land(world, depths, p, path.bounce_stream(s, p.depth), face)
        radiance = landing.radiance - left_out(landing.x).map(lambda c: jnp.where(first, c, 0.0))
        landing = replace(landing, radiance=radiance)
        return path.reflect(world, depths, p, landing), where(first, Met.of(landing.x), met)

    begun, zero = replace(path.start(world, o, d), depth=depth), 0.0 * o.x
    met = Met(jnp.full_like(begun.depth, -1), zero, (zero, zero), o * 0.0, o * 0.0)
    end, met = jax.lax.while_loop(lambda c: jnp.any(c[0].alive), step, (begun, met))
    return met, end.radiance


class Seen(eqx.Module):
    """A point from which edges are seen: attached position, and held fixed: the normal on its side, an origin for rays
    by direction (`lift` off the surface), what its path is worth."""

    position: Vec3
    normal: Vec3
    lift: Vec3
    beta: Spectrum

    def plain(self, world: World) -> Vec3 | None:
        """The normal of its face where shading has others; of no length where there is no face."""
        return self.lift * (1.0 / world.epsilon) if world.plan.smooth_normals else None

    def origin(self, w: Vec3) -> Vec3:
        return sg(self.position) + self.lift * jnp.where(dot(self.lift, w) < 0, -1.0, 1.0)


def _look(world: World, seen: Seen, chosen: Chosen, side: Any) -> tuple[Vec3, Vec3, Any]:
    """Origin, direction and face met just beside an edge."""
    w = normalise(chosen.w + chosen.pole * (side * aside(world, chosen.r)))
    o = seen.origin(w)
    return o, w, world.settle(world.search.closest(o, w))


class Mirror(eqx.Module):
    """A flat mirror, chosen by area: its face, its plane, the cone that holds it as seen from x, and 1/its chance."""

    face: Any
    plane: edge.Plane
    cone: edge.Cone
    weight: Any

    @classmethod
    def choose(cls, world: World, edges: Edges, x: Vec3, u: Any) -> Mirror:
        chance = edges.mirrors
        assert chance is not None
        face = jnp.minimum(jnp.sum(jnp.cumsum(chance) <= u), len(chance) - 1)
        o, a, b = curves.corners(world, face)
        middle, sides = o + (a + b) * 0.5, [length(a + b), length(a - b)]  # of a disk, half of the square around it
        disk = face >= world.first("disk")
        to = where(disk, o, middle) - x
        radius = jnp.maximum(*sides) * jnp.where(disk, 1.0, 0.5)
        sine = radius / jnp.maximum(length(to), 1e-30)
        ok = chance[face] > 0
        weight = jnp.where(ok, 1.0 / jnp.where(ok, chance[face], 1.0), 0.0)
        cone = edge.Cone(normalise(to), sine, Outline.of(world, face, x, world.plan.kinds))
        return cls(face, edge.Plane.of(world, face), cone, weight)

    def behind(self, world: World, w: Vec3, at: Met) -> Met:
        """What a ray along w that lands at a point sees in the mirror; of face −2 where the point is not on it."""
        turned = self.plane.turned(w)
        origin = leave(world, at, turned)
        y = surface_point(world, world.settle(world.search.closest(origin, turned)), origin, turned)
        there = at.face == self.face
        return replace(Met.of(y), distance=y.distance + at.distance, face=jnp.where(there, y.face, -2))


def along(f: Any, at: Any, motion: Any) -> tuple[Any, Any]:
    """f(*at), an array, and its derivative by `motion`, tangents of `at` of which some may be None."""
    value, slope = eqx.filter_jvp(f, at, motion)
    return value, jnp.zeros_like(value) if slope is None else slope


def zero_valued(coefficient: Spectrum, position: Any) -> Spectrum:
    """coefficient · (position − its own value)."""
    moved = position - sg(position)
    return coefficient.map(lambda c: sg(jnp.where(jnp.isfinite(c), c, 0.0)) * moved)


def lamp_cone(world: World, k: Any, x: Vec3) -> edge.Cone:
    """What lamp number k takes of the directions from x, but for its own outline; where there are many, all lamps."""
    bounds, plan, outline = world.light_bounds, world.plan, None
    apart = bounds.shape[0] > 1 or world.light_rows.shape[0] <= FEW_LIGHTS
    if apart and FLAT & set(plan.light_kinds):
        face = world.light_rows[k, 14 + plan.channels].astype(jnp.int32)
        outline = Outline.of(world, face, x, plan.light_kinds)
    return edge.Cone.around(bounds[k], x, None, outline)


def shadows(world: World, edges: Edges, seen: Seen, value: Any, s: Stream) -> Spectrum:
    """The boundary term of direct light at a point; `value(ω)`: f_r cosθ."""
    fixed, plan = sg(world), world.plan
    x, n = sg(seen.position), None if brdf.is_translucent(plan.lobes) else seen.normal
    bounds = fixed.light_bounds
    chances = fixed.light_rows[: bounds.shape[0], 13] if bounds.shape[0] > 1 else jnp.ones(1)
    cdf = jnp.cumsum(chances)
    k = pick(cdf, s.pair_at(2)[0])
    chosen = choose(fixed, edges, x, n, s, lamp_cone(fixed, k, x), creases=False, plain=seen.plain(fixed))
    j, r = chosen.edge, chosen.r
    free = jnp.where(dot(chosen.pole, chosen.beside - x) > 0, -1.0, 1.0)
    both = jax.vmap(lambda side: _look(fixed, seen, chosen, side))(jnp.stack([free, -free]))
    (o, w, face), (_, _, hider) = (jax.tree.map(lambda a, k=k: a[k], both) for k in (0, 1))
    z = surface_point(fixed, face, o, w)
    asked = z.light_density > 0
    if bounds.shape[0] > 1:
        asked &= face == fixed.light_rows[k, 14 + plan.channels].astype(jnp.int32)
    ok = asked & edges.belongs(j, hider) & (face >= 0) & (z.distance > r * 1.0001) & (chosen.weight > 0)
    emitted = radiance_of(fixed, z, -w)
    scale = jnp.where(ok, -free * chosen.weight * cdf[-1] / jnp.maximum(chances[k], 1e-30) / r, 0.0)
    coefficient = seen.beta * value(chosen.w) * emitted * scale
    y = chosen.attached(world, edges)
    there = where(ok, z, replace(z, face=jnp.maximum(face, 0)))
    behind = material.emitter_point(world, there)[0]
    ratio = r / jnp.where(ok, z.distance, 1.0)
    w_attached = (y - seen.position) - (behind - seen.position) * ratio
    return zero_valued(coefficient, dot(chosen.pole, w_attached))


def outlines(
    world: World, edges: Edges, depths: path.Depths, seen: Seen, value: Any, s: Stream, depth: Any, further: bool
) -> Spectrum:
    """The boundary term of reflected light, and of the enclosure's, at a point that a path reached with `depth` edges.

    The emission of lamps that are sampled there has another form, see `shadows`. Edges are seen from there, and where a
    scene has mirrors their images in one of those as well. `further`: as of `follow`.
    """
    fixed, plan = sg(world), world.plan
    x, n = sg(seen.position), None if brdf.is_translucent(plan.lobes) else seen.normal
    kinds: list[tuple[Chosen, Mirror | None]] = []
    if edges.mirrors is None:
        kinds.append((choose(fixed, edges, x, n, s, plain=seen.plain(fixed)), None))
    else:
        mirror, lamp = Mirror.choose(fixed, edges, x, s.pair_at(2)[1]), None
        if plan.light_kinds:  # a lamp's image is as bright as the lamp
            bounds = fixed.light_bounds
            k = jnp.minimum((s.pair_at(2)[0] * bounds.shape[0]).astype(int), bounds.shape[0] - 1)
            lamp = edge.Cone.around(bounds[k], x, mirror.plane)  # not only inside: its own outline matters here
        kinds.append((choose(fixed, edges, x, n, s, toward=lamp, plain=seen.plain(fixed)), None))
        kinds.append((choose(fixed, edges, x, n, s.child(1), mirror.cone, mirror.plane, toward=lamp), mirror))

    inside: list[tuple[contours.Contour, Mirror | None]] = []
    if plan.smooth_normals and further:
        for k, (_, mirror) in enumerate(kinds):
            eye, up = (x, n) if mirror is None else (mirror.plane.image(x), None)
            inside.append((contours.choose(fixed, eye, up, s.child(2 + k)), mirror))

    def beside(c: Chosen, side: float) -> tuple[Vec3, Vec3, Vec3]:
        curved = c.edge >= len(edges.ends)
        w = normalise(c.w + c.pole * (side * aside(fixed, c.r, curved)))
        return seen.origin(w), w, where(curved, w, c.w)

    def towards(y: Vec3, mirror: Mirror | None) -> tuple[Vec3, Vec3, Vec3]:
        y = y if mirror is None else mirror.plane.image(y)
        w = normalise(y - seen.origin(y - x))
        return seen.origin(y - x), w, w

    sides = [beside(c, side) for c, _ in kinds for side in (-1.0, 1.0)]
    sides += [towards(y, mirror) for c, mirror in inside for y in (c.dark, c.light)]
    ray = lambda o, w, e: follow(fixed, depths, o, w, s, depth + 1, further, not plan.light_kinds, (o, e))
    looked = jax.vmap(ray)(*jax.tree.map(lambda *a: jnp.stack(a), *sides))
    total = Spectrum.full(plan.channels, 0.0 * x.x)

    def seen_at(k: int, mirror: Mirror | None) -> tuple[list[Met], Spectrum]:
        """What the two rays of number k meet, and the difference of what arrives along them."""
        rays = [jax.tree.map(lambda a, i=2 * k + i: a[i], looked) for i in (0, 1)]
        met = [y if mirror is None else mirror.behind(fixed, sides[2 * k + i][1], y) for i, (y, _) in enumerate(rays)]
        return met, rays[0][1] - rays[1][1]

    for k, (chosen, mirror) in enumerate(kinds):
        met, jump = seen_at(k, mirror)
        reach = 8.0 * aside(fixed, chosen.r) * chosen.r
        share = owned(fixed, edges, chosen.edge, chosen.r, reach, *met)
        scale = chosen.weight * share * (1.0 if mirror is None else mirror.weight) / chosen.r
        coefficient = seen.beta * value(chosen.w) * jump * scale
        y_attached = chosen.attached(world, edges, None if mirror is None else mirror.face)
        total = total + zero_valued(coefficient, dot(chosen.pole, y_attached - seen.position))
    for k, (contour, mirror) in enumerate(inside, len(kinds)):
        met, jump = seen_at(k, mirror)
        eye = x if mirror is None else mirror.plane.image(x)
        d, solid_angle = contour.seen_from(fixed, eye)
        w, scale, ray = d, contour.weight * solid_angle, (seen.position, d)
        if mirror is not None:
            w, scale, plane = mirror.plane.turned(d), scale * mirror.weight, edge.Plane.of(world, mirror.face)
            ray = plane.image(seen.position), plane.turned(w)
        scale = jnp.where((met[0].face == contour.face) & (met[1].face == contour.face), -scale, 0.0)
        total = total + zero_valued(seen.beta * value(w) * jump * scale, contours.level(world, contour.face, *ray))
    return total


def surfaces(
    world: World, edges: Edges, begin: Any, motion: Any, steps: int, depths: path.Depths, seed: Any, numbers: Any,
    spp: int,
) -> Any:  # fmt: skip
    """The boundary terms of all reflection integrals on the way to lanes `numbers`, means over spp paths, (N, C): their
    derivative by `motion`, tangents of world and begin.

    Each path takes the term of direct light at every landing, and that of reflected light at one of them: with
    chance 1/2 at the first, 1/4 at the second. What a meter takes in counts as a landing before those.
    """
    fixed, plan = sg(world), world.plan
    seed, last = combine(seed, 0xB0DE), max(steps - 2, 0)
    further = steps > (1 if begin.searches else 2)
    reflecting = (
        further or plan.enclosure or not plan.light_kinds
    )  # else what is seen beside edges is lamps, which shadows are of

    def landed(x: SurfacePoint, at: Any, beta: Spectrum) -> Seen:
        return Seen(x.position, sg(at.frame.n * at.side), sg(x.normal) * fixed.epsilon, sg(beta))

    def one(world: World, begin: Any, number: Any, sample: Any) -> Any:
        s = path.sample_stream(seed, number, sample)
        begun, meter = begin(world, number, s), begin.meter(world, number, s)
        first = 0 if meter is None else -1
        u = s.child(21).pair_at(0)[0]
        which = jnp.floor(-jnp.log2(jnp.maximum(1.0 - u, 1e-9))).astype(jnp.int32) + first
        which = jnp.minimum(which, last) if steps > 1 else jnp.full_like(which, first)
        rare = jnp.exp2(jnp.minimum(which - first + 1, last - first if steps > 1 else 0).astype(u.dtype))
        total, kept = Spectrum.full(plan.channels, 0.0 * begun.o.x), None
        if reflecting:
            x = surface_point(fixed, jnp.zeros_like(begun.depth), sg(begun.o), sg(begun.d))  # of the right structure
            kept = (begun.o, x, sg(begun.d), sg(begun.beta), begun.alive & False)
        white = lambda n, w: Spectrum.full(plan.channels, jnp.maximum(dot(n, w), 0.0))
        if meter is not None:
            position, normal, weight = meter
            beta = Spectrum.full(plan.channels, sg(weight * jnp.ones_like(u)))
            if plan.light_kinds:
                seen = Seen(position, sg(normal), sg(normal) * 0.0, beta)
                total = total + shadows(world, edges, seen, functools.partial(white, sg(normal)), s.child(22))
            if kept is not None:
                kept = (position, replace(kept[1], normal=sg(normal)), sg(normal), beta, which == -1)

        def body(carry: Any, k: Any) -> tuple[Any, None]:
            state, total, kept = carry
            s_k = path.bounce_stream(s, k)
            x = surface_point(world, world.settle(fixed.search.closest(state.o, state.d)), state.o, state.d)
            wo = -state.d
            at = shading_at(world, x, wo, choice(world, s_k), True)
            goes_on = (state.depth + 1 < depths.max_depth) | (depths.max_depth < 0)
            alive = state.alive & (x.face >= 0) & goes_on
            if plan.light_kinds:
                f = functools.partial(reflected, fixed, sg(at))
                term = shadows(world, edges, landed(x, at, state.beta), f, s_k.child(22))
                total = total + term.map(lambda c: jnp.where(alive, c, 0.0))
            if kept is not None:
                here = alive & (k.astype(jnp.int32) == which)
                kept = where(here, (x.position, sg(x), sg(wo), sg(state.beta), here), kept)
            node = world.settle(reflection_node(world, at, s_k))
            beta = sg(state.beta * node.weight)
            follow = path.PathState(
                leave(world, x, node.w), node.w, beta, state.radiance, node.pdf, node.delta, state.depth + 1,
                alive & (beta.max() > 0),
            )  # fmt: skip
            return (follow, total, kept), None

        if steps > 1:
            landings = jnp.arange(steps - 1, dtype=jnp.uint32)
            (_, total, kept), _ = jax.lax.scan(body, (begun, total, kept), landings)
        if kept is not None:
            position, x, wo, beta, found = kept
            s_k = path.bounce_stream(s, which)
            at = shading_at(fixed, x, wo, choice(fixed, s_k))
            seen, f = replace(landed(x, at, beta * rare), position=position), functools.partial(reflected, fixed, at)
            if meter is not None:
                here = which == -1
                normal = where(here, x.normal, seen.normal)
                seen = replace(seen, normal=normal, lift=seen.lift * jnp.where(here, 0.0, 1.0))
                f = lambda w: where(here, white(normal, w), reflected(fixed, at, w))
            term = outlines(world, edges, depths, seen, f, s_k.child(23), which, further)
            total = total + term.map(lambda c: jnp.where(found, c, 0.0))
        counts = begin.weight(world, number, s)
        return (total if counts is None else total * sg(counts)).array()

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def one_pass(motion: Any, numbers: Any, sample: Any) -> Any:
        terms = lambda world, begin: jax.vmap(lambda number: one(world, begin, number, sample))(numbers)
        return along(terms, (world, begin), motion)[1]

    zero = jnp.zeros((numbers.shape[0], plan.channels), world.faces.dtype)
    add = lambda total, sample: (total + one_pass(motion, numbers, sample), None)
    return jax.lax.scan(add, zero, jnp.arange(spp, dtype=jnp.int32))[0] / spp
