"""What a hard case is, and how it is measured: radiance along rays, by a method, in a precision, and its derivative.

Cases are kept in files by theme, which `every` collects. A case asks for the weighted mean of the radiance along up to
`RAYS` rays, so that scenes of one plan and size share a program; whatever is no such mean is a `Fact`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxrt
from jaxrt.casting import cast
from jaxrt.sampling.sobol import Stream
from jaxrt.scene import Structure
from jaxrt.surface import radiance_of
from jaxrt.vector import Vec3

RAYS, KEYS = 64, 8
SIGMAS = 4.5
VALUES, MOTION = ("materials", "radiance"), ("to_world",)
"""Tables by which derivatives are taken together: those of what shines and reflects, and of what moves."""


class Look(NamedTuple):
    """Rays (N, 3), and what each counts for in the mean."""

    origins: Any
    directions: Any
    weights: Any


@dataclasses.dataclass(frozen=True)
class Slope:
    """A derivative: by which parameter, along which direction, and what it is; None: finite."""

    parameter: str
    direction: Any
    want: float | None = None
    rtol: float = 1e-3
    noise: float = 0.02


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, rays, and the mean of the radiance along them: `want`, or from `want` to `most`, as `source` has it.

    `rtol`: how far a value may be off beyond 4.5 standard errors, and `noise`: the largest of these, both in shares of
    what is expected. `field`: how far the field method may be off, which holds what elements are too coarse for; None:
    not asked. `backends`: of the search, but for the one that a plan chooses. `fails`: why it does, and what to do.
    """

    name: str
    scene: Callable[[], jaxrt.Scene]
    look: Look
    want: float
    source: str
    most: float | None = None
    rtol: float = 1e-4
    noise: float = 0.01
    spp: int = 256
    depth: int = 2
    field: float | None = None
    slope: Slope | None = None
    backends: tuple[str, ...] = ()
    quick: bool = False
    fails: str = ""


@dataclasses.dataclass(frozen=True)
class Fact:
    """One number that is no mean of radiance: what `find` gives, from `want` to `most`, within `limit`. `double`: whether
    it can be asked in float64."""

    name: str
    find: Callable[[], float]
    want: float
    source: str
    limit: float = 0.0
    most: float | None = None
    method: str = "search"
    double: bool = True
    quick: bool = False
    fails: str = ""


class Row(NamedTuple):
    """A line of the table. `error`: how far off, beyond nothing; `limit`: what it has to stay below."""

    case: str
    method: str
    precision: str
    quantity: str
    found: float
    expected: str
    stderr: float
    error: float
    limit: float

    @property
    def holds(self) -> bool:
        return self.error <= self.limit


def every() -> list[Case | Fact]:
    """All cases."""
    import cases_closed
    import cases_geometry
    import cases_lights
    import cases_materials
    import cases_search

    themes = (cases_geometry, cases_lights, cases_materials, cases_closed, cases_search)
    return [case for theme in themes for case in theme.CASES]


# ------------------------------------------------------------------------------------------------ programs


@functools.partial(jax.jit, static_argnames=("plan", "spp", "depth"))
def _by_path(scene: Any, rays: Any, keys: Any, plan: Any, spp: int, depth: int) -> Any:
    o, d, w = rays
    mean = lambda key: w @ jaxrt.radiance(scene, o, d, key, plan=plan, spp=spp, max_depth=depth).mean(-1)
    return jax.lax.map(mean, keys)


@functools.partial(jax.jit, static_argnames=("plan", "directions", "depth"))
def _by_field(scene: Any, elements: Any, rays: Any, keys: Any, plan: Any, directions: int, depth: int) -> Any:
    def mean(key: Any) -> Any:
        edges = depth + 1  # a field is what a path has yet to meet beyond one edge
        field = jaxrt.solve(scene, key, plan=plan, elements=elements, directions=directions, max_depth=edges)

        def one(o: Any, d: Any, k: Any) -> Any:
            o, d = Vec3.of(o), Vec3.of(d)
            x = cast(field.world, o, d)
            return (radiance_of(field.world, x, -d) + field(x, -d, Stream(k, jnp.uint32(1)))).array().mean()

        o, d, w = rays
        return w @ jax.vmap(one)(o, d, jnp.arange(len(o), dtype=jnp.uint32))

    return jax.lax.map(mean, keys)


@functools.partial(jax.jit, static_argnames=("plan", "by", "extra", "depth"))
def _slopes(scene: Any, elements: Any, rays: Any, keys: Any, plan: Any, by: Any, extra: int, depth: int) -> Any:
    def mean(values: Any, key: Any) -> Any:
        moved = eqx.tree_at(lambda s: [getattr(s, name) for name in by], scene, values)
        if elements is None:
            return _by_path(moved, rays, key[None], plan, extra, depth)[0]
        return _by_field(moved, elements, rays, key[None], plan, extra, depth)[0]

    values = [getattr(scene, name) for name in by]
    return jax.lax.map(lambda key: jax.grad(mean)(values, key), keys)


# ------------------------------------------------------------------------------------------------ measuring


DIRECTIONS, RESOLUTION, FIELD_KEYS = 128, 512, 4


def rows_of(case: Case | Fact, double: bool = False) -> Iterator[Row]:
    """All that a case asks, in one precision."""
    with jax.enable_x64(double):
        precision = "float64" if double else "float32"
        if isinstance(case, Fact):
            if double and not case.double:
                return
            found = float(case.find())
            error = _off(found, case.want, case.most)
            yield Row(case.name, case.method, precision, "value", found, _said(case), 0.0, error, case.limit)
            return
        scene = case.scene()
        tables = dataclasses.replace(scene, structure=Structure(), plan=None)
        rays, keys = _padded(case.look), jnp.arange(KEYS, dtype=jnp.uint32)
        for backend in (None, *case.backends):
            if double and backend == "embree":  # which computes in float32
                continue
            plan = jaxrt.plan(scene, backend=backend)
            found = _by_path(tables, rays, keys, plan, case.spp, case.depth)
            named = "path" if backend is None else f"path, {backend}"
            yield _judged(case, named, precision, found, case.rtol, case.noise)
        plan = jaxrt.plan(scene)
        if case.slope is not None:
            slopes = _slopes(tables, None, rays, keys, plan, _leaves(scene, case.slope), case.spp, case.depth)
            yield _judged_slope(case, "path", precision, scene, slopes, case.slope.rtol)
        if case.field is not None:
            elements = jaxrt.elements_of(scene, plan, RESOLUTION)
            args = (tables, elements, rays, keys[:FIELD_KEYS], plan)
            yield _judged(case, "field", precision, _by_field(*args, DIRECTIONS, case.depth), case.field, case.noise)
            if case.slope is not None and _leaves(scene, case.slope) == VALUES:
                slopes = _slopes(*args, VALUES, DIRECTIONS, case.depth)
                yield _judged_slope(case, "field", precision, scene, slopes, max(case.slope.rtol, case.field))


def _padded(look: Look) -> tuple[Any, Any, Any]:
    o, d, w = (np.asarray(a, np.float64) for a in look)
    o, d = np.broadcast_arrays(np.atleast_2d(o), np.atleast_2d(d))
    w = np.broadcast_to(np.atleast_1d(w), len(o)) / np.sum(np.broadcast_to(np.atleast_1d(w), len(o)))
    fill = lambda a: np.concatenate([a, np.repeat(a[:1], RAYS - len(a), 0)])
    real = jnp.result_type(float)
    return (
        jnp.asarray(fill(o), real),
        jnp.asarray(fill(d), real),
        jnp.asarray(np.append(w, np.zeros(RAYS - len(w))), real),
    )


def _off(found: float, want: float, most: float | None) -> float:
    """How far a number is from what it should be; infinite if it is none."""
    if not np.isfinite(found):
        return float("inf")
    return abs(found - want) if most is None else max(want - found, found - most, 0.0)


def _said(case: Case | Fact) -> str:
    return f"{case.want:.6g}" if case.most is None else f"{case.want:.3g} to {case.most:.3g}"


def _judged(case: Case, method: str, precision: str, found: Any, rtol: float, noise: float) -> Row:
    mean, stderr = _mean(found)
    size = abs(case.want) if case.most is None else max(abs(case.want), abs(case.most))
    limit = SIGMAS * min(stderr, noise * size) + rtol * size  # what is too noisy to say anything does not pass
    error = _off(mean, case.want, case.most)
    return Row(case.name, method, precision, "value", mean, _said(case), stderr, error, limit)


def _judged_slope(case: Case, method: str, precision: str, scene: Any, slopes: Any, rtol: float) -> Row:
    slope, by = case.slope, _leaves(scene, case.slope)
    assert slope is not None
    slot = scene.structure.slot(slope.parameter)
    leaf = np.asarray(slopes[by.index(slot.leaf)], np.float64)
    part = leaf[(slice(None), *slot.index)]
    mean, stderr = _mean(
        (part * np.asarray(slope.direction)).reshape(KEYS if method == "path" else FIELD_KEYS, -1).sum(1)
    )
    finite = all(np.isfinite(np.asarray(a)).all() for a in slopes)
    name = f"d/d {slope.parameter}"
    if slope.want is None or not finite:
        error = 0.0 if finite else float("inf")
        return Row(case.name, method, precision, name, mean, "finite", stderr, error, 0.0)
    limit = SIGMAS * min(stderr, slope.noise * abs(slope.want)) + rtol * abs(slope.want)
    return Row(case.name, method, precision, name, mean, f"{slope.want:.6g}", stderr, abs(mean - slope.want), limit)


def _mean(found: Any) -> tuple[float, float]:
    found = np.asarray(found, np.float64)
    return float(found.mean()), float(found.std(ddof=1) / np.sqrt(len(found)))


def _leaves(scene: Any, slope: Slope | None) -> tuple[str, ...]:
    assert slope is not None
    return VALUES if scene.structure.slot(slope.parameter).leaf in VALUES else MOTION


# ------------------------------------------------------------------------------------------------ parts of scenes


def plate(center: Any, a: Any, b: Any, **more: Any) -> jaxrt.Rectangle:
    """A parallelogram about its centre with half sides a and b; its front is where a × b points."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    m = np.eye(4)
    n = np.cross(a, b)
    m[:3] = np.stack([a, b, n / np.linalg.norm(n), center], 1)
    return jaxrt.Rectangle(to_world=m, **more)


def square(center: Any, a: Any, b: Any, n: int = 8, height: float = 1e-3) -> Look:
    """Gauss's points on a plate, seen from a little above its front, for its mean."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    at, weight = np.polynomial.legendre.leggauss(n)
    u, v = (m.ravel() for m in np.meshgrid(at, at))
    up = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
    points = np.asarray(center, float) + u[:, None] * a + v[:, None] * b
    return Look(points + height * up, np.broadcast_to(-up, points.shape), np.outer(weight, weight).ravel())


def point(at: Any = (0.0, 0.0, 0.0), normal: Any = (0.0, 0.0, 1.0), height: float = 1e-3) -> Look:
    """One point, seen from a little above."""
    n = np.asarray(normal, float)
    return Look(np.asarray(at, float) + height * n, -n, 1.0)


def polygon(corners: Any, at: Any = (0.0, 0.0, 0.0), normal: Any = (0.0, 0.0, 1.0)) -> float:
    """Irradiance at a point from a polygon of radiance 1 above its horizon (Lambert): ½ Σ Θ Γ·n."""
    v = np.asarray(corners, float) - np.asarray(at, float)
    after = np.roll(v, -1, 0)
    across = np.cross(v, after)
    length = np.linalg.norm(across, axis=1)
    angle = np.arctan2(length, (v * after).sum(1))
    return abs(float(0.5 * np.sum(angle * (across @ np.asarray(normal, float)) / np.where(length > 0, length, 1.0))))


def corners(center: Any, a: Any, b: Any) -> np.ndarray:
    c, a, b = (np.asarray(v, float) for v in (center, a, b))
    return np.stack([c - a - b, c + a - b, c + a + b, c - a + b])
