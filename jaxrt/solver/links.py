"""Links: the operator T between elements, sampled once. From each element frozen directions go through ψ until they
land on an element; mirrors, gloss and elements that something stands on are followed further, as by a path.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from ..brdf import MaterialColumns
from ..chart import off_surface
from ..compiler import chunks, one_function, over_devices
from ..effects import Plan
from ..rules import met_share
from ..sampling.sobol import Stream, combine
from ..surface import _row, radiance_of, surface_point
from ..vector import Spectrum, where
from ..world import FACE, World
from . import path
from .elements import BLACK, Elements, element_of, sampled

FARTHEST = 64
"""Reflections after which a link that found no element is given up."""

PATIENCE = 2
"""Reflections after which a link ends also on an element that something stands on: below a box nothing else is met."""

DERIVED = 6
"""Reflections that derivatives follow a link."""

WIDE = 2048
"""Elements that are linked together under differentiation, as paths of pictures are."""

ENDLESS = path.Depths(-1, 1 << 30, False)

LENGTHS = 4
"""Numbers of edges that are told apart in direct light of links; longer ones count as the last."""


class Links(eqx.Module):
    """Direct light and links of each element: b = e + T b with (T b)_i = 1/K Σ_k weight_ik b[target_ik].

    `area`: m². `direct`: mean of both halves of the samples by edges up to the light, (E, 2, S, C). `weight`: None
    where it is `albedo` for all links of an element. `edges`: of each link.
    """

    direct: Float[Array, "E 2 S C"]
    albedo: Float[Array, "E C"]
    area: Float[Array, " E"]
    target: Int32[Array, "E K"]
    weight: Float[Array, "E K C"] | None
    edges: Int32[Array, "E K"] | None

    @property
    def emitted(self) -> Any:
        """e: direct light of each element, (E, C)."""
        return self.direct.mean(1).sum(1)

    def half(self, k: Any) -> Links:
        """The links of one half of the samples, 0 or 1."""
        n = self.target.shape[1] // 2
        part: Any = lambda a: None if a is None else jax.lax.dynamic_slice_in_dim(a, k * n, n, 1)
        direct = jnp.repeat(jax.lax.dynamic_slice_in_dim(self.direct, k, 1, 1), 2, 1)
        return Links(direct, self.albedo, self.area, part(self.target), part(self.weight), part(self.edges))

    def apply(self, b: Any) -> Any:
        """T b, for b (E, C)."""
        landed = b.at[self.target].get(mode="promise_in_bounds")
        if self.weight is None:
            return self.albedo * landed.mean(1)
        return (self.weight * landed).mean(1)


class Begun(eqx.Module):
    """A link on its way: the path, and the face on which it is about to land."""

    path: path.PathState
    face: Any


class Step(eqx.Module):
    """What one reflection of a link gave: light, whether it ended, and the element that it found (or black)."""

    light: Spectrum
    ended: Any
    target: Any
    weight: Spectrum
    edges: Any


def begin(world: World, elements: Elements, seed: Any, e: Any, k: Any, at: tuple[Any, Any] | None = None) -> Begun:
    """Link k of element e, about to land on its own beginning: `at` a place in the element, or anywhere in it."""
    s = stream_of(seed, e, k)
    face, y, n = sampled(world, elements, e, s.pair_at(0) if at is None else at, s.pair_at(1)[0])
    begun = path.start(world, off_surface(world, y, n), -n, depth=-1)
    return Begun(replace(begun, pdf=0.0 * begun.pdf, delta=jnp.zeros_like(begun.alive)), face)


def stream_of(seed: Any, e: Any, k: Any) -> Stream:
    return Stream(k.astype(jnp.uint32), combine(seed, e))


def advance(
    world: World, elements: Elements, seed: Any, follow: bool, e: Any, k: Any, link: Begun
) -> tuple[Begun, Step]:
    """One reflection of a link: direct light where it stands, then where it lands. A `follow`ed one may go on."""
    s = path.bounce_stream(stream_of(seed, e, k), link.path.depth + 1)
    at = path.bounce(world, ENDLESS, link.path, s, link.face)
    face = world.settle(world.search.closest(at.o, at.d))
    x = world.settle(surface_point(world, face, at.o, at.d))
    element = element_of(world, elements, x, -at.d)
    holds = element >= 0
    if follow:
        coarse = _row(elements.size, jnp.maximum(element, 0)) == jnp.inf
        holds = holds & (~coarse | (at.depth >= PATIENCE))
    ended = ~at.alive | holds | (x.face < 0) | (at.depth >= FARTHEST) | (not follow)
    share = met_share(world, x, at.o, at.d, at.pdf, at.delta)
    met = at.beta * radiance_of(world, x, -at.d) * share
    light = at.radiance - link.path.radiance + met.map(lambda c: jnp.where(ended & at.alive, c, 0.0))
    target = jnp.where(at.alive & holds, element, BLACK)
    weight = at.beta.map(lambda c: jnp.where(at.alive & ended, c, 0.0))
    return Begun(at, face), Step(light, ended, target, weight, at.depth + 1)


class _Lane(eqx.Module):
    """An element at work: its current sample and link, and the light that came of them by half and length."""

    sample: Any
    link: Begun
    direct: tuple[Spectrum, ...]


def _links(world: World, elements: Elements, seed: Any, numbers: Any, count: int, follow: bool, lengths: int) -> Links:
    """Links of elements (n,): a lane starts its next link where one ends."""
    n, channels = numbers.shape[0], world.plan.channels
    zero = Spectrum.full(channels, jnp.zeros(n, world.faces.dtype))
    sample, row = jnp.zeros(n, jnp.int32), jnp.arange(n)
    link = jax.vmap(lambda e, k: begin(world, elements, seed, e, k))(numbers, sample)
    lanes = _Lane(sample, link, (zero,) * (2 * lengths))
    target = jnp.zeros((n, count), jnp.int32)
    weight = jnp.zeros((n, count, channels), world.faces.dtype) if follow else None
    edges = jnp.zeros((n, count), jnp.int32) if follow and lengths > 1 else None

    def step(world: World, elements: Elements, seed: Any, e: Any, lane: _Lane) -> tuple[_Lane, Step]:
        link, found = advance(world, elements, seed, follow, e, lane.sample, lane.link)
        real = lane.sample < count
        bucket = _bucket(lane.sample, link.path.depth, count, lengths)
        direct = _added(lane.direct, found.light, bucket, real)
        sample = lane.sample + found.ended.astype(lane.sample.dtype)
        link = where(found.ended, begin(world, elements, seed, e, jnp.minimum(sample, count - 1)), link)
        return _Lane(sample, link, direct), found

    steps = jax.vmap(step, in_axes=(None, None, None, 0, 0))
    together = one_function(steps) if world.plan.backend == "dense" else steps  # scatters cannot be in it

    def body(carry: Any) -> Any:
        lanes, target, weight, edges = carry
        k = lanes.sample
        lanes, found = together(world, elements, seed, numbers, lanes)
        put = lambda table, v: None if table is None else table.at[row, k].set(v, mode="drop")
        return lanes, put(target, found.target), put(weight, found.weight.array()), put(edges, found.edges)

    lanes, target, weight, edges = jax.lax.while_loop(
        lambda c: jnp.any(c[0].sample < count), body, (lanes, target, weight, edges)
    )
    direct = jnp.stack([p.array() for p in lanes.direct], 1).reshape(n, 2, lengths, channels)
    return _scaled(world, elements, numbers, direct, target, weight, edges)


def _added(direct: tuple[Spectrum, ...], light: Spectrum, bucket: Any, real: Any) -> tuple[Spectrum, ...]:
    """Sums of direct light with what came now in one of them."""
    add = lambda b, total: total.map(lambda a, c: a + jnp.where(real & (bucket == b), c, 0.0), light)
    return tuple(add(b, total) for b, total in enumerate(direct))


def _bucket(sample: Any, depth: Any, count: int, lengths: int) -> Any:
    """Which sum light goes to: by half of the samples, and by edges up to the light."""
    return jnp.where(2 * sample >= count, lengths, 0) + jnp.minimum(depth, lengths - 1)


def _scaled(world: World, elements: Elements, numbers: Any, direct: Any, target: Any, weight: Any, edges: Any) -> Links:
    """Means of sums, and nothing for black and padding. The albedo is the material's, to the last bit."""
    count, real = target.shape[1], (elements.size[numbers] > 0)[:, None]
    finish = world.faces[elements.face[elements.first[numbers]], FACE["finish"]].astype(jnp.int32)
    columns = MaterialColumns(world.plan.channels, world.plan.fields)["reflectance"]
    return Links(
        direct=jnp.where(real[:, None, None], direct * (2.0 / count), 0.0),
        albedo=jnp.where(real, world.finishes[jax.lax.stop_gradient(finish), slice(*columns)], 0.0),
        area=elements.area[numbers],
        target=target,
        weight=None if weight is None else jnp.where(real[:, :, None], weight, 0.0),
        edges=edges,
    )


def _links_fixed(
    world: World, elements: Elements, seed: Any, numbers: Any, count: int, follow: bool, lengths: int
) -> Links:
    """`_links` link by link, each of a fixed number of steps: what is differentiated."""
    n, channels = numbers.shape[0], world.plan.channels

    def element(e: Any, k: Any) -> Any:
        def body(carry: Any, _: Any) -> Any:
            link, going, direct, done = carry
            after, found = world.settle(advance(world, elements, seed, follow, e, k, link))
            bucket = _bucket(k, after.path.depth, count, lengths)
            direct = _added(direct, found.light, bucket, going)
            done = where(going, (found.target, found.weight, found.edges), done)
            return (where(going, after, link), going & ~found.ended, direct, done), None

        link, zero = begin(world, elements, seed, e, k), Spectrum.full(channels, jnp.zeros((), world.faces.dtype))
        start = link, jnp.asarray(True), (zero,) * (2 * lengths), (jnp.int32(BLACK), zero, jnp.int32(0))
        _, _, direct, done = jax.lax.scan(body, start, None, length=_derived(world.plan) if follow else 1)[0]
        return direct, done

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def add(direct: Any, k: Any) -> Any:
        light, (target, weight, edges) = jax.vmap(element, in_axes=(0, None))(numbers, k)
        return direct + jnp.stack([light.array() for light in light], 1), (target, weight.array(), edges)

    zero = jnp.zeros((n, 2 * lengths, channels), world.faces.dtype)
    direct, done = jax.lax.scan(add, zero, jnp.arange(count, dtype=jnp.int32))
    target, weight, edges = (jnp.moveaxis(a, 0, 1) for a in done)
    weight, edges = weight if follow else None, edges if follow and lengths > 1 else None
    return _scaled(world, elements, numbers, direct.reshape(n, 2, lengths, channels), target, weight, edges)


def _derived(plan: Plan) -> int:
    """Reflections after which derivatives give up a link: where all surfaces have elements it has ended by then."""
    plain = plan.lobes == ("diffuse",) and not (
        plan.instances or plan.textures or plan.nodes or "sdfgrid" in plan.kinds
    )
    return PATIENCE + 1 if plain else DERIVED


def link_rows(world: World, elements: Elements, seed: Any, rows: Any, count: int, follow: bool, lengths: int) -> Links:
    """Links of the elements in each row of numbers (R, n), one row after another; `count` from each element.

    `follow`: whether some landings are not on elements and are to be followed.
    """
    return _link_rows(world, elements, seed, rows, count, follow, lengths)  # which has no name to be kept under


@eqx.filter_custom_jvp
def _link_rows(world: World, elements: Elements, seed: Any, rows: Any, count: int, follow: bool, lengths: int) -> Links:
    one = lambda world, elements, seed, row: _links(world, elements, seed, row, count, follow, lengths)
    return over_devices(one, rows, _met(world, elements), elements, seed)


def _met(world: World, elements: Elements) -> World:
    """The world without light sampling, where emitters are everywhere."""
    if not elements.everywhere:
        return world
    return replace(world, plan=replace(world.plan, light_kinds=(), solid_angle=False))


@_link_rows.def_jvp
def _link_rows_jvp(primals: Any, tangents: Any) -> Any:
    world, elements, seed, rows, count, follow, lengths = primals

    def fixed(world: World) -> Links:
        one = lambda world, elements, seed, row: _links_fixed(world, elements, seed, row, count, follow, lengths)
        found = over_devices(one, chunks(rows.reshape(-1), WIDE), _met(world, elements), elements, seed)
        return jax.tree.map(
            lambda a: a.reshape(-1, *a.shape[2:])[: rows.size].reshape(*rows.shape, *a.shape[2:]), found
        )

    return eqx.filter_jvp(fixed, (world,), (tangents[0],))
