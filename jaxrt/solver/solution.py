"""What a render returns: a picture that knows how wrong it is."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np


def mean_and_variance(sums: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each pixel's mean and that mean's variance, (N, C), from sums (sets, N, C); variance NaN below two sets."""
    used = counts > 0
    total = float(counts.sum())
    mean = sums.sum(0) / total
    if used.sum() < 2:
        return mean, np.full_like(mean, np.nan)
    n = counts[used][:, None, None].astype(sums.dtype)
    return mean, (n * (sums[used] / n - mean) ** 2).sum(0) / (used.sum() - 1) / total


def standard_error(variance: np.ndarray) -> np.ndarray:
    """Standard errors (H, W, C) from variances that the few sets of each pixel gave; takes the place of its argument.

    The sets of one pixel give its variance 3 degrees of freedom; a binomial average over its 3 x 3 neighbours
    gives about 20, so that normal quantiles have the right coverage. Totals over the picture are better taken
    of the unpooled variance, which does not spread from highlights.
    """
    height, above = len(variance), variance[:0].copy()
    for start in range(0, height, 256):  # in bands, each with a row of its neighbours
        stop = min(start + 256, height)
        rows = np.concatenate([above, variance[start : stop + 1]])
        above = variance[stop - 1 : stop].copy()
        for axis in (0, 1):
            rows = _pooled(rows, axis)
        first = 0 if start == 0 else 1
        variance[start:stop] = np.sqrt(rows[first : first + stop - start])
    return variance


def _pooled(v: np.ndarray, axis: int) -> np.ndarray:
    """Binomial average (1/4, 1/2, 1/4) of neighbours along an axis; at its ends of two."""
    v = np.moveaxis(v, axis, 0)
    if len(v) > 1:
        out, quarter = 0.5 * v, 0.25 * v
        out[1:] += quarter[:-1]
        out[:-1] += quarter[1:]
        out[[0, -1]] *= 4 / 3
        v = out
    return np.moveaxis(v, 0, axis)


def relative_mse(image: Any, reference: Any) -> float:
    """mean((I − R)²/(R² + ε)), ε = 0.01 mean(R²): the one error measure of the project; its root is relative."""
    image, reference = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    epsilon = 0.01 * (reference**2).mean()
    return float(((image - reference) ** 2 / np.maximum(reference**2 + epsilon, 1e-300)).mean())


def predicted_error(image: np.ndarray, variance: np.ndarray) -> float:
    """√relMSE that a picture's variances predict."""
    bands = [slice(k, k + 64) for k in range(0, len(image), 64)]
    epsilon = max(0.01 * sum(float(np.vdot(image[b], image[b])) for b in bands) / image.size, 1e-30)
    relative = lambda b: variance[b] / (image[b] * image[b] + np.float32(epsilon))
    return float(np.sqrt(sum(relative(b).sum(dtype=np.float64) for b in bands) / image.size))


@dataclasses.dataclass
class Solution:
    """A picture (H, W, C) float32, its standard error, and how it came about.

    image: radiance, W·m⁻²·sr⁻¹. stderr: standard error of each value (NaN below two samples a pixel).
    relative_error: √relMSE that the variances of pixels predict.
    stats: samples, spp, lamp_pixels (taken again), rays, iterations, max_depth, method, why, threads, nonfinite,
    seconds_compile (making programs), seconds_solve (of a field), seconds_run (the rest); with a field also elements,
    directions, field_iterations, field_bytes. aovs: what pixels see first, by name, as `render` was asked.
    """

    image: np.ndarray
    stderr: np.ndarray
    stats: dict[str, Any]
    relative_error: float = float("nan")
    header: dict[str, Any] = dataclasses.field(default_factory=dict)
    failed: bool = False
    aovs: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    @property
    def result(self) -> Any:
        """Did the render reach what was asked: `optimistix.RESULTS.successful` or `nonlinear_max_steps_reached`."""
        import optimistix

        results = optimistix.RESULTS
        return results.nonlinear_max_steps_reached if self.failed else results.successful

    def save(self, path: str | Path, exposure: float = 0.0) -> None:
        """Writes `.exr` (with standard errors, AOVs and provenance) or `.png` (sRGB, `exposure` in stops). Atomic.

        Raises `SceneError` for another suffix or a folder that cannot be written.
        """
        from ..files import image as files
        from ..parts import SceneError

        path = Path(path)
        if path.suffix.lower() == ".exr":
            stderr = None if np.isnan(self.stderr).all() else self.stderr
            files.write_exr(path, self.image, stderr, {"jaxrt": json.dumps(self.header)}, self.aovs)
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
