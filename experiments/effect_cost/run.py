"""What each effect costs in each scene, and whether a clock around whole pictures says the same.

    python experiments/effect_cost/run.py [--quick | --all] [scene.xml ...]

`jaxrt.effect_costs` times a small picture with and without an effect: those that are in the plan of any of the scenes,
or with --all every one (out of the plan: forced in). The check is another clock: pictures of four times the pixels, by
the wall time of the whole call, in turn and warm. Where an effect's cost is above the noise of both, the two shares of
a picture's time should be of one order of magnitude. Writes results/effect_cost.csv, .json (machine, versions, seed)
and .png.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import results_of

import jaxrt
from jaxrt.effects.costs import SAMPLES, SIDE, Cost
from jaxrt.effects.registry import EFFECTS

HERE = Path(__file__).parent
SCENES = sorted((HERE.parent.parent / "scenes").glob("*.xml"))
QUICK = ("rgb", "solid_angle")
SEED = 0


def clock(scene: Any, cost: Cost, repeat: int) -> tuple[float, float, float]:
    """Seconds of a whole call for a larger picture without and with an effect, and how far they are known."""
    plan = jaxrt.plan(scene, free=None)
    backend = cost.name.removeprefix("rays:")
    given: dict[str, Any] = {"backend": backend} if backend != cost.name else {cost.name: not cost.on}
    plans = [jaxrt.plan(scene, free=None, **given), plan][:: 1 if cost.on else -1]
    times: list[list[float]] = [[], []]
    width, height, *_ = scene.structure.sensors[0].film
    scale = 2 * SIDE / max(width, height)
    scene = jaxrt.resized(scene, 0, round(scale * width), round(scale * height))
    for _ in range(repeat + 1):  # the first time compiles, where need be
        for plan, spent in zip(plans, times, strict=True):
            start = time.perf_counter()
            jaxrt.render(scene, SAMPLES, SEED, plan=plan, method="path")
            spent.append(time.perf_counter() - start)
    noise = max(sorted(spent[1:])[min(1, repeat - 1)] - min(spent[1:]) for spent in times)
    return min(times[0][1:]), min(times[1][1:]), noise


def draw(table: dict[str, dict[str, tuple[Cost, float]]], names: list[str], file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shares = np.array([[100 * of[n][0].share if n in of else np.nan for of in table.values()] for n in names])
    fig, (left, right) = plt.subplots(
        1, 2, figsize=(5 + 1.1 * len(table), 1.8 + 0.34 * len(names)), layout="constrained", width_ratios=(3, 2)
    )
    shown = left.imshow(shares, cmap="RdBu_r", vmin=-100, vmax=100, aspect="auto")
    left.set_xticks(range(len(table)), list(table), rotation=30, ha="right")
    left.set_yticks(range(len(names)), names)
    for j, of in enumerate(table.values()):
        for k, name in enumerate(names):
            if name in of:
                cost = of[name][0]
                more = 1e3 * (cost.seconds[1] - cost.seconds[0])
                weight, colour = ("bold" if cost.on else "normal"), "white" if abs(cost.share) > 0.6 else "black"
                left.text(j, k, f"{more:+.0f} ms", ha="center", va="center", fontsize=7, weight=weight, color=colour)
    left.set_title("with the effect more than without (bold: in the plan)", fontsize=9)
    fig.colorbar(shown, ax=left, label="% of a picture", extend="both")
    both = [pair for of in table.values() for pair in of.values()]
    x, y = np.array([[100 * cost.share, 100 * by_clock] for cost, by_clock in both]).T
    right.plot(x, y, "o", ms=4, alpha=0.7)
    ends = [min(*x, *y, -10), max(*x, *y, 10)]
    right.plot(ends, ends, "k-", lw=0.5)
    right.set_xscale("symlog", linthresh=10)
    right.set_yscale("symlog", linthresh=10)
    right.set(xlabel="% of a picture, by the table", ylabel="% by a clock")
    right.set_title("table and clock", fontsize=9)
    fig.savefig(file, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description="What each effect costs in each scene.")
    parser.add_argument("--quick", action="store_true", help="two effects in one scene, best of two")
    parser.add_argument("--all", action="store_true", help="every effect, also those that no scene has")
    parser.add_argument("scenes", nargs="*", type=Path)
    args = parser.parse_args()
    files, repeat = args.scenes or (SCENES[:1] if args.quick else SCENES), 2 if args.quick else 5
    scenes = {file.stem: jaxrt.load(file) for file in files}
    used = set().union(*(jaxrt.plan(scene, free=None).effects for scene in scenes.values()))
    names = [n for n in EFFECTS if (n in QUICK if args.quick else args.all or n in used)]

    results = results_of(HERE, SEED)
    table: dict[str, dict[str, tuple[Cost, float]]] = {}
    agree = compared = 0
    with (results / "effect_cost.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["scene", "effect", "in", "without s", "with s", "noise s", "share", "ns a ray", "compile s",
                       "radiance", "clock without s", "clock with s", "clock noise s"])  # fmt: skip
        for stem, scene in scenes.items():
            table[stem] = {}
            for cost in jaxrt.effect_costs(scene, names, repeat=repeat):
                without, with_it, noise = clock(scene, cost, repeat)
                by_clock = (with_it - without) / (without, with_it)[cost.on]
                table[stem][cost.name] = cost, by_clock
                more = cost.compiling[1] - cost.compiling[0]
                rows.writerow([stem, cost.name, cost.on, *cost.seconds, cost.noise, cost.share, cost.ns_a_ray, more,
                               cost.radiance[0], without, with_it, noise])  # fmt: skip
                file.flush()
                told = "within the noise"
                if abs(with_it - without) > noise and abs(cost.seconds[1] - cost.seconds[0]) > cost.noise:
                    near = 0.3 < cost.share / by_clock < 3.3
                    compared, agree, told = compared + 1, agree + near, "agree" if near else "DISAGREE"
                print(f"{stem:<14} {cost.name:<22} {cost.share:+7.1%} of a picture ({cost.ns_a_ray:+7.2f} ns a ray), "
                      f"by a clock {by_clock:+7.1%}: {told}", flush=True)  # fmt: skip
    print(f"table and clock are of one order of magnitude in {agree} of {compared} cases above the noise")
    draw(table, [n for n in names if any(n in of for of in table.values())], results / "effect_cost.png")


if __name__ == "__main__":
    main()
