"""`jaxrt compare`: how far two pictures are apart."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .options import MistakeError
from .shared import existing

if TYPE_CHECKING:
    import numpy as np

_BLOCK = 8  # pixels to a side of the blocks that `compare` averages


def add(commands: Any, scene: argparse.ArgumentParser) -> None:
    parser = commands.add_parser("compare", help="how far two pictures are apart")
    parser.add_argument("a", metavar="A.exr")
    parser.add_argument("b", metavar="B.exr", help="the reference")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    for path in (args.a, args.b):
        existing(path)
    import numpy as np

    from ..files.image import read_exr
    from ..solver.solution import relative_mse

    (a, a_error, _), (b, b_error, _) = read_exr(args.a), read_exr(args.b)
    if a.shape != b.shape:
        sizes = [f"{path} is {im.shape[1]}x{im.shape[0]}" for path, im in ((args.a, a), (args.b, b))]
        raise MistakeError(f"{' and '.join(sizes)}; render both at one size")
    a, b = a.astype(np.float64), b.astype(np.float64)
    finite = np.asarray(np.isfinite(a + b).all(-1))
    if not finite.all():
        print(f"not finite       {int((~finite).sum())} pixels, left out")
        a[~finite] = b[~finite] = 0.0
    scale = b.mean() or 1.0
    worst, at = _worst_block(a, b)
    print(f"mean offset      {(a.mean() - b.mean()) / scale:+.3%}")
    print(f"relMSE           {relative_mse(a, b):.3e}")
    print(f"|z| < 4.5        {_share_of_z(a - b, a_error, b_error, scale, finite)}")
    print(f"worst {_BLOCK}x{_BLOCK} block  {worst / abs(scale):.2%} of the mean, at x {at[0]}, y {at[1]}")


def _share_of_z(
    off: np.ndarray, a_error: np.ndarray | None, b_error: np.ndarray | None, scale: float, finite: np.ndarray
) -> str:
    """The share of values whose difference is below 4.5 of its standard error, as text."""
    import numpy as np

    known = [e.astype(np.float64) ** 2 for e in (a_error, b_error) if e is not None and np.isfinite(e).any()]
    if not known:
        return "unknown: neither picture has standard errors"
    z = off / np.sqrt(np.nan_to_num(sum(known)) + (1e-6 * scale) ** 2)
    return f"{(np.abs(z[finite]) < 4.5).mean():.3%}" if finite.any() else "unknown: no pixel is finite"


def _worst_block(a: np.ndarray, b: np.ndarray) -> tuple[float, tuple[int, int]]:
    """The largest difference of block means in any channel, and the block's first column and row."""
    import numpy as np

    off = a - b
    count = np.ones((*off.shape[:2], 1))
    for axis in (0, 1):
        starts = np.arange(0, off.shape[axis], _BLOCK)
        off, count = np.add.reduceat(off, starts, axis), np.add.reduceat(count, starts, axis)
    means = np.abs(off / count).max(-1)
    row, column = np.unravel_index(means.argmax(), means.shape)
    return float(means.max()), (int(column) * _BLOCK, int(row) * _BLOCK)
