"""Radiance of a clear sky (Hosek and Wilkie 2012, "An analytic model for full spectral sky-dome radiance") and of the
sun in it (2013, "Adding a solar-radiance function to the Hošek-Wilkie skylight model"), RGB, evaluated on the host.

The numbers in `sky.npz` are fitted to radiances, by `scenes/fit_sky.py`. The model is © 2012–2013 Lukas Hosek and
Alexander Wilkie, who published it under the 3-clause BSD licence.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

APERTURE = 0.5358
"""The sun's diameter, degrees, for which its radiance is stored."""

FIRST, STEP = 2.0, 3.0
"""Elevations (degrees) of the sun for which its radiance is stored: linear between them, and constant beyond."""


@functools.cache
def tables() -> dict[str, np.ndarray]:
    """`sky`: control points of nine coefficients and a scale, (turbidity 1 to 10, albedo 0 and 1, channel, 10, 6).
    `sun`: radiance in W·m⁻²·sr⁻¹·nm⁻¹, (turbidity, elevation, channel)."""
    with np.load(Path(__file__).with_name("sky.npz")) as stored:
        return {name: stored[name].astype(np.float64) for name in stored}


def at_turbidity(table: np.ndarray, turbidity: float) -> np.ndarray:
    """A table whose first axis is turbidity, between whole ones."""
    low = min(int(turbidity), len(table) - 1) - 1
    return table[low] + (table[low + 1] - table[low]) * (turbidity - 1 - low)


def bezier(elevation: Any) -> np.ndarray:
    """Shares of the six control points at elevations (radians) of the sun, (..., 6)."""
    x = np.cbrt(np.asarray(elevation, float) / (np.pi / 2))[..., None]
    k = np.arange(6)
    return np.array([1.0, 5, 10, 10, 5, 1]) * x**k * (1 - x) ** (5 - k)


def coefficients(turbidity: float, albedo: np.ndarray, elevation: float) -> np.ndarray:
    """A, B, ..., I of the model and the scale, of each channel, (C, 10). `albedo`: of the ground, (C,)."""
    black, white = at_turbidity(tables()["sky"], turbidity)
    return (black + (white - black) * np.asarray(albedo)[:, None, None]) @ bezier(elevation)


def radiance(c: Any, cos_theta: Any, gamma: Any, cos_gamma: Any) -> Any:
    """Radiance (W·m⁻²·sr⁻¹·nm⁻¹) of one channel by its coefficients c: θ from the zenith, γ from the sun. Equation 8 of
    2012, with coefficients in the order of the authors' data: H multiplies √cosθ, and I is χ's."""
    horizon = 1 + c[0] * np.exp(c[1] / (cos_theta + 0.01))
    chi = 1 + c[8] * (c[8] - 2 * cos_gamma)
    chi = (1 + cos_gamma * cos_gamma) / (chi * np.sqrt(chi))
    sun = c[2] + c[3] * np.exp(c[4] * gamma) + c[5] * (cos_gamma * cos_gamma) + c[6] * chi
    return horizon * (sun + c[7] * np.sqrt(cos_theta)) * c[9]


def sun_radiance(turbidity: float, elevation: float, aperture: float = APERTURE) -> np.ndarray:
    """Mean radiance of the sun's disc (W·m⁻²·sr⁻¹·nm⁻¹), (3,): its irradiance is the same at any aperture (degrees)."""
    table = at_turbidity(tables()["sun"], turbidity)
    x = np.clip((np.degrees(elevation) - FIRST) / STEP, 0, len(table) - 1)
    low = min(int(x), len(table) - 2)
    area = lambda diameter: 1 - np.cos(np.radians(diameter / 2))
    return (table[low] + (table[low + 1] - table[low]) * (x - low)) * (area(APERTURE) / area(aperture))


def picture(turbidity: float, albedo: np.ndarray, sun: np.ndarray, width: int) -> np.ndarray:
    """The sky as an enclosure's picture, (width/2, width, 3): its columns go around from +y by +x, its first row is +z.
    `sun`: the unit vector towards it. Below the horizon, and with the sun there, it is black; nowhere it is less."""
    height = width // 2
    found = np.zeros((height, width, 3), np.float32)
    if sun[2] < 0:
        return found
    theta, phi = np.arange(height // 2)[:, None] * (np.pi / (height - 1)), 2 * np.pi * (np.arange(width) + 0.5) / width
    across = np.sin(phi) * sun[0] + np.cos(phi) * sun[1]
    cos_theta = np.cos(theta)
    cos_gamma = np.clip(np.sin(theta) * across + cos_theta * sun[2], -1, 1)
    gamma, cos_gamma = np.arccos(cos_gamma).astype(np.float32), cos_gamma.astype(np.float32)
    for k, c in enumerate(coefficients(turbidity, albedo, float(np.arcsin(min(sun[2], 1.0)))).astype(np.float32)):
        found[: height // 2, :, k] = np.maximum(radiance(c, cos_theta.astype(np.float32), gamma, cos_gamma), 0)
    return found
