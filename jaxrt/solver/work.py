"""How samples of pixels become rows of lanes, and rows the work of threads."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np

from ..compiler import cores, program
from ..parts import SceneError
from ..sampling.independent import SAMPLERS
from ..scene import Structure
from ..world import World
from . import path
from .begin import Picture
from .measure import PASS
from .nonfinite import refuse
from .tally import Tally

FEW_SAMPLES, ROWS = 64, 16
"""Samples of a lane that are worth a call; with fewer it takes several rows of lanes, and up to so many."""

SAMPLES, PIXELS = 32, 8
"""Samples that a lane should take at least, of so many pixels at most: it ends with the longest of all lanes."""

LANE_BYTES = 4096
"""What a lane holds while it works, at most: its state, and what a bounce computes for it."""


def machine_memory() -> int:
    """Bytes of memory of this machine; 4 GiB where it does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not POSIX
        return 4 << 30


def lanes_for(film: tuple[int, int, int], threads: int, chunk: int, memory: float, exact: bool) -> int:
    """Pixels a program: at most `chunk`, small enough that every core gets some and memory suffices; of few sizes."""
    width, height, channels = film
    values = 4 * path.SETS * (1 + exact) + 8  # of each pixel and channel: sums, the picture and its error
    pixels, room = width * height, memory - values * channels * width * height
    if room < threads * 256 * LANE_BYTES:
        raise SceneError(
            f"memory: {memory / 1e6:.0f} MB do not hold a picture of {width}x{height}, "
            f"which takes {(memory - room) / 1e6 + 1:.0f} MB; give more memory or a smaller size"
        )
    size = 256
    while size < chunk and size * threads < pixels and 2 * size * threads * LANE_BYTES <= room:
        size *= 2
    return min(size, chunk)


def tiled(places: np.ndarray, width: int, height: int, side: int = 16) -> np.ndarray:
    """Pixels (row · width + column) at these places of an order tile by tile.

    A program ends with its longest lane, and the paths of neighbours are alike.
    """
    band, within = np.divmod(places.astype(np.int32), np.int32(width * side))
    rows = np.minimum(side, height - band * side)
    tile, within = np.divmod(within, rows * side)
    row, column = np.divmod(within, np.minimum(side, width - tile * side))
    return (band * side + row) * width + tile * side + column


class Batch(NamedTuple):
    """Samples first ... last − 1, numbers or arrays, of pixels: of those listed, or of all, tile by tile."""

    count: int
    first: Any
    last: Any
    pixels: np.ndarray | None = None

    def part(self, start: int, stop: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = np.arange(start, stop, dtype=np.int32)
        numbers = tiled(at, *size) if self.pixels is None else self.pixels[at]
        first, last = (np.broadcast_to(a if np.ndim(a) == 0 else a[at], at.shape) for a in (self.first, self.last))
        return numbers, first, last


def missing(have: np.ndarray, want: np.ndarray, order: np.ndarray, most: int = PASS) -> Batch:
    """What is missing to so many samples of each pixel, `order` their order in the picture: in pieces of at most so
    many samples, those of one length next to each other."""
    have, want = have[order], np.maximum(have, want)[order]
    pieces = -(-(want - have) // most)
    pixel = np.repeat(np.arange(len(order)), pieces)
    piece = np.arange(len(pixel)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first = have[pixel] + piece * most
    last = np.minimum(first + most, want[pixel])
    sort = np.lexsort((piece, first - last))
    return Batch(len(pixel), first[sort], last[sort], order[pixel[sort]])


class Workers:
    """Threads that take samples of one view's pixels into a `Tally`, each call a few rows of lanes of `pixels` each.

    Sums do not depend on which thread was faster. `watched`: names, where a sum that is not finite is an error.
    """

    def __init__(
        self, world: World, view: Picture, depths: path.Depths, field: Any, pool: Executor, lanes: int, pixels: int,
        tones: np.ndarray | None, sampler: str = "sobol", watched: Structure | None = None,
    ) -> None:  # fmt: skip
        self.view, self.field, self.pool, self.lanes, self.pixels, self.tones = view, field, pool, lanes, pixels, tones
        self.depths, self.args, self.sampler, self.watched = depths, (world, view, depths), sampler, watched
        self.size = int(view.width), int(view.height)
        self.n = self.size[0] * self.size[1]
        self.channels = world.plan.channels if tones is None else 1
        one = self._in_rows(Batch(1, 0, 1).part(0, 1, self.size))
        self.run = program(path.trace_rows, *self.args, self.seeded(np.uint32(0)), *one, np.int32(1), field)

    def seeing(self, view: Picture, depths: path.Depths) -> Workers:
        """The same threads for another view or other depths."""
        return Workers(
            self.args[0], view, depths, self.field, self.pool, self.lanes, self.pixels, self.tones, self.sampler
        )

    def seeded(self, seed: Any) -> Any:
        return SAMPLERS[self.sampler](seed)

    def tally(self, seed: Any, exact: bool = True) -> Tally:
        block = None if self.field is None else int(self.field.block)
        return Tally(self.n, self.channels, seed, block, exact)

    def take(
        self, tally: Tally, work: Sequence[Batch], stop: Callable[[], bool] = lambda: False,
        tell: Callable[[float], None] | None = None,
    ) -> None:  # fmt: skip
        """All of the work, or until `stop` says so; `tell` is called with the share of calls done."""
        calls, interrupted = list(self._calls(work)), threading.Event()

        def call(one: tuple[Batch, int, int]) -> Any:
            if interrupted.is_set() or stop():
                return None
            batch, start, end = one
            part: tuple[np.ndarray, ...] = batch.part(start, end, self.size)
            count = np.int32(-(-(end - start) // (self.lanes * self.pixels)))
            values, cast = self.run(*self.args, self.seeded(tally.seed), *self._in_rows(part), count, self.field)
            values = np.asarray(values)[:count].swapaxes(1, 2)  # (rows, pixels of a lane, lanes, sets, C)
            values = values.reshape(-1, *values.shape[3:])[: end - start]
            cast = np.asarray(cast)[:count].reshape(-1)
            if self.pixels == 1:
                cast = cast[: end - start].sum(dtype=np.int64)
            else:  # of lanes of several pixels by shares, for those left over took one sample each
                asked, idle = int((part[2] - part[1]).sum()), cast.size * self.pixels - (end - start)
                cast = cast.sum(dtype=np.int64) * asked // (asked + idle)
            return part, values if self.tones is None else values @ self.tones, int(cast)

        try:
            for k, found in enumerate(self.pool.map(call, calls)):
                if found is not None:
                    part, values, cast = found
                    if self.watched is not None:
                        refuse(self, tally.seed, self.watched, part, values)
                    tally.add(part[0], part[1], part[2], values)
                    tally.rays += cast
                if tell:
                    tell((k + 1) / len(calls))
        except BaseException:
            interrupted.set()  # an interrupt waits for one call, not for the picture
            raise

    def _in_rows(self, part: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        """Numbers, first and last, each (ROWS, lanes, pixels). Lanes left over take one sample, which nobody counts."""
        whole = np.zeros((3, ROWS * self.pixels * self.lanes), np.int32)
        whole[:, : len(part[0])] = part
        return list(whole.reshape(3, ROWS, self.pixels, self.lanes).swapaxes(2, 3))

    def _calls(self, work: Sequence[Batch]) -> Iterator[tuple[Batch, int, int]]:
        """Parts of batches, as many for each thread as for the next."""
        threads, size = cores(), self.lanes * self.pixels
        for batch in work:
            if batch.count == 0:
                continue
            rows = -(-batch.count // size)
            each = self.pixels * float(np.mean(batch.last - batch.first))
            calls = max(2 * threads, -(-rows // int(np.clip(FEW_SAMPLES / each, 1, ROWS))))
            starts = np.linspace(0, rows, min(rows, -(-calls // threads) * threads) + 1).astype(int) * size
            for start, end in itertools.pairwise(starts):
                yield batch, int(start), min(int(end), batch.count)


__all__ = ["PIXELS", "SAMPLES", "Batch", "Workers", "lanes_for", "machine_memory", "missing", "tiled"]
