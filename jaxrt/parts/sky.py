"""A clear sky as the radiance of an enclosure."""

from __future__ import annotations

import dataclasses
from typing import Any, NoReturn

import numpy as np

from .checks import SceneError, check, unit
from .textures import Texture


@dataclasses.dataclass(eq=False)
class Sky(Texture):
    """The model of Hosek and Wilkie: `coefficients` (C, 10), as `jaxrt.files.sky` finds them; see `jaxrt.sky`.

    `sun`: the unit vector towards it in the enclosure's own space, where +y is up.
    """

    kind = "sky"
    coefficients: Any
    sun: Any

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "sky"
        self.sun = unit(self.sun, f"{name}.sun")
        self.coefficients = np.asarray(self.coefficients, np.float64)
        good = self.coefficients.ndim == 2 and self.coefficients.shape[1] == 10 and len(self.coefficients) > 0
        check(good, f"{name}.coefficients", f"have shape {self.coefficients.shape}; give ten a channel")
        check(bool(np.isfinite(self.coefficients).all()), f"{name}.coefficients", "have one that is not finite")

    def values(self) -> np.ndarray:
        """Coefficients, and the direction of the sun, (13, C)."""
        channels = len(self.coefficients)
        return np.concatenate([self.coefficients.T, np.broadcast_to(self.sun[:, None], (3, channels))])

    def average(self, values: np.ndarray) -> np.ndarray:
        """Over all directions, to a percent."""
        from ..sky import radiance

        cos_theta, phi = (np.arange(64)[:, None] + 0.5) / 64, 2 * np.pi * (np.arange(64) + 0.5) / 64
        s, sun = np.sqrt(1 - cos_theta**2), values[10:, 0]
        cos_gamma = s * (np.cos(phi) * sun[0] + np.sin(phi) * sun[2]) + cos_theta * sun[1]
        gamma = np.arccos(np.clip(cos_gamma, -1, 1))
        return np.stack([radiance(c, cos_theta, gamma, np).mean() / 2 for c in values[:10].T])

    def checked(self, element: str, least: float, most: float) -> NoReturn:
        raise SceneError(f"{element}: takes no Sky; give that as radiance of an Enclosure")
