"""Pictures as a pure function: pixels are averages of exitant radiance."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..compiler import chunks, over_devices
from ..effects import Plan, fitting
from ..gradient import refused, silhouettes, visibility
from ..gradient.edges import edges_of
from ..parts import SceneError
from ..sampling.sobol import seed_of
from ..scene import Scene, in_working_precision
from ..world import World, prepare
from . import path
from .begin import Meters, Picture, Rays, View, picture_of

LANES = 512
"""Rays in flight in one program: all that a bounce touches fits a core's cache (256 to 1024 measured alike)."""

APART = 2048
"""Rays in flight where searches stand between the parts of a bounce (512 costs 12 % more, 8192 10 %)."""

WIDE, STILL = 8192, 2048
"""Rays in flight under differentiation, where a program pays for starting each kernel: where something moves (2048
takes 1.7 times as long), and where nothing does (8192 takes 1.3 to 1.7 times, 1024 2.2 times as long)."""

SILHOUETTE = 32.0
"""Points on edges that a picture's derivative takes per sample, in units of its side: of straight ones, of outlines of
curved faces, and in mirrors."""

FOLLOWED = 8
"""Landings up to which derivatives follow paths that end in a field."""

PASS = 256
"""Samples a pixel that are summed plainly; sums of passes are compensated."""


def lanes_of(plan: Plan) -> int:
    """Rays in flight in a program that pictures are made with."""
    return LANES if plan.backend == "dense" else APART


def view_of(scene: Scene, sensor: int) -> Picture:
    """Sensor number `sensor` as the loop sees it. Raises `SceneError` if there is none."""
    sensors = scene.structure.sensors
    if not -len(sensors) <= sensor < len(sensors):
        source = scene.structure.source or "scene"
        raise SceneError(f"{source}: has {len(sensors)} sensors, no number {sensor}; count from 0")
    return picture_of(scene, sensors[sensor])


def depths_of(scene: Scene, max_depth: int | None, rr_depth: int | None = None) -> path.Depths:
    asked = scene.structure.asked()
    depth = asked.max_depth if max_depth is None else max_depth
    rr_depth = asked.rr_depth if rr_depth is None else rr_depth
    if not isinstance(depth, (int, np.integer)) or depth < -1:
        raise SceneError(f"max_depth: is {depth}; give -1 for no end, or a whole number from 0")
    if not isinstance(rr_depth, (int, np.integer)) or rr_depth < 1:
        raise SceneError(f"rr_depth: is {rr_depth}; give a whole number of at least 1")
    return path.Depths(int(depth), int(rr_depth), asked.hide_emitters)


def seen_by(view: Picture, depths: path.Depths) -> path.Depths:
    """The depths for a view: a meter of irradiance sees all light."""
    return dataclasses.replace(depths, hide_emitters=depths.hide_emitters & False) if view.searches else depths


def _compensated(step: Any, start: Any, count: int) -> Any:
    """Σ step(k), k < count, by Kahan's sum."""

    def add(k: Any, carry: Any) -> Any:
        total, lost = carry
        value = step(k) - lost
        new = total + value
        return new, (new - total) - value

    return jax.lax.fori_loop(0, count, add, (start, jnp.zeros_like(start)))[0]


@eqx.filter_custom_jvp
def _means(
    world: World,
    begin: Any,
    depths: path.Depths,
    seed: Any,
    field: Any,
    edges: Any,
    placed: Any,
    numbers: Any,
    n: int,
    spp: int,
    steps: int,
) -> Any:
    """Means of lanes (chunks, lanes) -> (chunks, lanes, C), by the loop without reverse mode.

    `edges`: those of M, for derivatives by what moves; `placed`: lamps without extent, places of
    instances, grids of distances, vertex normals. `n`: lanes that there are in all, of which `numbers` may be some.
    """

    def chunk(world: World, begin: Any, depths: path.Depths, seed: Any, field: Any, row: Any) -> Any:
        def one(k: Any) -> Any:
            last = jnp.minimum((k + 1) * PASS, spp)
            return path.trace(world, begin, depths, seed, row[:, None], k * PASS, last, field)[0].sum((1, 2))

        start = jnp.zeros((row.shape[0], world.plan.channels), world.faces.dtype)
        return _compensated(one, start, -(-spp // PASS)) / spp

    return over_devices(chunk, numbers, world, begin, depths, seed, field)


@_means.def_jvp
def _means_jvp(primals: Any, tangents: Any) -> Any:
    world, begin, depths, seed, field, edges, placed, numbers, n, spp, steps = primals
    steps = FOLLOWED if field is not None and not 0 <= steps <= FOLLOWED else steps
    if steps < 0:
        raise ValueError("measure: derivatives need a finite number of bounces; give max_depth= (1 is emission only)")

    def chunk(world: World, begin: Any, depths: path.Depths, seed: Any, field: Any, row: Any) -> Any:
        return path.trace_fixed(world, begin, steps, depths, seed, row, spp, field, moves)

    moves = any(a is not None for a in (tangents[0].geometry, *tangents[6])) or bool(jax.tree.leaves(tangents[1]))
    lanes = max(1, (WIDE if moves else STILL) // numbers.shape[1]) * numbers.shape[1]
    wide = chunks(numbers.reshape(-1), lanes)
    slides = world.textures is not None and tangents[0].textures.to_uv is not None and world.plan.stepped
    if edges is not None and (moves or slides):
        kind = begin.sensor.kind if isinstance(begin, Picture) else ""
        refused.check(world.plan, kind, steps > 1 or begin.searches, *(a is not None for a in tangents[6][:2]))

    if moves:
        world, begin, field = refused.once((world, begin, field))
    else:  # and where something moves only the second time
        geometry, begin, _ = refused.once((world.geometry, begin, placed))
        world = eqx.tree_at(lambda w: w.geometry, world, geometry)

    def around(world: World, edges: Any, begin: Any, motion: Any, depths: path.Depths, seed: Any, row: Any) -> Any:
        return visibility.surfaces(world, edges, begin, motion, steps, depths, seed, row, spp)

    interior = lambda world, begin, field: over_devices(chunk, wide, world, begin, depths, seed, field)
    motion = tangents[0], tangents[1]
    values, slopes = visibility.along(interior, (world, begin, field), (*motion, tangents[4]))
    if edges is not None and moves and steps > 0:
        if steps > 1 or begin.searches:
            slopes = slopes + over_devices(around, wide, world, edges, begin, motion, depths, seed)
        if isinstance(begin, View):
            samples = math.ceil(spp * SILHOUETTE * math.sqrt(n))
            seen = silhouettes.picture(world, edges, begin, motion, steps, depths, seed, n, samples)
            slopes = slopes + seen[jnp.minimum(wide, n - 1)]
    asked = lambda a: a.reshape(-1, a.shape[-1])[: numbers.size].reshape(*numbers.shape, -1)
    return asked(values), asked(slopes)


@functools.partial(jax.jit, static_argnames=("n", "spp", "max_depth", "boundary"))
def _pixels(
    scene: Scene,
    plan: Plan,
    begin: Any,
    key: Any,
    depths: path.Depths,
    field: Any,
    some: Any = None,
    *,
    n: int,
    spp: int,
    max_depth: int,
    boundary: bool,
) -> Any:
    """Means of lanes 0..n−1, or of `some` of them, (n, C); compiled once for scenes and beginnings of one structure."""
    scene, begin = in_working_precision((scene, begin))
    world = prepare(scene, plan)
    asked = jnp.arange(n, dtype=jnp.int32) if some is None else some
    numbers = chunks(asked, lanes_of(plan))
    steps = max_depth + 2 * plan.hide_emitters if max_depth > 0 else max_depth  # to pass both sides of a lamp
    edges = edges_of(scene, world) if boundary else None
    values = _means(
        world,
        begin,
        depths,
        seed_of(key),
        field,
        edges,
        (scene.lamps, scene.instances, scene.distances, scene.normals),
        numbers,
        n,
        spp,
        steps,
    )
    return jnp.broadcast_to(values.reshape(-1, plan.channels)[: asked.size], (asked.size, plan.out_channels))


def _checked(scene: Scene, plan: Plan | None, spp: int) -> tuple[Scene, Plan]:
    if not isinstance(spp, (int, np.integer)) or spp < 1:
        raise SceneError(f"spp: is {spp}; give a whole number of at least 1")
    return fitting(scene, plan)


def measure(
    scene: Scene,
    key: Any,
    *,
    plan: Plan | None = None,
    spp: int = 16,
    max_depth: int | None = None,
    rr_depth: int | None = None,
    sensor: int = 0,
    radiance: Any = None,
    boundary: bool = True,
    pixels: Any = None,
) -> Float[Array, "height width channels"] | Float[Array, "n channels"]:
    """A picture, as a pure function of scene and key: jit, grad, jvp and vmap apply.

    `key`: a JAX key or an integer. `plan`: `jaxrt.plan(scene)`, made before tracing; the scene's own by
    default. `spp`: samples a pixel. `max_depth`: as Mitsuba counts it (1: emission only, −1: no end, which
    derivatives refuse); the scene's own by default. `radiance`: a `Field` in which paths end, from `jaxrt.solve` to
    the same depth; derivatives then are those of both. `pixels`: numbers (n,) of those to measure, row · width +
    column: their values, (n, C), are what they are in the whole picture. Radiance in W·m⁻²·sr⁻¹, averaged over each
    pixel's filter.

    Derivatives hold samples fixed, and where surfaces or the camera move they hold how that changes what is seen
    (`jaxrt.gradient`; without `boundary`, they do not). What these terms do not know is refused with a `SceneError`.
    Second derivatives hold where nothing moves at all, and are refused elsewhere.
    """
    scene, plan = _checked(scene, plan, spp)
    view = view_of(scene, sensor)
    depths = seen_by(view, depths_of(scene, max_depth, rr_depth))
    width, height = view.width, view.height
    n = width * height
    if radiance is not None and radiance.max_depth != depths.max_depth:
        has, asked = radiance.max_depth, depths.max_depth
        raise SceneError(f"radiance: the field is of max_depth {has}, the picture of {asked}; give one for both")
    field = None if radiance is None else radiance.stored
    if pixels is not None and not isinstance(pixels, Tracer):
        low, high = np.min(np.asarray(pixels), initial=0), np.max(np.asarray(pixels), initial=0)
        if low < 0 or high >= n:
            raise SceneError(f"pixels: are {low} to {high}; give numbers from 0 to {n - 1}")
    some = None if pixels is None else jnp.asarray(pixels, jnp.int32).reshape(-1)
    image = _pixels(
        scene, plan, view, key, depths, field, some, n=n, spp=spp, max_depth=depths.max_depth, boundary=boundary
    )
    tones = scene.structure.sensors[sensor].tones(image.shape[-1])
    image = image if tones is None else image @ jnp.asarray(tones, image.dtype)
    return image.reshape(height, width, -1) if some is None else image


def _rays(points: Any, directions: Any) -> tuple[Any, Any, Any]:
    points, directions = jnp.asarray(points), jnp.asarray(directions)
    points, directions = (a if jnp.issubdtype(a.dtype, jnp.floating) else a.astype(float) for a in (points, directions))
    if points.shape[-1:] != (3,) or directions.shape[-1:] != (3,):
        raise ValueError(f"points and directions have shape (..., 3), not {points.shape} and {directions.shape}")
    points, directions = jnp.broadcast_arrays(points, directions)
    return points.reshape(-1, 3), directions.reshape(-1, 3), points.shape[:-1]


def radiance(
    scene: Scene,
    points: Float[Array, "*batch 3"],
    directions: Float[Array, "*batch 3"],
    key: Any = 0,
    *,
    plan: Plan | None = None,
    spp: int = 64,
    max_depth: int | None = None,
    boundary: bool = True,
) -> Float[Array, "*batch channels"]:
    """Radiance that arrives at points (m) along rays: L(ψ(o, ω), −ω), W·m⁻²·sr⁻¹. Directions are normalised. A ray that
    begins on a surface meets it; begin it off it by more than rounding, a millionth of the scene's size.

    Pure like `measure`, and differentiable as it is, in points and directions too.
    """
    o, d, batch = _rays(points, directions)
    return _along(scene, Rays(o, d), key, plan, spp, max_depth, boundary).reshape(*batch, -1)


def irradiance(
    scene: Scene,
    points: Float[Array, "*batch 3"],
    normals: Float[Array, "*batch 3"],
    key: Any = 0,
    *,
    plan: Plan | None = None,
    spp: int = 64,
    max_depth: int | None = None,
    boundary: bool = True,
) -> Float[Array, "*batch channels"]:
    """Irradiance E = ∫ L_i dμ (W·m⁻²) at points (m) on the side of `normals`, by light and cosine sampling.

    Pure like `measure`, and differentiable as it is, in points and normals too.
    """
    o, n, batch = _rays(points, normals)
    return _along(scene, Meters(o, n), key, plan, spp, max_depth, boundary).reshape(*batch, -1)


def _along(
    scene: Scene, begin: Any, key: Any, plan: Plan | None, spp: int, max_depth: int | None, boundary: bool
) -> Any:
    scene, plan = _checked(scene, plan, spp)
    depths = dataclasses.replace(depths_of(scene, max_depth), hide_emitters=False)  # a meter sees all light
    n = begin.points.shape[0]
    if n == 0:
        return jnp.zeros((0, plan.out_channels), scene.vertices.dtype)
    return _pixels(scene, plan, begin, key, depths, None, n=n, spp=spp, max_depth=depths.max_depth, boundary=boundary)


__all__ = ["LANES", "PASS", "depths_of", "irradiance", "measure", "radiance", "view_of"]
