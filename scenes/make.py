"""Makes the meshes of the scenes here: python scenes/make.py. Every file in meshes/ comes from this script.

The Cornell box is the measured one (Goral et al. 1984; data of the Program of Computer Graphics, Cornell
University): no wall of it is quite square, so its parts are quads given by their corners, in millimetres.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.ply import export_ply

FOLDER = Path(__file__).parent / "meshes"

# Corners counter-clockwise as seen from inside the room, or from outside the block.
CORNELL = {
    "cornell_floor": [[(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)]],
    "cornell_back": [[(549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2)]],
    "cornell_left": [[(552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0)]],
}
BLOCKS = {
    "cornell_short": (165, [(130, 65), (82, 225), (240, 272), (290, 114)]),
    "cornell_tall": (330, [(423, 247), (265, 296), (314, 456), (472, 406)]),
}


def block(height: float, base: Sequence[tuple[float, float]]) -> list[list[tuple[float, float, float]]]:
    """The quads of a block on the floor, without its underside. `base`: (x, z), clockwise with z upwards."""
    low, high = [(x, 0.0, z) for x, z in base], [(x, height, z) for x, z in base]
    sides = [[low[k], high[k], high[(k + 1) % 4], low[(k + 1) % 4]] for k in range(4)]
    return [high, *(side[::-1] for side in sides)]


def quads(faces: Sequence[Sequence[tuple[float, float, float]]]) -> trimesh.Trimesh:
    """Two triangles for each quad, with vertices of their own: edges stay sharp."""
    corners = np.array(faces, float).reshape(-1, 3)
    first = 4 * np.arange(len(faces))[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return trimesh.Trimesh(corners, triangles, process=False)


def main() -> None:
    meshes = {name: quads(faces) for name, faces in CORNELL.items()}
    meshes |= {name: quads(block(*shape)) for name, shape in BLOCKS.items()}
    meshes["icosphere"] = trimesh.creation.icosphere(subdivisions=1)  # 80 triangles, radius 1
    meshes["torus"] = trimesh.creation.torus(1.0, 0.4, major_sections=20, minor_sections=8)  # 320 triangles
    FOLDER.mkdir(exist_ok=True)
    for name, mesh in meshes.items():
        text = export_ply(mesh, encoding="ascii", vertex_normal=False)
        (FOLDER / f"{name}.ply").write_bytes(text)


if __name__ == "__main__":
    main()
