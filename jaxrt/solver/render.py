"""Pictures by both methods, with their errors."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, Literal, NamedTuple, overload

import jax
import numpy as np

from .. import __version__
from ..compiler import cores, remembered, seconds_spent
from ..effects import Plan, fitting
from ..effects import plan as make_plan
from ..parts import SceneError
from ..sampling.independent import SAMPLERS
from ..sampling.sobol import seed_of
from ..scene import Scene, Structure, in_working_precision
from ..world import World, prepared
from . import path
from .aov import aovs, checked
from .approach import Approach, approach, costs, timed_field
from .begin import Picture
from .choose import choose
from .field import SOLVED
from .lamps import TAKES, borders
from .measure import PASS, depths_of, lanes_of, seen_by, view_of
from .nonfinite import located
from .remainder import Series, series
from .solution import Solution, solution_of
from .tally import Tally
from .tolerance import Forecast, Goal, reach
from .work import PIXELS, SAMPLES, Batch, Workers, lanes_for, machine_memory, missing


def resized(scene: Scene, sensor: int, width: int, height: int) -> Scene:
    """The scene with another picture size for one of its sensors."""
    if width < 1 or height < 1:
        raise SceneError(f"size: is {width}x{height}; give positive whole numbers")
    sensors = list(scene.structure.sensors)
    view_of(scene, sensor)
    sensors[sensor] = sensors[sensor].sized(width, height)
    sensors[sensor].as_film()  # which says what it cannot be
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, sensors=tuple(sensors)))


@remembered
def _specialised(scene: Scene) -> Plan:
    return make_plan(scene, free=None)


@remembered
def _view(scene: Scene, sensor: int) -> Picture:
    view = in_working_precision(view_of(scene, sensor))
    return jax.device_put(dataclasses.replace(view, width=np.int32(view.width), height=np.int32(view.height)))


@overload
def render(scene: Scene, spp: int | None = None, seed: Any = 0, *, sensor: int = 0, **options: Any) -> Solution: ...
@overload
def render(
    scene: Scene, spp: int | None = None, seed: Any = 0, *, sensor: Sequence[int], **options: Any
) -> list[Solution]: ...
def render(  # pyright: ignore[reportInconsistentOverload]  # options are those below
    scene: Scene,
    spp: int | None = None,
    seed: Any = 0,
    *,
    rtol: float | None = None,
    seconds: float | None = None,
    method: Literal["auto", "path", "field"] = "auto",
    max_depth: int | None = None,
    rr_depth: int | None = None,
    sensor: int | Sequence[int] = 0,
    plan: Plan | None = None,
    chunk: int | None = None,
    memory: float | None = None,
    sampler: Literal["sobol", "independent"] = "sobol",
    aov: Sequence[str] | None = None,
    debug: bool = False,
    progress: Callable[[float], None] | None = None,
    foretold: Callable[[list[Forecast]], None] | None = None,
) -> Solution | list[Solution]:
    """A picture with its standard error; of several sensors a list of them, which look into one field.

    `spp`: samples a pixel, by default what the scene file asks. Or `rtol`: as many as it takes for √relMSE to be below,
    in 95 of 100 renders; or `seconds`: the best picture in so many, compiling included; of both, what comes first.
    Samples then go where the error is, see `Solution.error` and `.spp`, and `foretold` is called once with what that
    tolerance will cost, and half and a tenth of it.

    `method`: path, or field: paths end in a field that is solved first; auto chooses and says why in `stats`.
    `max_depth` as Mitsuba counts it (1: emission only; −1: no end; with `rtol`, paths without end are cut where what
    is left allows it, see `stats["bounces"]`). `plan`: by default specialised on all values of the scene. `chunk`:
    pixels in flight a core, by default what is fastest; the same seed, plan and chunk give the same bits, another chunk
    the same within rounding. `memory`: bytes that picture and pixels in flight may take, by default a quarter of the
    machine's. `sampler`: sobol, or independent: samples that know nothing of one another. `aov`: what `Solution.aovs`
    is to hold of the first surface that each pixel sees: depth, normal, geo_normal, albedo, uv, position, face, each
    also under another name as "name:depth"; by default what the scene file asks. `debug`: whether the first sample
    that is not finite is an error, `NonFiniteError`, with its path; else `stats` tells of it. `progress`: called with
    the share done. Raises `SceneError` for wrong arguments.
    """
    began, spent = time.perf_counter(), seconds_spent()
    goal = _goal(spp, rtol, seconds)
    sensors = [sensor] if isinstance(sensor, (int, np.integer)) else list(sensor)
    spp = scene.structure.asked().spp if spp is None else spp
    exact = goal is not None
    job = _job(scene, spp, seed, sensors, exact, method, max_depth, rr_depth, plan, chunk, memory, sampler, debug)
    names = checked(scene.structure.asked().aovs if aov is None else aov, job.views)
    with ThreadPoolExecutor(cores()) as pool:
        way = job.fixed(pool) if goal is None else job.approach(pool, goal, max_depth is None)
        if foretold and goal is not None and goal.error > 0:
            foretold(costs(way, goal.error))
        found, seconds_solve = [], way.said.pop("seconds_solve", 0.0)
        for k, workers in enumerate(way.workers):
            tell = progress and (lambda done, k=k: progress((k + done) / len(way.workers)))
            if goal is None:
                tally = job.take(workers, tell)
            else:
                rest = (goal.left - job.finishing) / (len(way.workers) - k)
                share = Goal(way.samples_error(goal.error, k), time.perf_counter() + rest)
                tally = reach(workers, share, way.pilots[k], tell)
            sol = solution_of(tally, workers.size, job.plan.out_channels if workers.tones is None else 1)
            if sol.stats["nonfinite"]:
                bad = np.flatnonzero(~np.isfinite(sol.image).all(-1))
                count, first = located(workers, tally.seed, scene.structure, bad, tally.taken[bad])
                sol.stats |= {"nonfinite_samples": count, "nonfinite_at": first}
            if goal is not None:
                sol.error = way.whole_error(sol.error, k)
            sol.aovs = aovs(job.world, workers.view, job.key, max(int(sol.spp.mean()), 1), names, pool)
            now, made = time.perf_counter(), seconds_spent() - spent
            sol.stats |= {
                "spp": job.spp if goal is None else round(float(sol.spp.mean()), 1),
                "max_depth": int(workers.depths.max_depth),
                "threads": cores(),
                "seconds_compile": made,
                "seconds_solve": seconds_solve,
                "seconds_run": now - began - made - seconds_solve,
                "method": way.method,
                "why": way.why,
                "bounces": job.bounces(way),
                **way.said,
            }
            spent, began, seconds_solve = spent + made, now, 0.0
            sol.failed = "unsolved" in way.said or (goal is not None and _missed(sol, rtol, seconds))
            sol.header = {
                "version": __version__,
                "scene": scene.structure.source,
                "plan": sorted(job.plan.effects),
                "seed": int(seed) if isinstance(seed, (int, np.integer)) else f"key {int(job.key)}",
                "method": way.method,
                "sampler": sampler,
                "samples": sol.stats["spp"],
                "rtol": rtol,
                "max_depth": sol.stats["max_depth"],
                "seconds": sum(sol.stats[f"seconds_{part}"] for part in ("compile", "solve", "run")),
            }
            found.append(sol)
    return found[0] if isinstance(sensor, (int, np.integer)) else found


class Prospect(NamedTuple):
    """What a tolerance, half and a tenth of it will cost; by which method and why; and how many bounces that takes."""

    costs: list[Forecast]
    method: str
    why: str
    bounces: str


def forecast(scene: Scene, rtol: float, seed: Any = 0, *, sensor: int = 0, **options: Any) -> Prospect:
    """What a tolerance will cost, from a pilot; seconds of a first render, compiling left out.

    `options`: method, max_depth, rr_depth, plan, chunk, memory, sampler as of `render`.
    """
    goal = _goal(None, rtol, None)
    assert goal is not None
    with ThreadPoolExecutor(cores()) as pool:
        job = _job(scene, 1, seed, [sensor], True, **options)
        way = job.approach(pool, goal, options.get("max_depth") is None)
        spent = sum((p.even.samples + p.tally.samples) * p.rate for p in way.pilots)
        told = [one._replace(seconds=one.seconds + spent) for one in costs(way, rtol)]
        return Prospect(told, way.method, way.why, job.bounces(way))


def _goal(spp: Any, rtol: Any, seconds: Any) -> Goal | None:
    """What is to be reached, None for a number of samples."""
    for name, value in (("rtol", rtol), ("seconds", seconds)):
        if value is None:
            continue
        if spp is not None:
            raise SceneError(f"{name}: is given beside spp; give one of them")
        if not isinstance(value, (int, float, np.integer, np.floating)) or not 0 < value < np.inf:
            raise SceneError(f"{name}: is {value}; give a positive number")
    if rtol is None and seconds is None:
        return None
    return Goal(rtol or 0.0, np.inf if seconds is None else time.perf_counter() + seconds)


def _missed(sol: Solution, rtol: float | None, seconds: float | None) -> bool:
    """Whether a tolerance was asked and not reached, which in a limited time is no failure."""
    return seconds is None and rtol is not None and not sol.error.claim <= rtol * 1.0001


class _Job(NamedTuple):
    """What is to be sampled, checked and prepared."""

    world: World
    tables: Scene
    plan: Plan
    views: list[Picture]
    tones: list[np.ndarray | None]
    lanes: list[int]
    depths: path.Depths
    key: Any
    spp: int
    method: str
    sampler: str
    watched: Structure | None  # names, where the first sample that is not finite is an error

    @property
    def paths(self) -> int:
        return self.spp * sum(int(v.width) * int(v.height) for v in self.views)

    @property
    def finishing(self) -> float:
        """Seconds it takes about to make pictures and their errors of sums, and files of these."""
        return 0.02 + 4e-7 * self.paths / self.spp * self.plan.out_channels

    def workers(self, k: int, field: Any, pool: Executor, pixels: int = 1, series: Series | None = None) -> Workers:
        """Those of view k. `series`: where paths may end."""
        view, depths = self.views[k], self.depths
        if series is not None and field is None:
            depths = dataclasses.replace(depths, max_depth=np.int32(series.max_depth))
        depths = seen_by(view, depths)
        lanes, tones = self.lanes[k], self.tones[k]
        return Workers(self.world, view, depths, field, pool, lanes, pixels, tones, self.sampler, self.watched)

    def fixed(self, pool: Executor) -> Approach:
        """The method for so many samples a pixel."""
        depth, method, why = int(self.depths.max_depth), self.method, "asked for"
        if method == "auto":
            method, why = choose(self.world, self.tables, depth, self.paths)
        field, said = None, {}
        if method == "field":
            field, said = timed_field(self.world, self.tables, self.key, depth, self.paths, self.spp, pool)
        # Pixels of a lane: it is not to end too soon, nor one thread before the others.
        workers = []
        for k, (view, lanes) in enumerate(zip(self.views, self.lanes, strict=True)):
            pixels = min(PIXELS, 1 << max(0, (SAMPLES // self.spp).bit_length() - 1))
            while pixels > 1 and int(view.width) * int(view.height) < pixels * lanes * cores() * 4:
                pixels //= 2
            workers.append(self.workers(k, field, pool, pixels))
        return Approach(method, why, workers, [], [], said)

    def approach(self, pool: Executor, goal: Goal, ends: bool) -> Approach:
        """The method for a tolerance or a time. `ends`: whether paths without end may be cut where it allows that."""
        cut = None
        if ends and goal.error > 0 and int(self.depths.max_depth) < 0 and self.method != "field":
            cut = series(self.workers(0, None, pool), self.world, self.tables, self.key, goal.error)
        workers = lambda k, field: self.workers(k, field, pool, series=cut)
        return approach(
            self.world, self.tables, self.depths, self.key, goal, self.method, pool, len(self.views), workers, cut
        )

    def bounces(self, way: Approach) -> str:
        """How many bounces are followed, and why."""
        depth = int(self.depths.max_depth)
        if depth >= 0:
            return f"paths of at most {depth} edges: the scene asks for so many, or you do"
        if way.method == "field":
            return f"all bounces: the fixed point, solved to {SOLVED:.1%}"
        if way.cut is None:
            return "paths without end, by roulette"
        return f"paths of at most {way.cut.max_depth} edges leave out {way.cut.remainder:.2%} ({way.cut.why})"

    def take(self, workers: Workers, tell: Callable[[float], None] | None) -> Tally:
        """So many samples of each pixel, and several times as many where the border of a lamp goes through it."""
        n, spp = workers.n, self.spp
        edges = np.zeros(0, np.int32) if workers.depths.hide_emitters else borders(self.world, workers.view)
        tally = workers.tally(self.key, exact=spp > PASS)
        work = [Batch(n, first, min(first + PASS, spp)) for first in range(0, spp, PASS)]
        if len(edges):
            have = np.full(n, spp, np.int32)
            want = have.copy()
            want[edges] *= TAKES
            work.append(missing(have, want, edges, min(spp, PASS)))
        if tell:
            tell(0.0)
        workers.take(tally, work, tell=tell)
        return tally


def _job(
    scene: Scene, spp: Any, seed: Any, sensors: list[int], exact: bool, method: str = "auto",
    max_depth: int | None = None, rr_depth: int | None = None, plan: Plan | None = None, chunk: int | None = None,
    memory: float | None = None, sampler: str = "sobol", debug: bool = False,
) -> _Job:  # fmt: skip
    if method not in ("auto", "path", "field"):
        raise SceneError(f"method: {method!r} is not known; give auto, path or field")
    if sampler not in SAMPLERS:
        raise SceneError(f"sampler: {sampler!r} is not known; give {' or '.join(SAMPLERS)}")
    for name, value in (("spp", spp), ("chunk", 1 if chunk is None else chunk)):
        if not isinstance(value, (int, np.integer)) or value < 1:
            raise SceneError(f"{name}: is {value}; give a whole number of at least 1")
    views, depths = [_view(scene, k) for k in sensors], depths_of(scene, max_depth, rr_depth)
    plan = _specialised(scene) if plan is None else fitting(scene, plan)[1]
    memory = machine_memory() / 4 if memory is None else memory
    chunk = lanes_of(plan) if chunk is None else chunk
    size = lambda view: (int(view.width), int(view.height), plan.out_channels)
    lanes = [lanes_for(size(view), cores(), chunk, memory, exact or spp > PASS) for view in views]
    tones = [scene.structure.sensors[k].tones(plan.channels) for k in sensors]
    # Run-time numbers go in as arrays: paths of other sizes, depths and seeds use the same program.
    depths = path.Depths(np.int32(depths.max_depth), np.int32(depths.rr_depth), np.bool_(depths.hide_emitters))
    world, tables = prepared(scene, plan)
    key, watched = np.asarray(seed_of(seed)), scene.structure if debug else None
    return _Job(world, tables, plan, views, tones, lanes, depths, key, int(spp), method, sampler, watched)
