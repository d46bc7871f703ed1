"""Are the colours of the Cornell box found again from one picture, and how soon?

    python experiments/fit_albedo/run.py [--quick]

Target: a picture of the box. Start: white, red and green all at .5. Least squares (Gauss-Newton) on relative residuals.
Writes results/fit_albedo.json (numbers, machine, versions, seed) and .png: target, pictures on the way, loss.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import optimistix

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
import fits  # noqa: E402

fits.use_cores()
import jaxrt  # noqa: E402

SEED = 0
NAMES = ("white.reflectance", "red.reflectance", "green.reflectance")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="smaller pictures, fewer samples: under a minute")
    args = parser.parse_args()
    side, spp, reference = (24, 32, 1024) if args.quick else (64, 64, 4096)
    scene = jaxrt.load(HERE.parent.parent / "scenes" / "cornell_box.xml", res=side)
    target = jaxrt.render(scene, spp=reference, seed=SEED + 1, method="path").image
    truth = {name: np.asarray(jaxrt.params(scene)[name]) for name in NAMES}
    start = jaxrt.with_params(scene, {name: np.full(3, 0.5) for name in NAMES})
    solver = optimistix.GaussNewton(1e-3, 1e-4)
    fit = jaxrt.fit(start, target, NAMES, loss="relative", optimiser=solver, spp=spp, seed=SEED)

    errors = {name: np.abs(np.asarray(fit.parameters[name]) - truth[name]) for name in NAMES}
    scores = {name: errors[name] / np.asarray(fit.stderr[name]) for name in NAMES}
    worst = max(float(e.max()) for e in errors.values())
    numbers = {
        "side": side, "spp": spp, "reference spp": reference, "seconds": fit.seconds, "steps": len(fit.history["step"]),
        "seconds compiling": fit.history["seconds"][0], "worst error": worst,
        "errors": {name: e.tolist() for name, e in errors.items()},
        "errors in standard errors": {name: z.tolist() for name, z in scores.items()},
    }  # fmt: skip
    curves = {"loss": (fit.history["seconds"], fit.history["loss"])}
    for name in NAMES:
        curves[f"error of {name}"] = fit.history["seconds"], np.abs(fit.history[name] - truth[name]).max(1)
    shown = fits.on_the_way(start, fit) | {"target": target}
    fits.write(HERE, SEED, numbers, curves, shown)
    print(
        f"{3 * len(NAMES)} reflectances within {worst:.4f} of the truth after {len(fit.history['step'])} steps and "
        f"{fit.seconds:.1f} s, of which {fit.history['seconds'][0]:.1f} s to the end of the first step (compiling); "
        f"errors are up to {max(float(z.max()) for z in scores.values()):.1f} of their own standard errors"
    )


if __name__ == "__main__":
    main()
