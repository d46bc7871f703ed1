"""Least squares or Adam: how soon is a fit of few parameters within one per cent?

    python experiments/adam_or_lm/run.py [--quick]

The nine reflectances of experiments/fit_albedo, from the same start and target: Gauss-Newton with residuals of two
independent pictures, the same with one, Levenberg-Marquardt, and Adam (rates that fall by a cosine) with and without
independent pictures. Time counts from the end of the first step, so that it is that of steps alone; compiling is told
apart. Writes results/adam_or_lm.json (numbers, machine, versions, seed) and .png: errors in time.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
import optimistix

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
import fits  # noqa: E402

fits.use_cores()
import jaxrt  # noqa: E402

SEED = 0
NAMES = ("white.reflectance", "red.reflectance", "green.reflectance")
GOAL = 0.01


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two of the methods on a smaller picture: under a minute")
    args = parser.parse_args()
    side, spp, reference = (24, 64, 1024) if args.quick else (48, 64, 8192)
    scene = jaxrt.load(HERE.parent.parent / "scenes" / "cornell_box.xml", res=side)
    target = jaxrt.render(scene, spp=reference, seed=SEED + 1, method="path").image
    truth = {name: np.asarray(jaxrt.params(scene)[name]) for name in NAMES}
    start = jaxrt.with_params(scene, {name: np.full(3, 0.5) for name in NAMES})
    methods: dict[str, dict[str, Any]] = {
        "Gauss-Newton": {"optimiser": optimistix.GaussNewton(1e-3, 1e-4)},
        "Adam, 100 steps": {"steps": 100, "spp": spp // 4},
        "Adam, 400 steps": {"steps": 400, "spp": spp // 4},
        "Adam, 100 steps, one picture": {"steps": 100, "spp": spp // 4, "unbiased": False},
        "Gauss-Newton, one picture": {"optimiser": optimistix.GaussNewton(1e-3, 1e-4), "unbiased": False},
        "Levenberg-Marquardt": {"optimiser": optimistix.LevenbergMarquardt(1e-3, 1e-4)},
    }
    if args.quick:
        methods = {name: methods[name] for name in list(methods)[:2]}
    curves, table = {}, {}
    for label, given in methods.items():
        fit = jaxrt.fit(start, target, NAMES, progress=False, **{"loss": "relative", "spp": spp, "seed": SEED, **given})
        error = np.max([np.abs(fit.history[name] - truth[name]).max(1) for name in NAMES], 0)
        seconds = fit.history["seconds"] - fit.history["seconds"][0]
        late = np.nonzero(error >= GOAL)[0]
        reached = seconds[late[-1] + 1] if len(late) and late[-1] + 1 < len(error) else float("nan")
        table[label] = {
            "steps": len(error), "error": error[-1], "seconds to 1 %": reached, "seconds": seconds[-1],
            "seconds to the end of the first step": fit.history["seconds"][0],
        }  # fmt: skip
        curves[f"error, {label}"] = seconds, error
        print(
            f"{label:30} error {error[-1]:.4f} after {len(error)} steps, {seconds[-1]:.1f} s and "
            f"{fit.history['seconds'][0]:.1f} s of compiling; below {GOAL} for good after {reached:.1f} s",
            flush=True,
        )
    best = min(table, key=lambda k: table[k]["error"])
    shown = {"start": jaxrt.render(start, spp=64, method="path").image, "target": target}
    numbers = {"side": side, "spp": spp, "reference spp": reference, "methods": table}
    fits.write(HERE, SEED, numbers, curves, shown)
    print(f"least error: {best}, {table[best]['error']:.4f} after {table[best]['seconds']:.1f} s of steps")


if __name__ == "__main__":
    main()
