"""Sweeps of pictures: samples a pixel by every method and sampler, depth, effects forced out, and the peer."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..effects import plan as make_plan
from ..effects.costs import other_plan
from ..effects.registry import EFFECTS
from .curve import Curve, Row, ladder
from .double import double_rows
from .stage import Stage, samples

Until = Callable[[float], bool]
"""Whether there is time for a row that is expected to take so many seconds."""

DEPTHS = 12
"""Edges up to which the series is cut."""


def _samples(stage: Stage, first: int = 1) -> list[int]:
    return [n for n in (4**k for k in range(8)) if first <= n <= stage.most]


def _by_samples(stage: Stage, name: str, until: Until, method: str, sampler: str, first: int = 1) -> Curve:
    point = lambda n: stage.rendered(samples(n), n, int(n), method=method, sampler=sampler)
    rows = ladder(point, _samples(stage, first), until, stage.reference.error)
    return Curve(name, "samples", rows, stage.reference.error)


def path_sobol(stage: Stage, until: Until) -> Iterator[Curve]:
    yield _by_samples(stage, "path, Sobol", until, "path", "sobol")


def path_independent(stage: Stage, until: Until) -> Iterator[Curve]:
    yield _by_samples(stage, "path, independent", until, "path", "independent")


def has_field(stage: Stage) -> bool:
    """Whether there is light to store on elements of the scene."""
    plan = make_plan(stage.scene, free=None)
    return plan.bounces and not plan.instances and "diffuse" in plan.lobes


def field_sobol(stage: Stage, until: Until) -> Iterator[Curve]:
    if has_field(stage):
        yield _by_samples(stage, "field, Sobol", until, "field", "sobol", 4)


def mitsuba(stage: Stage, until: Until) -> Iterator[Curve]:
    if (peer := stage.peer) is None:
        return

    peer.picture(1, stage.seed)  # compiles

    def point(n: float) -> Row:
        picture = lambda seed: (peer.picture(int(n), seed), float("nan"), 0.0)
        return stage.timed(picture, samples(n), n)

    rows = ladder(point, _samples(stage), until, stage.reference.error)
    yield Curve(f"Mitsuba 3, {peer.variant}", "samples", rows, stage.reference.error)


def path_double(stage: Stage, until: Until) -> Iterator[Curve]:
    if stage.file is None:
        return
    rows = double_rows(stage, [n for n in _samples(stage) if n <= 256])
    yield Curve("path, float64", "samples", tuple(rows), stage.reference.error)


def depth(stage: Stage, until: Until) -> Iterator[Curve]:
    """Pictures of growing max_depth with many samples: what a series that is cut leaves out."""
    asked = stage.scene.structure.asked().max_depth
    depths = range(1, (min(asked, DEPTHS) if asked >= 0 else DEPTHS) + 1)
    spp = min(stage.most, 256)
    point = lambda d: stage.rendered(f"max_depth {int(d)}", d, spp, method="path", max_depth=int(d))
    rows = ladder(point, list(depths), until, stage.reference.error)
    yield Curve(f"depth: path, {samples(spp)}", "depth", rows, stage.reference.error)


def effects(stage: Stage, until: Until) -> Iterator[Curve]:
    """One picture with the plan as it is, and one without each effect that can be forced out."""
    make = lambda **forced: make_plan(stage.scene, None, **forced)
    plan, spp, rows = make(), min(stage.most, 256), []
    others = {"all in": plan}
    for name in EFFECTS:
        other = other_plan(plan, name, make) if name in plan.effects else None
        if other is not None:
            others[f"without {name}"] = other
    for k, (name, other) in enumerate(others.items()):
        if k and not until(rows[-1].seconds + max(row.compile for row in rows)):
            break
        rows.append(stage.rendered(name, k, spp, method="path", plan=other))
    yield Curve(f"effects: path, {samples(spp)}", "effects", tuple(rows), stage.reference.error)
