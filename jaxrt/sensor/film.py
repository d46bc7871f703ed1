"""Film filters, by importance: a pixel draws its samples from its own filter, so no sample is splatted.

A pixel is ∫ h_p(q) L(q) dq with ∫ h_p = 1. Near the picture's edge the filter is cut off at the edge and
scaled up again, as when only samples inside the picture exist; unless its film samples beyond (`border`).
A filter that is negative in places is drawn from by its absolute value, and its samples carry a weight.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

_KNOTS = 1024


class Filter(NamedTuple):
    """A reconstruction filter: its kind, radius (pixels), what shapes it, and whether samples lie beyond the edge."""

    kind: str
    radius: float
    stddev: float = 0.5  # of a gaussian
    bc: tuple[float, float] = (1 / 3, 1 / 3)  # of a cubic (Mitchell and Netravali 1988)
    border: bool = False

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Its values, up to a factor, at offsets of at most the radius."""
        x = np.abs(x)
        if self.kind == "tent":
            return 1.0 - x / self.radius
        if self.kind == "gaussian":  # lowered so that it ends at 0
            return np.maximum(
                np.exp(-0.5 * (x / self.stddev) ** 2) - np.exp(-0.5 * (self.radius / self.stddev) ** 2), 0
            )
        if self.kind == "lanczos":
            return np.sinc(x) * np.sinc(x / self.radius)
        b, c = (0.0, 0.5) if self.kind == "catmullrom" else self.bc
        near = (12 - 9 * b - 6 * c) * x**3 + (-18 + 12 * b + 6 * c) * x**2 + (6 - 2 * b)
        far = (-b - 6 * c) * x**3 + (6 * b + 30 * c) * x**2 + (-12 * b - 48 * c) * x + (8 * b + 24 * c)
        return np.where(x < 1, near, far)

    @property
    def signed(self) -> bool:
        """Whether it is negative in places."""
        return self.kind != "box" and bool(_tables(self)[3].size)


@functools.lru_cache
def _tables(h: Filter) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of |h|, the distribution at even offsets in [−radius, radius], and its inverse at even chances; the integral of
    h's sign up to those chances, as the inverse has it; and the distances at which h changes its sign."""
    x = np.linspace(-h.radius, h.radius, 16 * _KNOTS + 1)
    size = np.abs(h(x))
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (size[1:] + size[:-1]))])
    cdf /= cdf[-1]
    rising = np.concatenate([[True], np.diff(cdf) > 0])
    inverse = np.interp(np.linspace(0.0, 1.0, _KNOTS + 1), cdf[rising], x[rising])
    at = x[8 * _KNOTS :][size[8 * _KNOTS :] > 1e-9 * size.max()]
    turns = np.nonzero(np.diff(np.sign(h(at))))[0]
    turns = 0.5 * (at[turns] + at[turns + 1])
    drawn = np.interp((np.arange(_KNOTS * 64) + 0.5) / 64, np.arange(_KNOTS + 1), inverse)
    sign = (-1.0) ** (np.abs(drawn)[:, None] > turns).sum(1)
    signed = np.concatenate([[0.0], np.cumsum(sign.reshape(-1, 64).mean(1)) / _KNOTS])
    return cdf[::16], inverse, signed, turns


class Pixel(eqx.Module):
    """Column and row of a pixel, and the range of each axis's distribution that lies inside the picture; of a filter
    that is negative in places also the weight of a sample, but for its sign."""

    column: Any
    row: Any
    low: tuple[Any, Any]
    high: tuple[Any, Any]
    weight: Any = None


def pixel(film: tuple[Any, ...], column: Any, row: Any, width: Any, height: Any) -> Pixel:
    h = Filter(*film[2:])
    low, high, weight = [], [], jnp.ones_like(column)
    for at, size in ((column, width), (row, height)):
        center = at + 0.5
        ends = (-center, size - center)
        if h.border:
            ends = (jnp.full_like(center, -h.radius), jnp.full_like(center, h.radius))
        ends = jnp.maximum(ends[0], -h.radius), jnp.minimum(ends[1], h.radius)
        if h.kind == "box":
            low.append(center + ends[0])
            high.append(center + ends[1])
            continue
        cdf, _, signed, _ = _tables(h)
        read = lambda at, table: jnp.interp(at * _KNOTS, jnp.arange(_KNOTS + 1.0), jnp.asarray(table, at.dtype))
        low.append(read((ends[0] + h.radius) / (2 * h.radius), cdf))
        high.append(read((ends[1] + h.radius) / (2 * h.radius), cdf))
        if h.signed:
            weight = weight * (high[-1] - low[-1]) / (read(high[-1], signed) - read(low[-1], signed))
    return Pixel(column, row, (low[0], low[1]), (high[0], high[1]), weight if h.signed else None)


def sample(film: tuple[Any, ...], p: Pixel, u: tuple[Any, Any]) -> tuple[Any, Any]:
    """A position on the film, in pixels from the upper left corner, with density |h_p| / ∫ |h_p|."""
    h, out = Filter(*film[2:]), []
    for at, low, high, r in zip((p.column, p.row), p.low, p.high, u, strict=True):
        q = low + (high - low) * r
        if h.kind != "box":
            table = _tables(h)[1]
            steps = jnp.asarray(np.stack([table[:-1], np.diff(table)], 1), q.dtype)
            k = jnp.clip((q * _KNOTS).astype(jnp.int32), 0, _KNOTS - 1)
            cell = steps.at[k].get(mode="clip")
            q = at + 0.5 + cell[0] + cell[1] * (q * _KNOTS - k)
        out.append(q)
    return out[0], out[1]


def weight(film: tuple[Any, ...], p: Pixel, position: tuple[Any, Any]) -> Any:
    """h_p / density at a position: ± ∫ |h_p|."""
    found = p.weight
    for at, q in zip((p.column, p.row), position, strict=True):
        for turn in _tables(Filter(*film[2:]))[3]:
            found = jnp.where(jnp.abs(q - at - 0.5) > turn, -found, found)
    return found


def density(film: tuple[Any, ...], p: Pixel, at: tuple[Any, Any]) -> Any:
    """h_p at a position on the film, 1/pixel²: the density with which `sample` draws it, times its weight."""
    f, out = Filter(*film[2:]), 1.0
    for center, low, high, q in zip((p.column + 0.5, p.row + 0.5), p.low, p.high, at, strict=True):
        if f.kind == "box":
            inside, h = (q >= low) & (q < high), jnp.ones_like(q)
        else:
            place = (q - center + f.radius) / (2 * f.radius) * _KNOTS
            k = jnp.clip(place.astype(jnp.int32), 0, _KNOTS - 1)
            cdf = jnp.asarray(_tables(f)[0], q.dtype)
            start, step = cdf[:-1].at[k].get(mode="clip"), jnp.diff(cdf).at[k].get(mode="clip")
            drawn = start + step * (place - k)  # where `sample` has it: beyond the picture's edge it has nothing
            inside = (place >= 0) & (place < _KNOTS) & (drawn >= low) & (drawn <= high)
            h = step * (_KNOTS / (2 * f.radius))
        out = out * jnp.where(inside, h / jnp.maximum(high - low, 1e-30), 0.0)
    return out if p.weight is None else out * weight(film, p, at)
