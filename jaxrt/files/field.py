"""A field as a mesh that any viewer shows: its elements, coloured by their radiance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .image import to_srgb
from .writing import replacing

if TYPE_CHECKING:
    from ..solver.field import Field


def write_field(file: str | Path, field: Field, exposure: float = 0.0) -> None:
    """Writes a binary `.ply`: a polygon for each piece of an element, sRGB colours, and radiance as floats. Atomic.

    Vertices are not shared, so that elements are seen as they are. Raises `SceneError` for another suffix or a folder
    that cannot be written.
    """
    import trimesh

    from ..parts import SceneError
    from ..solver.elements import corners_of_pieces

    if Path(file).suffix.lower() != ".ply":
        raise SceneError(f"{file}: a field is written as .ply; change the suffix")
    corners, element, cut = corners_of_pieces(field.world, field.elements)  # (P, 4, 3)
    radiance = np.asarray(field.values, np.float32)[element]
    rgb = np.broadcast_to(radiance, (len(element), 3)) if radiance.shape[-1] == 1 else radiance[:, :3]
    colors = np.repeat(to_srgb(np.ascontiguousarray(rgb[:, None]), exposure)[:, 0], 4, 0)
    start = 4 * np.arange(len(element))[:, None]
    faces = np.concatenate([start + np.array([0, 1, 2]), (start + np.array([1, 3, 2]))[~cut]])
    mesh = trimesh.Trimesh(
        corners.reshape(-1, 3),
        faces,
        vertex_colors=np.concatenate([colors, np.full((len(colors), 1), 255, np.uint8)], 1),
        vertex_attributes={name: np.repeat(rgb[:, k], 4) for k, name in enumerate(("red_W", "green_W", "blue_W"))},
        process=False,
    )
    with replacing(file) as part, open(part, "wb") as out:
        mesh.export(out, file_type="ply", vertex_normal=False)
