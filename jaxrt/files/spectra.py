"""Spectra as linear sRGB (Rec. 709 primaries), converted exactly as Mitsuba 3 does in its rgb variants.

A spectrum is integrated with the CIE 1931 observer. A reflectance, or an index of refraction, is seen
under D65, so that a constant spectrum stays what it is. A radiance is seen as it is, so that a constant
one (illuminant E) is not white but `EQUAL_ENERGY`.
"""

from __future__ import annotations

import pathlib
import re
from typing import Literal

import numpy as np

from ..parts import SceneError
from . import cie
from .reading import read_bytes

Role = Literal["reflectance", "ior", "radiance"]

XYZ_TO_SRGB = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
"""CIE XYZ to linear sRGB with white point D65 (ITU-R BT.709)."""

EQUAL_ENERGY = XYZ_TO_SRGB.sum(1)
"""Linear sRGB of the constant spectrum 1 as a radiance."""

# Mitsuba's normalisation: Y of the constant spectrum 1, and Y of D65, are 1
_Y_INTEGRAL, _D65_MEAN = 106.75025939941406, 98.99741751876255
_STEPS = 1000  # of Mitsuba's Riemann sum over 360 to 830 nm

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def number(text: str) -> float:
    """A finite decimal number. Raises `ValueError` for anything else (also for nan, inf and 1_000)."""
    if not _NUMBER.fullmatch(text.strip(" \t\r\n")):
        raise ValueError("not a number")
    value = float(text)
    if not np.isfinite(value):
        raise ValueError("not a finite number")
    return value


def check(wavelengths: np.ndarray, values: np.ndarray) -> None:
    """`ValueError`, with what to do, unless these are at least two values at increasing wavelengths (nm)."""
    if len(wavelengths) < 2:
        raise ValueError("a spectrum has at least two wavelengths; give more, or one number for a constant one")
    if not (np.diff(wavelengths) > 0).all():
        raise ValueError("wavelengths do not increase; sort them and drop repeated ones")
    if not (np.isfinite(wavelengths).all() and np.isfinite(values).all()):
        raise ValueError("has a number that is not finite")


def to_rgb(wavelengths: np.ndarray, values: np.ndarray, role: Role) -> tuple[np.ndarray, bool]:
    """Linear sRGB (3,) of a spectrum which is linear between `wavelengths` (nm) and zero outside them.

    role: what the values are, see the module. Also returns whether the colour was outside the gamut and
    clipped: to [0, 1] for a reflectance, to 0 or more else. Raises `ValueError` as `check` does.
    """
    check(wavelengths, values)
    w = np.linspace(cie.WAVELENGTHS[0], cie.WAVELENGTHS[-1], _STEPS)
    spectrum = np.interp(w, wavelengths, values, left=0.0, right=0.0)
    if role != "radiance":
        spectrum *= np.interp(w, cie.WAVELENGTHS, cie.D65) / _D65_MEAN
    observer = np.stack([np.interp(w, cie.WAVELENGTHS, bar) for bar in (cie.X_BAR, cie.Y_BAR, cie.Z_BAR)])
    xyz = observer @ spectrum * (cie.WAVELENGTHS[-1] - cie.WAVELENGTHS[0]) / _STEPS / _Y_INTEGRAL
    rgb = XYZ_TO_SRGB @ xyz
    clipped = np.clip(rgb, 0.0, 1.0 if role == "reflectance" else None)
    return clipped, bool((clipped != rgb).any())


def read_spd(path: pathlib.Path) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths (nm) and values of an .spd file: two numbers a line, with `#` before comments.

    Raises `SceneError` for a file that is missing or has anything else in it.
    """
    try:
        lines = read_bytes(path).decode("utf-8").splitlines()
    except UnicodeDecodeError:
        raise SceneError(f"{path.name}: cannot be read as text; check the file") from None
    pairs = []
    for count, line in enumerate(lines, 1):
        words = line.split("#")[0].split()
        try:
            if words:
                wavelength, value = (number(word) for word in words)
                pairs.append((wavelength, value))
        except ValueError:
            raise SceneError(f"{path.name}:{count}: not two numbers; give a wavelength in nm and a value") from None
    table = np.array(pairs, np.float64).reshape(-1, 2)
    try:
        check(table[:, 0], table[:, 1])
    except ValueError as error:
        raise SceneError(f"{path.name}: {error}") from None
    return table[:, 0], table[:, 1]
