"""The path method: `estimate(0, n)` fused into a loop over bounces.

One `bounce`, two drivers. Pictures: a lane is a pixel and starts its next sample when a path ends, in a
`while_loop` without reverse mode. Derivatives: a scan of fixed length, with a checkpoint around each pass.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from .. import emitter
from ..casting import cast
from ..compiler import one_function
from ..gradient import material
from ..rules import balance, light_node, reflected, reflection_density, reflection_node
from ..sampling.sobol import Drawn, Stream, combine
from ..scene import SensorStructure
from ..sensor import camera, film
from ..surface import leave, radiance_of, shading_at
from ..vector import Frame, Spectrum, Vec3, dot, where
from ..world import World

SETS = 4
"""Independent randomisations of a pixel; sample i belongs to set i mod 4, whatever the chunk."""

CAMERA_PAIRS = 2  # film, lens
BOUNCE_PAIRS = 3  # reflection, light, choice of light and roulette


class Depths(eqx.Module):
    """Run-time numbers of a render. Depth as Mitsuba counts it: 1 is emission only."""

    max_depth: Any
    rr_depth: Any
    hide_emitters: Any


class PathState(eqx.Module):
    """A path between two bounces: the ray (o, d), throughput β, radiance so far, and how d was sampled."""

    o: Vec3
    d: Vec3
    beta: Spectrum
    radiance: Spectrum
    pdf: Any  # density of d, sr⁻¹
    delta: Any  # whether d came from a delta lobe or the camera
    depth: Any  # edges so far
    alive: Any
    before: Vec3 | None = None  # under differentiation: the point that reflected last, and its `slope`
    slopes: tuple[Vec3, ...] | None = None


def start(world: World, o: Vec3, d: Vec3) -> PathState:
    one = jnp.ones_like(o.x + d.x)
    channels = world.plan.channels
    return PathState(
        o=o,
        d=d,
        beta=Spectrum.full(channels, one),
        radiance=Spectrum.full(channels, 0.0 * one),
        pdf=one,
        delta=jnp.ones(one.shape, bool),
        depth=jnp.zeros(one.shape, jnp.int32),
        alive=jnp.ones(one.shape, bool),
    )


def hidden(world: World, o: Vec3, light: emitter.LightSample) -> Any:
    """Whether something lies between o and a light sample. Its own face does not count, but a tube hides its inside."""
    own = jnp.where(light.face >= world.first("cylinder"), -2, light.face) if world.blocks[4] else light.face
    return world.search.occluded(o, light.w, light.distance * (1.0 - 1e-5), own)


def bounce(world: World, depths: Depths, state: PathState, s: Stream) -> PathState:
    """One step of a path: land, collect emission and direct light, reflect."""
    plan = world.plan
    # ψ: where the ray lands.
    x = cast(world, state.o, state.d)
    used = (x.position, x.normal, x.shading, x.tangent, x.distance, x.finish, x.light_density)
    (p, n, ns, tangent, t, finish, density), s = world.settle((used, Drawn.of(s, BOUNCE_PAIRS)))
    x = replace(x, position=p, normal=n, shading=ns, tangent=tangent, distance=t, finish=finish, light_density=density)
    wo = -state.d
    # Emission met by reflection, weighted against the chance of having drawn it as a light.
    share = 1.0
    if plan.lights:
        share = sg(jnp.where(state.delta, 1.0, balance(state.pdf, emitter.density(world, state.o, x, state.d))))
    seen = state.alive & ~((state.depth == 0) & depths.hide_emitters) & (depths.max_depth != 0)
    met = state.beta * radiance_of(world, x, wo) * share
    if state.before is not None and state.slopes is not None and plan.lights:
        met = met * material.met(world, state.before, x, state.slopes, seen & ~state.delta & (x.light_density > 0))
    radiance = state.radiance + met.map(lambda c: jnp.where(seen, c, 0.0))
    depth = state.depth + 1
    alive = state.alive & (x.face >= 0) & ((depth < depths.max_depth) | (depths.max_depth < 0))
    if not plan.bounces:
        return replace(state, radiance=radiance, depth=depth, alive=alive & False)
    at = shading_at(world, x, wo)
    # Direct light by a light sample, weighted against reflection.
    if plan.lights:
        node, light = world.settle(light_node(world, x, at, s))
        blocked = hidden(world, leave(world, x, node.w), light)
        share = sg(balance(node.pdf, reflection_density(world, at, node.w)))
        lit = state.beta * node.weight * light.radiance * share
        radiance = radiance + lit.map(lambda c: jnp.where(alive & ~blocked, c, 0.0))
    # Reflection: the next direction.
    node = world.settle(reflection_node(world, at, s))
    beta = state.beta * node.weight
    # Russian roulette from rr_depth on.
    most = sg(beta.max())
    survive = jnp.where(depth >= depths.rr_depth, jnp.clip(most, 0.0, 0.95), 1.0)
    alive = alive & (most > 0) & (s.pair_at(2)[1] < survive)
    beta = beta * (1.0 / jnp.where(survive > 0, survive, 1.0))
    follow = PathState(leave(world, x, node.w), node.w, beta, radiance, node.pdf, node.delta, depth, alive)
    if state.before is None:
        return follow
    return replace(follow, before=x.position, slopes=material.slope(functools.partial(reflected, world), at, node.w))


class View(eqx.Module):
    """A sensor as the loop sees it: its pose, lens and picture size; what is compiled is static."""

    to_world: Any
    lens: Any
    width: Any
    height: Any
    sensor: SensorStructure = eqx.field(static=True)


def camera_ray(world: World, view: View, p: film.Pixel, s: Stream) -> tuple[Vec3, Vec3]:
    at = world.settle(film.sample(view.sensor.film, p, s.pair_at(0)))
    u = s.pair_at(1) if camera.uses_lens(view.sensor) else None
    return camera.ray(view.sensor, view.to_world, view.lens, (view.width, view.height), at, u)


def sample_stream(seed: Any, pixel: Any, i: Any) -> Stream:
    """Sample i of a pixel: point i div 4 of the pixel's set i mod 4."""
    i = i.astype(jnp.uint32)
    return Stream(i // SETS, combine(combine(seed, pixel), i % SETS))


def bounce_stream(s: Stream, depth: Any) -> Stream:
    return Stream(s.index, s.seed, (CAMERA_PAIRS + BOUNCE_PAIRS * depth).astype(jnp.uint32))


def camera_start(world: World, view: View) -> Any:
    """How a pixel (row · width + column) begins a path: a function (number, stream) -> PathState."""

    def begin(number: Any, s: Stream) -> PathState:
        column, row = (k.astype(view.lens.dtype) for k in (number % view.width, number // view.width))
        place = film.pixel(view.sensor.film, column, row, view.width, view.height)
        return start(world, *camera_ray(world, view, place, s))

    return begin


def receive(world: World, at: Vec3, frame: Frame, local: Vec3, s: Stream) -> PathState:
    """A path that begins at an irradiance meter: β = π by cosine sampling, and a light sample already counted."""
    begun = start(world, at, frame.to_world(local))
    begun = replace(begun, beta=begun.beta * np.pi, pdf=local.z / np.pi, delta=begun.delta & False)
    if not world.plan.lights:
        return begun
    light = emitter.sample(world, at, s.child(3), 1)
    cos = dot(frame.n, light.w)
    ok = (light.pdf > 0) & (cos > 0)
    blocked = hidden(world, at, light)
    scale = jnp.where(ok & ~blocked, cos / jnp.where(ok, light.pdf, 1.0), 0.0)
    return replace(begun, radiance=light.radiance * (scale * balance(light.pdf, jnp.maximum(cos, 0.0) / np.pi)))


class Lane(eqx.Module):
    """A pixel at work: its current sample and path, the sum of each set, and how many rays it cast."""

    sample: Any
    path: PathState
    sums: tuple[Spectrum, ...]
    rays: Any


def run(world: World, depths: Depths, seed: Any, numbers: Any, begin: Any, first: Any, last: Any) -> tuple[Any, Any]:
    """Sums of samples first..last−1 of each lane by set, (N, 4, C), and rays cast, (N,)."""
    rays_a_bounce = 2 if world.plan.lights else 1

    def fresh(number: Any, sample: Any) -> PathState:
        return begin(number, sample_stream(seed, number, sample))

    def step(number: Any, lane: Lane) -> Lane:
        # A path that ended gives its radiance to its set, and the lane starts its next sample.
        path, of_set = lane.path, lane.sample & (SETS - 1)
        ended = ~path.alive & (lane.sample < last)
        sums = tuple(
            total.map(lambda a, b, k=k: a + jnp.where(ended & (of_set == k), b, 0.0), path.radiance)
            for k, total in enumerate(lane.sums)
        )
        sample = lane.sample + ended.astype(lane.sample.dtype)
        path = where(ended, fresh(number, sample), path)
        o, d = world.settle((path.o, path.d))
        path = replace(path, o=o, d=d)
        s = bounce_stream(sample_stream(seed, number, sample), path.depth)
        rays = lane.rays + jnp.where(sample < last, rays_a_bounce, 0)
        return Lane(sample, bounce(world, depths, path, s), sums, rays)

    zero = Spectrum.full(world.plan.channels, jnp.zeros(numbers.shape, world.faces.dtype))
    sample = jnp.full(numbers.shape, first, jnp.int32)
    lanes = Lane(sample, jax.vmap(fresh)(numbers, sample), (zero,) * SETS, jnp.zeros(numbers.shape, jnp.int32))

    def loop(lanes: Lane) -> tuple[Any, Any]:
        lanes = jax.lax.while_loop(lambda c: jnp.any(c.sample < last), lambda c: jax.vmap(step)(numbers, c), lanes)
        return jnp.stack([s.array() for s in lanes.sums], 1), lanes.rays

    return (one_function(loop) if world.plan.bounces else loop)(lanes)


def trace(world: World, view: View, depths: Depths, seed: Any, pixels: Any, first: Any, last: Any) -> tuple[Any, Any]:
    """`run` for pixels of a view."""
    return run(world, depths, seed, pixels, camera_start(world, view), first, last)


def trace_fixed(world: World, view: View, max_depth: int, depths: Depths, seed: Any, pixels: Any, spp: int) -> Any:
    """Mean of samples 0..spp−1 of each pixel, (N, C): the reverse-mode driver, memory of one pass."""

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def one_pass(world: World, view: View, numbers: Any, sample: Any) -> Any:
        def one(number: Any) -> Any:
            s = sample_stream(seed, number, sample)

            def body(path: PathState, _: Any) -> tuple[PathState, None]:
                return bounce(world, depths, path, bounce_stream(s, path.depth)), None

            path = camera_start(world, view)(number, s)
            none = Vec3(*(0.0 * c for c in path.o))
            path = replace(path, before=none, slopes=(none,) * world.plan.channels)
            return jax.lax.scan(body, path, None, length=max(max_depth, 1))[0].radiance.array()

        return jax.vmap(one)(numbers)

    def add(carry: Any, sample: Any) -> tuple[Any, None]:
        total, lost = carry
        value = one_pass(world, view, pixels, sample) - lost
        new = total + value
        return (new, sg((new - total) - value)), None

    zero = jnp.zeros((pixels.shape[0], world.plan.channels), world.faces.dtype)
    return jax.lax.scan(add, (zero, zero), jnp.arange(spp, dtype=jnp.int32))[0][0] / spp
