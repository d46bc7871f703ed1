"""Triangles as files of meshes hold them, and what the readers of such files share.

They are read by hand: trimesh joins vertices across normals and texture coordinates, does not keep Mitsuba's
vertex order, loses OBJ materials' numbers and takes truncated files for whole ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..parts import SceneError
from .reading import TRIANGLE, take


@dataclasses.dataclass
class MeshData:
    """Triangles: vertices (V, 3), faces (F, 3) int32, unit normals (V, 3) and uvs (V, 2) if the file has them, and
    further values of vertices or faces by name."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    attributes: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)


def fail(path: str | Path, problem: str) -> NoReturn:
    raise SceneError(f"{path}: {problem}")


def listed(names: Sequence[str]) -> str:
    """A list for a note, of a length that can be read."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals (V, 3): the mean of the faces' normals, each weighted by its angle at the vertex.

    G. Thürmer and C. Wüthrich, Computing vertex normals from polygonal facets, 1998. Mitsuba does the
    same for a mesh without normals. A vertex without a proper face gets (1, 0, 0), as there.
    """
    total, p = np.zeros((len(vertices), 3)), np.asarray(vertices, np.float64)[faces]
    face = _unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    for k in range(3):
        a, b = _unit(p[:, (k + 1) % 3] - p[:, k]), _unit(p[:, (k + 2) % 3] - p[:, k])
        weighted = face * np.arccos(np.clip((a * b).sum(1), -1, 1))[:, None]
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], weighted[:, axis], len(vertices))
    total = _unit(total)
    return np.where((total == 0).all(1, keepdims=True), [1.0, 0.0, 0.0], total)


def _unit(v: np.ndarray) -> np.ndarray:
    """Unit vectors; zero and immeasurable ones become zero."""
    largest = np.abs(v).max(-1, keepdims=True, initial=0.0)
    proper = (largest > 0) & np.isfinite(largest)
    v = np.where(proper, v, 0.0) / np.where(proper, largest, 1.0)  # first to the unit cube: squares cannot overflow
    return v / np.where(proper, np.linalg.norm(v, axis=-1, keepdims=True), 1.0)


def checked(path: str | Path, mesh: MeshData) -> MeshData:
    """Finite numbers where a face uses them, and unit normals; a missing (zero) normal becomes the smooth one."""
    take(path, TRIANGLE * len(mesh.faces), "put it into the scene fewer times, as instances of a group")
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    for name, a in (("position", mesh.vertices), ("normal", mesh.normals), ("texture coordinate", mesh.uvs)):
        if a is not None and (bad := np.flatnonzero(~np.isfinite(a).all(1) & used)).size:
            fail(path, f"the {name} of vertex {bad[0]} is not finite; repair the mesh")
    if mesh.normals is not None:
        with np.errstate(over="ignore", invalid="ignore"):  # of vertices that no face uses
            mesh.normals = _unit(mesh.normals)
        if (zero := (mesh.normals == 0).all(1)).any():
            mesh.normals = None if zero[used].all() else mesh.normals
            if mesh.normals is not None:
                mesh.normals[zero] = smooth_normals(mesh.vertices, mesh.faces)[zero]
    return mesh
