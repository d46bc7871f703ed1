"""Pictures that surfaces carry: read as linear values."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np

from ..parts import SceneError
from .image import read_exr
from .reading import VALUE, RefusedError, read_bytes, take

EIGHT_BITS = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".webp", ".gif", ".ppm", ".pgm")


def linear(x: np.ndarray) -> np.ndarray:
    """sRGB's curve undone (IEC 61966-2-1)."""
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


SMALLER = "make its picture smaller"

_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "WEBP", "GIF", "PPM")  # of Pillow's others some run programs


def decoded(data: bytes, path: str | Path, raw: bool = False) -> np.ndarray:
    """A PNG, JPEG, ... as (H, W, 1, 3 or 4) float32, its colours linear unless they are `raw`.

    Raises `SceneError` for what is no such picture; it names `path`.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures, which `take` refuses
            image = Image.open(io.BytesIO(data), formats=_FORMATS)
        with image:
            deep = image.mode in ("I;16", "I;16B", "I")
            grey, alpha = (
                image.mode in ("1", "L", "LA"),
                "transparency" in image.info or image.mode in ("LA", "PA", "RGBA"),
            )
            mode = "" if deep else "RGBA" if alpha else "L" if grey else "RGB"
            take(path, VALUE * image.width * image.height * (len(mode) or 1), SMALLER, len(data))
            steps = np.clip(np.asarray(image), 0, 65535) if deep else np.asarray(image.convert(mode))
    except RefusedError:
        raise
    except Image.DecompressionBombError:
        take(path, 1 << 60, SMALLER, len(data))
        raise
    except Exception:  # whatever a damaged picture does to a decoder, whose words may quote it
        what = "is damaged, or no picture of a kind that can be read"
        raise SceneError(f"{path}: {what}; give PNG, JPEG, BMP, EXR, HDR or PFM") from None
    steps = steps[..., None] if steps.ndim == 2 else steps
    values = np.linspace(0.0, 1.0, 65536 if deep else 256)
    plain, curved = (table.astype(np.float32) for table in (values, linear(values)))
    x = (plain if raw else curved)[steps]
    if not raw and mode == "RGBA":
        x[..., 3] = plain[steps[..., 3]]
    return x


def read_picture(path: str | Path, raw: bool = False) -> np.ndarray:
    """(H, W, 1 or 3) float32, linear unless `raw`; EXR, HDR and PFM are linear as they are. Raises `SceneError`."""
    suffix = Path(path).suffix.lower()
    if suffix == ".exr":
        image = read_exr(path)[0]
        return image[..., :1] if (image == image[..., :1]).all() else image
    data = read_bytes(path)
    if suffix in (".hdr", ".rgbe"):
        return _radiance_hdr(path, data)
    if suffix == ".pfm":
        return _portable_floats(path, data)
    return decoded(data, path, raw)[..., :3]


def _portable_floats(path: str | Path, data: bytes) -> np.ndarray:
    """PFM: a head of three lines, then floats with the rows from below; a negative scale says little-endian."""
    head = re.match(rb"P([Ff])\s+(\d{1,5})\s+(\d{1,5})\s+(-?)[\d.eE+-]+\s", data)
    if head is None:
        raise SceneError(f"{path}: is no PFM picture; make it again")
    width, height, channels = int(head[2]), int(head[3]), 3 if head[1] == b"F" else 1
    body = data[head.end() :]
    if width * height == 0 or len(body) != 4 * width * height * channels:
        raise SceneError(f"{path}: claims {width} x {height} pixels, which it does not hold; it is damaged")
    floats = np.frombuffer(body, "<f4" if head[4] else ">f4").reshape(height, width, channels)
    return np.ascontiguousarray(floats[::-1], np.float32)


def _radiance_hdr(path: str | Path, data: bytes) -> np.ndarray:
    """Radiance's RGBE format (Ward 1991), with or without run lengths; a number is the lower end of its interval, as
    most readers have it, and not the middle."""

    def refuse(why: str) -> SceneError:
        return SceneError(f"{path}: {why}; make it again")

    head, _, rest = data.partition(b"\n\n")
    size, _, body = rest.partition(b"\n")
    words = size.split()
    if not head.startswith((b"#?RADIANCE", b"#?RGBE")) or len(words) != 4 or words[0] != b"-Y" or words[2] != b"+X":
        raise refuse("is not a Radiance picture with rows from the top")
    try:
        height, width = int(words[1]), int(words[3])
    except ValueError:
        raise refuse("has a size that is no number") from None
    if not (0 < height <= 1 << 15 and 0 < width <= 1 << 15) or height * 4 > len(body):
        raise refuse(f"claims {width} x {height} pixels, which it cannot hold; it is damaged")
    take(path, VALUE * 3 * height * width, SMALLER, len(data))
    rgbe, at = np.empty((height, width, 4), np.uint8), 0
    for y in range(height):
        row = body[at : at + 4]
        if len(row) == 4 and row[:2] == b"\2\2" and row[2] * 256 + row[3] == width and 8 <= width < 1 << 15:
            at += 4
            for c in range(4):
                x = 0
                while x < width:
                    if at >= len(body):
                        raise refuse("ends too early; it is damaged")
                    n = body[at]
                    if n > 128:
                        n, run = n - 128, True
                    else:
                        run = False
                    if x + n > width or at + 1 + (1 if run else n) > len(body) or n == 0:
                        raise refuse("has a damaged row")
                    part = body[at + 1 : at + 2] * n if run else body[at + 1 : at + 1 + n]
                    rgbe[y, x : x + n, c] = np.frombuffer(part, np.uint8)
                    at, x = at + 1 + (1 if run else n), x + n
        else:
            if at + 4 * width > len(body):
                raise refuse("ends too early; it is damaged")
            rgbe[y] = np.frombuffer(body, np.uint8, 4 * width, at).reshape(width, 4)
            at += 4 * width
    scale = np.ldexp(1.0, rgbe[..., 3:].astype(int) - 136)
    return (np.where(rgbe[..., 3:] > 0, rgbe[..., :3], 0.0) * scale).astype(np.float32)
