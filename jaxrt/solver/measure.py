"""Pictures as a pure function: pixels are averages of exitant radiance."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..effects import Plan
from ..effects import plan as make_plan
from ..parts import SceneError
from ..sampling.sobol import Stream, seed_of
from ..sampling.warp import cosine_hemisphere
from ..scene import Scene
from ..vector import Frame, Vec3, normalise
from ..world import World, prepare
from . import path

LANES = 512
"""Rays in flight in one program: all that a bounce touches fits a core's cache (256 to 1024 measured alike)."""

WIDE = 8192
"""Rays in flight under differentiation, where a program still pays for starting each kernel."""

PASS = 256
"""Samples a pixel that are summed plainly; sums of passes are compensated."""


def view_of(scene: Scene, sensor: int) -> path.View:
    """Sensor number `sensor` as the loop sees it. Raises `SceneError` if there is none."""
    sensors = scene.structure.sensors
    if not -len(sensors) <= sensor < len(sensors):
        source = scene.structure.source or "scene"
        raise SceneError(f"{source}: has {len(sensors)} sensors, no number {sensor}; count from 0")
    structure = sensors[sensor]
    width, height = structure.film[:2]
    return path.View(scene.sensor_to_world[sensor], scene.lens[sensor], width, height, structure.sized(0, 0))


def depths_of(scene: Scene, max_depth: int | None, rr_depth: int | None = None) -> path.Depths:
    asked = scene.structure.asked()
    depth = asked.max_depth if max_depth is None else max_depth
    if depth < -1:
        raise SceneError(f"max_depth: is {depth}; give -1 for no end, or 0 or more")
    return path.Depths(depth, asked.rr_depth if rr_depth is None else rr_depth, asked.hide_emitters)


def _chunks(numbers: Any, lanes: int) -> Any:
    """Numbers in rows of at most `lanes`, the last row filled up from the start."""
    n = numbers.shape[0]
    lanes = min(lanes, n)
    return numbers[jnp.arange(-(-n // lanes) * lanes) % n].reshape(-1, lanes)


def _over_devices(f: Any, rows: Any, *whole: Any) -> Any:
    """f(*whole, row) for each of `rows`, one after another on each device of this process."""
    devices, n = jax.local_devices(), rows.shape[0]
    each = lambda rows, *whole: jax.lax.map(lambda row: f(*whole, row), rows)
    if len(devices) == 1 or n == 1 or jax.sharding.get_abstract_mesh().axis_names:  # the last: sharded by the caller
        return each(rows, *whole)
    rows = rows[np.resize(np.arange(n), -(-n // len(devices)) * len(devices))]
    split, same = jax.sharding.PartitionSpec("device"), jax.sharding.PartitionSpec()
    mesh, specs = jax.sharding.Mesh(np.array(devices), ("device",)), (split, *(same for _ in whole))
    return jax.shard_map(each, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)(rows, *whole)[:n]


def _compensated(step: Any, start: Any, count: int) -> Any:
    """Σ step(k), k < count, by Kahan's sum."""

    def add(k: Any, carry: Any) -> Any:
        total, lost = carry
        value = step(k) - lost
        new = total + value
        return new, (new - total) - value

    return jax.lax.fori_loop(0, count, add, (start, jnp.zeros_like(start)))[0]


@eqx.filter_custom_jvp
def _picture(world: World, view: path.View, depths: path.Depths, seed: Any, pixels: Any, spp: int, depth: int) -> Any:
    """Means of pixels (chunks, lanes) -> (chunks, lanes, C), by the loop without reverse mode."""

    def chunk(world: World, view: path.View, depths: path.Depths, seed: Any, px: Any) -> Any:
        def one(k: Any) -> Any:
            return path.trace(world, view, depths, seed, px, k * PASS, jnp.minimum((k + 1) * PASS, spp))[0].sum(1)

        start = jnp.zeros((px.shape[0], world.plan.channels), world.faces.dtype)
        return _compensated(one, start, -(-spp // PASS)) / spp

    return _over_devices(chunk, pixels, world, view, depths, seed)


@_picture.def_jvp
def _picture_jvp(primals: Any, tangents: Any) -> Any:
    world, view, depths, seed, pixels, spp, depth = primals
    if depth < 0:
        raise ValueError(
            "measure: derivatives need a finite number of bounces; give max_depth= (1 is emission only)"
        )

    lanes = max(1, WIDE // pixels.shape[1]) * pixels.shape[1]
    wide = _chunks(pixels.reshape(-1), lanes)

    def chunk(world: World, view: path.View, depths: path.Depths, seed: Any, px: Any) -> Any:
        return path.trace_fixed(world, view, depth, depths, seed, px, spp)

    def fixed(world: World, view: path.View) -> Any:
        values = _over_devices(chunk, wide, world, view, depths, seed)
        return values.reshape(-1, values.shape[-1])[: pixels.size].reshape(*pixels.shape, -1)

    return eqx.filter_jvp(fixed, (world, view), (tangents[0], tangents[1]))


def measure(
    scene: Scene,
    key: Any,
    *,
    plan: Plan | None = None,
    spp: int = 16,
    max_depth: int | None = None,
    rr_depth: int | None = None,
    sensor: int = 0,
) -> Float[Array, "height width channels"]:
    """A picture, as a pure function of scene and key: jit, grad, jvp, vmap and second derivatives apply.

    `key`: a JAX key or an integer. `plan`: `jaxrt.plan(scene)`, made before tracing; the scene's own by
    default. `spp`: samples a pixel. `max_depth`: as Mitsuba counts it (1: emission only, −1: no end, which
    derivatives refuse); the scene's own by default. Radiance in W·m⁻²·sr⁻¹, averaged over each pixel's filter.

    Derivatives hold samples fixed (design: interior terms). They are right where no visibility edge moves.
    """
    plan = plan or scene.plan or make_plan(scene)
    if spp < 1:
        raise SceneError(f"spp: is {spp}; give at least 1")
    view, depths = view_of(scene, sensor), depths_of(scene, max_depth, rr_depth)
    world = prepare(scene, plan)
    width, height = scene.structure.sensors[sensor].film[:2]
    pixels = _chunks(jnp.arange(width * height, dtype=jnp.int32), LANES)
    values = _picture(world, view, depths, seed_of(key), pixels, spp, depths.max_depth)
    image = values.reshape(-1, plan.channels)[: width * height].reshape(height, width, plan.channels)
    return jnp.broadcast_to(image, (height, width, plan.out_channels))


@functools.partial(jax.jit, static_argnames=("spp", "plan", "kind"))
def _along(
    scene: Scene, points: Any, directions: Any, seed: Any, depths: path.Depths, plan: Plan, spp: int, kind: str
) -> Any:
    world = prepare(scene, plan)
    numbers = jnp.arange(points.shape[0], dtype=jnp.int32)

    def radiance_start(number: Any, s: Stream) -> path.PathState:
        return path.start(world, Vec3.of(points[number]), normalise(Vec3.of(directions[number])))

    def irradiance_start(number: Any, s: Stream) -> path.PathState:
        frame = Frame.around(normalise(Vec3.of(directions[number])))
        local = cosine_hemisphere(s.pair_at(0))
        at = Vec3.of(points[number]) + frame.n * world.epsilon
        return path.receive(world, at, frame, local, s)

    begin = radiance_start if kind == "radiance" else irradiance_start
    sums, _ = path.run(world, depths, seed, numbers, begin, 0, spp)
    return jnp.broadcast_to(sums.sum(1) / spp, (points.shape[0], plan.out_channels))


def _rays(points: Any, directions: Any) -> tuple[Any, Any, Any]:
    points, directions = jnp.asarray(points), jnp.asarray(directions)
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
) -> Float[Array, "*batch channels"]:
    """Radiance that arrives at points (m) along rays: L(ψ(o, ω), −ω), W·m⁻²·sr⁻¹. Directions are normalised."""
    o, d, batch = _rays(points, directions)
    plan = plan or scene.plan or make_plan(scene)
    return _along(scene, o, d, seed_of(key), depths_of(scene, max_depth), plan, spp, "radiance").reshape(*batch, -1)


def irradiance(
    scene: Scene,
    points: Float[Array, "*batch 3"],
    normals: Float[Array, "*batch 3"],
    key: Any = 0,
    *,
    plan: Plan | None = None,
    spp: int = 64,
    max_depth: int | None = None,
) -> Float[Array, "*batch channels"]:
    """Irradiance E = ∫ L_i dμ (W·m⁻²) at points (m) on the side of `normals`, by light and cosine sampling."""
    o, n, batch = _rays(points, normals)
    plan = plan or scene.plan or make_plan(scene)
    depths = dataclasses.replace(depths_of(scene, max_depth), hide_emitters=False)  # a meter sees all light
    return _along(scene, o, n, seed_of(key), depths, plan, spp, "irradiance").reshape(*batch, -1)


__all__ = ["LANES", "PASS", "depths_of", "irradiance", "measure", "radiance", "view_of"]
