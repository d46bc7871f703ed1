"""What every part is checked with."""

from __future__ import annotations

from typing import Any

import numpy as np


class SceneError(ValueError):
    """A mistake in a scene: one line that names the file (if any), the element and the remedy."""

    def __init__(self, message: object = ""):
        super().__init__(printable(str(message)))


def printable(text: str) -> str:
    """One line that a terminal takes for text only, whatever characters the names in it have."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


LARGEST = 1e30
"""Numbers in a scene end here: float32 reaches to 3e38, and products of them have to fit."""


def check(ok: bool, element: str, problem: str) -> None:
    if not ok:
        raise SceneError(f"{element}: {problem}" if element else problem)


def varying(value: Any, element: str, *, most: float = np.inf, least: float = 0.0) -> Any:
    """A spectrum, or a texture of such."""
    return (
        value.checked(element, least, most)
        if hasattr(value, "checked")
        else spectrum(value, element, most=most, least=least)
    )


def spectrum(value: Any, element: str, *, most: float = np.inf, least: float = 0.0) -> np.ndarray:
    """A finite spectrum, shape (1,) or (C,), float64, with every value in [least, most]."""
    check(not hasattr(value, "checked"), element, "takes no texture; give a colour or a number")
    try:
        a = np.atleast_1d(np.asarray(value, np.float64))
    except (TypeError, ValueError):
        raise SceneError(f"{element}: {str(value)[:80]!r} is no number") from None
    check(a.ndim == 1, element, f"a spectrum is one number or a list of numbers, not shape {a.shape}")
    check(bool(np.isfinite(a).all()), element, "has a value that is not finite; give finite numbers")
    check(bool((np.abs(a) <= LARGEST).all()), element, f"has a value beyond {LARGEST:g}; give smaller numbers")
    check(bool((a >= least).all()), element, f"is {a.min():g}; give a value of at least {least:g}")
    check(bool((a <= most).all()), element, f"is {a.max():g}; give a value of at most {most:g}")
    return a


def scalar(value: Any, element: str, *, least: float = -np.inf, most: float = np.inf) -> float:
    a = spectrum(value, element, least=least, most=most)
    check(a.size == 1, element, "is one number")
    return float(a[0])


def matrix(value: Any, element: str) -> np.ndarray:
    m = np.asarray(value, np.float64)
    check(m.shape == (4, 4), element, f"is a 4x4 matrix, not shape {m.shape}")
    check(bool((np.abs(m) <= LARGEST).all()), element, f"has an entry that is not finite, or beyond {LARGEST:g}")
    check(
        bool(np.allclose(m[3], [0, 0, 0, 1])) or not m.any(),
        element,
        "has a perspective part; give an affine transform",
    )
    check(abs(float(np.linalg.det(m[:3, :3]))) > 0, element, "is singular; give an invertible transform")
    return m


def unit(value: Any, element: str) -> np.ndarray:
    v = np.asarray(value, np.float64)
    good = v.shape == (3,) and bool(np.isfinite(v).all()) and bool(v.any())
    check(good, element, "is no direction; give three finite numbers, not all 0")
    return v / np.linalg.norm(v)
