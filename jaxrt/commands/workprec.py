"""`jaxrt workprec`: what accuracy costs in time, for a scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .options import MistakeError, duration, whole
from .shared import load, progress_bar, writable

QUICK, FULL = (40.0, 32, 256), (120.0, 64, 4096)
"""Seconds, pixels to a side, and samples a pixel at most."""


def add(commands: Any, scene: argparse.ArgumentParser) -> None:
    parser = commands.add_parser(
        "workprec", parents=[scene], help="error against seconds, by methods and settings, with Mitsuba 3 beside them"
    )
    add = parser.add_argument
    add("-o", "--output", metavar="FOLDER", help="where CSV, PNG, SVG and HTML go; default: the scene's name-workprec")
    add("--seconds", metavar="S", type=duration, help="for all of it, about; default: 120, or 40 with --quick")
    add("--quick", action="store_true", help="smaller pictures and fewer samples")
    add("--seed", metavar="S", type=whole(0, 1 << 31), default=0, help="the same seed gives the same errors")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    folder, (seconds, side, most) = _folder(args.scene, args.output), QUICK if args.quick else FULL
    scene = load(args)
    from ..workprec import work_precision
    from ..workprec.figure import pyplot
    from ..workprec.table import show
    from ..workprec.write import write

    pyplot()  # what is missing is said before the work
    with progress_bar() as progress:
        report = work_precision(
            scene,
            Path(args.scene).stem,
            file=None if args.sandbox else args.scene,  # for Mitsuba, which knows no sandbox
            defaults=dict(args.defaults),
            seconds=args.seconds or seconds,
            side=side,
            most=most,
            seed=args.seed,
            progress=progress and (lambda name, share: progress(share)),
        )
    show(report)
    print(", ".join(str(file) for file in write([report], folder)))


def _folder(scene: str, output: str | None) -> Path:
    folder = Path(output) if output is not None else Path(f"{Path(scene).stem}-workprec")
    if folder.exists() and not folder.is_dir():
        raise MistakeError(f"{folder}: is not a folder; give another name")
    near = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    writable(near, "give another folder by -o")
    return folder
