"""How far a picture is from its target: residuals, whose mean square is the loss, or a loss of the caller's own."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from ..parts import SceneError

FLOOR = 0.01
"""Beside the target's mean (of squares), what keeps dark pixels from counting without end; as in `relative_mse`."""


@dataclass(frozen=True)
class Loss:
    """residuals(image, target, level), level² the whole target's mean square.

    `linear`: in the image, so that the loss is quadratic; `local`: pixel by pixel, so that some of them will do.
    """

    residuals: Callable[[Any, Any, Any], Any]
    linear: bool = True
    local: bool = True


def _l2(image: Any, target: Any, level: Any) -> Any:
    return image - target


def _relative(image: Any, target: Any, level: Any) -> Any:
    return (image - target) / jnp.sqrt(target**2 + FLOOR * level**2 + 1e-30)


def _log(image: Any, target: Any, level: Any) -> Any:
    floor = FLOOR * level + 1e-30
    return jnp.log(jnp.maximum(image, 0.0) + floor) - jnp.log(jnp.maximum(target, 0.0) + floor)


def halved(a: Any) -> Any:
    """Means of 2 x 2 pixels, (H, W, C) -> (H // 2, W // 2, C)."""
    a = a[: a.shape[0] // 2 * 2, : a.shape[1] // 2 * 2]
    return a.reshape(a.shape[0] // 2, 2, a.shape[1] // 2, 2, -1).mean((1, 3))


def _multiscale(image: Any, target: Any, level: Any) -> Any:
    off = image - target
    levels = [off]
    while min(off.shape[:2]) >= 2:
        off = halved(off)
        levels.append(off)
    total = sum(a.size for a in levels)
    return jnp.concatenate([a.ravel() * (total / (a.size * len(levels))) ** 0.5 for a in levels])


LOSSES = {
    "l2": Loss(_l2),
    "relative": Loss(_relative),
    "log": Loss(_log, linear=False),
    "multiscale": Loss(_multiscale, local=False),
}


@functools.lru_cache
def _own(given: Callable[[Any, Any], Any]) -> Loss:
    return Loss(lambda image, target, level: jnp.asarray(given(image, target)), linear=False, local=False)


def loss_of(given: Any) -> Loss:
    """A loss by name, or the caller's: (image, target) -> a loss, or residuals of any shape but ()."""
    if isinstance(given, Loss):
        return given
    if callable(given):
        return _own(given)
    if not isinstance(given, str) or given not in LOSSES:
        raise SceneError(f"loss: {given!r} is not known; give {', '.join(LOSSES)} or a function (image, target)")
    return LOSSES[given]
