"""Photometric files, IES LM-63 of 1986, 1991, 1995, 2002 and 2019, with photometry of type C.

PyPI has a reader (photompy), which brings matplotlib; what a lamp needs of such a file is a row of numbers.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ..parts import PhotometricWeb, SceneError, spectrum
from .mesh import fail
from .reading import read_bytes

TYPES = {1: "C", 2: "B", 3: "A"}


def load_ies(path: str | Path, scale: Any = 1.0) -> PhotometricWeb:
    """The photometric web of an IES LM-63 file, the `intensity` of a `Goniometric` lamp.

    Candela are taken as W/sr. They are multiplied by the file's factors (LM-63-02, section 5) and by `scale`, a number
    or a colour (C,), for the file has none. Where planes end between 180° and 360°, the first stands at 360°, too.
    Raises `SceneError` for a file that is missing or damaged, has photometry of type A or B, or a TILT.
    """
    return read_ies(read_bytes(path), path, scale)


def read_ies(content: bytes, path: str | Path, scale: Any = 1.0) -> PhotometricWeb:
    """`load_ies` of a file's content; `path`: the file that errors name."""
    text = "\n".join(content.decode("latin-1").replace("\x1a", " ").splitlines())
    start = re.search(r"^[ \t]*TILT[ \t]*=(.*)$", text, re.MULTILINE)
    if start is None:
        fail(path, "is no IES LM-63 file, for it has no line TILT=; check the path")
    if start[1].strip() != "NONE":
        fail(path, "has a TILT, which is not supported; give a file with TILT=NONE")
    try:
        numbers = np.array(text[start.end() :].replace(",", " ").split(), np.float64)
    except ValueError:
        fail(path, "has something else than numbers after its line TILT=; it is damaged, get it again")
    if len(numbers) < 13 or not np.isfinite(numbers).all():
        fail(path, "is truncated, or has numbers that are not finite; get it again")
    v, h, kind = numbers[3:6]
    if kind != 1:
        fail(
            path, f"has photometry of type {TYPES.get(kind, f'{kind:g}')}; only type C is supported, convert it to that"
        )
    if min(v, h) < 1 or v % 1 or h % 1 or len(numbers) != 13 + v + h + v * h:
        fail(path, f"has {len(numbers)} numbers, not those for {v:g} by {h:g} angles; it is damaged, get it again")
    year = re.match(r"\s*IES(?:NA)?:LM-63-(\d{4})", text)
    later = year is not None and int(year[1]) > 1995  # where the second of the ballast factors is something else
    factors = np.array([numbers[2], numbers[10], 1.0 if later else numbers[11]])
    vertical, horizontal, candela = np.split(numbers[13:], [int(v), int(v + h)])
    candela = candela.reshape(int(h), int(v))
    if horizontal[0] == 0 and 180 < horizontal[-1] < 360:
        horizontal, candela = np.append(horizontal, 360.0), np.concatenate([candela, candela[:1]])
    try:
        with np.errstate(all="ignore"):  # what overflows is refused there
            data = candela[..., None] * factors.prod() * spectrum(scale, "scale")
        return PhotometricWeb(data, vertical, horizontal)
    except SceneError as problem:
        fail(path, str(problem))
