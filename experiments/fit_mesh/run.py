"""Does a ball take another shape from a few pictures of it?

    python experiments/fit_mesh/run.py [--quick]

Target: a blob with four bumps, of more triangles than the ball, under two lamps, from views all around. Start: a ball.
Adam of one step size on smooth displacements of the ball's vertices, by l2 of the pictures. The answer is checked by
the distance of its vertices from the target's surface. Writes results/fit_mesh.json (numbers, machine, versions, seed)
and .png: targets, the first view on the way, loss.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
import optax
import trimesh

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
import fits  # noqa: E402

fits.use_cores()
import stages  # noqa: E402

import jaxrt  # noqa: E402

SEED, DEPTH = 0, 2
NAME = "ball.vertices"


def blob(level: int) -> tuple[np.ndarray, np.ndarray]:
    """A ball of radius .7 with bumps of up to 30 %, along the diagonals of a cube that make a tetrahedron."""
    vertices, faces = stages.icosphere(level)
    bumps = 0.3 * 3**1.5 * vertices.prod(1)
    return 0.7 * vertices * (1 + bumps[:, None]), faces


def room(vertices: np.ndarray, faces: np.ndarray, side: int, views: int) -> jaxrt.Scene:
    """A mesh between two lamps, above and below, seen from points around it, high and low by turns."""
    around = 2 * np.pi * np.arange(views) / views
    eyes = 3.5 * np.stack([np.cos(around), 0.9 * (-1.0) ** np.arange(views), np.sin(around)], 1)
    film = jaxrt.Film(side, side, "box")
    cameras = [jaxrt.Sensor(to_world=stages.look_at(eye, (0, 0, 0)), fov=26.0, film=film) for eye in eyes]
    lamp = lambda name, at, facing: jaxrt.Rectangle(
        id=name, to_world=stages.placed(0.8, at, facing), emission=25.0, bsdf=stages.BLACK
    )
    shapes = [
        jaxrt.Mesh(id="ball", vertices=vertices, faces=faces, bsdf=jaxrt.Diffuse(0.7)),
        lamp("above", (0.8, 4.5, 0.0), "-y"),
        lamp("below", (-0.8, -4.5, 0.0), "y"),
    ]
    return jaxrt.Scene.build(shapes, sensors=cameras, enclosure=jaxrt.Enclosure(0.2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="smaller pictures, fewer triangles, views and steps: under a minute"
    )
    args = parser.parse_args()
    level, side, views, steps, spp, reference = (2, 24, 4, 35, 8, 512) if args.quick else (3, 32, 6, 60, 8, 1024)
    shape = blob(level + 1)
    surface = trimesh.Trimesh(*shape, process=False)
    scene = room(*shape, side, views)
    sensors = list(range(views))
    shoot = lambda s, k, n=reference: (
        jaxrt.render(s, spp=n, seed=SEED + 1, sensor=k, method="path", max_depth=DEPTH).image
    )
    targets = [shoot(scene, k) for k in sensors]
    vertices, faces = stages.icosphere(level)
    start = room(0.7 * vertices, faces, side, views)
    keep, places = fits.chosen_steps(steps), {"start": 0.7 * vertices}

    def kept(step: int, loss: float, values: dict[str, Any]) -> None:
        if step - 1 in keep:
            places[f"step {step}"] = np.asarray(values[NAME])

    smooth = jaxrt.Smooth(4.0 ** (level - 2))  # as far over the ball on a finer mesh
    optimiser = jaxrt.uniform_adam(optax.cosine_decay_schedule(0.05, steps))
    fit = jaxrt.fit(
        start, targets, {NAME: smooth}, sensor=sensors, optimiser=optimiser, spp=spp, steps=steps, seed=SEED,
        max_depth=DEPTH, progress=kept,
    )  # fmt: skip
    far = lambda place: trimesh.proximity.closest_point_naive(surface, np.asarray(place, float))[1]
    before, after = far(places["start"]), far(fit.parameters[NAME])
    seconds = fit.history["seconds"]
    numbers = {
        "vertices": len(vertices), "side": side, "views": views, "steps": steps, "spp": spp, "reference spp": reference,
        "seconds": fit.seconds, "seconds compiling": seconds[0],
        "mean distance": after.mean(), "largest distance": after.max(),
        "mean distance at the start": before.mean(), "largest distance at the start": before.max(),
    }  # fmt: skip
    shown = {
        title: shoot(jaxrt.with_params(start, {NAME: place}), 0, 256) for title, place in places.items()
    } | {f"target {k}": targets[k] for k in sensors[:2]}  # fmt: skip
    curves = {"loss": (seconds, fit.history["loss"])}
    fits.write(HERE, SEED, numbers, curves, shown)
    print(
        f"{len(vertices)} vertices within {after.mean():.4f} of the target's surface in the mean, {after.max():.3f} at "
        f"most (once {before.mean():.3f} and {before.max():.3f}), after {steps} steps and {fit.seconds:.1f} s, of "
        f"which {seconds[0]:.1f} s to the end of the first step (compiling)"
    )


if __name__ == "__main__":
    main()
