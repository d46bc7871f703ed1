"""A plan as a table for the terminal, with what its effects cost where that was measured."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from .costs import Cost
from .static import Plan


def show(plan: Plan, costs: Sequence[Cost] | None = None) -> None:
    """The table of a plan on stdout. Costs: time of a small picture, a ray and compiling more with an effect than
    without it, and the radiance that it adds to the mean of the picture, with its standard error."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("effect")
    table.add_column("", min_width=3)
    by_name = {cost.name: cost for cost in costs or ()}
    if costs is not None:
        for head in ("picture", "", "ns a ray", "compile", "radiance"):
            table.add_column(head, justify="right")
    table.add_column("because")
    for name, on, why in plan.reasons:
        cells = [] if costs is None else _cells(by_name.get(name))
        style = "" if on else "dim"
        table.add_row(*(Text(cell, style) for cell in (name, "in " if on else "out", *cells, why)))
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=400)
    console.print(table)
    for assumed in plan.assumes:
        console.print(Text(f"assumes {assumed}"), soft_wrap=True)


def _cells(cost: Cost | None) -> list[str]:
    if cost is None:
        return [""] * 5
    (without, with_it), (before, after) = cost.seconds, cost.compiling
    radiance, error = cost.radiance
    return [
        f"{1e3 * (with_it - without):+.1f} ± {1e3 * cost.noise:.1f} ms",
        f"{cost.share:+.0%}",
        f"{cost.ns_a_ray:+.1f}",
        f"{after - before:+.1f} s",
        f"{radiance:+.3g} ± {error:.1g}" if abs(radiance) > 1e-6 * abs(cost.mean) else "0",
    ]
