"""Pictures: OpenEXR with standard errors and attributes, and PNG for the eye."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..parts import SceneError
from .reading import VALUE, credit, regular, take
from .writing import replacing

AOVS = {"depth": "", "normal": "XYZ", "geo_normal": "XYZ", "albedo": "RGB", "uv": "UV", "position": "XYZ", "face": ""}
"""What `render` may give of each pixel beside its radiance, and the names of its channels in an EXR file."""


def aov_of(asked: str) -> tuple[str, str]:
    """The name and the kind of what is asked for as "kind", or as "name:kind"."""
    name, colon, kind = asked.rpartition(":")
    return (name, kind) if colon else (kind, kind)


_LARGEST = 1 << 15  # pixels to a side, as `Film` has it; a damaged header may claim anything


def _rgb(a: np.ndarray, name: str) -> np.ndarray:
    """(H, W, 3) float32; one channel stands for all three."""
    a = np.asarray(a)
    if a.ndim != 3 or a.shape[2] not in (1, 3) or 0 in a.shape or max(a.shape) > _LARGEST:
        raise SceneError(f"{name} has shape {a.shape}; give (H, W, 1) or (H, W, 3), with sides up to {_LARGEST}")
    with np.errstate(over="ignore"):
        return np.broadcast_to(a, (*a.shape[:2], 3)).astype(np.float32, copy=False)


def write_exr(
    path: str | Path,
    image: np.ndarray,
    stderr: np.ndarray | None = None,
    attributes: Mapping[str, str | float | int] | None = None,
    aovs: Mapping[str, np.ndarray] | None = None,
    spp: np.ndarray | None = None,
) -> None:
    """Write linear radiance (H, W, 1 or 3) as float32 channels R, G, B; its standard error as stderr.R/G/B; of `aovs`,
    named as in `AOVS`, depth, normal.X, ... (a face's number is exact up to 2²⁴); samples of each pixel (H, W) as spp.

    One channel is written three times, so that every viewer shows it. `attributes` go into the header;
    whole numbers beyond 32 bits as text, for EXR has no others. Raises `SceneError` for another shape,
    an attribute that EXR cannot hold, or a path that cannot be written.
    """
    import OpenEXR

    # R, G, B and stderr.R, ... interleaved. OpenEXR writes an array that is not contiguous scrambled, without a word
    channels = {"RGB": np.ascontiguousarray(_rgb(image, "image"))}
    if stderr is not None:
        channels["stderr"] = np.ascontiguousarray(_rgb(stderr, "stderr"))
        if channels["stderr"].shape != channels["RGB"].shape:
            raise SceneError(f"stderr has shape {np.shape(stderr)}, image {np.shape(image)}; give the same")
    for name, values in (aovs or {}).items():
        name, kind = aov_of(name)
        suffixes = [f".{c}" for c in AOVS[kind]] or ["" if name == kind else ".T"]  # as Mitsuba has it
        planes = np.asarray(values, np.float32).reshape(*channels["RGB"].shape[:2], -1)
        planes = np.broadcast_to(planes, (*planes.shape[:2], len(suffixes)))
        channels |= {name + c: np.ascontiguousarray(planes[..., k]) for k, c in enumerate(suffixes)}
    if spp is not None:
        channels["spp"] = np.ascontiguousarray(spp, np.uint32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    own = {*header, "channels", "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio", "version"}
    for key, value in (attributes or {}).items():
        value = value.item() if isinstance(value, np.generic) else value
        if key in own or not key or len(key) > 255 or not key.isascii() or not isinstance(value, str | float | int):
            raise SceneError(
                f"attribute {key!r}: {str(value)[:40]!r} cannot go into an EXR header; rename it or give text"
            )
        header[key] = str(value) if isinstance(value, int) and not -(1 << 31) <= value < 1 << 31 else value
    with replacing(path) as temporary, OpenEXR.File(header, channels) as file:
        file.write(temporary)


def read_exr(path: str | Path) -> tuple[np.ndarray, np.ndarray | None, dict[str, str | float | int]]:
    """(image (H, W, 3) float32, its standard error or None, text and number attributes) of an EXR file.

    Takes R, G, B or Y of the first part. Raises `SceneError` for a file that is missing, damaged, or
    holds no such picture.
    """
    import OpenEXR

    def refuse(problem: str) -> NoReturn:
        raise SceneError(f"{path}: {problem}")

    size = regular(path)
    try:
        with Path(path).open("rb") as start:
            if start.read(4) != b"\x76\x2f\x31\x01":
                refuse("is not an EXR file; check the path")
        with _silence(), OpenEXR.File(str(path), header_only=True) as file:
            cost = sum(_claimed(part, refuse) for part in file.parts)
        credit(path, size)
        take(path, cost, "make its picture smaller", size)  # before OpenEXR reserves what is claimed
        with _silence(), OpenEXR.File(str(path), separate_channels=True) as file:
            pixels = {name: channel.pixels for name, channel in file.channels().items()}
            header = dict(file.header())
    except SceneError:
        raise
    except Exception:  # OpenEXR and its binding raise RuntimeError, ValueError, TypeError and others
        refuse("cannot be read as EXR; it is damaged, make it again")

    def layer(prefix: str) -> np.ndarray | None:
        names = [f"{prefix}{c}" for c in "RGB"]
        names = names if all(n in pixels for n in names) else [f"{prefix}Y"] * 3
        if names[0] not in pixels:
            return None
        planes = [np.asarray(pixels[n]) for n in names]
        if any(a.shape != planes[0].shape or a.ndim != 2 or a.dtype.kind not in "fu" for a in planes):
            refuse("has subsampled or deep channels; convert it to plain ones")
        return np.stack(planes, -1).astype(np.float32)

    image = layer("")
    if image is None:
        refuse(f"has the channels {', '.join(pixels)[:80] or 'none'}, but not R, G, B or Y; convert it")
    return image, layer("stderr."), {k: v for k, v in header.items() if isinstance(v, str | float | int)}


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """What OpenEXR has to say of a damaged file it writes to stdout and stderr by itself; the exception is enough."""
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere), contextlib.ExitStack() as after:
        for stream in (1, 2):
            with contextlib.suppress(OSError):  # it may be closed
                kept = os.dup(stream)
                after.callback(os.close, kept)
                after.callback(os.dup2, kept, stream)
                os.dup2(nowhere.fileno(), stream)
        yield


def _claimed(part: Any, refuse: Callable[[str], NoReturn]) -> int:
    """Bytes of memory that a part of an EXR file leads to, by its header."""
    low, high = (np.asarray(v, np.int64) for v in part.header["dataWindow"])
    width, height = (int(n) + 1 for n in high - low)
    if not (0 < width <= _LARGEST and 0 < height <= _LARGEST):
        refuse(f"claims {width} x {height} pixels; make it again, with sides up to {_LARGEST}")
    return VALUE * width * height * max(len(part.header.get("channels", ())), 1)


def to_srgb(image: np.ndarray, exposure: float = 0.0) -> np.ndarray:
    """uint8 (H, W, 3): 2^exposure times linear radiance, by the sRGB curve (IEC 61966-2-1), for display.

    What is too bright, infinity too, is cut at white; negative values are black; a pixel with a NaN is
    magenta, so that nobody takes it for an answer.
    """
    if not np.isfinite(exposure):
        raise SceneError(f"exposure is {exposure}; give a finite number of stops")
    rgb = _rgb(image, "image")
    out = np.empty(rgb.shape, np.uint8)
    for start in range(0, len(rgb), 256):  # in bands: float64 takes eight times the room
        band = rgb[start : start + 256].astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # 0 · inf at an absurd exposure
            x = np.clip(np.nan_to_num(band * np.exp2(np.float64(exposure)), nan=0.0), 0.0, 1.0)
        x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
        out[start : start + 256] = np.floor(255 * x + 0.5)
        out[start : start + 256][np.isnan(band).any(-1)] = (255, 0, 255)
    return out


def write_png(path: str | Path, image: np.ndarray, exposure: float = 0.0) -> None:
    """Write `to_srgb` of linear radiance (H, W, 1 or 3) as PNG. Raises `SceneError` as `write_exr`."""
    import PIL.Image

    picture = PIL.Image.fromarray(to_srgb(image, exposure))
    with replacing(path) as temporary:
        picture.save(temporary, format="PNG")
