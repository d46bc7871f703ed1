"""Work-precision diagrams by matplotlib, which the extra `figures` installs."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from ..parts import SceneError
from .curve import Curve
from .report import Report
from .words import LEVEL

COLOURS = {
    "path, Sobol": "#2f7ed8",
    "path, independent": "#8bb6e8",
    "path, float64": "#6a5acd",
    "field, Sobol": "#e07b00",
    "Mitsuba 3": "#3a9d5d",
    "field, elements": "#e07b00",
    "field, directions": "#b0503c",
    "field, tolerance": "#c9a227",
}
OTHER = "#888888"
INK = "#222222"
"""Of text and axes."""


def pyplot() -> Any:
    """matplotlib without a window. Raises `SceneError` where it is not installed."""
    try:
        import matplotlib
    except ImportError:
        raise SceneError("matplotlib: is not installed; pip install 'jaxrt[figures]'") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def colour(name: str) -> str:
    return next((c for start, c in COLOURS.items() if name.startswith(start)), OTHER)


def _plot(ax: Any, curve: Curve, x: str) -> None:
    at, tint = [getattr(row, x) for row in curve.rows], colour(curve.name)
    ax.plot(at, [row.error for row in curve.rows], "o-", color=tint, lw=1.6, ms=4, label=curve.name)
    ax.plot(at, [row.claimed for row in curve.rows], ":", color=tint, lw=1)


def _ticks(axis: Any, words: Any) -> None:
    """1, 2 and 5 of each decade, or 1 alone of many."""
    from matplotlib import ticker

    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)))
    axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: words(value)))
    axis.set_minor_formatter(ticker.NullFormatter())


def _samples(ax: Any, report: Report) -> None:
    ax.set(xscale="log", yscale="log", xlabel="seconds", ylabel="error (√relMSE)", title=report.name)
    for curve in report.of("samples"):
        _plot(ax, curve, "seconds")
    for curve in report.of("effects"):
        for row in curve.rows:
            ax.plot(row.seconds, row.error, "x" if row.quantity else "D", color=OTHER, ms=5)
        if curve.rows:
            ax.plot([], [], "x", color=OTHER, label="an effect left out")
    ax.axhline(LEVEL, color=OTHER, lw=0.6, ls="--")
    ax.axhline(max(report.reference.error, 1e-12), color=OTHER, lw=0.6)
    ax.annotate(
        "the reference's own error", (1, report.reference.error), xycoords=("axes fraction", "data"), fontsize=7,
        ha="right", va="bottom", color=OTHER,
    )  # fmt: skip
    ax.legend(fontsize=7, frameon=False, loc="lower left")


def _depth(ax: Any, report: Report) -> None:
    ax.set(yscale="log", xlabel="max_depth", ylabel="error", title="depth")
    for curve in report.of("depth"):
        _plot(ax, curve, "quantity")


def _fields(ax: Any, report: Report) -> None:
    ax.set(xscale="log", yscale="log", xlabel="seconds of solving", ylabel="error on surfaces (L2)", title="field")
    for sweep in ("elements", "directions", "tolerance"):
        for curve in report.of(sweep):
            _plot(ax, curve, "seconds")
    if ax.lines:
        ax.legend(fontsize=7, frameon=False)


def figure(reports: Sequence[Report], kind: str, columns: int | None = None, ground: bool = True) -> bytes:
    """Error against seconds, a line of panels for each scene, as png or svg.

    Dotted: the error that answers themselves claim. `columns`: how many scenes beside each other, each
    with its first panel alone; by default one with all its panels. `ground`: whether it is white, or there is none.
    """
    plt = pyplot()
    style = dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK)
    with plt.rc_context({**style, "svg.fonttype": "none", "axes.spines.top": False, "axes.spines.right": False}):
        if columns is None:
            shape, panels = (len(reports), 3), (_samples, _depth, _fields)
        else:
            shape, panels = (-(-len(reports) // columns), columns), (_samples,)
        fig, axes = plt.subplots(
            *shape, figsize=(4.2 * shape[1], 3.4 * shape[0]), squeeze=False, layout="constrained",
            width_ratios=(1.5, 1, 1.2) if columns is None else None,
        )  # fmt: skip
        grid = axes.ravel()
        for k, report in enumerate(reports):
            for j, panel in enumerate(panels):
                panel(grid[k * len(panels) + j], report)
        for ax in grid:
            ax.grid(alpha=0.15)
            ax.patch.set_alpha(0.0)
            if not ax.lines:
                ax.set_axis_off()
                ax.set_title("")
                continue
            _ticks(ax.yaxis, lambda value: f"{100 * value:g} %")
            if ax.get_xscale() == "log":
                _ticks(ax.xaxis, lambda value: f"{value:g} s" if value >= 1 else f"{1e3 * value:g} ms")
        out = io.BytesIO()
        fig.savefig(
            out, format=kind, dpi=150, transparent=not ground, metadata={"Date": None} if kind == "svg" else None
        )
        plt.close(fig)
    return out.getvalue()
