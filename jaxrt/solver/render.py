"""The host loop around both methods: chunks of pixels over cores, sums in float64, progress."""

from __future__ import annotations

import dataclasses
import itertools
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, overload

import jax
import numpy as np

from .. import __version__
from ..compiler import cores, program, remembered, seconds_spent
from ..effects import Plan, fitting
from ..effects import plan as make_plan
from ..parts import SceneError
from ..sampling.independent import SAMPLERS
from ..sampling.sobol import seed_of
from ..scene import Scene, in_working_precision
from ..world import World, prepared
from . import path
from .aov import aovs, checked
from .begin import Picture
from .choose import choose
from .field import for_picture
from .lamps import TAKES, borders
from .measure import PASS, depths_of, lanes_of, seen_by, view_of
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
"""Below so many samples a pixel a program takes up to so many rows of lanes: one is done too soon to be called."""

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
    method: Literal["auto", "path", "field"] = "auto",
    max_depth: int | None = None,
    rr_depth: int | None = None,
    sensor: int | Sequence[int] = 0,
    plan: Plan | None = None,
    chunk: int | None = None,
    memory: float | None = None,
    sampler: Literal["sobol", "independent"] = "sobol",
    aov: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Solution | list[Solution]:
    """A picture with its standard error; of several sensors a list of them, which look into one field.

    `spp`: samples a pixel, by default what the scene file asks. `method`: path, or field: paths end in a field that is
    solved first; auto chooses and says why in `stats`. `max_depth` as Mitsuba counts it (1: emission only; −1: no end).
    `plan`: by default specialised on all values of the scene. `chunk`: pixels in flight a core, by default what is
    fastest; the same seed, plan and chunk give the same bits, another chunk the same within rounding. `memory`: bytes
    that picture and pixels in flight may take, by default a quarter of the machine's. `sampler`: sobol, or independent:
    samples that know nothing of one another. `aov`: what `Solution.aovs` is to hold of the first surface that each
    pixel sees: depth, normal, geo_normal, albedo, uv, position, face, each also under another name as "name:depth"; by
    default what the scene file asks. `progress`: called with the share done. Raises `SceneError` for wrong arguments.
    """
    if method not in ("auto", "path", "field"):
        raise SceneError(f"method: {method!r} is not known; give auto, path or field")
    if sampler not in SAMPLERS:
        raise SceneError(f"sampler: {sampler!r} is not known; give {' or '.join(SAMPLERS)}")
    spp = scene.structure.asked().spp if spp is None else spp
    for name, value in (("spp", spp), ("chunk", 1 if chunk is None else chunk)):
        if not isinstance(value, (int, np.integer)) or value < 1:
            raise SceneError(f"{name}: is {value}; give a whole number of at least 1")
    spp = int(spp)
    sensors = [sensor] if isinstance(sensor, (int, np.integer)) else list(sensor)
    views, depths = [_view(scene, k) for k in sensors], depths_of(scene, max_depth, rr_depth)
    names = checked(scene.structure.asked().aovs if aov is None else aov, views)
    plan = _specialised(scene) if plan is None else fitting(scene, plan)[1]
    threads = cores()
    memory = machine_memory() / 4 if memory is None else memory
    chunk = lanes_of(plan) if chunk is None else chunk
    lanes = [_lanes((int(v.width), int(v.height), plan.out_channels), threads, chunk, memory) for v in views]

    # Run-time numbers go in as arrays: paths of other sizes, depths and seeds use the same program.
    depths = path.Depths(np.int32(depths.max_depth), np.int32(depths.rr_depth), np.bool_(depths.hide_emitters))
    key, spent, began = np.asarray(seed_of(seed)), seconds_spent(), time.perf_counter()
    world, tables = prepared(scene, plan)
    depth, paths = int(depths.max_depth), spp * sum(int(v.width) * int(v.height) for v in views)
    chosen, why = choose(world, tables, depth, paths) if method == "auto" else (method, "asked for")
    field, said, seconds_solve = None, {}, 0.0
    with ThreadPoolExecutor(threads) as pool:
        if chosen == "field":
            start, before = time.perf_counter(), seconds_spent()
            field, said = for_picture(world, tables, key, depth, paths, spp, pool)
            seconds_solve = time.perf_counter() - start - (seconds_spent() - before)
        found = []
        for k, (view, n) in enumerate(zip(views, lanes, strict=True)):
            part = progress and (lambda done, k=k: progress((k + done) / len(views)))
            tones = scene.structure.sensors[sensors[k]].tones(plan.channels)
            found.append(_picture(world, view, tones, depths, SAMPLERS[sampler](key), spp, n, field, pool, part))
            found[-1].aovs = aovs(world, view, key, spp, names, pool)
            now, made = time.perf_counter(), seconds_spent() - spent
            run = now - began - made - seconds_solve
            found[-1].stats |= {"seconds_compile": made, "seconds_solve": seconds_solve, "seconds_run": run}
            spent, began, seconds_solve = spent + made, now, 0.0
    for sol in found:
        sol.stats |= {"method": chosen, "why": why, **said}
        sol.failed |= "unsolved" in said
        sol.header = {
            "version": __version__,
            "scene": scene.structure.source,
            "plan": sorted(plan.effects),
            "seed": int(seed) if isinstance(seed, (int, np.integer)) else f"key {int(key)}",
            "method": chosen,
            "sampler": sampler,
            "samples": spp,
            "max_depth": sol.stats["max_depth"],
            "seconds": sum(sol.stats[f"seconds_{part}"] for part in ("compile", "solve", "run")),
        }
    return found[0] if isinstance(sensor, (int, np.integer)) else found


def _picture(
    world: World, view: Picture, tones: np.ndarray | None, depths: path.Depths, key: Any, spp: int, lanes: int,
    field: Any, pool: ThreadPoolExecutor, progress: Callable[[float], None] | None,
) -> Solution:  # fmt: skip
    """The picture of one view, block by block of pixels on the threads of `pool`."""
    plan, threads = world.plan, cores()
    width, height = int(view.width), int(view.height)
    n = width * height
    # Pixels of a lane, and rows of lanes of a program: neither is to end too soon, nor one thread before the others.
    pixels = min(PIXELS, 1 << max(0, (SAMPLES // spp).bit_length() - 1))
    while pixels > 1 and n < pixels * lanes * threads * 4:
        pixels //= 2
    depths = seen_by(view, depths)
    edges = np.zeros(0, np.int32) if depths.hide_emitters else borders(world, view)
    again = (edges + np.arange(1, TAKES + 1, dtype=np.int32)[:, None] * np.int32(n)).ravel()
    total, size = n + len(again), lanes * pixels
    rows = -(-total // size)
    blocks = max(2 * threads, -(-rows // (ROWS if spp < FEW_SAMPLES else 1)))
    starts = np.linspace(0, rows, min(rows, -(-blocks // threads) * threads) + 1).astype(int)
    blocks = len(starts) - 1

    def pixels_of(row: int, stop: int) -> np.ndarray:
        """Numbers of pixels in rows of lanes; from n on, pixel `number % n` with samples of its own."""
        at = np.arange(row * size, stop * size) % total
        numbers = _tiled(np.minimum(at, n - 1), width, height)
        return np.where(at < n, numbers, again[np.maximum(at - n, 0)]) if len(again) else numbers

    def in_rows(numbers: np.ndarray) -> np.ndarray:
        rows = numbers.reshape(-1, pixels, lanes).swapaxes(1, 2)
        return np.concatenate([rows, np.zeros((ROWS - len(rows), *rows.shape[1:]), rows.dtype)])

    args = world, view, depths, key
    run = program(path.trace_rows, *args, in_rows(pixels_of(0, 1)), np.int32(1), np.int32(0), np.int32(1), field)

    passes = [(a, min(a + PASS, spp)) for a in range(0, spp, PASS)]
    sets = path.SETS if field is None else path.HALVES
    counts = np.bincount(path.set_of(np.arange(spp), field), minlength=sets)
    channels, wide = (plan.channels, plan.out_channels) if tones is None else (1, 1)
    image, variance = (np.empty((n, channels), np.float32) for _ in range(2))
    sums_again = np.empty((sets, len(again), channels))
    rays = np.zeros(blocks, np.int64)
    done = itertools.count(1)
    stop_asked = threading.Event()

    def work(block: int) -> None:
        """All samples of a block of pixels, in order, so that sums do not depend on which thread was faster."""
        row, stop = (int(k) for k in starts[block : block + 2])
        numbers, first_of, used = pixels_of(row, stop), row * size, min(stop * size, total) - row * size
        sums, lanes_of_block = np.zeros(()), in_rows(numbers)
        for first, last in passes:
            if stop_asked.is_set():
                return
            counted = np.int32(stop - row), np.int32(first), np.int32(last)
            values, cast = run(*args, lanes_of_block, *counted, field)
            values = np.asarray(values)[: stop - row].transpose(3, 0, 2, 1, 4).reshape(sets, len(numbers), -1)[:, :used]
            values = values if tones is None else values @ tones
            sums = values if len(passes) == 1 else sums + values.astype(np.float64)
            cast = np.asarray(cast, np.int64).reshape(-1)
            rays[block] += int(cast[:used].sum() if pixels == 1 else cast.sum() * used // ((stop - row) * size))
            if progress:
                progress(next(done) / (blocks * len(passes)))
        own = min(used, max(0, n - first_of))
        image[numbers[:own]], variance[numbers[:own]] = mean_and_variance(sums[:, :own], counts)
        sums_again[:, first_of + own - n : first_of + used - n] = sums[:, own:]

    if progress:
        progress(0.0)
    try:
        list(pool.map(work, range(blocks)))
    except BaseException:
        stop_asked.set()  # an interrupt waits for one pass, not for the picture
        raise
    sums_again = sums_again.reshape(sets, TAKES, len(edges), channels).sum(1)
    image[edges], variance[edges] = mean_and_variance(sums_again, counts * TAKES)

    shape = (height, width, wide)
    image, variance = (a.reshape(height, width, -1) for a in (image, variance))
    known = np.count_nonzero(counts) > 1  # one sample alone says nothing of its error
    error = predicted_error(image, variance) if known else float("nan")
    stderr = standard_error(variance) if known else variance
    stats = {
        "samples": total * spp,
        "lamp_pixels": len(edges),
        "spp": spp,
        "rays": int(rays.sum()),
        "iterations": blocks * len(passes),
        "max_depth": int(depths.max_depth),
        "threads": threads,
        "nonfinite": int((~np.isfinite(image)).sum()),
    }
    full = lambda a: a if a.shape == shape else np.repeat(a, shape[2], 2)
    return Solution(full(image), full(stderr), stats, error)
