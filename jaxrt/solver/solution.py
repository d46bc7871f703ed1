"""What a render returns: a picture that knows how wrong it is."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

_POOL = (0.25, 0.5, 0.25)


def standard_error(sums: np.ndarray, counts: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Standard error of each pixel's mean, (H, W, C), and its variance unpooled, from sums (H·W, sets, C) of sets.

    The few independent sets of one pixel give its variance 3 degrees of freedom; a binomial average over its
    3 x 3 neighbours gives about 20, so that normal quantiles have the right coverage. Totals over the picture
    are better taken of the unpooled variance, which does not spread from highlights. NaN below two sets.
    """
    used = counts > 0
    height, width = shape
    if used.sum() < 2:
        nothing = np.full((height, width, sums.shape[-1]), np.nan)
        return nothing, nothing
    n, total = counts[used][None, :, None].astype(float), float(counts.sum())
    means = sums[:, used] / n
    mean = sums[:, used].sum(1, keepdims=True) / total
    variance = (n * (means - mean) ** 2).sum(1) / (used.sum() - 1) / total
    v = own = variance.reshape(height, width, -1)
    for axis in (0, 1):
        v = _pooled(v, axis) / _pooled(np.ones_like(v), axis)
    return np.sqrt(v), own


def _pooled(v: np.ndarray, axis: int) -> np.ndarray:
    """Binomial average of neighbours along an axis, with nothing beyond the edge."""
    before, after = np.zeros_like(v), np.zeros_like(v)
    most, least = [slice(None)] * 3, [slice(None)] * 3
    most[axis], least[axis] = slice(1, None), slice(None, -1)
    before[tuple(most)], after[tuple(least)] = v[tuple(least)], v[tuple(most)]
    return _POOL[0] * before + _POOL[1] * v + _POOL[2] * after


def relative_mse(image: Any, reference: Any) -> float:
    """mean((I − R)²/(R² + ε)), ε = 0.01 mean(R²): the one error measure of the project; its root is relative."""
    image, reference = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    epsilon = 0.01 * (reference**2).mean()
    return float(((image - reference) ** 2 / np.maximum(reference**2 + epsilon, 1e-300)).mean())


def predicted_error(image: np.ndarray, variance: np.ndarray) -> float:
    """√relMSE that a picture's variances predict."""
    square = image.astype(np.float64) ** 2
    return float(np.sqrt((variance / np.maximum(square + 0.01 * square.mean(), 1e-300)).mean()))


@dataclasses.dataclass
class Solution:
    """A picture (H, W, C) float32, its standard error, and how it came about.

    image: radiance, W·m⁻²·sr⁻¹. stderr: standard error of each value (NaN below two samples a pixel).
    relative_error: √relMSE that the variances of pixels predict.
    stats: samples, rays, iterations, max_depth, method, why, seconds_compile, seconds_run, devices, threads.
    """

    image: np.ndarray
    stderr: np.ndarray
    stats: dict[str, Any]
    relative_error: float = float("nan")
    header: dict[str, Any] = dataclasses.field(default_factory=dict)
    failed: bool = False

    @property
    def result(self) -> Any:
        """Did the render reach what was asked: `optimistix.RESULTS.successful` or `nonlinear_max_steps_reached`."""
        import optimistix

        results = optimistix.RESULTS
        return results.nonlinear_max_steps_reached if self.failed else results.successful

    def save(self, path: str | Path, exposure: float = 0.0) -> None:
        """Writes `.exr` (with standard errors and provenance) or `.png` (sRGB, `exposure` in stops). Atomic.

        Raises `SceneError` for another suffix or a folder that cannot be written.
        """
        from ..files import image as files
        from ..parts import SceneError

        path = Path(path)
        if path.suffix.lower() == ".exr":
            stderr = None if np.isnan(self.stderr).all() else self.stderr
            files.write_exr(path, self.image, stderr, {"jaxrt": json.dumps(self.header)})
        elif path.suffix.lower() == ".png":
            files.write_png(path, self.image, exposure)
        else:
            raise SceneError(f"{path}: a picture is written as .exr or .png; change the suffix")

    def _repr_png_(self) -> bytes:
        from PIL import Image

        from ..files.image import to_srgb

        out = io.BytesIO()
        Image.fromarray(to_srgb(self.image)).save(out, "PNG")
        return out.getvalue()
