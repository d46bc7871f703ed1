"""Derivatives by what moves, against central differences of pictures.

    python experiments/gradient_check/run.py [--quick] [name ...]

For each motion of `../stages.py` the derivative's picture by `jax.jvp`, with boundary terms and without, beside
(I(θ+h) − I(θ−h)) / 2h: relative L1 of means over blocks of 4 x 4 pixels, and of the differences between two seeds,
which is what noise alone makes of it. Writes results/gradient_check.csv, .json (machine, versions, seed) and, a row a
motion, .png: picture, derivative, central differences, five times the error.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import results_of
from stages import Motion, motions

import jaxrt

HERE = Path(__file__).parent
BLOCK, SEED = 4, 1


def blocks(image: Any) -> np.ndarray:
    """Means over blocks of pixels, of the first channel."""
    a = np.asarray(image, np.float64)[..., 0]
    return a.reshape(a.shape[0] // BLOCK, BLOCK, -1, BLOCK).mean((1, 3))


def compare(motion: Motion, spp: int, reference: int) -> dict[str, Any]:
    """Pictures of one motion, and their relative L1."""
    plan = jaxrt.plan(motion.scene)

    def picture(t: Any, key: Any, spp: int, boundary: bool = True) -> Any:
        scene = jaxrt.with_params(motion.scene, motion.at(t))
        return jaxrt.measure(scene, key, plan=plan, spp=spp, max_depth=motion.max_depth, boundary=boundary)

    def derivative(boundary: bool) -> Any:
        return jax.jit(lambda t, key: jax.jvp(lambda t: picture(t, key, spp, boundary), (t,), (1.0,)))

    timed: dict[bool, tuple[Any, Any, float]] = {}
    for boundary in (False, True):
        f = derivative(boundary)
        jax.block_until_ready(f(0.0, 0))  # compiles
        began = time.perf_counter()
        value, slope = jax.block_until_ready(f(0.0, SEED))
        timed[boundary] = value, slope, time.perf_counter() - began
    plain, h = jax.jit(lambda t, key: picture(t, key, reference)), motion.step
    differences = [
        (np.asarray(plain(h, key), np.float64) - np.asarray(plain(-h, key), np.float64)) / (2 * h)
        for key in (SEED + 1, SEED + 2)
    ]
    value, slope, seconds = timed[True]
    want = np.mean(differences, 0)
    size = np.abs(blocks(want)).sum()
    off = lambda a, b: float(np.abs(blocks(a) - blocks(b)).sum() / size)
    return {
        "pictures": (value, slope, want),
        "error": off(slope, want),
        "without": off(timed[False][1], want),
        "noise": off(*differences) / 2,
        "seconds": seconds,
        "seconds_without": timed[False][2],
    }


def draw(rows: list[tuple[str, dict[str, Any]]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(len(rows), 4, figsize=(9, 2.3 * len(rows)), squeeze=False)
    for row, (name, found) in zip(axes, rows, strict=True):
        value, slope, want = (np.asarray(a, np.float64)[..., 0] for a in found["pictures"])
        most = np.abs(blocks(found["pictures"][2])).max()
        row[0].imshow(value, cmap="gray", vmin=0, vmax=np.quantile(value, 0.99))
        for ax, image, times in ((row[1], slope, 1), (row[2], want, 1), (row[3], slope - want, 5)):
            ax.imshow(blocks(image[..., None]) * times, cmap="RdBu", vmin=-most, vmax=most)
        row[0].set_ylabel(name, fontsize=7)
        row[3].set_title(f"{100 * found['error']:.1f} % ({100 * found['without']:.0f} % without)", fontsize=7)
    for ax, title in zip(axes[0], ("picture", "derivative", "central differences", None), strict=True):
        if title:
            ax.set_title(title, fontsize=7)
    for ax in axes.flat:
        ax.set_xticks([]), ax.set_yticks([])
    fig.tight_layout()
    fig.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", help="motions; all by default")
    parser.add_argument("--quick", action="store_true", help="one motion, few samples: under a minute")
    args = parser.parse_args()
    res, spp, reference = (24, 256, 4096) if args.quick else (48, 1024, 32768)
    known = motions(res)
    names = args.names or (["occluder moved"] if args.quick else list(known))
    rows = []
    for name in names:
        found = compare(known[name](), spp, reference)
        rows.append((name, found))
        print(
            f"{name:20} relative L1 {found['error']:.4f}, without boundary terms {found['without']:.3f}, noise of the "
            f"differences {found['noise']:.4f}; {found['seconds']:.2f} s, without {found['seconds_without']:.2f} s",
            flush=True,
        )
    results = results_of(HERE, SEED, res=res, spp=spp, reference_spp=reference)
    columns = ["error", "without", "noise", "seconds", "seconds_without"]
    with open(results / "gradient_check.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["motion", *columns])
        writer.writerows([name, *(found[c] for c in columns)] for name, found in rows)
    draw(rows, results / "gradient_check.png")


if __name__ == "__main__":
    main()
