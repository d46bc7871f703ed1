"""Pictures to a tolerance, or within a time: a pilot, samples where the error is, what it will cost, when to stop.

No pixel's samples decide how many it gets: a pilot does, whose samples are left out of the picture (or all pixels get
as many, where it is most of it). How much there is in all follows from the error of the whole picture.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..sampling.sobol import combine
from .measure import PASS
from .solution import pooled, statistical
from .tally import Tally
from .work import Workers, missing, tiled

PILOT = 16
"""Samples a pixel of a pilot, in time for it."""

MORE = 4
"""What there is no time for so many pilots of has the pilot in it."""

STEEP = 1.14
"""The squared error falls with samples to this power, by Sobol points on the scenes of this repository (1.0 to 1.3)."""

BELIEVED = 0.1
"""How far √relMSE by halves, which scatters, may be from that by all sets, which is too small, by one log: of pilots of
2 · 16 samples of these scenes 0 to .2, and where much more is seen it is one bright sample."""

FASTEST, NEARLY = 6.0, 0.85
"""By so much at most samples grow before it is looked at what they say; and to so much of what is foretold."""

POWER, LEAST, MOST = 0.4, 0.5, 4.0
"""Samples of a pixel follow this power of what it adds to the squared error, within shares of the average: 1/2 would be
best if errors fell alike, but borders get better sooner; and a pilot may have seen nothing of rare light, or just once.
"""


class Goal(NamedTuple):
    """What is asked: `error`, √relMSE that samples may have in 95 of 100 renders; until when, by the clock."""

    error: float = 0.0
    deadline: float = np.inf

    @property
    def left(self) -> float:
        return self.deadline - time.perf_counter()


class Forecast(NamedTuple):
    """What a picture will cost: the error, and seconds from now until it is reached."""

    error: float
    seconds: float


class Pilot(NamedTuple):
    """What a picture begins with: a tally with as many samples for all pixels; the one to go on with, the samples of
    each of its pixels in shares of the average, the error that it may be claimed to have, what of that is there to
    stay, and seconds that a sample took."""

    even: Tally
    tally: Tally
    each: np.ndarray
    claim: float
    lasting: float
    rate: float

    @property
    def mean(self) -> float:
        return self.tally.samples / len(self.each)

    def samples(self, error: float) -> float:
        """How many for each pixel, on average, bring the claim down to this error."""
        return self.mean * max((self.lasting / error) ** (2.0 / STEEP), 1.0) if error > 0 else np.inf

    def forecast(self, error: float) -> Forecast:
        return Forecast(error, (self.samples(error) - self.mean) * len(self.each) * self.rate)

    def claim_after(self, seconds: float, off: float = 0.0) -> float:
        """The error that samples of so many more seconds leave, with that of something else."""
        times = 1.0 + max(seconds, 0.0) / (self.rate * self.tally.samples)
        return float(np.hypot(self.lasting * times ** (-STEEP / 2), off))


def _shares(tally: Tally, apart: bool = True) -> np.ndarray:
    """What pixels add to relMSE; of those that are not finite nothing, for samples do not mend them."""
    return np.nan_to_num(tally.relative_variances(apart))


def _claim(tally: Tally) -> float:
    return statistical(_shares(tally))[1]


def _claims(tally: Tally) -> tuple[float, float]:
    """The claim of few samples, and what of it is there to stay, for forecasts: all sets say too little, but all alike;
    halves say of each other too much where one sample is bright, and are believed as far as they scatter little."""
    (plain, above), (apart, more) = (statistical(_shares(tally, halves)) for halves in (False, True))
    if not 0 < plain < apart:
        return more, above
    scatter = np.log(more / apart) / 1.645
    return more, float(above * (apart / plain) ** (BELIEVED**2 / (BELIEVED**2 + scatter**2)))


def allotted(shares: np.ndarray) -> np.ndarray:
    """Samples of each pixel, 1 on average, for what pixels add to the squared error."""
    root = np.maximum(shares, 0.0) ** POWER
    each = np.clip(root / max(root.mean(), 1e-300), LEAST, MOST)
    return each / each.mean()


def pilot(workers: Workers, key: Any, goal: Goal) -> Pilot:
    """A few samples of every pixel, of which the first tell the speed and take a fifth of what time there is; then as
    many again where the error is, which stay."""
    even, began, left = workers.tally(combine(key, 0x9170)), time.perf_counter(), goal.left
    speed = lambda: (time.perf_counter() - began) / even.samples
    _take(workers, even, np.full(workers.n, even.turn))
    if left < np.inf:
        many = min(PILOT, int(max(0.2 * left / (speed() * workers.n * even.turn), 1.0)) * even.turn)
    else:
        many = PILOT
    _take(workers, even, np.full(workers.n, many))
    shares, rate = _shares(even), speed()
    if statistical(shares)[1] <= goal.error or goal.left < MORE * rate * even.samples:
        return Pilot(even, even, np.ones(workers.n), *_claims(even), rate)
    each = allotted(pooled(pooled(shares.reshape(workers.size[::-1]))).ravel())  # one pixel's four sets say little
    tally, began = workers.tally(key), time.perf_counter()
    _take(workers, tally, _rounded(tally, each * many))
    if many == PILOT and _claim(tally) > goal.error:
        _take(workers, tally, _rounded(tally, each * 2 * many))
    return Pilot(even, tally, each, *_claims(tally), (time.perf_counter() - began) / tally.samples)


def reach(workers: Workers, goal: Goal, begun: Pilot, tell: Callable[[float], None] | None) -> Tally:
    """Samples until the goal is reached: nearly as many as a pilot foretells, then what their own error does.

    `tell` is called with the share of the time that is over.
    """
    n, tally, rate, total = workers.n, begun.tally, begun.rate, begun.samples(goal.error)
    started, budget, before = time.perf_counter(), goal.left, tally.samples
    claim = begun.claim
    while claim > goal.error:
        mean, room = tally.samples / n, goal.left / (rate * n)
        if room < 1.0 or goal.left < 0.02 * budget:
            break
        soon = 1.0 if goal.left < 0.2 * budget else 0.7  # the last round is stopped by the clock
        likely = total if total < 2.0 * mean else NEARLY * total
        target = max(min(likely, mean + soon * room, FASTEST * mean), mean + 1.0)
        end = time.perf_counter() + rate * n * (min(total, mean + room) - mean)

        def over(_: float, end: float = end) -> None:
            now = time.perf_counter()
            if tell:
                tell(min(1.0, (now - started) / max(end - started, now - started, 1e-9)))

        _take(workers, tally, _rounded(tally, begun.each * target), lambda: goal.left < 0, over)
        rate = (time.perf_counter() - started) / max(tally.samples - before, 1)
        claim = _claim(tally)
        total = np.inf if goal.error == 0 else tally.samples / n * max((claim / goal.error) ** 1.8, 1.03)
    return tally


def _rounded(tally: Tally, samples: np.ndarray) -> np.ndarray:
    return (tally.turn * np.maximum(np.round(samples / tally.turn), 1)).astype(np.int32)


def _take(
    workers: Workers, tally: Tally, want: np.ndarray, stop: Callable[[], bool] = lambda: False,
    tell: Callable[[float], None] | None = None,
) -> None:  # fmt: skip
    order = tiled(np.arange(workers.n), *workers.size)
    mean = float(np.maximum(want - tally.taken, 0).mean())
    most = min(tally.turn * max(round(0.5 * mean / tally.turn), 1), max(PASS, tally.turn))  # rows last as their longest
    workers.take(tally, [missing(tally.taken, want, order, most)], stop, tell)
