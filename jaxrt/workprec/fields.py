"""Sweeps of the field: elements, directions and the solver's tolerance against radiance on surfaces by paths."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..chart import off_surface
from ..effects import fitting
from ..effects import plan as make_plan
from ..operators import psi
from ..parts import SceneError
from ..sampling.sobol import Stream
from ..scene import Scene, in_working_precision
from ..solver.field import solve
from ..solver.measure import radiance, view_of
from ..solver.partition import diffuse_sides
from ..solver.path import sample_stream
from ..surface import SurfacePoint, radiance_of, surface_point
from ..vector import Vec3, dot
from ..world import World, prepared
from .curve import Curve, Row, ladder
from .pictures import Until, has_field
from .stage import SEED, Stage

ELEMENTS, DIRECTIONS, TOLERANCES = (64, 256, 1024, 4096), (16, 64, 256, 1024), (0.3, 0.1, 1e-2, 1e-3, 1e-4)
POINTS = 1024


def relative_l2(values: np.ndarray, truth: np.ndarray) -> float:
    """‖R̃ − R‖ / ‖R‖ over points: by √relMSE the darkest of them, in slits that no element resolves, would be all."""
    return float(np.sqrt(((values - truth) ** 2).sum() / max(float((truth**2).sum()), 1e-300)))


class OnSurfaces:
    """Reflected radiance at points that the camera sees: what paths find there, (N, C), and what a field holds.

    Points are on diffuse sides, at most about `points` of them, and looked at along their normals. Raises `SceneError`
    where the camera sees no such surface.
    """

    def __init__(self, scene: Scene, spp: int, points: int = POINTS):
        self.scene, self.plan = fitting(scene, make_plan(scene, free=None))
        world, tables = prepared(self.scene, self.plan)
        view = in_working_precision(view_of(scene, 0))
        pixels = np.linspace(0, view.width * view.height - 1, points).astype(np.int32)
        o, n, side, emitted = jax.jit(jax.vmap(_seen, (None, None, 0)))(world, view, pixels)
        diffuse = np.append(diffuse_sides(world, tables)[0], False)[np.asarray(side)]
        if not diffuse.any():
            raise SceneError(f"{scene.structure.source or 'scene'}: its first sensor sees no diffuse surface")
        some = np.resize(np.flatnonzero(diffuse), points)  # of one size, for one program
        self.o, self.n, self.emitted = jax.tree.map(lambda a: a[some], (o, n, emitted))
        found = [self._by_paths(spp, SEED + k) for k in (0, 1)]
        self.truth = 0.5 * (found[0] + found[1])
        self.floor = 0.5 * relative_l2(found[0], found[1])

    def _by_paths(self, spp: int, seed: int) -> np.ndarray:
        o, d = (jnp.stack([v.x, v.y, v.z], -1) for v in (self.o, -self.n))
        all_of_it = radiance(self.scene, o, d, seed, plan=self.plan, spp=spp, max_depth=-1)
        return np.asarray(all_of_it, np.float64) - np.asarray(self.emitted)

    def held(self, field: Any) -> np.ndarray:
        values = np.asarray(_held(field, psi(field.world), self.o, self.n))
        return np.broadcast_to(values, self.truth.shape)


def _seen(world: World, view: Any, pixel: Any) -> tuple[Vec3, Vec3, Any, Any]:
    """A point before the surface that a pixel sees, the normal on that side, the side's number (−1 for none), and what
    it emits along the normal."""
    ray = view(world, pixel, sample_stream(jnp.uint32(SEED), pixel, jnp.int32(0)))
    x = surface_point(world, world.search.closest(ray.o, ray.d), ray.o, ray.d)
    back = dot(x.normal, ray.d) > 0
    n = x.normal * jnp.where(back, -1.0, 1.0)
    faces = sum(world.blocks)
    side = jnp.where((x.face >= 0) & (x.face < faces), x.face + jnp.where(back, faces, 0), -1)
    return off_surface(world, x.position, n), n, side, radiance_of(world, x, n).array()


@jax.jit
def _held(field: Any, cast: Any, o: Vec3, n: Vec3) -> Any:
    def one(o: Vec3, n: Vec3, k: Any) -> Any:
        x: SurfacePoint = cast(o, -n)
        return field(x, n, Stream(k, jnp.uint32(SEED))).array()

    return jax.vmap(one)(o, n, jnp.arange(o.x.shape[0], dtype=jnp.uint32))


def solved(on: OnSurfaces, setting: str, quantity: str | float, **options: Any) -> Row:
    """A row of a field: seconds of a warm solve, error at the points, and the field's own noise and truncation."""
    times = []
    for _ in range(2):
        start = time.perf_counter()
        field = solve(on.scene, SEED, plan=on.plan, max_depth=-1, **options)
        jax.block_until_ready(field.values)
        times.append(time.perf_counter() - start)
    error = relative_l2(on.held(field), on.truth)
    claimed = float(np.hypot(np.mean(np.asarray(field.error.noise)), np.max(np.asarray(field.error.truncation))))
    count = field.elements.count if quantity == "elements" else float(quantity)
    return Row(setting, count, times[1], max(times[0] - times[1], 0.0), error, claimed)


def fields(stage: Stage, until: Until) -> Iterator[Curve]:
    if not has_field(stage):
        return
    try:
        on = OnSurfaces(stage.scene, stage.most)
    except SceneError:
        return
    tolerance = lambda rtol: np.asarray(rtol, on.truth.dtype if jax.config.jax_enable_x64 else np.float32)  # pyright: ignore[reportAttributeAccessIssue]
    by_elements = lambda n: solved(
        on, f"{int(n)} elements, 256 directions", "elements", resolution=int(n), directions=256
    )
    by_directions = lambda n: solved(on, f"{int(n)} directions, 1024 elements", n, resolution=1024, directions=int(n))
    by_tolerance = lambda n: solved(
        on, f"rtol {1 / n:.1g}, 1024 elements", n, resolution=1024, directions=256, rtol=tolerance(1 / n)
    )
    for sweep, point, quantities in (
        ("elements", by_elements, ELEMENTS),
        ("directions", by_directions, DIRECTIONS),
        ("tolerance", by_tolerance, [1 / r for r in TOLERANCES]),
    ):
        if until(0.0):
            yield Curve(
                f"field, {sweep}", sweep, ladder(point, quantities, until, on.floor, sweep != "tolerance"), on.floor
            )
