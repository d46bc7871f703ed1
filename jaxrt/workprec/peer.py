"""Mitsuba 3 beside jaxrt, where it is installed: nothing here is needed to run jaxrt."""

from __future__ import annotations

import glob
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

PATHS = 1 << 21
"""Of one call of Mitsuba, which holds something for each of them."""


def load_mitsuba() -> tuple[Any, str] | None:
    """Mitsuba in its fastest variant that works here, or None where it is not installed."""
    names = glob.glob("/usr/lib/*/libLLVM*.so*") + glob.glob("/usr/lib/llvm-*/lib/libLLVM*.so*")
    found = sorted(names, key=lambda name: [int(n) for n in re.findall(r"\d+", name)])
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", found[-1])
    try:
        import mitsuba as mi  # pyright: ignore[reportMissingImports]
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


class Peer:
    """The same file in Mitsuba, its first sensor in another size."""

    def __init__(self, mi: Any, variant: str, file: Path, defaults: dict[str, Any], width: int, height: int):
        self.mi, self.variant, self.pixels = mi, variant, width * height
        self.scene = mi.load_file(str(file), **defaults)
        self.sensor = self.scene.sensors()[0]
        film = mi.traverse(self.sensor)
        film["film.size"] = film["film.crop_size"] = [width, height]
        film["film.crop_offset"] = [0, 0]
        film.update()

    def picture(self, spp: int, seed: int) -> np.ndarray:
        """(H, W, 3) float64; of many samples in several calls."""
        parts = max(1, spp * self.pixels // PATHS)
        most = -(-spp // parts)
        total, left = 0.0, spp
        for k in range(parts):
            n = min(most, left)
            image = self.mi.render(self.scene, sensor=self.sensor, spp=n, seed=1000 * seed + k)
            total, left = total + n * np.array(image, np.float64)[..., :3], left - n
        return np.asarray(total) / spp


def peer_of(file: Path | None, defaults: dict[str, Any], width: int, height: int) -> Peer | None:
    """The file in Mitsuba, or None: where Mitsuba is not installed, or does not read the file."""
    if file is None or file.suffix.lower() != ".xml" or (found := load_mitsuba()) is None:
        return None
    try:
        return Peer(*found, file, defaults, width, height)
    except Exception as error:  # Mitsuba raises RuntimeError, and Dr.Jit exceptions of its own
        print(f"mitsuba: {str(error).splitlines()[0]}")
        return None
