"""Photometric webs: intensity over all directions from a lamp, as goniometers measure it."""

from __future__ import annotations

import dataclasses
from typing import Any, NoReturn

import numpy as np

from .checks import LARGEST, SceneError, check
from .textures import Texture

SYMMETRIES = ((0, 0), (0, 90), (0, 180), (0, 360), (90, 270))
"""First and last horizontal angle: all planes alike, quadrants, halves, none; halves about the other axis."""


@dataclasses.dataclass(eq=False)
class PhotometricWeb(Texture):
    """Intensity (W·sr⁻¹) of a lamp by direction, as photometry of type C has it (ANSI/IESNA LM-63-02, section 3).

    `data` (H, V) or (H, V, C): a row for each of the `horizontal` angles (H,), a column for each of the `vertical` ones
    (V,), in degrees, ascending. Vertical angles count from where the lamp mainly shines, horizontal ones around that,
    counter-clockwise seen from behind the lamp. Between them intensity is bilinear in both angles, and 0 before the
    first and after the last vertical one. Horizontal angles go from 0 to 0 (for all planes), 90 (each quadrant is the
    mirror of the next), 180 (so is each half) or 360, or from 90 to 270. Has no use for `to_uv`. Raises `SceneError`.
    """

    kind = "web"
    data: Any
    vertical: Any
    horizontal: Any = (0.0,)

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "web"
        angles = [np.atleast_1d(np.asarray(a, np.float64)) for a in (self.horizontal, self.vertical)]
        for a, key in zip(angles, ("horizontal", "vertical"), strict=True):
            rising = a.ndim == 1 and a.size > 0 and bool(np.isfinite(a).all() and (np.diff(a) > 0).all())
            check(rising, f"{name}.{key}", "are no angles that ascend; give degrees in ascending order")
        self.horizontal, self.vertical = angles
        ends = self.horizontal[0], self.horizontal[-1]
        known = ", ".join(f"{a}..{b}" for a, b in SYMMETRIES)
        check(ends in SYMMETRIES, f"{name}.horizontal", f"go from {ends[0]:g} to {ends[1]:g}; give one of {known}")
        ends, many = (self.vertical[0], self.vertical[-1]), len(self.vertical) > 1
        good = many and 0 <= ends[0] and ends[1] <= 180
        check(good, f"{name}.vertical", f"go from {ends[0]:g} to {ends[1]:g}; give two or more between 0 and 180")
        a = np.asarray(self.data, np.float64)
        self.data = a = a[..., None] if a.ndim == 2 else a
        want = len(self.horizontal), len(self.vertical)
        check(a.ndim == 3 and a.shape[:2] == want and a.size > 0, f"{name}.data", f"has shape {a.shape}; give {want}")
        good = bool(np.isfinite(a).all() and (a >= 0).all() and (a <= LARGEST).all())
        check(good, f"{name}.data", f"has a value that is not between 0 and {LARGEST:g}; give intensities")

    def values(self) -> np.ndarray:
        """The angles (radians), vertical ones first, then the intensities."""
        rows, c = self.data.reshape(-1, self.data.shape[-1]), self.data.shape[-1]
        angles = np.radians(np.concatenate([self.vertical, self.horizontal]))
        return np.concatenate([np.broadcast_to(angles[:, None], (len(angles), c)), rows])

    def average(self, values: np.ndarray) -> np.ndarray:
        """Over all directions: flux/4π."""
        theta, phi = np.radians(self.vertical), np.radians(self.horizontal)
        a, b = theta[:-1], theta[1:]
        slope = (np.sin(b) - np.sin(a)) / (b - a)
        down = np.append(np.cos(a) - slope, 0.0) + np.insert(slope - np.cos(b), 0, 0.0)  # ∫ hat functions · sinθ dθ
        around = np.ones(1)
        if len(phi) > 1:
            around = np.append(np.diff(phi), 0.0) + np.insert(np.diff(phi), 0, 0.0)
        weights = np.outer(around / around.sum(), 0.5 * down).ravel()
        return weights @ values[len(theta) + len(phi) :]

    def checked(self, element: str, least: float, most: float) -> NoReturn:
        raise SceneError(f"{element}: takes no PhotometricWeb; give that as intensity of a Goniometric lamp")
