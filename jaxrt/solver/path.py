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
from jax.lax import stop_gradient as sg

from .. import brdf, emitter
from ..compiler import one_function
from ..gradient import material
from ..rules import balance, light_node, met_share, reflected, reflection_density, reflection_node
from ..sampling.independent import Independent
from ..sampling.sobol import Drawn, Stream, combine
from ..surface import Shading, SurfacePoint, choice, is_diffuse, leave, radiance_of, shading_at, surface_point
from ..vector import Spectrum, Vec3, where
from ..world import World

SETS, HALVES = 4, 2
"""Independent randomisations of a pixel; and parts of the only one where paths end in a field, which is more even: each
half of a block of Sobol points is as good a set as any, and how far the halves are apart is more than the error."""

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
    depth: Any  # edges so far; −1 where the first landing is the path's own beginning, whose emission is not its light
    alive: Any
    before: Vec3 | None = None  # under differentiation: the point that reflected last, and its `slope`
    slopes: tuple[Vec3, ...] | None = None
    clear: Any = None  # where emitters may be hidden behind what lets light straight through: whether all so far did
    scattered: Any = None  # with a field: whether the path has left a diffuse surface


def start(world: World, o: Vec3, d: Vec3, depth: int = 0) -> PathState:
    one = jnp.ones_like(o.x + d.x)
    channels = world.plan.channels
    return PathState(
        o=o,
        d=d,
        beta=Spectrum.full(channels, one),
        radiance=Spectrum.full(channels, 0.0 * one),
        pdf=one,
        delta=jnp.ones(one.shape, bool),
        depth=jnp.full(one.shape, depth, jnp.int32),
        alive=jnp.ones(one.shape, bool),
        clear=jnp.ones(one.shape, bool) if world.plan.hide_emitters and brdf.has_straight(world.plan.lobes) else None,
    )


def hidden(world: World, o: Vec3, light: emitter.LightSample, asked: Any) -> Any:
    """Whether something lies between o and a light sample. The search leaves out the light's own face.

    Where it is not asked the distance is 0, with which some searches end at once.
    """
    distance = jnp.where(asked, light.distance * (1.0 - 1e-5), 0.0)
    return light.hidden | world.search.occluded(o, light.w, distance, light.face)


def _part(world: World, state: PathState, searches: bool = False) -> Any:
    """What is done to the parts of a pass between two searches: XLA takes no search but the dense one into a function.

    The bunny in a room: 3.5 s with every kernel queued, 2.9 s with three functions and two searches in turn.
    """
    apart = world.plan.backend != "dense" and world.plan.bounces and state.before is None and not searches
    return one_function if apart else lambda f: f


def bounce(world: World, depths: Depths, state: PathState, s: Stream, face: Any = None) -> PathState:
    """One step of a path: land (on `face`, where that is known), collect emission and direct light, reflect."""
    return reflect(world, depths, state, land(world, depths, state, s, face))


def land(world: World, depths: Depths, state: PathState, s: Stream, face: Any = None) -> Landing:
    """Where a path lands, with the emission met there and a light sample."""
    if face is None:
        face = world.settle(world.search.closest(state.o, state.d))  # ψ: where the ray lands
    landing = _part(world, state)(_land)(world, depths, state, s, face)
    if landing.light is None:
        return landing
    return replace(landing, blocked=hidden(world, landing.origin, landing.light, landing.asked))


def reflect(world: World, depths: Depths, state: PathState, landing: Landing, node: Any = None) -> PathState:
    """The path after its landing: light that is not blocked, the next direction (or `node`), roulette."""
    return _part(world, state)(_reflect)(world, depths, state, landing, node)


class Landing(eqx.Module):
    """A path at a surface, before it goes on."""

    x: SurfacePoint
    s: Any
    passed: Any  # whether the camera's ray goes on through a hidden emitter
    alive: Any
    radiance: Spectrum  # with the emission met here
    at: Shading | None = None
    origin: Vec3 | None = None  # of the ray to the light sample
    light: emitter.LightSample | None = None
    asked: Any = None  # whether the sample may carry radiance
    lit: Spectrum | None = None  # what it adds unless it is hidden
    share: Any = None  # of that, beside emission met by reflection
    blocked: Any = None  # whether it is


_USED = ("position", "normal", "shading", "tangent", "bitangent", "place", "distance", "finish", "light_density")


def _land(world: World, depths: Depths, state: PathState, s: Stream, face: Any) -> Landing:
    """The point on a face where the path lands; emission met there, and a light sample."""
    plan, landing, u = world.plan, *_met(world, depths, state, s, face)
    x, s, alive = landing.x, landing.s, landing.alive
    if not plan.bounces:
        return landing
    at = shading_at(world, x, -state.d, u, state.before is not None)
    if not plan.lights:
        return replace(landing, at=at)
    # Direct light by a light sample, weighted against reflection.
    node, light = world.settle(light_node(world, x, at, s))
    useful = node.pdf if state.before is not None else node.weight.max()  # black surfaces have derivatives
    asked = alive & (sg(useful) > 0)
    share = sg(balance(node.pdf, reflection_density(world, at, node.w)))
    lit = state.beta * node.weight * light.radiance
    return replace(landing, at=at, origin=leave(world, x, node.w), light=light, asked=asked, lit=lit, share=share)


def _met(world: World, depths: Depths, state: PathState, s: Stream, face: Any) -> tuple[Landing, Any]:
    """The point on a face where the path lands, with the emission met there, and the choice of a material."""
    plan = world.plan
    x = surface_point(world, face, state.o, state.d)
    used = {name: getattr(x, name) for name in _USED}
    used, s, u = world.settle((used, Drawn.of(s, BOUNCE_PAIRS), choice(world, s)))
    x = replace(x, **used)
    # Emission met by reflection, weighted against the chance of having drawn it as a light.
    share = met_share(world, x, state.o, state.d, state.pdf, state.delta)
    passed = jnp.zeros_like(state.alive)
    if plan.hide_emitters:
        emits = (x.light_density > 0) | (x.face < 0)
        passed = state.alive & (state.depth == 0) & depths.hide_emitters & emits
    seen = state.alive & ~passed & (depths.max_depth != 0) & (state.depth >= 0)
    follows = (state.depth + 1 < depths.max_depth) | (depths.max_depth < 0)
    if state.clear is not None:  # as Mitsuba: lamps are seen there, but not the enclosure
        seen = seen & ~(state.clear & depths.hide_emitters & ((x.face < 0) | ~follows))
    met = state.beta * radiance_of(world, x, -state.d) * share
    if state.before is not None and state.slopes is not None and plan.lights:
        met = met * material.met(
            world, state.before, x, state.slopes, seen & ~state.delta & (x.light_density > 0) & (x.face >= 0)
        )
    radiance = state.radiance + met.map(lambda c: jnp.where(seen, c, 0.0))
    alive = state.alive & ~passed & (x.face >= 0) & follows
    return Landing(x, s, passed, alive, radiance), u


def _reflect(world: World, depths: Depths, state: PathState, landing: Landing, node: Any = None) -> PathState:
    x, at, s, alive, radiance = landing.x, landing.at, landing.s, landing.alive, landing.radiance
    depth = state.depth + 1
    if at is None:
        return _through(world, state, landing, replace(state, radiance=radiance, depth=depth, alive=alive & False))
    if landing.lit is not None:
        radiance = radiance + (landing.lit * landing.share).map(lambda c: jnp.where(alive & ~landing.blocked, c, 0.0))
    # Reflection: the next direction.
    node = world.settle(reflection_node(world, at, s)) if node is None else node
    beta = state.beta * node.weight
    # Russian roulette from rr_depth on.
    most = sg(beta.max())
    if state.before is not None:  # black surfaces reflect nothing, but their derivative does
        most = jnp.where((most > 0) | ~((node.pdf > 0) | node.delta), most, 0.05)
    radiance = radiance.map(lambda c: c + jnp.where(alive & (most != most), most, 0.0))  # which would end unseen
    survive = jnp.where(depth >= depths.rr_depth, jnp.clip(most, 0.0, 0.95), 1.0)
    alive = alive & (most > 0) & (s.pair_at(2)[1] < survive)
    beta = beta * (1.0 / jnp.where(survive > 0, survive, 1.0))
    o = leave(world, x, node.w)
    if state.before is None and not world.plan.enclosure and world.sun is None:  # the last ray can only meet a lamp
        alive = alive & ((depth + 1 != depths.max_depth) | emitter.may_meet(world, o, node.w))
    follow = PathState(o, node.w, beta, radiance, node.pdf, node.delta, depth, alive)
    if state.clear is not None:
        clear = state.clear & brdf.is_straight(world.plan.lobes, at.material, at.to_local(node.w), at.wo)
        follow = replace(follow, clear=clear)
    if state.scattered is not None:
        follow = replace(follow, scattered=state.scattered | is_diffuse(world, at))
    if state.before is not None:
        follow = replace(follow, before=x.position)
    if state.slopes is not None:
        follow = replace(follow, slopes=material.slope(functools.partial(reflected, world), at, node.w))
    return _through(world, state, landing, follow)


def _through(world: World, state: PathState, landing: Landing, follow: PathState) -> PathState:
    """`follow`, but the camera's ray goes on where it met a hidden emitter."""
    if not world.plan.hide_emitters:
        return follow
    through = landing.passed & (landing.x.face >= 0)
    return where(through, replace(state, o=leave(world, landing.x, state.d), alive=through), follow)


def sample_stream(seed: Any, pixel: Any, i: Any, field: Any = None) -> Stream:
    """Sample i of a pixel: point i div `SETS` of its set i mod `SETS`; with a field, point i of one sequence.

    `seed`: 32 bits, or `Independent`, with which every sample has numbers of its own.
    """
    i = i.astype(jnp.uint32)
    if isinstance(seed, Independent):
        return seed.stream(pixel, i)
    if field is not None:
        return Stream(i, combine(seed, pixel))
    return Stream(i // SETS, combine(combine(seed, pixel), i % SETS))


def set_of(i: Any, field: Any = None) -> Any:
    """The set to which sample i belongs: i mod `SETS`; with a field, one or other of two halves of every block."""
    return i % SETS if field is None else (i // field.block) % HALVES


def bounce_stream(s: Stream, depth: Any) -> Stream:
    return Stream(s.index, s.seed, (CAMERA_PAIRS + BOUNCE_PAIRS * depth).astype(jnp.uint32))


def _attached(world: World, begin: Any, number: Any, s: Stream, moving: bool) -> PathState:
    """A path that knows the point that reflected last, and its `slopes` if something moves, as derivatives need it."""
    path = begin(world, number, s)
    before, slope = begin.before(world, number, s, path.d)
    return replace(path, before=before, slopes=(slope,) * world.plan.channels if moving else None)


class Watched(eqx.Module):
    """Paths that know whether they have left a diffuse surface."""

    begin: Any

    @property
    def searches(self) -> bool:
        return self.begin.searches

    def before(self, *args: Any) -> tuple[Vec3, Vec3]:
        return self.begin.before(*args)

    def weight(self, *args: Any) -> Any:
        return self.begin.weight(*args)

    def __call__(self, world: World, number: Any, s: Stream) -> PathState:
        path = self.begin(world, number, s)
        return replace(path, scattered=jnp.zeros_like(path.alive))


class Lane(eqx.Module):
    """A lane at work: which of its pixels and which sample of that, the path, each pixel's sums, and rays cast."""

    pixel: Any
    sample: Any
    path: PathState
    sums: tuple[Spectrum, ...]
    rays: Any


def trace(
    world: World,
    begin: Any,
    depths: Depths,
    seed: Any,
    numbers: Any,
    first: Any,
    last: Any,
    field: Any = None,
) -> tuple[Any, Any]:
    """Sums of samples first..last−1, numbers or (N, P), of pixels (N, P) by set, (N, P, sets, C), and rays cast, (N,).

    A lane takes P pixels one after another: few samples each would end with the longest path of many.
    `begin`: how pixel `number` begins a path, (world, number, stream) -> PathState; whether it `searches` for that.
    `field`: a `Stored` radiance, in which paths end.
    """
    if field is not None:
        begin = Watched(begin)
    (n, pixels), sets = numbers.shape, SETS if field is None else HALVES
    zero = Spectrum.full(world.plan.channels, jnp.zeros(n, world.faces.dtype))
    first, last = (jnp.broadcast_to(jnp.asarray(a, jnp.int32), numbers.shape) for a in (first, last))
    sample, none = first[:, 0], jnp.zeros(n, jnp.int32)
    path = jax.vmap(lambda number, i: begin(world, number, sample_stream(seed, number, i, field)))(
        numbers[:, 0], sample
    )
    lanes = Lane(none, sample, path, (zero,) * (pixels * sets), none)
    whole = world.plan.bounces and world.plan.backend == "dense"
    sums, rays = (one_function(_loop) if whole else _loop)(
        world, begin, depths, seed, numbers, first, last, lanes, field
    )
    return sums.reshape(n, pixels, sets, -1), rays


def trace_rows(
    world: World, begin: Any, depths: Depths, seed: Any, rows: Any, first: Any, last: Any, count: Any, field: Any = None
) -> Any:
    """`trace` for the first `count` rows of pixels (R, N, P), each with its first and last samples, one by one."""
    one = lambda numbers, first, last: trace(world, begin, depths, seed, numbers, first, last, field)
    shape = jax.eval_shape(one, rows[0], first[0], last[0])
    none = jax.tree.map(lambda a: jnp.zeros((len(rows), *a.shape), a.dtype), shape)
    put = lambda k, done: jax.tree.map(lambda a, b: a.at[k].set(b), done, one(rows[k], first[k], last[k]))
    return jax.lax.fori_loop(0, count, put, none)


def _loop(
    world: World, begin: Any, depths: Depths, seed: Any, numbers: Any, first: Any, last: Any, lanes: Lane, field: Any
) -> tuple[Any, Any]:
    pixels = numbers.shape[1]
    columns = [tuple(a[:, k] for k in range(pixels)) for a in (numbers, first, last)]

    def step(numbers: Any, first: Any, last: Any, lane: Lane) -> Lane:
        number = _of_pixel(numbers, lane.pixel)
        s = bounce_stream(sample_stream(seed, number, lane.sample, field), lane.path.depth)
        if field is None:
            path, cast = bounce(world, depths, lane.path, s), 2 if world.plan.lights else 1
        else:
            path, cast = field.bounce(world, depths, lane.path, s, set_of(lane.sample, field))
        lane = replace(lane, path=path, rays=lane.rays + jnp.where(lane.pixel < pixels, cast, 0))
        return _part(world, path, begin.searches)(_ready)(world, begin, seed, numbers, lane, first, last, field)

    lanes = jax.lax.while_loop(
        lambda lanes: jnp.any(lanes.pixel < pixels),
        lambda lanes: jax.vmap(step)(columns[0], columns[1], columns[2], lanes),
        lanes,
    )
    return jnp.stack([s.array() for s in lanes.sums], 1), lanes.rays


def _of_pixel(columns: tuple[Any, ...], pixel: Any) -> Any:
    """What belongs to the pixel at which a lane works."""
    found = columns[0]
    for k in range(1, len(columns)):
        found = jnp.where(pixel == k, columns[k], found)
    return found


def _ready(world: World, begin: Any, seed: Any, numbers: Any, lane: Lane, first: Any, last: Any, field: Any) -> Lane:
    """The lane with a path to follow: one that ended gives its radiance to its set, and the next sample starts."""
    path, sets = lane.path, len(lane.sums) // len(numbers)
    place = lane.pixel * sets + set_of(lane.sample, field)
    ended = ~path.alive & (lane.pixel < len(numbers))
    ended, radiance = world.settle((ended, path.radiance))
    number = _of_pixel(numbers, lane.pixel)
    weight = begin.weight(world, number, sample_stream(seed, number, lane.sample, field))
    radiance = radiance if weight is None else radiance * weight
    sums = tuple(
        total.map(lambda a, b, k=k: a + jnp.where(ended & (place == k), b, 0.0), radiance)
        for k, total in enumerate(lane.sums)
    )
    sample = lane.sample + ended.astype(lane.sample.dtype)
    full = sample >= _of_pixel(last, lane.pixel)
    pixel = lane.pixel + full.astype(lane.pixel.dtype)
    lane = Lane(pixel, jnp.where(full, _of_pixel(first, pixel), sample), path, sums, lane.rays)
    number = _of_pixel(numbers, pixel)
    path = where(ended, begin(world, number, sample_stream(seed, number, lane.sample, field)), path)
    o, d = world.settle((path.o, path.d))
    return replace(lane, path=replace(path, o=o, d=d))


def trace_fixed(
    world: World,
    begin: Any,
    steps: int,
    depths: Depths,
    seed: Any,
    numbers: Any,
    spp: int,
    field: Any = None,
    moving: bool = True,
) -> Any:
    """Mean of samples 0..spp−1 of each lane, (N, C): the reverse-mode driver, memory of one pass.

    `moving`: whether surfaces or the camera do.
    """
    watched = begin if field is None else Watched(begin)

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def one_pass(world: World, begin: Any, field: Any, numbers: Any, sample: Any) -> Any:
        def one(number: Any) -> Any:
            s = sample_stream(seed, number, sample, field)

            def body(path: PathState, _: Any) -> tuple[PathState, None]:
                turn = bounce_stream(s, path.depth)
                if field is not None:
                    return field.bounce(world, depths, path, turn, set_of(sample, field))[0], None
                return bounce(world, depths, path, turn), None

            path = _attached(world, begin, number, s, moving)
            if field is not None:
                radiance = jax.lax.scan(body, path, None, length=max(steps, 1))[0].radiance
            else:  # nothing is reflected where the last edge ends
                path = jax.lax.scan(body, path, None, length=max(steps, 1) - 1)[0]
                face = world.settle(world.search.closest(path.o, path.d))
                radiance = _met(world, depths, path, bounce_stream(s, path.depth), face)[0].radiance
            weight = begin.weight(world, number, s)
            return radiance.array() if weight is None else radiance.array() * weight

        return jax.vmap(one)(numbers)

    def add(carry: Any, sample: Any) -> tuple[Any, None]:
        total, lost = carry
        value = one_pass(world, watched, field, numbers, sample) - lost
        new = total + value
        return (new, sg((new - total) - value)), None

    zero = jnp.zeros((numbers.shape[0], world.plan.channels), world.faces.dtype)
    return jax.lax.scan(add, (zero, zero), jnp.arange(spp, dtype=jnp.int32))[0][0] / spp
