"""What experiments share: the peer, a clock, and what results say of their circumstances."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxrt.workprec.circumstances import circumstances
from jaxrt.workprec.peer import load_mitsuba


def timed(call: Callable[[], float | None]) -> float:
    """Seconds of a call that blocks on its result; or what it returns, if it knows better."""
    start = time.perf_counter()
    known = call()
    return known if known is not None else time.perf_counter() - start


def results_of(folder: Path, seed: int = 0, name: str = "", **numbers: Any) -> Path:
    """The folder for an experiment's results, with a file that says machine, versions, seed, and these numbers."""
    results = folder / "results"
    results.mkdir(exist_ok=True)
    about = json.dumps(numbers | circumstances(seed), indent=1, default=float)
    (results / f"{name or folder.name}.json").write_text(about)
    return results


__all__ = ["load_mitsuba", "results_of", "timed"]
