"""Are a scene's lamps large and near, so that it pays to sample them by solid angle? Asked once, on the host."""

from __future__ import annotations

import numpy as np

from .sampling.warp import CORNERS, FAINTEST
from .scene import Scene


def solid_angle_pays(scene: Scene, lights: np.ndarray) -> bool:
    """Whether sampling the flat ones of these faces by solid angle lowers the variance of direct light enough.

    True if at random points of the surfaces, each weighted by its light, the squared error of a sample by area
    exceeds that of one by solid angle by more than a tenth of the squared signal. Occlusion is left out.
    """
    counts, blocks = np.asarray(scene.counts), scene.blocks
    flat = np.concatenate([np.arange(counts[0]), blocks[0] + np.arange(counts[1])])
    lamps = lights[lights < sum(blocks[:2])]
    if not lamps.size:
        return False
    some = lambda faces: np.random.default_rng(0).choice(faces, 4096) if len(faces) > 4096 else faces
    to_world, shape, flip = (np.asarray(a) for a in (scene.to_world, scene.face_shape, scene.flip))

    def rows(faces: np.ndarray) -> np.ndarray:
        triangle, local = faces < blocks[0], np.zeros((len(faces), 3, 3))
        corner = np.asarray(scene.vertices)[np.asarray(scene.triangles)[faces[triangle]]]
        local[triangle] = np.stack([corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], 1)
        local[~triangle] = np.asarray(scene.patches)[faces[~triangle] - blocks[0]].reshape(-1, 3, 3)
        m, side = to_world[shape[faces]], flip[shape[faces]]
        world = np.einsum("nij,nkj->nki", m[:, :3, :3], local)
        world[:, 0] += m[:, :3, 3]
        turned = side * np.where(triangle, 1.0, np.sign(np.linalg.det(m[:, :3, :3])))
        world[:, 1:] = np.where((turned < 0)[:, None, None], world[:, :0:-1], world[:, 1:])
        return world.reshape(-1, 9)

    lamps = some(lamps)
    return _compare(rows(some(flat)), rows(lamps), lamps >= blocks[0])


def _compare(surfaces: np.ndarray, lamps: np.ndarray, four: np.ndarray) -> bool:
    """`solid_angle_pays` for corners and edges (n, 9) in the world; `four`: which lamps have four corners."""
    random = np.random.default_rng(0)
    size = lambda rows: np.linalg.norm(np.cross(rows[:, 3:6], rows[:, 6:9]), axis=-1)

    def chosen(rows: np.ndarray, n: int = 256) -> np.ndarray:
        return random.choice(len(rows), n, p=size(rows) / size(rows).sum())

    def places(n: int, triangle: np.ndarray) -> np.ndarray:
        uv = random.uniform(size=(2, len(triangle), n))
        return np.where(triangle[:, None] & (uv.sum(0) > 1), 1 - uv, uv)

    def points(rows: np.ndarray, uv: np.ndarray) -> np.ndarray:
        return rows[:, None, :3] + uv[0][..., None] * rows[:, None, 3:6] + uv[1][..., None] * rows[:, None, 6:9]

    def cosines(to: np.ndarray, rows: np.ndarray) -> np.ndarray:
        n = np.cross(rows[:, 3:6], rows[:, 6:9])[:, None]
        return (to * n).sum(-1) / np.maximum(np.linalg.norm(to, axis=-1) * np.linalg.norm(n, axis=-1), 1e-30)

    if not (size(surfaces).sum() > 0 and size(lamps).sum() > 0):
        return False
    of_lamp = chosen(lamps)
    surface, lamp, four = surfaces[chosen(surfaces)], lamps[of_lamp], four[of_lamp]
    x, uv = points(surface, places(1, np.ones(len(surface), bool))), places(16, ~four)
    to = points(lamp, uv) - x
    area = size(lamp) * np.where(four, 1.0, 0.5)
    g = area[:, None] * np.maximum(-cosines(to, lamp), 0.0) / np.maximum((to**2).sum(-1), 1e-30)
    c = np.abs(cosines(to, surface))
    signal = (g * c).mean(-1) ** 2
    corners = np.where(four[:, None], *(np.array(CORNERS[k]).T[:, None] for k in ("parallelogram", "triangle")))
    toward = points(lamp, corners) - x
    light = np.abs(cosines(toward, surface)) / np.maximum((toward**2).sum(-1), 1e-30) ** 1.5
    light = FAINTEST + (1.0 - FAINTEST) * light / np.maximum(light.mean(-1, keepdims=True), 1e-30)
    low = uv[0] < uv[1]  # the square that a triangle is sampled from is folded along its diagonal
    folded = np.where(low, 2 * uv[0], uv.sum(0)), np.where(low, uv.sum(0), 2 * uv[1])
    a, b = (np.where(four[:, None], v, w) for v, w in zip(uv, folded, strict=True))
    w00, w10, w01, w11 = light.T[..., None]
    drawn = (1 - b) * ((1 - a) * w00 + a * w10) + b * ((1 - a) * w01 + a * w11)
    by_area = (g * g * c * c / drawn).mean(-1) - signal
    by_solid_angle = g.mean(-1) * (g * c * c).mean(-1) - signal
    return bool((by_area - by_solid_angle).sum() > 0.1 * signal.sum())
