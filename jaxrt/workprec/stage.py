"""What all sweeps of a scene share: the picture's size, the reference, the peer, and the clock."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..effects.costs import small
from ..scene import Scene
from ..solver.render import render
from ..solver.solution import relative_mse
from .curve import Row
from .peer import Peer, peer_of

SEED = 20260
"""Of references; what is tried takes 1, 2, ..."""


def samples(spp: float) -> str:
    """A number of samples as settings name it."""
    return f"{int(spp)} sample{'' if spp == 1 else 's'} a pixel"


def root_relative_mse(image: Any, reference: Any) -> float:
    return relative_mse(image, reference) ** 0.5


@dataclasses.dataclass(frozen=True)
class Reference:
    """A converged picture, its own √relMSE (half of what two halves of it are apart), and by what it was made."""

    image: np.ndarray
    error: float
    by: str


@dataclasses.dataclass(frozen=True)
class Stage:
    """A scene with a small picture, and what its sweeps are measured by. `file`: for peers and other processes."""

    name: str
    scene: Scene
    file: Path | None
    defaults: dict[str, Any]
    seed: int
    most: int  # samples a pixel
    reference: Reference
    peer: Peer | None

    def timed(self, picture: Callable[[int], tuple[np.ndarray, float, float]], setting: str, quantity: float) -> Row:
        """A row of two pictures by seeds of their own. `picture`: by a seed gives image, claimed error, and seconds of
        making programs; the better time counts, and the mean of squares of both errors."""
        times, compiling, errors, claims = [], 0.0, [], []
        for k in (1, 2):
            start = time.perf_counter()
            image, claimed, made = picture(self.seed + k)
            times.append(time.perf_counter() - start - made)
            compiling += made
            errors.append(relative_mse(image, self.reference.image))
            claims.append(claimed**2)
        error, claimed = (float(np.sqrt(np.mean(a))) for a in (errors, claims))
        return Row(setting, quantity, min(times), compiling, error, claimed, np.asarray(image, np.float32))

    def rendered(self, setting: str, quantity: float, spp: int, **options: Any) -> Row:
        """A row of pictures by `jaxrt.render`."""

        def picture(seed: int) -> tuple[np.ndarray, float, float]:
            sol = render(self.scene, spp, seed, **options)
            return sol.image, sol.relative_error, sol.stats["seconds_compile"]

        return self.timed(picture, setting, quantity)


def stage_of(
    scene: Scene,
    name: str,
    *,
    file: Path | None = None,
    defaults: dict[str, Any] | None = None,
    side: int = 64,
    seconds: float = 20.0,
    seed: int = 0,
    most: int = 4096,
    peer: bool = True,
) -> Stage:
    """A scene ready for sweeps, with a reference that took about so many seconds.

    The reference is Mitsuba's where that reads the file, which shares no code with what is measured; else it is made of
    independent samples by the path method, of other seeds.
    """
    scene, defaults = small(scene, 0, side), defaults or {}
    width, height, *_ = scene.structure.sensors[0].film
    other = peer_of(file, defaults, width, height) if peer else None
    if other is not None:
        image = other.picture(4, SEED)
        if image.shape != render(scene, 1, method="path").image.shape:  # several views in one picture, or grey
            other = None
    if other is not None:
        by, take = f"Mitsuba 3 ({other.variant})", other.picture
    else:
        by = "independent paths"
        take = lambda spp, seed: render(scene, spp, seed, method="path", sampler="independent").image
    return Stage(name, scene, file, defaults, seed, most, _reference(take, by, seconds, 16 * most), other)


def _reference(take: Callable[[int, int], np.ndarray], by: str, seconds: float, most: int) -> Reference:
    """Two halves, of as many samples as there is time for."""
    spp, spent = 16, 0.0
    take(spp, SEED)  # compiles
    while spp < most:
        start = time.perf_counter()
        take(spp, SEED + 1)
        spent = time.perf_counter() - start
        if spent > seconds / 20:
            break
        spp *= 4
    spp = int(np.clip(spp * (0.5 * seconds) / max(spent, 1e-3), spp, most))
    halves = [np.asarray(take(spp, SEED + 2 + k), np.float64) for k in (0, 1)]
    image = 0.5 * (halves[0] + halves[1])
    return Reference(image, 0.5 * root_relative_mse(halves[0], halves[1]), f"{by}, {samples(2 * spp)}")


def stage_with(scene: Scene, reference: Reference, seed: int = 0, most: int = 4096) -> Stage:
    """A stage for a scene in its size, with a reference that is known."""
    return Stage("", scene, None, {}, seed, most, reference, None)
