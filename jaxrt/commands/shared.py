"""What commands have in common: files that must be there, scenes, the progress bar."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import cache
from .options import MistakeError

if TYPE_CHECKING:
    from ..solver.tolerance import Forecast


def existing(path: str) -> None:
    if not os.path.isfile(path):
        raise MistakeError(f"{path}: no such file; check the path")


def writable(folder: Path, remedy: str) -> None:
    """Found out by writing: what the system says beforehand is not always so."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise MistakeError(f"{folder}: cannot be written ({error.strerror}); {remedy}") from None


def load(args: argparse.Namespace) -> Any:
    existing(args.scene)
    if not args.no_cache:
        cache.use()
    from ..loading import load

    defaults = dict(args.defaults)
    if "sandbox" in defaults:
        raise MistakeError("-D: sandbox cannot be a name of a scene's; rename it there")
    return load(args.scene, sandbox=args.sandbox, **defaults)


@contextlib.contextmanager
def progress_bar() -> Iterator[Callable[[float], None] | None]:
    """A callback that draws a progress bar with the time left on stderr; None where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=None)
        yield lambda share: bar.update(task, description="rendering", total=1.0, completed=share)


def tell_costs(costs: list[Forecast]) -> None:
    """What errors will cost, above the progress bar."""
    if not sys.stderr.isatty():
        return
    said = "; ".join(f"{one.error:.2%} in {span(one.seconds)}" for one in costs)
    print(f"jaxrt: foretold {said}", file=sys.stderr)


def span(seconds: float) -> str:
    """A time in words."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.2g} s"
