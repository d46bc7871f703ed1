"""Where is an object behind a screen, of which a camera sees only what light from it does to the walls?

    python experiments/fit_hidden/run.py [--quick]

Target: a room with a screen, and a white cube behind it, which casts its shadow where the camera does not look either.
That nothing of it is seen or shades what is seen is checked: pictures by direct light with the cube here and there are
the same. Start: the cube .7 away. Least squares (Gauss-Newton) on residuals of the picture and its halves; it moves
along two directions. Writes results/fit_hidden.json (numbers, machine, versions, seed) and .png: target, pictures on
the way, ten times their difference from the target, loss and errors.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
import fits  # noqa: E402

fits.use_cores()
import stages  # noqa: E402

import jaxrt  # noqa: E402

SEED, DEPTH = 0, 3
NAME = "cube.to_world"
DIRECTIONS = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
ROOM = 5.0  # between the walls


def room(side: int) -> jaxrt.Scene:
    """A room with a white cube behind a screen."""
    place = np.diag([0.4, 0.4, 0.4, 1.0])
    place[:3, 3] = (-1.0, 0.45, -1.0)
    wide = stages.placed(1.0, (-0.9, 0.85, 0.3), "z")
    wide[:3, :2] *= (1.6, 0.85)
    screen = jaxrt.Rectangle(id="screen", to_world=wide, bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.1)))
    cube = jaxrt.Cube(id="cube", to_world=place, bsdf=jaxrt.Diffuse(0.9))
    made = stages.room(side, screen, cube=cube, floor=jaxrt.Diffuse(0.2), lamp=30.0)
    low, camera = stages.placed(0.4, (-0.9, 1.5, -0.8), "-y"), stages.look_at((1.2, 2.2, 4.5), (-0.3, 1.3, 0.0))
    return jaxrt.with_params(made, {"lamp.to_world": low, "sensor.to_world": camera})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer samples and steps")
    args = parser.parse_args()
    side, spp, steps, reference = (24, 64, 6, 2048) if args.quick else (24, 256, 10, 8192)
    scene = room(side)
    picture = lambda s, depth, n: jaxrt.render(s, spp=n, seed=SEED + 1, method="path", max_depth=depth).image
    truth = np.asarray(jaxrt.params(scene)[NAME])
    start = jaxrt.with_params(scene, {NAME: np.array(stages.shifted(truth, (-0.5, 0.0, -0.5)))})
    seen = float(np.abs(picture(scene, 2, 64) - picture(start, 2, 64)).max())
    target = picture(scene, DEPTH, reference)
    fit = jaxrt.fit(
        start, target, {NAME: jaxrt.Shift(DIRECTIONS)}, loss="multiscale", optimiser=fits.gauss_newton(),
        spp=spp, seed=SEED, max_depth=DEPTH, steps=steps,
    )  # fmt: skip

    far = lambda place: float(np.linalg.norm(np.asarray(place)[:3, 3] - truth[:3, 3]))
    off, seconds = np.array([far(place) for place in fit.history[NAME]]), fit.history["seconds"]
    change = float(np.sqrt(jaxrt.relative_mse(picture(start, DEPTH, reference), target)))
    numbers = {
        "side": side, "spp": spp, "reference spp": reference, "seconds": fit.seconds, "steps": len(seconds),
        "seconds compiling": seconds[0], "distance": off[-1], "distance at the start": far(jaxrt.params(start)[NAME]),
        "difference of pictures by direct light": seen, "relative difference of pictures at the start": change,
        "standard errors of the position": np.asarray(fit.stderr[NAME])[:3, 3].tolist(),
    }  # fmt: skip
    curves = {"loss": (seconds, fit.history["loss"]), "distance": (seconds, off)}
    way = fits.on_the_way(start, fit, reference // 4, max_depth=DEPTH)
    shown: dict[str, Any] = {title: 0.5 + 10 * (image - target) for title, image in way.items()}
    fits.write(HERE, SEED, numbers, curves, {"target": target} | shown)
    print(
        f"the hidden cube within {off[-1]:.3f} of its place ({100 * off[-1] / ROOM:.2f} % of the room) after "
        f"{len(seconds)} steps and {fit.seconds:.1f} s, of which {seconds[0]:.1f} s to the end of the first step "
        f"(compiling); at the start {numbers['distance at the start']:.2f}, where the picture was "
        f"{100 * change:.1f} % off, and that by direct light {seen:g}"
    )


if __name__ == "__main__":
    main()
