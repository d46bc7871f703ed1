"""The host loop around both methods: chunks of pixels over cores, sums in float64, progress."""

from __future__ import annotations

import dataclasses
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, overload

import jax
import numpy as np

from .. import __version__
from ..compiler import cores, program
from ..effects import Plan
from ..effects import plan as make_plan
from ..parts import SceneError
from ..sampling.sobol import seed_of
from ..scene import Scene, Structure, in_working_precision
from ..world import World, prepare
from . import path
from .begin import View
from .choose import choose
from .field import for_picture
from .measure import PASS, depths_of, lanes_of, view_of
from .solution import Solution, mean_and_variance, predicted_error, standard_error


def resized(scene: Scene, sensor: int, width: int, height: int) -> Scene:
    """The scene with another picture size for one of its sensors."""
    if width < 1 or height < 1:
        raise SceneError(f"size: is {width}x{height}; give positive whole numbers")
    sensors = list(scene.structure.sensors)
    view_of(scene, sensor)
    sensors[sensor] = sensors[sensor].sized(width, height)
    sensors[sensor].as_film()  # which says what it cannot be
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, sensors=tuple(sensors)))


FEW_SAMPLES, ROWS = 64, 16
"""Below so many samples a pixel a program takes so many rows of pixels, for one row is done too soon to be called."""

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


def _lanes(film: tuple[int, int, int], threads: int, chunk: int, memory: float) -> int:
    """Pixels a program: at most `chunk`, small enough that every core gets some and memory suffices; of few sizes."""
    width, height, channels = film
    pixels, room = width * height, memory - 4 * 4 * channels * width * height  # picture, error, and both in the file
    if room < threads * 256 * LANE_BYTES:
        raise SceneError(
            f"memory: {memory / 1e6:.0f} MB do not hold a picture of {width}x{height}, "
            f"which takes {(memory - room) / 1e6 + 1:.0f} MB; give more memory or a smaller size"
        )
    size = 256
    while size < chunk and size * threads < pixels and 2 * size * threads * LANE_BYTES <= room:
        size *= 2
    return min(size, chunk)


def _tiled(places: np.ndarray, width: int, height: int, side: int = 16) -> np.ndarray:
    """Pixels (row · width + column) at these places of an order tile by tile.

    A program ends with its longest lane, and the paths of neighbours are alike.
    """
    band, within = np.divmod(places.astype(np.int32), np.int32(width * side))
    rows = np.minimum(side, height - band * side)
    tile, within = np.divmod(within, rows * side)
    row, column = np.divmod(within, np.minimum(side, width - tile * side))
    return (band * side + row) * width + tile * side + column


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
    method: Literal["auto", "path", "field"] = "auto",
    max_depth: int | None = None,
    rr_depth: int | None = None,
    sensor: int | Sequence[int] = 0,
    plan: Plan | None = None,
    chunk: int | None = None,
    memory: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Solution | list[Solution]:
    """A picture with its standard error; of several sensors a list of them, which look into one field.

    `spp`: samples a pixel, by default what the scene file asks. `method`: path, or field: paths end in a field that is
    solved first; auto chooses and says why in `stats`. `max_depth` as Mitsuba counts it (1: emission only; −1: no end).
    `plan`: by default specialised on all values of the scene. `chunk`: pixels in flight a core, by default what is
    fastest; the same seed, plan and chunk give the same bits, another chunk the same within rounding. `memory`: bytes
    that picture and pixels in flight may take, by default a quarter of the machine's. `progress`: called with the share
    done. Raises `SceneError` for wrong arguments.
    """
    if method not in ("auto", "path", "field"):
        raise SceneError(f"method: {method!r} is not known; give auto, path or field")
    spp = scene.structure.asked().spp if spp is None else spp
    for name, value in (("spp", spp), ("chunk", 1 if chunk is None else chunk)):
        if not isinstance(value, (int, np.integer)) or value < 1:
            raise SceneError(f"{name}: is {value}; give a whole number of at least 1")
    spp = int(spp)
    sensors = [sensor] if isinstance(sensor, (int, np.integer)) else list(sensor)
    views, depths = [view_of(scene, k) for k in sensors], depths_of(scene, max_depth, rr_depth)
    plan = plan or make_plan(scene, free=None)
    threads = cores()
    memory = machine_memory() / 4 if memory is None else memory
    chunk = lanes_of(plan) if chunk is None else chunk
    lanes = [_lanes((v.width, v.height, plan.out_channels), threads, chunk, memory) for v in views]

    # Run-time numbers go in as arrays: other sizes, depths and seeds use the same program.
    depths = path.Depths(np.int32(depths.max_depth), np.int32(depths.rr_depth), np.bool_(depths.hide_emitters))
    depths = jax.tree.map(np.asarray, depths)
    key, began = np.asarray(seed_of(seed)), time.perf_counter()
    scene = in_working_precision(scene)
    tables = dataclasses.replace(scene, structure=Structure(), plan=None)  # names and sensors make no other world
    world = program(prepare, tables, plan, keep=plan.backend == "dense")(tables, plan)
    depth, paths = int(depths.max_depth), spp * sum(v.width * v.height for v in views)
    chosen, why = choose(world, tables, depth, paths) if method == "auto" else (method, "asked for")
    field, said = None, {}
    with ThreadPoolExecutor(threads) as pool:
        if chosen == "field":
            field, said = for_picture(world, tables, key, depth, paths, spp, pool)
        solved = time.perf_counter()
        found = []
        for k, (view, n) in enumerate(zip(views, lanes, strict=True)):
            part = progress and (lambda done, k=k: progress((k + done) / len(views)))
            found.append(_picture(world, in_working_precision(view), depths, key, spp, n, field, pool, part))
    for k, sol in enumerate(found):
        sol.stats |= {"method": chosen, "why": why, **said}
        sol.failed |= "unsolved" in said
        sol.stats["seconds_compile"] += solved - began if k == 0 else 0.0
        sol.header = {
            "version": __version__,
            "scene": scene.structure.source,
            "plan": sorted(plan.effects),
            "seed": int(seed) if isinstance(seed, (int, np.integer)) else f"key {int(key)}",
            "method": chosen,
            "samples": spp,
            "max_depth": sol.stats["max_depth"],
            "seconds": sol.stats["seconds_compile"] + sol.stats["seconds_run"],
        }
    return found[0] if isinstance(sensor, (int, np.integer)) else found


def _picture(
    world: World, view: View, depths: path.Depths, key: Any, spp: int, lanes: int, field: Any,
    pool: ThreadPoolExecutor, progress: Callable[[float], None] | None,
) -> Solution:  # fmt: skip
    """The picture of one view, block by block of pixels on the threads of `pool`."""
    began, plan, threads = time.perf_counter(), world.plan, cores()
    width, height = int(view.width), int(view.height)
    n = width * height
    view = dataclasses.replace(view, width=np.int32(width), height=np.int32(height))
    # Pixels of a lane, and rows of lanes of a program, so that neither ends too soon.
    pixels = min(PIXELS, 1 << max(0, (SAMPLES // spp).bit_length() - 1))
    rows = max(1, ROWS // pixels) if spp < FEW_SAMPLES else 1
    while rows * pixels > 1 and n < rows * pixels * lanes * threads * 4:
        rows, pixels = (rows // 2, pixels) if rows > 1 else (rows, pixels // 2)
    size = rows * lanes * pixels
    pixels_of = lambda block: _tiled(np.arange(block * size, (block + 1) * size) % n, width, height)
    in_rows = lambda numbers: numbers.reshape(rows, pixels, lanes).swapaxes(1, 2)
    example = in_rows(pixels_of(0))
    args = jax.device_put((world, view, depths, key))
    run = program(path.trace_rows, *args, example, np.int32(0), np.int32(1), field)
    compiled = time.perf_counter()

    blocks = -(-n // size)
    passes = [(a, min(a + PASS, spp)) for a in range(0, spp, PASS)]
    sets = path.SETS if field is None else path.HALVES
    counts = np.bincount(path.set_of(np.arange(spp), field), minlength=sets)
    image, variance = (np.empty((n, plan.channels), np.float32) for _ in range(2))
    rays = np.zeros(blocks, np.int64)
    done = 0
    stop_asked = threading.Event()

    def work(block: int) -> None:
        """All samples of a block of pixels, in order, so that sums do not depend on which thread was faster."""
        nonlocal done
        numbers, used = pixels_of(block), min(size, n - block * size)
        sums = np.zeros(())
        for first, last in passes:
            if stop_asked.is_set():
                return
            values, cast = run(*args, in_rows(numbers), np.int32(first), np.int32(last), field)
            values = np.asarray(values).transpose(3, 0, 2, 1, 4).reshape(sets, size, -1)
            sums = values if len(passes) == 1 else sums + values.astype(np.float64)
            cast = np.asarray(cast, np.int64).reshape(-1)
            rays[block] += int(cast[:used].sum() if pixels == 1 else cast.sum() * used // size)
            done += 1
            if progress:
                progress(done / (blocks * len(passes)))
        image[numbers[:used]], variance[numbers[:used]] = mean_and_variance(sums[:, :used], counts)

    if progress:
        progress(0.0)
    try:
        list(pool.map(work, range(blocks)))
    except BaseException:
        stop_asked.set()  # an interrupt waits for one pass, not for the picture
        raise
    finished = time.perf_counter()

    shape = (height, width, plan.out_channels)
    image, variance = (a.reshape(height, width, -1) for a in (image, variance))
    error = predicted_error(image, variance)
    stderr = standard_error(variance)
    stats = {
        "samples": n * spp,
        "spp": spp,
        "rays": int(rays.sum()),
        "iterations": blocks * len(passes),
        "max_depth": int(depths.max_depth),
        "seconds_compile": compiled - began,
        "seconds_run": finished - compiled,
        "threads": threads,
        "nonfinite": int((~np.isfinite(image)).sum()),
    }
    wide = lambda a: a if a.shape == shape else np.repeat(a, shape[2], 2)
    return Solution(wide(image), wide(stderr), stats, error)
