"""Mitsuba's format of grids of values, .vol: version 3, little-endian, float32."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from .mesh import fail
from .reading import read_bytes

_HEADER = struct.Struct("<3sB5i6f")  # "VOL", version, type of values, their number along x, y, z, channels, box


def read_vol(path: str | Path) -> np.ndarray:
    """The values of a grid, (Z, Y, X, channels); the box that the file names is not kept.

    Format: Mitsuba's documentation of the plugin `gridvolume`. Raises `SceneError` for a file that is missing,
    malformed or truncated, or not of float32.
    """
    data = read_bytes(path)
    if len(data) < _HEADER.size or data[:3] != b"VOL":
        fail(path, "is not a grid of values (.vol), or is damaged; check the path or export it again")
    _, version, kind, x, y, z, channels = _HEADER.unpack_from(data)[:7]
    if version != 3 or kind != 1:
        fail(path, f"is of version {version} and type {kind}; export it as version 3 in float32 (type 1)")
    if min(x, y, z, channels) < 1 or len(data) - _HEADER.size != 4 * x * y * z * channels:
        fail(path, f"holds other than {x} x {y} x {z} values of {channels} channels; export it again")
    return np.frombuffer(data, "<f4", offset=_HEADER.size).reshape(z, y, x, channels)
