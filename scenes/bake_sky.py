"""Writes the light from all around a Mitsuba scene, such as sunsky's, into a picture, which jaxrt can take for it.

    python scenes/bake_sky.py SCENE.xml [-o SKY.exr] [--width 2048]

Mitsuba (with LLVM) evaluates its emitter, with the tables of Hosek and Wilkie that it comes with; the element that this
prints then stands in the scene for that emitter. Texels are means of 16 directions around them, and of 1024 where those
differ, or a neighbour's; so the sun, 3 texels across at the default width, sends as much light, to half a percent.
"""

import argparse
from pathlib import Path

import numpy as np

from jaxrt.files.image import write_exr

CHUNK = 1 << 20
"""Directions that are evaluated at once."""


def directions(texels: np.ndarray, width: int, side: int) -> np.ndarray:
    """Around texels of an envmap, (N, side², 3): rows from +y to −y, both poles included, columns from −z by +x."""
    within = (np.arange(side) + 0.5) / side - 0.5
    across, down = np.meshgrid(within, within)
    row, column = (a[:, None] for a in np.divmod(texels, width))
    theta = np.abs(row + down.ravel()) * np.pi / (width // 2 - 1)
    phi = 2 * np.pi * (column + 0.5 + across.ravel()) / width
    s = np.sin(theta)
    return np.stack([np.sin(phi) * s, np.cos(theta), -np.cos(phi) * s], -1)


def bake(scene: Path, width: int) -> np.ndarray:
    """Radiance from all directions of the world, (width/2, width, 3)."""
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    emitter = mitsuba.load_file(str(scene)).environment()
    if emitter is None:
        raise SystemExit(f"{scene}: has no light from all around")

    def means(texels: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Of each texel, and whether what it is the mean of differs."""
        found, differs = np.zeros((len(texels), 3), np.float32), np.zeros(len(texels), bool)
        for first in range(0, len(texels), CHUNK // side**2):
            part = slice(first, first + CHUNK // side**2)
            d = directions(texels[part], width, side)
            seen = drjit.zeros(mitsuba.SurfaceInteraction3f, d.size // 3)
            seen.wi = -mitsuba.Vector3f(*d.reshape(-1, 3).T.astype(np.float32))
            radiance = np.array(emitter.eval(seen)).T.reshape(d.shape)
            found[part] = radiance.mean(1)
            differs[part] = (np.ptp(radiance, 1) > 0.2 * found[part]).any(-1)
        return found, differs

    picture, differs = means(np.arange(width * width // 2), 4)
    near = differs.reshape(-1, width)
    for axis in (0, 1):  # and their neighbours, of which those directions may have missed a corner
        near = near | np.roll(near, 1, axis) | np.roll(near, -1, axis)
    differs = near.ravel()
    picture[differs] = means(np.flatnonzero(differs), 32)[0]
    return picture.reshape(width // 2, width, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("sky.exr"))
    parser.add_argument("--width", type=int, default=2048)
    asked = parser.parse_args()
    write_exr(asked.output, bake(asked.scene, asked.width))
    print(f'<emitter type="envmap"><string name="filename" value="{asked.output.name}"/></emitter>')


if __name__ == "__main__":
    main()
