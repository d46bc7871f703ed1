"""Is a box put back where it was by its outline and its shadow, all six numbers of its pose from one picture?

    python experiments/fit_pose/run.py [--quick]

Target: a box that floats over a floor under a lamp. Start: .47 away and turned by 24°. Least squares (Gauss-Newton) on
residuals of the picture and its halves, through the borders of what is seen and of shadows: without these terms
(`boundary=False`) the derivative of a picture of flat faces knows only how bright each face is.
Writes results/fit_pose.json (numbers, machine, versions, seed) and .png: target, pictures on the way, loss and errors.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
import fits  # noqa: E402

fits.use_cores()
import stages  # noqa: E402

import jaxrt  # noqa: E402

SEED, DEPTH = 0, 2
NAME = "cube.to_world"
SIZE = 2 * np.linalg.norm([0.7, 0.3, 0.45])  # the box's diagonal


def pose(turn: Any, at: Any) -> np.ndarray:
    m = np.diag([0.7, 0.3, 0.45, 1.0])
    m[:3, :3] = turn.as_matrix() @ m[:3, :3]
    m[:3, 3] = at
    return m


def errors(found: Any, truth: np.ndarray) -> tuple[float, float]:
    """How far off a pose is: distance of its middle over the box's size, and the angle between them in degrees."""
    turn = np.asarray(found, float)[:3, :3] @ np.linalg.inv(truth[:3, :3])
    angle = np.degrees(Rotation.from_matrix(turn).magnitude())
    return float(np.linalg.norm(found[:3, 3] - truth[:3, 3]) / SIZE), float(angle)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="smaller pictures, fewer samples: under a minute")
    args = parser.parse_args()
    side, spp, reference = (24, 32, 1024) if args.quick else (32, 128, 4096)
    turn = Rotation.from_euler("yxz", [30, 15, 10], degrees=True)
    truth = pose(turn, (-0.2, 0.9, 0.1))
    away = pose(Rotation.from_rotvec([8, 20, -10], degrees=True) * turn, (0.1, 1.1, -0.2))
    scene = stages.stage(side, cube=jaxrt.Cube(id="cube", to_world=truth, bsdf=jaxrt.Diffuse(0.4)), lamp=20.0)
    target = jaxrt.render(scene, spp=reference, seed=SEED + 1, method="path", max_depth=DEPTH).image
    start = jaxrt.with_params(scene, {NAME: away})
    fit = jaxrt.fit(
        start, target, NAME, loss="multiscale", optimiser=fits.gauss_newton(), spp=spp, seed=SEED,
        max_depth=DEPTH, steps=14,
    )  # fmt: skip

    off, at_start = errors(fit.parameters[NAME], truth), errors(away, truth)
    way = np.array([errors(found, truth) for found in fit.history[NAME]])
    numbers = {
        "side": side, "spp": spp, "reference spp": reference, "seconds": fit.seconds, "steps": len(fit.history["step"]),
        "seconds compiling": fit.history["seconds"][0], "distance over size": off[0], "degrees": off[1],
        "distance over size at the start": at_start[0], "degrees at the start": at_start[1],
        "standard errors of the position over size": (np.asarray(fit.stderr[NAME])[:3, 3] / SIZE).tolist(),
    }  # fmt: skip
    seconds = fit.history["seconds"]
    curves = {
        "loss": (seconds, fit.history["loss"]),
        "distance / size": (seconds, way[:, 0]), "degrees": (seconds, way[:, 1]),
    }  # fmt: skip
    shown = fits.on_the_way(start, fit, 256, max_depth=DEPTH) | {"target": target}
    fits.write(HERE, SEED, numbers, curves, shown)
    print(
        f"the box's middle within {100 * off[0]:.2f} % of its size and its turn within {off[1]:.2f}° after "
        f"{len(seconds)} steps and {fit.seconds:.1f} s, of which {seconds[0]:.1f} s to the end of the first step "
        f"(compiling); at the start {100 * at_start[0]:.0f} % and {at_start[1]:.0f}°"
    )


if __name__ == "__main__":
    main()
