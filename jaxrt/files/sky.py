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
"""The sun's diameter, degrees, where none is given."""

FIRST, STEP = 2.0, 3.0
"""Elevations (degrees) of the sun for which its irradiance is stored: linear between them, and constant beyond."""


@functools.cache
def tables() -> dict[str, np.ndarray]:
    """`sky`: control points of nine coefficients and a scale, (turbidity 1 to 10, albedo 0 and 1, channel, 10, 6).
    `sun`: irradiance across its light in W·m⁻²·nm⁻¹, (turbidity, elevation, channel)."""
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


def sun_radiance(turbidity: float, elevation: float, aperture: float = APERTURE) -> np.ndarray:
    """Mean radiance of the sun's disc (W·m⁻²·sr⁻¹·nm⁻¹), (3,), by its diameter (degrees): the irradiance stays."""
    table = at_turbidity(tables()["sun"], turbidity)
    x = np.clip((np.degrees(elevation) - FIRST) / STEP, 0, len(table) - 1)
    low = min(int(x), len(table) - 2)
    irradiance = table[low] + (table[low + 1] - table[low]) * (x - low)
    return irradiance / (4 * np.pi * np.sin(np.radians(aperture / 4)) ** 2)
