"""Does a picture to a tolerance keep its word, and what does it cost beside the best fixed number of samples?

    python experiments/tolerance/run.py [--quick] [--rtol R] [--seeds N] [--side PIXELS] [scene.xml ...]

Each scene is rendered to the tolerance with many seeds; the true error of each picture, against Mitsuba's of far more
samples (its own error is told), is set beside the error claimed. Then the fixed number of samples is sought with which
as many pictures are below the tolerance. Writes results/tolerance.csv, .png and .json (machine, versions, seed).
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path

import numpy as np

import jaxrt
from jaxrt.workprec.stage import Stage, root_relative_mse, stage_of

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from peer import results_of  # noqa: E402

SCENES = sorted((HERE.parent.parent / "scenes").glob("*.xml"))
HOLDS = 0.95
"""The share of renders in which a claim is to hold."""


def tried(stage: Stage, seeds: int, rtol: float) -> list[dict[str, float]]:
    """Pictures to a tolerance: what was claimed, what is true, seconds, and seconds foretold after the pilot."""
    rows, told = [], []
    jaxrt.render(stage.scene, seed=10**6, rtol=rtol)  # compiles
    for seed in range(seeds):
        told.clear()
        start, at = time.perf_counter(), []
        hear = lambda costs, at=at: (told.extend(costs), at.append(time.perf_counter()))
        sol = jaxrt.render(stage.scene, seed=seed, rtol=rtol, foretold=hear)
        end = time.perf_counter()
        true = root_relative_mse(sol.image, stage.reference.image)
        rows.append(
            {
                "claim": sol.error.claim,
                "true": float(np.sqrt(max(true**2 - stage.reference.error**2, 0.0))),
                "seconds": end - start,
                "foretold": told[0].seconds,
                "came": end - at[0],
                "spp": sol.stats["spp"],
            }
        )
    return rows


def best_fixed(stage: Stage, rtol: float, start: float) -> tuple[int, float]:
    """The least samples a pixel whose pictures are below the tolerance in 95 of 100 renders, to 5 %; and seconds."""
    floor = stage.reference.error

    def reached(spp: int) -> tuple[bool, float]:
        errors, clock = [], []
        for seed in range(8):
            begun = time.perf_counter()
            sol = jaxrt.render(stage.scene, spp, 500 + seed, method="path")
            clock.append(time.perf_counter() - begun)
            errors.append(np.sqrt(max(root_relative_mse(sol.image, stage.reference.image) ** 2 - floor**2, 0.0)))
        return float(np.mean(errors) + 1.645 * np.std(errors, ddof=1)) <= rtol, float(np.median(clock))

    jaxrt.render(stage.scene, 64, 1, method="path")  # compiles
    low, high = 4, max(8, int(start))
    while not reached(high)[0]:
        low, high = high, 2 * high
    while high > 1.05 * low + 1:
        middle = round(np.sqrt(low * high))
        low, high = (low, middle) if reached(middle)[0] else (middle, high)
    return high, reached(high)[1]


def figure(found: dict[str, list[dict[str, float]]], rtol: float, file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(figsize=(6.4, 4.2), constrained_layout=True)
    for k, (_name, rows) in enumerate(found.items()):
        claims, true = (100 * np.array([row[key] for row in rows]) for key in ("claim", "true"))
        spread = k + 0.3 * (np.arange(len(rows)) / max(len(rows) - 1, 1) - 0.5)
        axes.plot(spread, claims, "_", color="0.6", label="claimed" if k == 0 else None)
        axes.plot(spread, true, ".", color="C0", label="true" if k == 0 else None)
    axes.axhline(100 * rtol, color="C3", linewidth=0.8, label="asked")
    axes.set(ylabel="relative error, %", ylim=(0, 140 * rtol))
    axes.set_xticks(range(len(found)), [name.replace("_", "\n") for name in found])
    axes.legend(loc="lower right")
    fig.savefig(file, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description="Pictures to a tolerance: are their claims true, what do they cost?")
    parser.add_argument("--quick", action="store_true", help="one scene, a coarse tolerance, few seeds")
    parser.add_argument("--rtol", type=float, default=0.02)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--reference", type=float, default=60.0, help="seconds of each reference")
    parser.add_argument("scenes", nargs="*", type=Path)
    args = parser.parse_args()
    if args.quick:
        args.rtol, args.seeds, args.side, args.reference = 0.1, 12, 32, 8.0
    results, found, table = results_of(HERE), {}, []
    for file in args.scenes or (SCENES[:1] if args.quick else SCENES):
        stage = stage_of(jaxrt.load(file), file.stem, file=file, side=args.side, seconds=args.reference, most=1 << 14)
        rows = found[file.stem] = tried(stage, args.seeds, args.rtol)
        spp, seconds = best_fixed(stage, args.rtol, 0.5 * np.median([row["spp"] for row in rows]))
        column = lambda key, rows=rows: np.array([row[key] for row in rows])
        table.append(
            {
                "scene": file.stem,
                "asked": args.rtol,
                "reference": stage.reference.error,
                "below what was asked": int((column("true") <= args.rtol).sum()),
                "claim holds": int((column("true") <= column("claim")).sum()),
                "not below a third of it": int((column("true") >= column("claim") / 3).sum()),
                "of": len(rows),
                "samples": float(np.median(column("spp"))),
                "seconds": float(np.median(column("seconds"))),
                "fixed samples": spp,
                "fixed seconds": seconds,
                "foretold to came": float(np.median(column("foretold") / np.maximum(column("came"), 1e-3))),
            }
        )
        print({k: round(v, 4) if isinstance(v, float) else v for k, v in table[-1].items()}, flush=True)
    with (results / "tolerance.csv").open("w", newline="") as out:
        writer = csv.DictWriter(out, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    figure(found, args.rtol, results / "tolerance.png")
    holds, runs = sum(row["claim holds"] for row in table), sum(row["of"] for row in table)
    print(f"claims hold in {holds} of {runs} renders ({holds / runs:.1%}; {HOLDS:.0%} are meant)")


if __name__ == "__main__":
    main()
