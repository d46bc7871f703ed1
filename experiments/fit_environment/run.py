"""Is the light around a scene found again from one picture of three balls in it?

    python experiments/fit_environment/run.py [--quick]

Target: a mirror, a rough and a painted ball on a disk, under a picture of the sky with a bright window. The start has
the sky even. Adam on relative residuals. The answer is checked by what it lights: a picture from another side, of
painted balls alone. Writes results/fit_environment.json (numbers, machine, versions, seed) and .png: skies, loss.
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
from stages import look_at  # noqa: E402

import jaxrt  # noqa: E402

SEED = 0
NAME = "sky.radiance.data"


def sky(height: int) -> np.ndarray:
    """A picture of 2 height x height pixels: a gradient, warm at the horizon, and a window fifteen times as bright."""
    v, u = np.mgrid[:height, : 2 * height] + 0.5
    v, u = v / height, u / (2 * height)
    level = 0.25 + 0.75 * np.cos(np.pi * (v - 0.4)) ** 2
    picture = level[..., None] * np.stack([0.9 - 0.3 * v, 0.8 - 0.1 * v, 0.6 + 0.4 * (1 - v)], -1)
    window = (np.abs(u - 0.3) < 0.06) & (np.abs(v - 0.35) < 0.1)
    return np.where(window[..., None], [15.0, 13.0, 10.0], picture).astype(np.float32)


def balls(picture: np.ndarray, side: int, painted: bool = False) -> jaxrt.Scene:
    paint = jaxrt.Diffuse([0.6, 0.5, 0.4], id="paint")
    mirror = paint if painted else jaxrt.Conductor(id="mirror", specular_reflectance=0.9)
    rough = paint if painted else jaxrt.Conductor(id="rough", alpha=0.25, specular_reflectance=0.8)
    flat = np.eye(4)
    flat[:3, :3] = np.array([[3.0, 0, 0], [0, 0, 3.0], [0, -3.0, 0]])
    shapes = [
        jaxrt.Disk(id="ground", to_world=flat, bsdf=paint),
        jaxrt.Sphere(id="left", center=(-1.1, 0.5, 0), radius=0.5, bsdf=mirror),
        jaxrt.Sphere(id="middle", center=(0, 0.5, 0), radius=0.5, bsdf=rough),
        jaxrt.Sphere(id="right", center=(1.1, 0.5, 0), radius=0.5, bsdf=paint),
    ]
    from_ = (3.0, 2.0, -3.0) if painted else (0.0, 1.6, 4.2)
    camera = jaxrt.Sensor(to_world=look_at(from_, (0, 0.4, 0)), fov=42.0, film=jaxrt.Film(side, side * 3 // 4, "box"))
    enclosure = jaxrt.Enclosure(jaxrt.Bitmap(picture), id="sky")
    return jaxrt.Scene.build(shapes, sensors=[camera], enclosure=enclosure, integrator=jaxrt.Integrator(3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a coarser sky and fewer steps: under a minute")
    args = parser.parse_args()
    height, side, steps, reference = (6, 32, 150, 1024) if args.quick else (16, 64, 200, 2048)
    truth = sky(height)
    even = np.full_like(truth, truth.mean())
    target = jaxrt.render(balls(truth, side), spp=reference, seed=SEED + 1, method="path").image
    frames: dict[str, np.ndarray] = {"start": even}
    kept = fits.keeper(NAME, truth.shape, steps, frames)
    fit = jaxrt.fit(balls(even, side), target, NAME, loss="relative", spp=16, steps=steps, seed=SEED, progress=kept)
    found = np.asarray(fit.parameters[NAME]).reshape(truth.shape)
    lit = lambda picture: jaxrt.render(balls(picture, side, True), spp=reference, seed=SEED + 2, method="path").image
    other = lit(truth)
    above = lambda a: float(np.median(np.abs(a / truth - 1)[: height // 2]))  # what lies below the ground is not seen
    numbers = {
        "texels": height * 2 * height, "side": side, "steps": steps, "seconds": fit.seconds,
        "seconds compiling": fit.history["seconds"][0],
        "relMSE of the other picture": jaxrt.relative_mse(lit(found), other),
        "relMSE of the other picture at the start": jaxrt.relative_mse(lit(even), other),
        "median error above the horizon": above(found), "median error above the horizon at the start": above(even),
    }  # fmt: skip
    curves = {"loss": (fit.history["seconds"], fit.history["loss"])}
    shown = frames | {"truth": truth, "target": target}
    fits.write(HERE, SEED, numbers, curves, shown)
    rms = lambda name: 100 * numbers[f"relMSE of {name}"] ** 0.5
    print(
        f"{truth.size} numbers of a sky after {steps} steps and {fit.seconds:.1f} s: other balls under it are within "
        f"{rms('the other picture'):.1f} % (root of relMSE, once {rms('the other picture at the start'):.0f} %), "
        f"half of the sky above the horizon within {100 * above(found):.0f} % ({100 * above(even):.0f} %)"
    )


if __name__ == "__main__":
    main()
