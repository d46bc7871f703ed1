"""Textures, as far as they are read: their mean colour."""

from __future__ import annotations

import io

import numpy as np


def mean_colour(data: bytes) -> np.ndarray | None:
    """Mean linear RGB of a PNG or JPEG coded in sRGB; None where it cannot be read."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP")) as image:
            image.thumbnail((1024, 1024))
            x = np.asarray(image.convert("RGB"), np.float64) / 255.0
    except Exception:  # whatever a damaged picture does to a decoder
        return None
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).mean((0, 1))
