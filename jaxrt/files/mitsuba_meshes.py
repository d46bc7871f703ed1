"""Meshes of a Mitsuba scene, from files, with the normals and the front that Mitsuba gives them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .. import parts
from .mesh import MeshData, smooth_normals
from .mitsuba_context import Context
from .mitsuba_xml import Element
from .obj import read_obj
from .ply import read_ply
from .serialized import read_serialized


def mesh(ctx: Context, element: Element, fields: dict[str, Any]) -> dict[str, Any]:
    """Normals as Mitsuba has them: the file's, else smooth ones computed in the world, else (face_normals) none."""
    (reader, option), path = READERS[element.plugin], ctx.file(element)
    given = option(ctx, element)
    try:
        read = reader(path, given)
    except parts.SceneError as problem:
        element.fail(problem)
    vertices, faces, normals = read.vertices, read.faces, read.normals
    linear = fields["to_world"][:3, :3]
    if ctx.boolean(element, "face_normals", False):
        normals = None
    else:
        world = vertices @ linear.T
        if normals is None:
            normals = smooth_normals(world, faces)
        else:
            normals = _unit(normals @ np.linalg.inv(linear))
            faces = _wound(world, faces, normals)
        # back into the shape's space: a normal's way to the world is the inverse transpose
        normals = None if _flat_anyway(world, faces, normals) else _unit(normals @ linear)
    return {"vertices": vertices, "faces": faces, "normals": normals, "uvs": read.uvs, "attributes": read.attributes}


READERS: dict[str, tuple[Callable[[Any, Any], MeshData], Callable[[Context, Element], Any]]] = {
    "obj": (read_obj, lambda ctx, element: ctx.boolean(element, "flip_tex_coords", True)),
    "ply": (read_ply, lambda ctx, element: ctx.boolean(element, "flip_tex_coords", False)),
    "serialized": (read_serialized, lambda ctx, element: ctx.integer(element, "shape_index", 0)),
}
"""Readers of files, and of the parameter that each has."""


def _wound(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Faces wound so that their front is where the vertex normals point, which is what counts in Mitsuba."""
    opposed = (_crossed(vertices, faces) * normals[faces].sum(1)).sum(1) < 0
    return np.where(opposed[:, None], faces[:, ::-1], faces)


def _flat_anyway(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> bool:
    """Whether vertex normals only repeat the faces' (to float32), so that the picture is the same without them."""
    face = _crossed(vertices, faces)
    proper = (face != 0).any(1)
    return bool((abs(normals[faces[proper]] - _unit(face[proper])[:, None]) < 1e-6).all())


def _crossed(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
