"""The field method: R = L − L⁰ as the fixed point of b = e + T b on elements, solved once and then looked into."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.core import Tracer
from jaxtyping import Array, Float

from ..chart import off_surface
from ..compiler import cores, program, remembered
from ..effects import Plan, fitting
from ..parts import SceneError
from ..sampling.sobol import Stream, combine, seed_of
from ..scene import Scene, in_working_precision
from ..surface import SurfacePoint
from ..vector import Spectrum, Vec3, where
from ..world import World, prepare, prepared
from . import path
from .begin import Begin
from .elements import Elements, element_of, sampled
from .equilibrium import SOLVERS, residual_bound, series, solve_links, spectral_radius
from .gather import Stored
from .links import LENGTHS, Links, link_rows
from .partition import FINER, partition
from .probe import lit, stood_on

ROW, PART = 256, 1024
"""Elements that are linked together in one row of lanes; and those of a program, for a picture, at most."""

LINKS, GATHERS, LOOKS = 1 / 8, 4, 16
"""For pictures: links of the field for each path; directions that a path looks into; samples a pixel up to which paths
look at elements themselves."""

NEAR, NEAR_FROM = 5.0, 1024
"""From within so many times its size an element is not looked at where a pixel takes as many samples as the second
says, or more; with fewer it may be looked at from much nearer, for few pixels near contacts hold up all others."""

KEPT = 16
"""Partial sums of the series that a field of finite depth holds, the longest first, then 0 or the shortest."""

UNEVEN = 1.0
"""Direct light that falls on the wrong quarter of an element, in shares of what elements reflect on average, from which
a cell is cut."""

SOLVED = 1e-3
"""For pictures: the tolerance to which the equation between elements is solved."""

LEAST, MOST = 1 << 14, 1 << 23
"""Links of a picture's field, at least and at most: 16 bytes each where they carry a weight."""


class Error(eqx.Module):
    """How wrong a field is, relative to its largest value (truncation) or its mean (the others); each (C,) or a number.

    `truncation`: of the discrete system, at most; certified by the bound of a contraction, unless `certified` is false:
    then T is none in the sup-norm, and it is the step that was left. `discretisation`: mean of R − R̃ over all elements
    by paths, with its standard error; NaN if that was not asked for. `noise`: standard error of an element's value from
    the directions that it happened to have.
    """

    truncation: Any
    certified: Any
    discretisation: Any
    discretisation_stderr: Any
    noise: Any


class Field(eqx.Module):
    """R̃, an approximation of R = L − L⁰, as a radiance function (x, ω, s) -> Spectrum, and how it was found.

    On diffuse surfaces it is what their element stores (W·m⁻²·sr⁻¹), elsewhere it follows one path with samples s.
    `result`: an `optimistix.RESULTS`; not successful where the solver did not converge or no solution exists, and
    `why` says which.
    """

    world: World
    stored: Stored
    iterations: Any
    spectral_radius: Any
    error: Error
    result: Any
    max_depth: int = eqx.field(static=True, default=-1)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Any = None) -> Spectrum:
        world = self.world
        element = element_of(world, self.stored.elements, x, w)
        at = self.stored.at(element, jnp.int32(1), jnp.int32(0))
        held = at.map(lambda c: jnp.where(element >= 0, c, 0.0))
        if world.plan.lobes == ("diffuse",):
            return held
        if s is None:
            raise ValueError("a field is followed from mirrors and gloss with samples; give a Stream as third argument")
        depths = path.Depths(self.max_depth, 1 << 30, False)
        begun = path.start(world, off_surface(world, x.position, w), -w, depth=-1)
        begun = dataclasses.replace(begun, alive=(x.face >= 0) & (element < 0), scattered=jnp.zeros_like(begun.alive))
        stream = lambda state: path.bounce_stream(s, state.depth + 1)
        zero = jnp.int32(0)
        state, _ = self.stored.bounce(world, depths, begun, stream(begun), zero, x.face)
        state = jax.lax.while_loop(
            lambda a: jnp.any(a.alive & (a.depth < 64)),
            lambda a: self.stored.bounce(world, depths, a, stream(a), zero)[0],
            state,
        )
        return where(element >= 0, held, state.radiance)

    @property
    def elements(self) -> Elements:
        return self.stored.elements

    @property
    def values(self) -> Float[Array, "E channels"]:
        """Exitant reflected radiance of each element, the black one and padding among them."""
        return self.stored.values[0, 0]

    @property
    def why(self) -> str:
        """What became of the solve, in words."""
        if self.result == optx.RESULTS.successful:
            return f"solved in {int(self.iterations)} steps"
        return unsolved(float(self.spectral_radius))

    def save(self, file: Any) -> None:
        """The radiance on M as a PLY mesh of elements with float colours, and 8 bits for any viewer. Atomic."""
        from ..files.field import write_field

        write_field(file, self)


def elements_of(scene: Scene, plan: Plan | None = None, resolution: int = 4096) -> Elements:
    """About `resolution` elements of a scene, made on the host; under a transformation, make them before it."""
    scene, plan = fitting(scene, plan)
    return marked(*prepared(scene, plan), resolution)


@remembered
def marked(world: World, scene: Scene, resolution: int) -> Elements:
    """A partition, finer where another surface stands on it or lights shine unevenly; elements on which something
    stands still are of infinite size."""

    def standing(elements: Elements) -> np.ndarray:
        """Of each element; those of several pieces are not asked. In parts of one size, for one program."""
        first = elements.first[:-1]
        size = np.where(np.diff(elements.first) == 1, elements.size, 0.0).astype(elements.size.dtype)
        pieces = elements.rectangle[first], elements.face[first], size
        parts = [
            tuple(np.resize(a[k : k + PART], (PART, *a.shape[1:])) for a in pieces) for k in range(0, len(size), PART)
        ]
        run = program(stood_on, world, *parts[0], keep=world.plan.storable)
        return np.concatenate([np.asarray(run(world, *part)) for part in parts])[: len(size)]

    elements, owner, cell = partition(world, scene, resolution)
    stands = standing(elements)
    finer = np.where(stands, FINER, 1)
    if world.plan.lights:
        args = world, elements, np.arange(elements.count, dtype=np.int32)
        light, spread = (np.asarray(a) for a in program(lit, *args, keep=world.plan.storable)(*args))
        lost = elements.area * spread * resolution / max(float((elements.area * light).sum()), 1e-30)
        parts = np.exp2(np.ceil(0.5 * np.log2(np.clip(lost / UNEVEN, 1.0, FINER**2))))
        finer = np.maximum(finer, parts.astype(int))
    if finer.max() > 1:
        levels = np.ones(cell.max() + 1, int)
        np.maximum.at(levels, cell, finer[owner])
        elements, *_ = partition(world, scene, resolution, levels)
        stands = standing(elements)
    size = np.where(stands, np.inf, elements.size)
    return jax.device_put(dataclasses.replace(elements, size=size.astype(elements.size.dtype)))


def solve(
    scene: Scene,
    key: Any = 0,
    *,
    plan: Plan | None = None,
    resolution: int = 4096,
    directions: int = 64,
    rtol: float = 1e-4,
    solver: Any = "anderson",
    max_depth: int | None = None,
    elements: Elements | None = None,
    check: int = 0,
) -> Field:
    """The field of a scene: radiance that settles on its surfaces, as a radiance function.

    `resolution`: elements, about. `directions`: links of each. `rtol`: of the discrete system. `solver`: plain, ambient
    (fixed point iteration without and with ambient correction), anderson or gmres, or one of optimistix or lineax.
    `max_depth`: as Mitsuba counts it, by default the scene's own: −1 is the fixed point, else it is a partial sum of
    the series. `elements`: from `elements_of`; needed under jit, grad and vmap, where a partition cannot be made.
    `check`: paths from each element that estimate the error of discretisation; 0 leaves it out.

    Pure in scene and key; derivatives are implicit, and hold samples and partition fixed.
    """
    if isinstance(solver, str) and solver not in SOLVERS:
        raise SceneError(f"solver: {solver!r} is not known; give {', '.join(SOLVERS)}")
    for name, value in (("resolution", resolution), ("directions", directions)):
        if not isinstance(value, (int, np.integer)) or value < 2:
            raise SceneError(f"{name}: is {value}; give a whole number of at least 2")
    scene, plan = fitting(scene, plan)
    depth = scene.structure.asked().max_depth if max_depth is None else int(max_depth)
    if elements is None:
        if any(isinstance(a, Tracer) for a in jax.tree.leaves(scene)):
            raise ValueError("solve: elements cannot be made of a traced scene; give elements=jaxrt.elements_of(scene)")
        elements = elements_of(scene, plan, resolution)
    key = jnp.asarray(seed_of(key))  # a whole number would be compiled in
    world, links = links_of(scene, plan, elements, key, int(directions), depth)
    check = -(-int(check) // path.SETS) * path.SETS  # as many in each set
    return _found(world, elements, links, key, rtol, solver, depth, check)


def links_of(
    scene: Scene, plan: Plan, elements: Elements, key: Any, directions: int, depth: int = -1
) -> tuple[World, Links]:
    """The operator T between elements, and the world in which it was sampled."""
    follow = follows(plan, elements)
    return _linked(scene, plan, elements, key, directions, follow, lengths_of(follow, depth))


def follows(plan: Plan, elements: Elements) -> bool:
    """Whether a link may land where there is no element."""
    if plan.lobes != ("diffuse",) or plan.instances:
        return True
    return isinstance(elements.size, Tracer) or bool(np.isinf(np.asarray(elements.size)).any())


@eqx.filter_jit
def _linked(
    scene: Scene, plan: Plan, elements: Elements, key: Any, directions: int, follow: bool, lengths: int
) -> tuple[World, Links]:
    world, elements = prepare(in_working_precision(scene), plan), jax.tree.map(jnp.asarray, elements)
    count = elements.count
    rows = link_rows(world, elements, key, jnp.asarray(_rows(count)), directions, follow, lengths)
    return world, jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], rows)


@eqx.filter_jit
def _found(
    world: World, elements: Elements, links: Links, key: Any, rtol: float, solver: Any, depth: int, check: int
) -> Field:
    values, steps, result = settled(links, rtol, solver, depth)
    stored = Stored(jax.tree.map(jnp.asarray, elements), values[None])
    error = _error(world, stored, links, key, depth, check)
    return Field(world, stored, steps, spectral_radius(links), error, result, depth)


def _rows(count: int, size: int = ROW) -> np.ndarray:
    """Numbers of elements in rows of lanes, the last row filled up from the start."""
    return np.resize(np.arange(count, dtype=np.int32), -(-count // size) * size).reshape(-1, size)


def lengths_of(follow: bool, depth: int, before: bool = False) -> int:
    """How many lengths of links have to be told apart: what came by mirrors is no light of lights, see `settled`."""
    return LENGTHS if follow and (depth >= 0 or before) else 1


def settled(links: Links, rtol: Any, solver: Any, depth: int, before: bool = False) -> tuple[Any, Any, Any]:
    """What elements store, (J, E, C), how often T was applied, and a result.

    `before`: only light that was reflected before it came here, with one more edge.
    """
    direct = links.direct.mean(1)[:, 0] * float(before)
    if depth < 0:
        b, steps, result = solve_links(links, rtol, solver)
        return (b - direct)[None], steps, result
    edges = max(depth - 2, 1) + before
    levels = series(links, edges)[::-1][: KEPT + 1] - direct[None] if depth > 2 else 0.0 * links.emitted[None]
    if len(levels) < KEPT + 1:
        levels = jnp.concatenate([levels, 0.0 * levels[:1]])
    return levels, jnp.int32(edges - 1), optx.RESULTS.successful


def _half(links: Links, k: Any, rtol: Any, solver: Any, depth: int, before: bool) -> tuple[Any, Any, Any]:
    """`settled` for one half of the links, 0 or 1, (J, E, C), how often T was applied, and whether that sufficed."""
    values, steps, result = settled(links.half(k), rtol, solver, depth, before)
    return values, steps, result == optx.RESULTS.successful


def for_picture(
    world: World, scene: Scene, seed: Any, depth: int, paths: float, spp: int, pool: Any
) -> tuple[Stored, dict[str, Any]]:
    """The field that a picture of so many paths looks into, found on the threads of `pool`, and what to say of it.

    Links are a share of the paths, so that solving takes a share of the time whatever accuracy is asked.
    """
    wanted = np.sqrt(np.clip(paths * LINKS, LEAST, MOST))
    looks = spp <= LOOKS and world.plan.lights and not world.plan.enclosure  # an enclosure is no light to sample
    gathers = 0 if looks else GATHERS
    share = 6.0 if gathers else 3.0  # what is looked at itself has to be even rather than fine
    resolution = int(np.clip(2.0 ** round(np.log2(share * wanted)), 256, 1 << 15))  # of few sizes, for few programs
    directions = int(np.clip(1 << round(np.log2(max(wanted / share, 1.0))), 16 if gathers else 64, 1024))
    elements = marked(world, scene, resolution)
    follow, count = follows(world.plan, elements), elements.count
    threads = cores()
    parts = threads * -(-count // (threads * PART))  # as many for every thread
    numbers = _rows(count, -(-count // parts))[:, None]
    static = (directions, follow, lengths_of(follow, depth, gathers == 0))
    run = program(link_rows, world, elements, seed, numbers[0], static=static, keep=world.plan.storable)
    rows = list(pool.map(lambda row: jax.tree.map(np.asarray, run(world, elements, seed, row)), numbers))
    links = jax.tree.map(lambda *a: np.concatenate([b[0] for b in a])[:count], *rows)
    near = np.asarray(NEAR * min(1.0, spp / NEAR_FROM) ** 2, elements.size.dtype)
    links, rtol = jax.device_put(links), np.asarray(SOLVED, near.dtype)
    solve_half = program(_half, links, np.int32(0), rtol, static=("anderson", depth, gathers == 0))
    solved = list(
        pool.map(lambda k: jax.tree.map(np.asarray, solve_half(links, k, rtol)), np.arange(2, dtype=np.int32))
    )
    values = jax.device_put(np.stack([values for values, *_ in solved]))
    stored = Stored(elements, values, near, block_of(spp), gathers)
    said: dict[str, Any] = {"elements": count, "directions": directions, "field_iterations": int(solved[0][1])}
    said["field_bytes"] = sum(a.nbytes for a in jax.tree.leaves((links, elements)))
    if not all(good for *_, good in solved):
        said["unsolved"] = unsolved(float(program(spectral_radius, links)(links)))
    return stored, said


def unsolved(radius: float) -> str:
    """Why a field was not found, from the spectral radius of its T, and what helps."""
    if not np.isfinite(radius):
        return "what surfaces reflect is not finite; take the method path, which says where"
    if radius > 1.0 - 1e-4:
        return (
            f"no solution exists: the spectral radius of KG is {radius:.6f}, so light grows at every bounce; "
            "lower an albedo, open the scene or give a finite max_depth"
        )
    return (
        f"the solver did not converge in the steps it has (spectral radius of KG {radius:.6f}); "
        "give a larger rtol, the solver gmres, or a finite max_depth"
    )


def block_of(spp: int) -> np.ndarray:
    """Samples that follow one another in one set of a pixel: half of those there are, or of the power of two below."""
    return np.asarray(1 << max(spp.bit_length() - 2, 0), np.int32)


class _Probes(Begin):
    """Paths that begin on elements, for their reflected radiance."""

    elements: Elements

    def __call__(self, world: World, number: Any, s: Stream) -> path.PathState:
        place = s.child(1)  # the path's own first reflection takes pairs from before the camera's
        _, y, n = sampled(world, self.elements, number, place.pair_at(0), place.pair_at(1)[0])
        return path.start(world, off_surface(world, y, n), -n, depth=-1)


def _error(world: World, stored: Stored, links: Links, seed: Any, depth: int, check: int) -> Error:
    sg = jax.lax.stop_gradient
    world, stored, links = sg((world, stored, links))
    b, area = stored.values[0, 0], stored.elements.area[:, None]
    mean = jnp.maximum((area * b).sum(0), 1e-30)
    bound, left, norm = residual_bound(links, b)
    largest = jnp.maximum(b.max(), 1e-30)
    certified = norm < 1.0
    truncation = jnp.where(certified, bound, left) / largest if depth < 0 else jnp.zeros(())
    first, second = (half.emitted + half.apply(b) for half in (links.half(0), links.half(1)))
    apart = 0.5 * (first - second)
    noise = jnp.sqrt((area * apart**2).sum(0) / area.sum()) / (mean / area.sum())
    unknown = jnp.full_like(mean, jnp.nan)
    if check == 0:
        return Error(truncation, certified, unknown, unknown, noise)
    count = stored.elements.count
    depths = path.Depths(jnp.int32(depth if depth < 0 else depth - 1), jnp.int32(5), jnp.asarray(False))
    lanes = jnp.asarray(_rows(count)[..., None])
    first, last = (jnp.full(lanes.shape, k, jnp.int32) for k in (0, check))
    sums, _ = path.trace_rows(world, _Probes(stored.elements), depths, combine(seed, 7), lanes, first, last, len(lanes))
    sums = sums.reshape(-1, *sums.shape[3:])[:count]  # (E, sets, C)
    sets = sums.shape[1]
    off = sums * (sets / check) - b[:, None]
    share = area / mean[None]
    stderr = jnp.sqrt((share**2 * off.var(1, ddof=1)).sum(0) / sets)
    return Error(truncation, certified, (share * off.mean(1)).sum(0), stderr, noise)


__all__ = ["Error", "Field", "elements_of", "solve"]
