"""All sweeps of a scene within a budget of seconds."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..parts import SceneError
from ..scene import Scene
from . import fields, pictures
from .circumstances import circumstances
from .curve import Curve
from .stage import Reference, stage_of

SWEEPS: dict[str, tuple[Any, float]] = {
    "path": (pictures.path_sobol, 3.0),
    "mitsuba": (pictures.mitsuba, 2.0),
    "depth": (pictures.depth, 1.0),
    "field": (pictures.field_sobol, 8.0),
    "independent": (pictures.path_independent, 2.0),
    "effects": (pictures.effects, 3.0),
    "fields": (fields.fields, 6.0),
    "float64": (pictures.path_double, 2.0),
}
"""By name: what gives curves, and its share of the time."""


@dataclasses.dataclass(frozen=True)
class Report:
    """What a scene's sweeps gave. `left_out`: names of those for which there was no time."""

    name: str
    size: tuple[int, int]
    reference: Reference
    curves: tuple[Curve, ...]
    left_out: tuple[str, ...]
    circumstances: dict[str, Any]

    def of(self, sweep: str) -> list[Curve]:
        return [curve for curve in self.curves if curve.sweep == sweep]


def work_precision(
    scene: Scene,
    name: str = "scene",
    *,
    file: str | Path | None = None,
    defaults: dict[str, Any] | None = None,
    seconds: float = 120.0,
    side: int = 64,
    most: int = 4096,
    seed: int = 0,
    sweeps: Sequence[str] | None = None,
    peer: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> Report:
    """Error against seconds: by samples, methods, samplers, depth, elements, directions, tolerance, precision, effects.

    `file`, `defaults`: what the scene was loaded from, which Mitsuba (if `peer`, where installed) and a process for
    float64 load again. `seconds`: for all of it, compiling included, about; sweeps for which none are left are named in
    the report. `side`: pixels of the longer side. `most`: samples a pixel. `sweeps`: names of `SWEEPS`, by default all.
    `progress`: called with a sweep's name and the share done. Raises `SceneError` for wrong arguments.
    """
    wanted = list(SWEEPS) if sweeps is None else list(sweeps)
    for sweep in wanted:
        if sweep not in SWEEPS:
            raise SceneError(f"sweeps: {sweep!r} is not known; give any of {', '.join(SWEEPS)}")
    for what, value in (("side", side), ("most", most)):
        if not isinstance(value, (int, np.integer)) or value < 1:
            raise SceneError(f"{what}: is {value}; give a whole number of at least 1")
    if not (math.isfinite(seconds) and seconds > 0):
        raise SceneError(f"seconds: is {seconds}; give a number above 0")
    began = time.perf_counter()
    say = progress or (lambda name, share: None)
    say("reference", 0.0)
    file = None if file is None else Path(file)
    stage = stage_of(
        scene, name, file=file, defaults=defaults, side=side, seconds=0.15 * seconds, seed=seed, most=most, peer=peer
    )
    curves: list[Curve] = []
    left_out: list[str] = []
    for k, sweep in enumerate(wanted):
        now = time.perf_counter()
        left = began + seconds - now
        run, weight = SWEEPS[sweep]
        if curves and left < 0.05 * seconds:
            left_out.append(sweep)
            continue
        say(sweep, min(1.0 - left / seconds, 1.0))
        end = now + left * weight / sum(SWEEPS[other][1] for other in wanted[k:])
        curves += run(stage, lambda expected, end=end: time.perf_counter() + 1.5 * expected < end)
    width, height, *_ = stage.scene.structure.sensors[0].film
    told = circumstances(seed) | {"seconds": time.perf_counter() - began}
    if stage.peer is not None:
        told |= {"mitsuba": stage.peer.mi.__version__, "variant": stage.peer.variant}
    curves = [curve for curve in curves if curve.rows]
    return Report(name, (width, height), stage.reference, tuple(curves), tuple(left_out), told)
