"""Is a texture found again from one picture of the surface it is painted on?

    python experiments/fit_texture/run.py [--quick]

Target: a room whose back wall has a bitmap; the start has it grey. Adam, samples anew in each step. Also with pixels
drawn at random. Writes results/fit_texture.json (numbers, machine, versions, seed) and .png: textures on the way, loss.
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
import jaxrt  # noqa: E402

SEED = 0
NAME = "paint.reflectance.data"


def picture(n: int) -> np.ndarray:
    """A texture of n x n texels with large and small features, between .1 and .9."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n
    red = 0.5 + 0.4 * np.sin(6 * x + 2 * y)
    green = np.where((x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.09, 0.85, 0.15)
    blue = np.where((np.floor(4 * x) + np.floor(4 * y)) % 2 == 0, 0.7, 0.2)
    return np.stack([red, green, blue], -1).astype(np.float32)


def pose(middle: tuple[float, float, float], normal: tuple[float, float, float], half: float = 1.0) -> np.ndarray:
    n = np.array(normal, float)
    up = np.array([0.0, 1.0, 0.0]) if abs(n[1]) < 0.5 else np.array([0.0, 0.0, 1.0])
    across = np.cross(up, n)
    m = np.eye(4)
    m[:3, :3] = np.stack([across * half, np.cross(n, across) * half, n], 1)
    m[:3, 3] = middle
    return m


def room(texture: np.ndarray, side: int) -> jaxrt.Scene:
    paint = jaxrt.Diffuse(jaxrt.Bitmap(texture), id="paint")
    white, red = jaxrt.Diffuse(0.7, id="white"), jaxrt.Diffuse([0.6, 0.2, 0.1], id="red")
    walls = [
        jaxrt.Rectangle(id="back", to_world=pose((0, 0, -1), (0, 0, 1)), bsdf=paint),
        jaxrt.Rectangle(id="floor", to_world=pose((0, -1, 0), (0, 1, 0)), bsdf=white),
        jaxrt.Rectangle(id="left", to_world=pose((-1, 0, 0), (1, 0, 0)), bsdf=red),
        jaxrt.Rectangle(id="right", to_world=pose((1, 0, 0), (-1, 0, 0)), bsdf=white),
        jaxrt.Rectangle(id="lamp", to_world=pose((0, 1, 0), (0, -1, 0), 0.7), bsdf=white, emission=[3.0, 3.0, 3.0]),
    ]
    back = np.eye(4)
    back[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    back[:3, 3] = (0.0, 0.0, 1.4)
    film = jaxrt.Film(side, side, "box")
    camera = jaxrt.Sensor(to_world=back, fov=50.0, film=film)
    return jaxrt.Scene.build(walls, sensors=[camera], integrator=jaxrt.Integrator(3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer texels and steps: under a minute")
    args = parser.parse_args()
    n, side, steps, reference = (8, 32, 60, 256) if args.quick else (32, 80, 200, 2048)
    truth = picture(n)
    scene = room(truth, side)
    target = jaxrt.render(scene, spp=reference, seed=SEED + 1, method="path").image
    start = jaxrt.with_params(scene, {NAME: np.full_like(jaxrt.params(scene)[NAME], 0.5)})
    frames: dict[str, np.ndarray] = {"start": np.full_like(truth, 0.5)}
    kept = fits.keeper(NAME, truth.shape, steps, frames)
    common = {"loss": "relative", "spp": 16, "steps": steps, "seed": SEED}
    fit = jaxrt.fit(start, target, NAME, progress=kept, **common)
    some = fit if args.quick else jaxrt.fit(start, target, NAME, pixels=side * side // 4, progress=False, **common)
    off = lambda f: float(np.sqrt(((np.asarray(f.parameters[NAME]).reshape(truth.shape) - truth) ** 2).mean()))
    numbers = {
        "texels": n * n, "side": side, "steps": steps, "rms error": off(fit), "rms error at the start":
        float(np.sqrt(((truth - 0.5) ** 2).mean())), "seconds": fit.seconds,
        "seconds compiling": fit.history["seconds"][0],
        "rms error, a quarter of the pixels": off(some), "seconds, a quarter of the pixels": some.seconds,
    }  # fmt: skip
    curves = {
        "loss": (fit.history["seconds"], fit.history["loss"]),
        "loss, a quarter of the pixels a step": (some.history["seconds"], some.history["loss"]),
    }
    shown = {k: (255 * np.clip(v, 0, 1)).astype(np.uint8) for k, v in (frames | {"truth": truth}).items()}
    fits.write(HERE, SEED, numbers, curves, shown | {"target": target})
    print(
        f"{3 * n * n} numbers of a texture: rms error {off(fit):.4f} after {steps} steps and {fit.seconds:.1f} s "
        f"({fit.history['seconds'][0]:.1f} s of them for the first), from {numbers['rms error at the start']:.3f}; "
        + (
            ""
            if args.quick
            else f"with a quarter of the pixels in each step {off(some):.4f} after {some.seconds:.1f} s"
        )
    )


if __name__ == "__main__":
    main()
