"""A report for the terminal and as CSV."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from .report import Report
from .words import HEADS, cells, said_of, sentence


def show(report: Report) -> None:
    """The report on stdout."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in HEADS:
        table.add_column(head, justify="left" if head == HEADS[0] else "right")
    for curve in report.curves:
        table.add_row(Text(curve.name, "bold"))
        for row in curve.rows:
            table.add_row(*(Text(cell) for cell in ("  " + row.setting, *cells(row)[1:])))
        if said := said_of(curve):
            table.add_row(Text(f"  {said}", "italic"))
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=160)
    console.print(table)
    console.print(f"reference: {report.reference.by}, known to {report.reference.error:.2%}", soft_wrap=True)
    if report.left_out:
        console.print(f"left out for want of time: {', '.join(report.left_out)}; give more --seconds", soft_wrap=True)
    console.print(sentence(report), soft_wrap=True)


def csv_of(reports: Sequence[Report]) -> str:
    """All rows of all scenes, with order and slope of their curve."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["scene", "sweep", "curve", "setting", "quantity", "seconds", "compile_seconds", "error", "claimed",
                   "reference_error", "order", "slope_in_seconds"])  # fmt: skip
    for report in reports:
        for curve in report.curves:
            lines = ["", ""] if curve.sweep in ("depth", "effects") else [curve.order, curve.slope]
            for row in curve.rows:
                rows.writerow([report.name, curve.sweep, curve.name, row.setting, row.quantity, row.seconds,
                               row.compile, row.error, row.claimed, curve.floor, *lines])  # fmt: skip
    return out.getvalue()
