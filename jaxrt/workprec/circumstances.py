"""What results say of their circumstances."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from ..compiler import cores


def circumstances(seed: int) -> dict[str, Any]:
    """Machine, versions and seed, as results record them."""
    import jax
    import numpy as np

    from .. import __version__

    cpu = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].partition(": ")[2] if names else cpu
    return {
        "cpu": cpu, "cores": cores(), "load": os.getloadavg(), "python": platform.python_version(),
        "jax": jax.__version__, "numpy": np.__version__, "jaxrt": __version__, "seed": seed,
    }  # fmt: skip
