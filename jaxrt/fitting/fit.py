"""Scenes fitted to pictures."""

from __future__ import annotations

import functools
import time
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..effects import Plan, fitting
from ..effects import plan as make_plan
from ..parts import SceneError
from ..scene import Scene
from ..solver.measure import depths_of
from .loop import run
from .losses import Loss, loss_of
from .parameters import Free
from .result import Fit
from .steps import FORWARD, Descent, LeastSquares
from .views import Measuring, checked, views_of

RATE, STEPS, SQUARES = 0.1, 200, 20
"""Adam's first step where no optimiser is given; steps of descent and of least squares."""


def fit(
    scene: Scene,
    targets: Any,
    free: str | Iterable[str] | Mapping[str, Any],
    *,
    sensor: int | Sequence[int] = 0,
    loss: str | Callable[..., Any] = "l2",
    optimiser: Any = None,
    steps: int | None = None,
    spp: int = 16,
    seed: int = 0,
    frozen: bool | None = None,
    unbiased: bool | None = None,
    pixels: int | None = None,
    coarse: Sequence[tuple[int, int]] = (),
    max_depth: int | None = None,
    forward: bool | None = None,
    boundary: bool = True,
    plan: Plan | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: bool | Callable[[int, float, dict[str, Any]], None] | None = None,
) -> Fit:
    """The scene with some of its parameters changed so that its pictures come close to targets.

    `targets`: (H, W, C), radiance in W·m⁻²·sr⁻¹; with `sensor` a list, as many of them. `free`: names or patterns of
    parameters ("*.reflectance"), or a mapping from these to what keeps them in bounds: "unit", "positive",
    (lower, upper), "rigid" (of a to_world), "shift" or `Shift(directions)` (of one that does not turn), "smooth" or
    `Smooth(λ)` (of vertices), "plain"; by default by name.

    `loss`: "l2", "relative" ((I − T)/√(T² + ε)), "log", "multiscale" (l2 of the picture and of halves down to one
    pixel), each a mean of squares, or a function (image, target) -> a loss, or residuals. `optimiser`: of optax, by
    default Adam whose steps fall from .1 to 0 by a cosine, or least squares of optimistix, as
    `GaussNewton(1e-3, 1e-5)`; for vertices `uniform_adam`. `steps`: 200, or 20 of least squares at most. `coarse`:
    (factor, steps) that go before these with pictures so many times smaller, as [(4, 50), (2, 50)].

    `spp`: samples a pixel and step; anew each step, or `frozen`, as least squares always has them. `unbiased`: these
    in two halves, so that noise does not move the minimum; by default where the loss is l2, relative or multiscale and
    samples are not frozen, and with Gauss-Newton, which compares no losses. `pixels`: so many of each picture a step,
    drawn at random. `forward`: forward mode, by default for few numbers. `max_depth`, `boundary`, `plan` as of
    `measure`; the plan by default `plan(scene, free)`.

    `checkpoint`: a file that is kept up to date and from which `resume` goes on, to the same bits. `progress`: a bar,
    by default where stderr is a terminal, or a function (step, loss, values). Raises `SceneError` for unknown names,
    targets of other shapes, values out of bounds and what derivatives refuse.
    """
    started = time.perf_counter()
    pairs = checked(scene, targets, sensor)
    chosen = Free.of(scene, free)
    squares, optimiser, steps = _optimiser(optimiser, steps, sum(n for _, n in _checked_coarse(coarse)))
    kind = loss_of(loss)
    for name, value, least in (("spp", spp, 1), ("pixels", 1 if pixels is None else pixels, 1), ("seed", seed, 0)):
        if not isinstance(value, (int, np.integer)) or value < least:
            raise SceneError(f"{name}: is {value}; give a whole number of at least {least}")
    if (why := _refusal(loss, kind, optimiser if squares else None, frozen, unbiased, pixels)) is not None:
        raise SceneError(why)
    if resume and checkpoint is None:
        raise SceneError("resume: has no file to go on from; give checkpoint=")
    depth = depths_of(scene, max_depth).max_depth
    if depth < 0:
        raise SceneError("max_depth: derivatives need a finite number of bounces; give max_depth=")
    plan = make_plan(scene, free=list(chosen.transforms)) if plan is None else plan
    jax.eval_shape(lambda z: fitting(chosen(scene, z), plan) and 0.0, chosen.start)  # parameters that it relies on

    able = kind.linear and (_compares_nothing(optimiser) if squares else not frozen)
    twice = able if unbiased is None else unbiased
    forward = chosen.numbers <= FORWARD if forward is None else forward
    measuring = Measuring(kind, -(-spp // 2) if twice else spp, pixels, plan, depth, boundary)
    method = LeastSquares(optimiser, measuring, twice) if squares else Descent(optimiser, measuring, twice, forward)
    stages = [*((views_of(scene, pairs, factor), n) for factor, n in coarse), (views_of(scene, pairs), steps)]
    about = {
        "parameters": {name: list(np.shape(z)) for name, z in chosen.start.items()},
        "loss": str(loss) if isinstance(loss, str) else "given",
        "method": type(optimiser).__name__ if squares else "descent",
        "spp": int(spp), "seed": int(seed), "frozen": bool(frozen or squares), "twice": bool(twice),
        "pixels": None if pixels is None else int(pixels), "targets": [zlib.crc32(t.tobytes()) for _, t in pairs],
        "steps": [n for _, n in stages], "sizes": [[list(v.targets.shape) for v in views] for views, _ in stages],
    }  # fmt: skip
    return run(
        scene, chosen, method, stages, bool(frozen or squares), seed, about, checkpoint, resume, progress, started
    )


@functools.lru_cache
def _adam(steps: int) -> Any:
    """One object for each number of steps, so that fits share programs."""
    import optax

    return optax.adam(optax.cosine_decay_schedule(RATE, steps))


def _compares_nothing(solver: Any) -> bool:
    """Whether a least squares solver takes every step, as Gauss-Newton does."""
    import optimistix

    return isinstance(getattr(solver, "search", None), optimistix.LearningRate)


def _refusal(loss: Any, kind: Loss, solver: Any, frozen: Any, unbiased: Any, pixels: Any) -> str | None:
    """Why these do not go together, or None. `solver`: of least squares."""
    if solver is not None and frozen is False:
        return "frozen: least squares compares residuals of one step and the next; leave it out, or take optax"
    if solver is not None and pixels is not None:
        return "pixels: least squares takes whole pictures; leave them out, or take optax"
    if solver is not None and unbiased and not _compares_nothing(solver):
        name = type(solver).__name__
        return f"unbiased: {name} takes no step that raises the sum of squares; leave it out, or take GaussNewton"
    if pixels is not None and not kind.local:
        return f"pixels: loss {loss!r} takes whole pictures; leave pixels out, or give l2, relative or log"
    if unbiased and not kind.linear:
        return f"unbiased: loss {loss!r} is not quadratic; leave it out, or give l2, relative or multiscale"
    return None


def _checked_coarse(coarse: Sequence[tuple[int, int]]) -> Sequence[tuple[int, int]]:
    for pair in coarse:
        if not (isinstance(pair, (tuple, list)) and len(pair) == 2 and all(isinstance(k, int) and k > 0 for k in pair)):
            raise SceneError(f"coarse: {pair!r} is no stage; give pairs (factor, steps), as [(4, 50), (2, 50)]")
    return coarse


def _optimiser(given: Any, steps: int | None, before: int) -> tuple[bool, Any, int]:
    """Whether it is least squares, the optimiser, and its steps at full size."""
    import optimistix

    squares = isinstance(given, optimistix.AbstractLeastSquaresSolver)
    steps = (SQUARES if squares else STEPS) if steps is None else steps
    if not isinstance(steps, (int, np.integer)) or steps < 1:
        raise SceneError(f"steps: is {steps}; give a whole number of at least 1")
    if given is None:
        given = _adam(before + int(steps))
    if not squares and not hasattr(given, "update"):
        raise SceneError(
            f"optimiser: {type(given).__name__} is not known; give one of optax, or least squares of optimistix"
        )
    return squares, given, int(steps)
