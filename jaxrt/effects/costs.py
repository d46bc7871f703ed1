"""What effects cost, and what the picture loses without them: measured on small pictures, with and without each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ..intersect import BACKENDS, refusal
from ..parts import SceneError
from ..scene import Scene
from .make import effect_named
from .make import plan as make_plan
from .registry import EFFECTS
from .static import Plan

SIDE, SAMPLES, REPEAT = 96, 16, 5
"""Pixels along the longer side of the picture that is timed, samples a pixel, and how often each side has its turn."""


@dataclasses.dataclass(frozen=True)
class Cost:
    """One effect, without it and with it: seconds of a picture (the best of several), of compiling, rays cast.

    `on`: whether it is in the plan. `noise`: how far the best times are known (s). `radiance`: what the mean of the
    picture is brighter with the effect, and the standard error of that (W·m⁻²·sr⁻¹); `mean`: of the plan's picture.
    """

    name: str
    on: bool
    seconds: tuple[float, float]
    compiling: tuple[float, float]
    rays: tuple[int, int]
    noise: float
    radiance: tuple[float, float]
    mean: float

    @property
    def share(self) -> float:
        """Of the time that a picture takes with the plan."""
        without, with_it = self.seconds
        return (with_it - without) / self.seconds[self.on]

    @property
    def ns_a_ray(self) -> float:
        """Nanoseconds that every ray takes longer with the effect."""
        without, with_it = (1e9 * s / max(n, 1) for s, n in zip(self.seconds, self.rays, strict=True))
        return with_it - without


def effect_costs(
    scene: Scene,
    names: Iterable[str] | None = None,
    *,
    free: Any = None,
    backend: str | None = None,
    sensor: int = 0,
    spp: int = SAMPLES,
    side: int = SIDE,
    repeat: int = REPEAT,
    progress: Callable[[str, float], None] | None = None,
    **overrides: bool,
) -> list[Cost]:
    """What each effect (or those named) costs in a picture by the path method: of one that is in, against the program
    without it; of one that is out, against the program with it forced in.

    `free`, `backend`, `overrides`: of the plan, as `jaxrt.plan` takes them. The picture is that of `sensor`, at most
    `side` pixels wide and high, with `spp` samples a pixel. Both programs take turns, warm, `repeat` times. Effects
    that the scene cannot do without, or has no use for at all, are left out. `progress`: called with a name and the
    share done. Raises `SceneError` for unknown names, and where the scene has no such sensor.
    """
    asked: dict[str, Any] = {"backend": backend, **overrides}
    make = lambda **more: make_plan(scene, free, **(asked | more))
    plan, wanted = make(), EFFECTS if names is None else [effect_named(name).name for name in names]
    variants = [(name, other) for name in wanted if (other := other_plan(plan, name, make)) is not None]
    picture = _pictures(scene, sensor, side, spp)
    found, base = [], None
    for k, (name, other) in enumerate(variants):
        if progress:
            progress(name, k / len(variants))
        base = base or picture(plan)
        sides = {False: picture(other), True: base} if name in plan.effects else {False: base, True: picture(other)}
        plans = {on: plan if sol is base else other for on, sol in sides.items()}
        times = {on: [] for on in plans}
        for _ in range(repeat):
            for on in plans:
                times[on].append(picture(plans[on]).stats["seconds_run"])
        noise = max(sorted(t)[min(1, repeat - 1)] - min(t) for t in times.values())
        pair = lambda of: (of(False), of(True))
        more = pair(lambda on, sides=sides: _mean(sides[on]))
        found.append(
            Cost(
                name,
                name in plan.effects,
                pair(lambda on, times=times: min(times[on])),
                pair(lambda on, sides=sides: sides[on].stats["seconds_compile"]),
                pair(lambda on, sides=sides: sides[on].stats["rays"]),
                noise,
                (more[1][0] - more[0][0], float(np.hypot(more[0][1], more[1][1]))),
                _mean(base)[0],
            )
        )
    return found


def dropped_radiance(scene: Scene, overrides: dict[str, Any], sensor: int = 0, spp: int = 64) -> tuple[float, ...]:
    """Mean radiance of a small picture, what it loses under overrides of its plan, and the standard error of that."""
    picture = _pictures(scene, sensor, SIDE, spp)
    (all_of_it, error), (left, its_error) = (
        _mean(picture(make_plan(scene, None, **given))) for given in ({}, overrides)
    )
    return all_of_it, all_of_it - left, float(np.hypot(error, its_error))


def other_plan(plan: Plan, name: str, make: Callable[..., Plan]) -> Plan | None:
    """The plan with an effect turned round, or None where that cannot be or makes no difference."""
    effect, on = EFFECTS[name], name in plan.effects
    backend = name.removeprefix("rays:")
    if backend in BACKENDS:
        return None if on or refusal(backend) else make(backend=backend)
    if effect.fixed or (on and effect.stays):
        return None
    other = make(**{name: not on})
    return None if other == plan else other


def small(scene: Scene, sensor: int, side: int) -> Scene:
    """The scene with a picture of at most `side` pixels to a side. Raises `SceneError` where there is no sensor."""
    from ..solver.render import resized

    if not scene.structure.sensors:
        raise SceneError(
            f"{scene.structure.source or 'scene'}: has no sensor; what effects cost is measured on pictures"
        )
    structure = scene.structure.sensors[sensor]
    width, height, *_ = structure.film
    scale, views = min(1.0, side / max(width, height)), len(structure.parts) or 1
    width, height = (max(1, round(scale * n)) for n in (width / views, height))
    return resized(scene, sensor, width * views, height)


def _pictures(scene: Scene, sensor: int, side: int, spp: int) -> Callable[[Plan], Any]:
    from ..solver.render import render

    scene = small(scene, sensor, side)
    return lambda plan: render(scene, spp, plan=plan, sensor=sensor, method="path")


def _mean(sol: Any) -> tuple[float, float]:
    """Mean of a picture, and the standard error of that."""
    error = np.sqrt((sol.stderr.astype(np.float64) ** 2).sum()) / sol.stderr.size
    return float(sol.image.mean(dtype=np.float64)), float(error)
