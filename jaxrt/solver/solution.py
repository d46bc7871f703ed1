"""What a render returns: a picture that knows how wrong it is."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from .tally import Tally


def standard_error(variance: np.ndarray) -> np.ndarray:
    """Standard errors (H, W, C) from variances that the few sets of each pixel gave; takes the place of its argument.

    The sets of one pixel give its variance 3 degrees of freedom; a binomial average over its 3 x 3 neighbours
    gives about 20, so that normal quantiles have the right coverage. Totals over the picture are better taken
    of the unpooled variance, which does not spread from highlights.
    """
    if not (finite := np.isfinite(variance)).all():  # what is none in a pixel is no matter of its neighbours
        share, known = pooled(np.where(finite, variance, 0.0)), pooled(finite.astype(variance.dtype))
        return np.where(finite, np.sqrt(share / np.maximum(known, 1e-6)), np.nan)
    height, above = len(variance), variance[:0].copy()
    for start in range(0, height, 256):  # in bands, each with a row of its neighbours
        stop = min(start + 256, height)
        rows = np.concatenate([above, variance[start : stop + 1]])
        above = variance[stop - 1 : stop].copy()
        rows = pooled(rows)
        first = 0 if start == 0 else 1
        variance[start:stop] = np.sqrt(rows[first : first + stop - start])
    return variance


def pooled(v: np.ndarray) -> np.ndarray:
    """A binomial average of each pixel's value and its 3 x 3 neighbours', (H, W, ...)."""
    return _pooled(_pooled(v, 0), 1)


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


def share_of_most(values: np.ndarray, share: float = 1e-3) -> float:
    """What the largest of some values hold of their sum, so many of them but one at least; 0 where that is 0."""
    values, k = np.nan_to_num(values.ravel()), max(round(share * values.size), 1)
    total = values.sum(dtype=np.float64)
    return float(np.partition(values, -k)[-k:].sum(dtype=np.float64) / total) if total > 0 else 0.0


def block_means(image: np.ndarray, side: int) -> np.ndarray:
    """Means of blocks of so many pixels a side, (H // side, W // side, C) float64; what fills no block is left out."""
    rows, columns = image.shape[0] // side, image.shape[1] // side
    whole = image[: rows * side, : columns * side].reshape(rows, side, columns, side, -1)
    return whole.mean((1, 3), dtype=np.float64)


def relative_mse(image: Any, reference: Any) -> float:
    """mean((I − R)²/(R² + ε)), ε = 0.01 mean(R²): the one error measure of the project; its root is relative."""
    image, reference = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    epsilon = 0.01 * (reference**2).mean()
    return float(((image - reference) ** 2 / np.maximum(reference**2 + epsilon, 1e-300)).mean())


@dataclasses.dataclass
class Error:
    """How wrong a picture is: parts of √relMSE, and what it stays below.

    `statistical`: of samples. `truncation`: of paths that end after a number of edges. `discretisation`: of what
    elements of a field are too coarse for; NaN where a field was looked into and nobody asked. `claim`: what the whole
    error does not exceed in 95 of 100 renders. `each`: of each pixel's value, (H, W, C) or a number, by those names.
    """

    statistical: float
    truncation: float = 0.0
    discretisation: float = 0.0
    claim: float = float("nan")
    each: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def total(self) -> float:
        """√relMSE that is expected."""
        parts = self.statistical, self.truncation, 0.0 if np.isnan(self.discretisation) else self.discretisation
        return float(np.sqrt(sum(part**2 for part in parts)))


def statistical(shares: np.ndarray) -> tuple[float, float]:
    """√relMSE that is expected of what pixels add to it, and what it does not exceed in 95 of 100 renders.

    Each pixel's squared error is its variance times a χ² of one degree, and two degrees tell the variance. So the
    logarithm of what the sum over n pixels is off by has a variance of about 3/n, n those that matter; of which, as
    estimates scatter, there seem to be half.
    """
    if np.isnan(shares).any():
        return float("nan"), float("nan")
    mean, square = float(shares.mean()), float(np.vdot(shares, shares)) / len(shares)
    matter = 2.0 * len(shares) * mean**2 / square if square > 0 else np.inf
    return float(np.sqrt(mean)), float(np.sqrt(mean * np.exp(1.645 * np.sqrt(3.0 / max(matter, 3.0)))))


@dataclasses.dataclass
class Solution:
    """A picture (H, W, C) float32, its standard error, and how it came about.

    image: radiance, W·m⁻²·sr⁻¹. stderr: standard error of each value (NaN below two samples a pixel).
    error: its parts and what it stays below. spp: samples of each pixel (H, W).
    stats: samples, spp, rays, max_depth, bounces, method, why, threads, nonfinite (values of the picture that are not
    finite; and if there are any, nonfinite_samples: samples found to be so, and nonfinite_at: the first of them),
    outliers (what the brightest pixels in a thousand hold of the picture's energy, and those of most variance of that),
    seconds_compile (making programs), seconds_solve (of a field), seconds_run (the rest); with a field also elements,
    directions, field_iterations, field_bytes. aovs: what pixels see first, by name, as `render` was asked.
    """

    image: np.ndarray
    stderr: np.ndarray
    stats: dict[str, Any]
    error: Error
    spp: np.ndarray
    header: dict[str, Any] = dataclasses.field(default_factory=dict)
    failed: bool = False
    aovs: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    @property
    def relative_error(self) -> float:
        """√relMSE that the variances of pixels predict."""
        return self.error.total

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
            files.write_exr(path, self.image, stderr, {"jaxrt": json.dumps(self.header)}, self.aovs, self.spp)
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


def solution_of(tally: Tally, size: tuple[int, int], channels: int) -> Solution:
    """The picture (width, height) of what was sampled, by so many channels where they are all alike."""
    shares, (image, variance) = tally.relative_variances(), tally.found()
    tally.sums = tally.sums[:0]  # which in large pictures is most of the memory
    image, variance, spp = (a.reshape(size[1], size[0], -1) for a in (image, variance, tally.taken))
    outliers = {"energy": share_of_most(image.mean(-1)), "variance": share_of_most(variance.mean(-1))}
    known = not np.isnan(variance).all()  # one sample alone says nothing of its error
    stderr = standard_error(variance) if known else variance
    stats = {
        "samples": tally.samples,
        "rays": tally.rays,
        "nonfinite": int((~np.isfinite(image)).sum()),
        "outliers": outliers,
    }
    image, stderr = (a if a.shape[2] == channels else np.repeat(a, channels, 2) for a in (image, stderr))
    expected, claim = statistical(shares)
    error = Error(expected, claim=claim, each={"statistical": stderr})
    return Solution(image, stderr, stats, error, spp[..., 0])
