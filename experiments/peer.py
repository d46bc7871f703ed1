"""What experiments share: the peer, a clock, and what results say of their circumstances."""

from __future__ import annotations

import time
from collections.abc import Callable

from jaxrt.workprec.circumstances import circumstances
from jaxrt.workprec.peer import load_mitsuba


def timed(call: Callable[[], float | None]) -> float:
    """Seconds of a call that blocks on its result; or what it returns, if it knows better."""
    start = time.perf_counter()
    known = call()
    return known if known is not None else time.perf_counter() - start


__all__ = ["circumstances", "load_mitsuba", "timed"]
