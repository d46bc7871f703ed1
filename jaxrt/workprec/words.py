"""Numbers as table, figure and page say them."""

from __future__ import annotations

import math

from .curve import Curve, Row
from .report import Report

LEVEL = 0.01
"""The error for which seconds are told."""

HEADS = ("setting", "seconds", "compile", "error", "claimed")


def percent(value: float) -> str:
    return "–" if math.isnan(value) else f"{_two(100 * value)} %"


def seconds(value: float) -> str:
    if math.isnan(value):
        return "–"
    return f"{_two(1e3 * value)} ms" if value < 0.0995 else f"{_two(value)} s"


def _two(value: float) -> str:
    """Two digits, or all there are before the point."""
    return f"{value:.0f}" if value >= 99.5 else f"{value:#.2g}".rstrip(".")


def sentence(report: Report) -> str:
    """What accuracy costs, in words; the fastest way first."""
    known = [(c.seconds_for(LEVEL), c) for c in report.of("samples")]
    known = sorted(((t, c) for t, c in known if not math.isnan(t)), key=lambda pair: pair[0])
    if not known:
        return f"No method came near an error of {LEVEL:.0%}."
    times = ", ".join(f"{seconds(t)} by {c.name}" for t, c in known)
    digits = ", ".join(f"{_two(c.digit)} times as much by {c.name}" for _, c in known if math.isfinite(c.digit))
    return f"An error of {LEVEL:.0%} takes {times}." + (f" One more digit costs {digits}." if digits else "")


def cells(row: Row) -> tuple[str, ...]:
    """A row of the table, under `HEADS`."""
    compile = f"{row.compile:.1f} s" if row.compile else ""
    return row.setting, seconds(row.seconds), compile, percent(row.error), percent(row.claimed)


def said_of(curve: Curve) -> str:
    """What the line through a curve says; nothing of curves through which there is none."""
    if curve.sweep == "effects":
        return ""
    said = []
    if curve.sweep == "depth":
        if not math.isnan(curve.ratio):
            said.append(f"each bounce leaves {curve.ratio:.2f} of the error")
    elif not math.isnan(curve.order):
        said.append(f"error ~ {curve.sweep}^{curve.order:.2f}".replace("-", "−"))
    if curve.sweep == "samples" and not math.isnan(curve.slope):
        said.append(f"~ seconds^{curve.slope:.2f}".replace("-", "−"))
        if math.isfinite(curve.digit):
            said.append(f"one more digit costs {_two(curve.digit)} times as much")
    return ", ".join(said)
