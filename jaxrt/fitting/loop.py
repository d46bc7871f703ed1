"""The host loop of a fit: stages of steps, history, checkpoints, progress."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from ..scene import Scene
from . import checkpoint as files
from .parameters import Free
from .result import Fit
from .steps import LeastSquares

EVERY = 30.0
"""Seconds between checkpoints."""

FEW = 64
"""Numbers of a parameter up to which the history has its values."""


def run(
    scene: Scene, free: Free, method: Any, stages: Any, frozen: bool, seed: int, about: dict[str, Any],
    path: Any, resume: bool, progress: Any, started: float,
) -> Fit:  # fmt: skip
    """The host loop: stages of steps, history, checkpoints."""
    import optimistix

    results = optimistix.RESULTS
    key, result = jax.random.key(seed), results.successful
    shown = [name for name, z in free.start.items() if np.size(z) <= FEW]
    history: dict[str, list[Any]] = {name: [] for name in ("step", "loss", "seconds", *shown)}
    total, step, before = sum(n for _, n in stages), 0, 0.0
    values = jax.jit(lambda free, z: free.values(z))
    kept = files.about_of(path, about) if path is not None and resume else None
    state, stage, skip, done = None, 0, 0, False
    if path is not None and kept is not None:
        stage, skip, done = kept["stage"], kept["within"], kept["done"]
        state = method.init(scene, free, stages[stage][0], key)
        state, history = files.load(path, state)
        step, before = len(history["step"]), float(history["seconds"][-1]) if history["seconds"] else 0.0

    def save(stage: int, within: int) -> None:
        if path is not None and state is not None:
            files.save(path, state, history, about | {"stage": stage, "within": within, "done": done})

    if path is not None and kept is None:  # at once: a path that cannot be written is known before anything is spent
        state = method.init(scene, free, stages[0][0], key)
        save(0, 0)
    saved = time.perf_counter()
    with _shown(progress) as show:
        try:
            for number in range(stage, len(stages)):
                views, n = stages[number]
                if state is None:
                    state = method.init(scene, free, views, key)
                elif number > stage:
                    state, stage, skip, done = method.enter(state, scene, free, views, key), number, 0, False
                while skip < n and not done:
                    own = key if frozen else jax.random.fold_in(key, step)
                    found, loss, done, finite = method.step(state, scene, free, views, own)
                    loss, done = float(loss), bool(done)
                    if not finite:
                        result = results.nonfinite
                        break
                    state, skip, step = found, skip + 1, step + 1
                    now = values(free, state.z)
                    spent = before + time.perf_counter() - started
                    for name, value in {"step": step, "loss": loss, "seconds": spent, **now}.items():
                        if name in history:
                            history[name].append(np.asarray(value))
                    if time.perf_counter() - saved > EVERY:
                        save(number, skip)
                        saved = time.perf_counter()
                    show(step, total, loss, now)
                if result != results.successful:
                    break
        finally:
            save(stage, skip)
    if isinstance(method, LeastSquares) and not done and result == results.successful:
        result = results.nonlinear_max_steps_reached
    assert state is not None
    found = values(free, state.z)
    covariance = method.covariance(state, scene, free, stages[-1][0], key) if isinstance(method, LeastSquares) else None
    return Fit(
        free(scene, state.z), found, {name: np.asarray(v) for name, v in history.items()}, covariance,
        before + time.perf_counter() - started, result,
    )  # fmt: skip


@contextlib.contextmanager
def _shown(progress: Any) -> Iterator[Callable[[int, int, float, dict[str, Any]], Any]]:
    """What shows a step: the caller's function, a bar with loss and time left on stderr, or nothing."""
    if callable(progress):
        yield lambda step, total, loss, values: progress(step, loss, values)
        return
    if not (sys.stderr.isatty() if progress is None else progress):
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=None)
        yield lambda step, total, loss, _: bar.update(task, description=f"loss {loss:.4g}", total=total, completed=step)
