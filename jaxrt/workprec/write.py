"""Reports as files: CSV, PNG, SVG, HTML, and JSON of machine, versions and seed."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path

from ..files.writing import write_bytes
from .figure import figure
from .page import page
from .report import Report
from .table import csv_of

NAME = "work_precision"


def write(reports: Sequence[Report], folder: str | Path, columns: int | None = None) -> list[Path]:
    """Writes work_precision.csv, .json, .png, .svg and .html to a folder, which is made; gives their paths.

    `columns`: of the figure, as `figure` takes it. Raises `SceneError` where matplotlib is missing.
    """
    folder = Path(folder)
    told = {report.name: report.circumstances | {"reference": report.reference.by} for report in reports}
    made = {
        "csv": csv_of(reports).encode(),
        "json": json.dumps(told, indent=1).encode(),
        "png": figure(reports, "png", columns=columns),
        "svg": figure(reports, "svg", columns=columns),
        "html": page(reports).encode(),
    }  # fmt: skip
    with contextlib.suppress(OSError):  # said below, in one line
        folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{NAME}.{suffix}" for suffix in made]
    for file, content in zip(files, made.values(), strict=True):
        write_bytes(file, content)
    return files
