"""How a tolerance is best reached: pilots by paths and, where it may be cheaper, by a field; and what they foretell."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np

from ..compiler import seconds_spent
from ..scene import Scene
from ..world import World
from .choose import choose
from .field import SOLVED, for_picture
from .path import Depths
from .remainder import Series
from .solution import Error, block_means
from .tally import Tally
from .tolerance import Forecast, Goal, Pilot, pilot
from .work import Workers

FIELD_AFTER, FIELD_WITHIN = 10.0, 60.0
"""Seconds of work by paths from which it is tried whether a field is sooner there, for it has programs of its own; and
the time that has to be left for that."""

TURN = 4
"""Samples that follow one another in one set of a pixel where paths end in a field and their number is not known."""

BLOCK = 8
"""Pixels a side of the blocks by whose means pictures of two methods are compared."""


class Discretisation(NamedTuple):
    """How far a field's picture is off, as √relMSE of blocks: the estimate, what it stays below, and of each pixel."""

    error: float = 0.0
    below: float = 0.0
    each: Any = 0.0


class Approach(NamedTuple):
    """A method, why, and for each view who works, a pilot, and what a field is too coarse for; where paths end."""

    method: str
    why: str
    workers: list[Workers]
    pilots: list[Pilot]
    off: list[Discretisation]
    said: dict[str, Any]
    cut: Series | None = None
    other: Any = None  # approach, for errors that this one does not reach

    @property
    def truncation(self) -> float:
        """What is left of the series, or of the solution of the equation between elements."""
        if self.method == "field":
            return SOLVED
        return 0.0 if self.cut is None else self.cut.remainder

    def samples_error(self, error: float, k: int) -> float:
        """What the samples of view k may contribute to an error."""
        if not self.reaches(error):  # by then samples no longer help
            return max(error, 0.5 * (self.off[k].below + self.truncation))
        return float(np.sqrt((error - self.truncation) ** 2 - self.off[k].below ** 2))

    def whole_error(self, error: Error, k: int) -> Error:
        """The error of samples together with the others."""
        off, each = self.off[k], error.each | {"truncation": self.truncation, "discretisation": self.off[k].each}
        claim = float(np.hypot(error.claim, off.below)) + self.truncation
        return dataclasses.replace(error, truncation=self.truncation, discretisation=off.error, claim=claim, each=each)

    def forecast(self, error: float) -> Forecast:
        """Until all views have this error."""
        if self.other is not None and not self.reaches(error):
            return self.other.forecast(error)
        each = [p.forecast(self.samples_error(error, k)) for k, p in enumerate(self.pilots)]
        return Forecast(error, sum(one.seconds for one in each))

    def reaches(self, error: float) -> bool:
        """Whether samples can bring all views to this error."""
        return all(off.below + self.truncation < 0.9 * error for off in self.off)


def costs(way: Approach, error: float) -> list[Forecast]:
    """Of an error, half of it and a tenth."""
    return [way.forecast(error * share) for share in (1.0, 0.5, 0.1)]


def timed_field(world: World, scene: Scene, key: Any, depth: int, paths: int, spp: int, pool: Executor) -> Any:
    """`for_picture`, with the seconds it took in what is said."""
    start, before = time.perf_counter(), seconds_spent()
    field, said = for_picture(world, scene, key, depth, paths, spp, pool)
    return field, said | {"seconds_solve": time.perf_counter() - start - (seconds_spent() - before)}


def approach(
    world: World, scene: Scene, depths: Depths, key: Any, goal: Goal, method: str, pool: Executor,
    views: int, workers_of: Callable[[int, Any], Workers], cut: Series | None,
) -> Approach:  # fmt: skip
    """By paths, unless a field is asked for, or found to be sooner there. `workers_of(k, field)`: of view k."""
    workers = [workers_of(k, None) for k in range(views)]
    pilots = [pilot(w, key, goal) for w in workers]
    by_paths = Approach("path", "asked for", workers, pilots, [Discretisation()] * views, {}, cut)
    seconds = min(by_paths.forecast(goal.error).seconds, goal.left)
    n = sum(w.n for w in workers)
    paths = min(sum(p.samples(goal.error) * w.n for p, w in zip(pilots, workers, strict=True)), 1e12)
    if goal.deadline < np.inf:
        paths = min(paths, sum(max(goal.left, 0.0) / p.rate / views for p in pilots))
    asked = method != "auto"
    if not asked:
        method, why = choose(world, scene, int(depths.max_depth), int(paths))
        if method == "field" and (seconds < FIELD_AFTER or goal.left < FIELD_WITHIN):
            method, why = "path", f"{seconds:.1f} s of paths are sooner there than a field is compiled and solved"
        by_paths = by_paths._replace(why=why)
    if method == "path":
        return by_paths
    field, said = timed_field(world, scene, key, int(depths.max_depth), int(paths), max(int(paths / n), 1), pool)
    field = dataclasses.replace(field, block=np.asarray(TURN, np.int32))
    workers = [workers_of(k, field) for k in range(views)]
    found = [pilot(w, key, goal) for w in workers]
    off = [discretisation(p.even, f.even, w.size) for p, f, w in zip(pilots, found, workers, strict=True)]
    by_field = Approach("field", "asked for", workers, found, off, said)
    if asked:
        return by_field
    if goal.error > 0:
        times = [way.forecast(goal.error).seconds for way in (by_field, by_paths)]
        better = times[0] < times[1] and by_field.reaches(goal.error)
        why = f"foretold: {times[0]:.1f} s by field, {times[1]:.1f} s by paths"
        why += "" if by_field.reaches(goal.error) else ", but elements are too coarse"
    else:
        left = goal.left / views
        errors = [
            max(p.claim_after(left, off.below) for p, off in zip(way.pilots, way.off, strict=True))
            for way in (by_field, by_paths)
        ]
        better, why = errors[0] < errors[1], f"foretold: {errors[0]:.2%} by field, {errors[1]:.2%} by paths"
    return by_field._replace(why=why, other=by_paths) if better else by_paths._replace(why=why)


def discretisation(paths: Tally, field: Tally, size: tuple[int, int]) -> Discretisation:
    """How far a field's picture is from one by paths, of which the noise is known: by means of blocks of pixels."""
    width, height = size
    block = min(BLOCK, width, height)
    blocks = lambda a: block_means(a.reshape(height, width, -1), block)
    (one, noise), (other, more) = paths.found(), field.found()
    apart = (blocks(one) - blocks(other)) ** 2 - (blocks(noise) + blocks(more)) / block**2
    mean = blocks(one)
    share = (apart / (mean**2 + 0.01 * np.square(one, dtype=np.float64).mean() + 1e-30)).mean(-1).ravel()
    estimate, spread = share.mean(), share.std(ddof=1) / np.sqrt(share.size) if share.size > 1 else 0.0
    whole = np.repeat(np.repeat(np.sqrt(np.maximum(apart, 0.0)), block, 0), block, 1)
    whole = np.pad(whole, ((0, height - len(whole)), (0, width - whole.shape[1]), (0, 0)), "edge")
    root = lambda a: float(np.sqrt(max(a, 0.0)))
    return Discretisation(root(estimate), root(estimate + 1.645 * spread), whole.astype(np.float32))
