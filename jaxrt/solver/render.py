"""The host loop around the path method: chunks of pixels over cores, sums in float64, progress."""

from __future__ import annotations

import dataclasses
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import jax
import numpy as np

from .. import __version__
from ..compiler import program
from ..effects import Plan
from ..effects import plan as make_plan
from ..parts import SceneError
from ..sampling.sobol import seed_of
from ..scene import Scene, Structure
from ..world import prepare
from . import path
from .measure import LANES, PASS, depths_of, view_of
from .solution import Solution, predicted_error, standard_error


def resized(scene: Scene, sensor: int, width: int, height: int) -> Scene:
    """The scene with another picture size for one of its sensors."""
    if width < 1 or height < 1:
        raise SceneError(f"size: is {width}x{height}; give positive whole numbers")
    sensors = list(scene.structure.sensors)
    view_of(scene, sensor)
    sensors[sensor] = sensors[sensor].sized(width, height)
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, sensors=tuple(sensors)))


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _lanes(pixels: int, threads: int, chunk: int) -> int:
    """Pixels a program: at most `chunk`, small enough that every core gets some, of few sizes."""
    size = 256
    while size < chunk and size * threads < pixels:
        size *= 2
    return min(size, chunk)


def _tiles(width: int, height: int, side: int = 16) -> np.ndarray:
    """Pixels (row · width + column) tile by tile: a program ends with its longest lane, and neighbours are alike."""
    row, column = np.divmod(np.arange(width * height, dtype=np.int32), width)
    return np.lexsort((column, row, column // side, row // side)).astype(np.int32)


def render(
    scene: Scene,
    spp: int | None = None,
    seed: int = 0,
    *,
    method: Literal["auto", "path"] = "auto",
    max_depth: int | None = None,
    rr_depth: int | None = None,
    sensor: int = 0,
    plan: Plan | None = None,
    chunk: int = LANES,
    progress: Callable[[float], None] | None = None,
) -> Solution:
    """A picture with its standard error.

    `spp`: samples a pixel, by default what the scene file asks. `max_depth` as Mitsuba counts it (1:
    emission only; −1: no end). `plan`: by default specialised on all values of the scene. `chunk`: pixels
    in flight a core; the same seed, plan and chunk give the same bits, another chunk the same within
    rounding. `progress`: called with the share done. Raises `SceneError` for wrong arguments.
    """
    if method not in ("auto", "path"):
        raise SceneError(f"method: {method!r} is not known; give auto or path")
    spp = scene.structure.asked().spp if spp is None else spp
    if spp < 1 or int(spp) != spp:
        raise SceneError(f"spp: is {spp}; give a whole number of at least 1")
    if chunk < 1:
        raise SceneError(f"chunk: is {chunk}; give at least 1")
    view, depths = view_of(scene, sensor), depths_of(scene, max_depth, rr_depth)
    plan = plan or make_plan(scene, free=None)
    width, height = view.width, view.height
    n, threads = width * height, cores()
    lanes = _lanes(n, threads, chunk)

    # Run-time numbers go in as arrays: other sizes, depths and seeds use the same program.
    numbers = lambda tree: jax.tree.map(np.asarray, tree)
    view = dataclasses.replace(view, width=np.int32(width), height=np.int32(height))
    depths = numbers(path.Depths(np.int32(depths.max_depth), np.int32(depths.rr_depth), np.bool_(depths.hide_emitters)))
    key = np.asarray(seed_of(seed))
    began = time.perf_counter()
    order = _tiles(width, height)
    first = np.resize(order, lanes)
    tables = dataclasses.replace(scene, structure=Structure(), plan=None)  # names and sensors make no other world
    world = program(prepare, tables, plan)(tables, plan)
    run = program(path.trace, world, view, depths, key, first, np.int32(0), np.int32(1))
    compiled = time.perf_counter()

    blocks = -(-n // lanes)
    passes = [(a, min(a + PASS, spp)) for a in range(0, spp, PASS)]
    sums = np.zeros((n, path.SETS, plan.channels))
    rays = np.zeros(blocks, np.int64)
    done = 0

    def work(job: tuple[int, tuple[int, int]]) -> None:
        nonlocal done
        block, (a, b) = job
        start, stop = block * lanes, min((block + 1) * lanes, n)
        pixels = np.resize(order[start:stop], lanes)
        values, cast = run(world, view, depths, key, pixels, np.int32(a), np.int32(b))
        sums[order[start:stop]] += np.asarray(values, np.float64)[: stop - start]
        rays[block] += int(np.asarray(cast, np.int64)[: stop - start].sum())
        done += 1
        if progress:
            progress(done / (blocks * len(passes)))

    stop_asked = threading.Event()

    def column(block: int) -> None:
        for bounds in passes:  # in order, so that sums do not depend on which thread was faster
            if stop_asked.is_set():
                return
            work((block, bounds))

    if progress:
        progress(0.0)
    with ThreadPoolExecutor(threads) as pool:
        try:
            list(pool.map(column, range(blocks)))
        except BaseException:
            stop_asked.set()  # an interrupt waits for one pass, not for the picture
            raise
    finished = time.perf_counter()

    counts = np.array([len(range(k, spp, path.SETS)) for k in range(path.SETS)])
    shape = (height, width, plan.out_channels)
    image = (sums.sum(1) / spp).reshape(height, width, -1)
    stderr, variance = standard_error(sums, counts, (height, width))
    stats = {
        "samples": n * spp,
        "spp": spp,
        "rays": int(rays.sum()),
        "iterations": blocks * len(passes),
        "max_depth": int(depths.max_depth),
        "method": "path",
        "why": "asked for" if method == "path" else "the only method so far",
        "seconds_compile": compiled - began,
        "seconds_run": finished - compiled,
        "threads": threads,
        "nonfinite": int((~np.isfinite(image)).sum()),
    }
    header = {
        "version": __version__,
        "scene": scene.structure.source,
        "plan": sorted(plan.effects),
        "seed": seed,
        "method": "path",
        "samples": spp,
        "max_depth": stats["max_depth"],
        "seconds": finished - began,
    }
    return Solution(
        np.broadcast_to(image, shape).astype(np.float32),
        np.broadcast_to(stderr, shape).astype(np.float32),
        stats,
        predicted_error(image, variance),
        header,
    )
