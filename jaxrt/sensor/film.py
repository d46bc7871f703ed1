"""Film filters, by importance: a pixel draws its samples from its own filter, so no sample is splatted.

A pixel is ∫ h_p(q) L(q) dq with ∫ h_p = 1. Near the picture's edge the filter is cut off at the edge and
scaled up again, as when only samples inside the picture exist.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

_KNOTS = 1024


@functools.lru_cache
def _tables(kind: str, radius: float, stddev: float) -> tuple[np.ndarray, np.ndarray]:
    """The filter's distribution at even offsets in [−radius, radius], and its inverse at even chances."""
    x = np.linspace(-radius, radius, 16 * _KNOTS + 1)
    if kind == "tent":
        h = 1.0 - np.abs(x) / radius
    else:  # gaussian, lowered so that it ends at 0
        h = np.exp(-0.5 * (x / stddev) ** 2) - np.exp(-0.5 * (radius / stddev) ** 2)
    h = np.maximum(h, 0.0)
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (h[1:] + h[:-1]))])
    cdf /= cdf[-1]
    rising = np.concatenate([[True], np.diff(cdf) > 0])
    inverse = np.interp(np.linspace(0.0, 1.0, _KNOTS + 1), cdf[rising], x[rising])
    return cdf[::16], inverse


class Pixel(eqx.Module):
    """Column and row of a pixel, and the range of each axis's distribution that lies inside the picture."""

    column: Any
    row: Any
    low: tuple[Any, Any]
    high: tuple[Any, Any]


def pixel(film: tuple[Any, ...], column: Any, row: Any, width: Any, height: Any) -> Pixel:
    kind, radius, stddev = film[2:]
    low, high = [], []
    for at, size in ((column, width), (row, height)):
        center = at + 0.5
        if kind == "box":
            low.append(jnp.maximum(center - radius, 0.0))
            high.append(jnp.minimum(center + radius, 1.0 * size))
        else:
            cdf = jnp.asarray(_tables(kind, radius, stddev)[0], center.dtype)
            place = lambda q: jnp.interp((q + radius) / (2 * radius) * _KNOTS, jnp.arange(_KNOTS + 1.0), cdf)  # noqa: B023
            low.append(place(jnp.maximum(-center, -radius)))
            high.append(place(jnp.minimum(size - center, radius)))
    return Pixel(column, row, (low[0], low[1]), (high[0], high[1]))


def sample(film: tuple[Any, ...], p: Pixel, u: tuple[Any, Any]) -> tuple[Any, Any]:
    """A position on the film, in pixels from the upper left corner, with density h_p."""
    kind, radius, stddev = film[2:]
    out = []
    for at, low, high, r in zip((p.column, p.row), p.low, p.high, u, strict=True):
        q = low + (high - low) * r
        if kind != "box":
            table = _tables(kind, radius, stddev)[1]
            steps = jnp.asarray(np.stack([table[:-1], np.diff(table)], 1), q.dtype)
            k = jnp.clip((q * _KNOTS).astype(jnp.int32), 0, _KNOTS - 1)
            cell = steps.at[k].get(mode="clip")
            q = at + 0.5 + cell[0] + cell[1] * (q * _KNOTS - k)
        out.append(q)
    return out[0], out[1]


def density(film: tuple[Any, ...], p: Pixel, at: tuple[Any, Any]) -> Any:
    """h_p at a position on the film: the density with which `sample` draws it, 1/pixel²."""
    kind, radius, stddev = film[2:]
    out = 1.0
    for center, low, high, q in zip((p.column + 0.5, p.row + 0.5), p.low, p.high, at, strict=True):
        if kind == "box":
            inside, h = (q >= low) & (q < high), jnp.ones_like(q)
        else:
            place = (q - center + radius) / (2 * radius) * _KNOTS
            k = jnp.clip(place.astype(jnp.int32), 0, _KNOTS - 1)
            inside = (place >= 0) & (place < _KNOTS)
            h = jnp.asarray(np.diff(_tables(kind, radius, stddev)[0]), q.dtype).at[k].get(mode="clip")
            h = h * (_KNOTS / (2 * radius))
        out = out * jnp.where(inside, h / jnp.maximum(high - low, 1e-30), 0.0)
    return out
