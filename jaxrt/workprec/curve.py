"""Points of a work-precision diagram, and what a line through them says."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np

LAST = 4
"""Points that a slope against seconds is taken from: below, what every picture takes is most of the time."""


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Least squares in log-log: d log y / d log x; NaN of fewer than two points."""
    return _line(np.log(np.asarray(x, float)), np.log(np.asarray(y, float)))


def _line(a: np.ndarray, b: np.ndarray) -> float:
    if len(a) < 2:
        return float("nan")
    off = a - a.mean()
    return float((off * (b - b.mean())).sum() / (off**2).sum()) if off.any() else float("nan")


@dataclasses.dataclass(frozen=True)
class Row:
    """A setting, and what it gave.

    quantity: the number that the sweep turns (samples a pixel, elements, ...). seconds: of the whole call when warm.
    compile: seconds of making programs, the first time. error: √relMSE against the reference, of fields relative L2.
    claimed: the error that the answer itself reports; NaN where it reports none. image: (H, W, C), of pictures.
    """

    setting: str
    quantity: float
    seconds: float
    compile: float
    error: float
    claimed: float = float("nan")
    image: np.ndarray | None = dataclasses.field(default=None, repr=False, compare=False)


@dataclasses.dataclass(frozen=True)
class Curve:
    """Rows along one number. `sweep`: which one. `floor`: what the reference itself does not know (√relMSE)."""

    name: str
    sweep: str
    rows: tuple[Row, ...]
    floor: float = 0.0

    @property
    def above(self) -> list[Row]:
        """The rows whose error is of their own, and not of the reference, nor none at all."""
        return [row for row in self.rows if row.error > max(2.0 * self.floor, 1e-12)]

    @property
    def order(self) -> float:
        """d log error / d log quantity: −1/2 for independent samples."""
        return slope([row.quantity for row in self.above], [row.error for row in self.above])

    @property
    def ratio(self) -> float:
        """How much of the error one more step of the quantity leaves: the factor of a geometric series."""
        rows = self.above
        return float(np.exp(_line(np.array([row.quantity for row in rows]), np.log([row.error for row in rows]))))

    @property
    def slope(self) -> float:
        """d log error / d log seconds, of the last points."""
        rows = self.above[-LAST:]
        return slope([row.seconds for row in rows], [row.error for row in rows])

    @property
    def digit(self) -> float:
        """How many times as much an error of a tenth takes: 10^(−1/order); infinite where more does not help.

        Of the order, not of the slope against seconds: that is steeper as long as what every call takes is felt.
        """
        return 10.0 ** (-1.0 / self.order) if self.order < -0.05 else float("inf")

    def seconds_for(self, error: float) -> float:
        """Seconds to an error, by lines in log-log, beyond the last point by the order; NaN where it never comes."""
        rows = self.above
        if not rows:
            return float("nan")
        if rows[0].error <= error:
            return rows[0].seconds
        for a, b in itertools.pairwise(rows):
            if b.error <= error:
                share = np.log(a.error / error) / np.log(a.error / b.error)
                return float(a.seconds * (b.seconds / a.seconds) ** share)
        if not self.order < -0.05:
            return float("nan")
        return float(rows[-1].seconds * (rows[-1].error / error) ** (-1.0 / self.order))


def ladder(
    point: Callable[[float], Row],
    quantities: Sequence[float],
    until: Callable[[float], bool],
    floor: float = 0.0,
    compiles: bool = False,
) -> tuple[Row, ...]:
    """Rows of growing cost, until `until` says of the seconds that the next will take that there is no time for them,
    or the error is the reference's own. `compiles`: whether every row has programs of its own."""
    rows: list[Row] = []
    for k, quantity in enumerate(quantities):
        if rows:
            expected = rows[-1].seconds * max(quantity / quantities[k - 1], 1.0)
            if not until(expected + compiles * rows[-1].compile):
                break
        rows.append(point(quantity))
        if rows[-1].error < 2.0 * floor:
            break
    return tuple(rows)
