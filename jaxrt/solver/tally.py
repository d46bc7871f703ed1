"""Sums of a picture's samples: how many each pixel has, what they say, and how far they are apart."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from . import path

BAND = 1 << 16
"""Pixels that are summed up at once."""


class Tally:
    """Sums of samples 0 ... `taken` − 1 of each of n pixels, by set, and rays that were cast for them.

    Sums of many passes are kept in float64. With a `block`, sets are blocks of so many samples by turns, as paths have
    them that end in a field.
    """

    def __init__(self, n: int, channels: int, seed: Any, block: int | None = None, exact: bool = True) -> None:
        self.seed, self.block, self.rays = seed, block, 0
        sets = path.SETS if block is None else path.HALVES
        self.sums = np.zeros((n, sets, channels), np.float64 if exact else np.float32)
        self.taken = np.zeros(n, np.int32)

    def add(self, numbers: np.ndarray, first: np.ndarray, last: np.ndarray, sums: np.ndarray) -> None:
        """Samples first ... last − 1 of pixels, (N, sets, C); left out where those before are missing."""
        while len(numbers):
            once, at = np.unique(numbers, return_index=True)
            turn = self.taken[once] == first[at]
            once, now = once[turn], at[turn]
            self.sums[once] += sums[now]
            self.taken[once] = last[now]
            if len(at) == len(numbers):
                return
            later = np.delete(np.arange(len(numbers)), at)
            numbers, first, last, sums = (a[later] for a in (numbers, first, last, sums))

    def counts(self, taken: np.ndarray) -> np.ndarray:
        """How many of so many samples are in each set, (sets, N)."""
        each = np.arange(self.sums.shape[1])[:, None]
        if self.block is None:
            return (taken + path.SETS - 1 - each) // path.SETS
        whole, rest = np.divmod(taken, path.HALVES * self.block)
        return whole * self.block + np.clip(rest - each * self.block, 0, self.block)

    def found(self) -> tuple[np.ndarray, np.ndarray]:
        """Each pixel's mean, and the variance of that by how far its sets are apart, NaN below two; (n, C) float32."""
        shape = len(self.taken), self.sums.shape[2]
        mean, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        for k in range(0, shape[0], BAND):
            band = slice(k, k + BAND)
            mean[band], variance[band] = mean_and_variance(
                self.sums[band].swapaxes(0, 1), self.counts(self.taken[band])
            )
        return mean, variance

    def relative_variances(self, apart: bool = True) -> np.ndarray:
        """What each pixel adds to relMSE, (n,): the variance of its mean over the square of that.

        If `apart`, and where there are sets enough, one half of them tells the variance and the other the mean: what is
        bright by chance has a large variance by the same chance, which would hide it. NaN for pixels that are not
        finite, which have no say in the others' share.
        """
        finite = np.all(np.isfinite(self.sums), axis=(1, 2))
        if not np.all(finite):
            others = copy.copy(self)
            others.sums = np.where(finite[:, None, None], self.sums, 0.0)
            return np.where(finite, others.relative_variances(apart), np.nan)
        n, sets, channels = self.sums.shape
        bands = [slice(k, k + BAND) for k in range(0, n, BAND)]
        square = sum(float(np.square(self._mean(b, range(sets))).sum(dtype=np.float64)) for b in bands)
        epsilon = max(0.01 * square / (n * channels), 1e-30)
        found = np.empty(n)
        for b in bands:
            counts, total = self.counts(self.taken[b]), np.maximum(self.taken[b], 1)[:, None]
            halves = [range(sets // 2), range(sets // 2, sets)]
            if not apart or sets < 4 or (counts == 0).any():
                halves = [range(sets)]
            shares = 0.0
            for own, other in zip(halves, halves[::-1], strict=True):
                part = list(own)
                variance = mean_and_variance(self.sums[b, part].swapaxes(0, 1), counts[part])[1]
                variance = variance * counts[part].sum(0)[:, None] / total
                shares = shares + variance / (np.square(self._mean(b, other), dtype=np.float64) + epsilon)
            found[b] = np.mean(shares, 1) / len(halves)
        return found

    def _mean(self, band: slice, sets: Any) -> np.ndarray:
        counts = self.counts(self.taken[band])[list(sets)].sum(0)[:, None]
        return self.sums[band, list(sets)].sum(1) / np.maximum(counts, 1)

    @property
    def turn(self) -> int:
        """Samples after which all sets have as many."""
        return path.SETS if self.block is None else path.HALVES * self.block

    @property
    def samples(self) -> int:
        return int(self.taken.sum(dtype=np.int64))


def mean_and_variance(sums: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and their variances, (N, C), from sums (sets, N, C) of so many samples (sets, N); NaN below two sets."""
    n, total = counts[..., None].astype(sums.dtype), counts.sum(0)[:, None].astype(sums.dtype)
    mean = sums.sum(0) / np.maximum(total, 1)
    apart = (n * (sums / np.maximum(n, 1) - mean) ** 2).sum(0)
    degrees = (counts > 0).sum(0)[:, None] - 1
    return mean, np.where(degrees > 0, apart / np.maximum(degrees, 1) / np.maximum(total, 1), np.nan)
