"""Where is a lamp that is not in the picture, and how much does it send out, from the shadow that it casts?

    python experiments/fit_light/run.py [--quick]

Target: a cube over a floor, and its shadow. Start: the lamp 1.2 away in a scene 6 wide, with half of its radiance.
Least squares (Gauss-Newton) on residuals of the picture and its halves; three numbers of place and one of radiance.
Writes results/fit_light.json (numbers, machine, versions, seed) and .png: target, pictures on the way, loss and errors.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
import fits  # noqa: E402

fits.use_cores()
import stages  # noqa: E402

import jaxrt  # noqa: E402

SEED, DEPTH = 0, 2
PLACE, RADIANCE = "lamp.to_world", "lamp.emitter.radiance"
ROOM = 6.0  # the floor's side


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="smaller pictures, fewer samples: under a minute")
    args = parser.parse_args()
    side, spp, reference = (24, 32, 1024) if args.quick else (32, 128, 4096)
    scene = stages.stage(side, lamp=20.0)
    target = jaxrt.render(scene, spp=reference, seed=SEED + 1, method="path", max_depth=DEPTH).image
    truth = {name: np.asarray(jaxrt.params(scene)[name]) for name in (PLACE, RADIANCE)}
    away = np.array(stages.shifted(truth[PLACE], (-0.9, -0.4, 0.7)))
    start = jaxrt.with_params(scene, {PLACE: away, RADIANCE: truth[RADIANCE] / 2})
    fit = jaxrt.fit(
        start, target, {PLACE: "shift", RADIANCE: "positive"}, loss="multiscale",
        optimiser=fits.gauss_newton(), spp=spp, seed=SEED, max_depth=DEPTH, steps=14,
    )  # fmt: skip

    off = np.linalg.norm(fit.history[PLACE][:, :3, 3] - truth[PLACE][:3, 3], axis=1) / ROOM
    power = np.abs(fit.history[RADIANCE] / truth[RADIANCE] - 1).max(-1)  # its area stays: as far off as its radiance
    seconds = fit.history["seconds"]
    numbers = {
        "side": side, "spp": spp, "reference spp": reference, "seconds": fit.seconds, "steps": len(seconds),
        "seconds compiling": seconds[0], "distance over room": off[-1], "relative error of power": power[-1],
        "distance over room at the start": off[0],
        "standard errors of the position over room": (np.asarray(fit.stderr[PLACE])[:3, 3] / ROOM).tolist(),
        "relative standard error of power": (np.asarray(fit.stderr[RADIANCE]) / truth[RADIANCE]).tolist(),
    }  # fmt: skip
    curves = {"loss": (seconds, fit.history["loss"]), "distance / room": (seconds, off), "power": (seconds, power)}
    shown = fits.on_the_way(start, fit, 256, max_depth=DEPTH) | {"target": target}
    fits.write(HERE, SEED, numbers, curves, shown)
    print(
        f"the lamp's place within {100 * off[-1]:.2f} % of the room and its power within {100 * power[-1]:.2f} % after "
        f"{len(seconds)} steps and {fit.seconds:.1f} s, of which {seconds[0]:.1f} s to the end of the first step "
        f"(compiling); at the start {100 * np.linalg.norm(away[:3, 3] - truth[PLACE][:3, 3]) / ROOM:.0f} % and 50 %"
    )


if __name__ == "__main__":
    main()
