"""What experiments share: the peer, a clock, and what results say of their circumstances."""

from __future__ import annotations

import glob
import os
import platform
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def load_mitsuba() -> tuple[Any, str] | None:
    """Mitsuba in its fastest variant that works here, or None where it is not installed."""
    names = glob.glob("/usr/lib/*/libLLVM*.so*") + glob.glob("/usr/lib/llvm-*/lib/libLLVM*.so*")
    found = sorted(names, key=lambda name: [int(n) for n in re.findall(r"\d+", name)])
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", found[-1])
    try:
        import mitsuba as mi
    except ImportError:
        return None
    for variant in ("llvm_ad_rgb", "scalar_rgb"):
        try:
            mi.set_variant(variant)
            mi.load_dict({"type": "sphere"})
            return mi, variant
        except Exception as error:  # no LLVM: Dr.Jit has no exception of its own for it
            print(f"{variant}: {str(error).splitlines()[0]}")
    return None


def circumstances(seed: int) -> dict[str, Any]:
    """Machine, versions and seed, as results record them."""
    import jax
    import numpy as np

    import jaxrt

    cpu = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].partition(": ")[2] if names else cpu
    return {
        "cpu": cpu, "cores": len(os.sched_getaffinity(0)), "load": os.getloadavg(), "python": platform.python_version(),
        "jax": jax.__version__, "numpy": np.__version__, "jaxrt": jaxrt.__version__, "seed": seed,
    }  # fmt: skip


def timed(call: Callable[[], float | None]) -> float:
    """Seconds of a call that blocks on its result; or what it returns, if it knows better."""
    start = time.perf_counter()
    known = call()
    return known if known is not None else time.perf_counter() - start
