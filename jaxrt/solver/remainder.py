"""How many terms of the series L = Σ (KG)ᵏ L⁰ a tolerance calls for: by a bound, or by an estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..brdf import MaterialColumns
from ..scene import Scene
from ..world import World
from .path import Depths
from .solution import block_means
from .work import Batch, Workers

SHARE = 0.1
"""Of a tolerance, what the rest of the series may take."""

SIDE, SPP, FEW = 32, 64, 16
"""Pixels a side and samples of the pictures that tell how fast the series falls; of one that tells how bright it is."""

LADDER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of edges at which it is looked at."""


class Series(NamedTuple):
    """Edges of a path, its last one included; what the rest adds, at most or by an estimate, as √relMSE; and why."""

    max_depth: int
    remainder: float
    why: str


def series(workers: Workers, world: World, scene: Scene, key: Any, error: float) -> Series:
    """As many terms as leave a rest below a tenth of the error. `workers` follow paths without end."""
    certain = bound(world, scene)
    whole = _small(workers, key, -1, SPP if certain is None else FEW)
    scale = np.sqrt(whole**2 + 0.01 * (whole**2).mean() + 1e-30)
    if certain is not None:
        rho, most = certain
        first = most * float(np.sqrt((scale**-2.0).mean())) / (1.0 - rho)
        depth = 1 if first <= SHARE * error else int(np.ceil(np.log(SHARE * error / first) / np.log(rho)))
        return Series(depth, first * rho**depth, f"at most: surfaces reflect {rho:.0%} of the light that meets them")
    before = None
    for depth in LADDER:
        off = (whole - _small(workers, key, depth)) / scale
        rest = float(np.sqrt((off**2).mean()))
        if 2.0 * rest <= SHARE * error:  # of the few paths that go on, some that matter may be missing
            if before is None or rest == 0:
                return Series(depth, rest, "estimated, for there is no bound")
            falls = (rest / before[1]) ** (1 / (depth - before[0]))
            return Series(depth, rest, f"estimated, for there is no bound: the rest falls to {falls:.2f} an edge")
        before = depth, rest
    return Series(-1, 0.0, "the series falls too slowly to be cut; paths end by roulette")


def bound(world: World, scene: Scene) -> tuple[float, float] | None:
    """(ρ, ‖L⁰‖∞) if it is known that ‖KG L‖∞ ≤ ρ ‖L‖∞ with ρ < 1: where all surfaces are diffuse and of one colour."""
    plan = world.plan
    if plan.lobes != ("diffuse",) or world.inner or world.textures is not None:
        return None
    if plan.enclosure or world.sun is not None:
        return None
    if not set(plan.light_kinds) or scene.lamps.shape[0]:
        return None
    rows, shapes = np.asarray(scene.finishes), np.unique(np.asarray(scene.shape_finish))
    columns = MaterialColumns(plan.channels, plan.fields)
    albedo = np.asarray(world.finishes)[shapes][:, slice(*columns["reflectance"])]
    rho, most = float(albedo.max(initial=0.0)), float(np.asarray(scene.radiance)[rows[shapes, 1]].max(initial=0.0))
    return (rho, most) if 0 < rho < 1 else None


def _small(workers: Workers, key: Any, depth: int, spp: int = SPP) -> np.ndarray:
    """A small picture of so many edges, in blocks; of all depths by the same paths."""
    view, depths = workers.view, workers.depths
    width, height = workers.size
    scale = min(1.0, SIDE / max(width, height))
    size = [max(1, round(scale * side)) for side in (width, height)]
    view = replace(view, width=np.int32(size[0]), height=np.int32(size[1]))
    few = workers.seeing(view, Depths(np.int32(depth), depths.rr_depth, depths.hide_emitters))
    tally = few.tally(key)
    few.take(tally, [Batch(few.n, 0, spp)])
    return block_means(tally.found()[0].reshape(size[1], size[0], -1), min(4, *size))
