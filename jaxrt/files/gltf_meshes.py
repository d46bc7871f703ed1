"""Meshes of glTF 2.0: the primitives that have triangles, with their normals, texture coordinates and colours."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..parts import Mesh
from .gltf_document import Document
from .gltf_materials import VERTEX_ALPHA, VERTEX_COLOR, Materials, Tint
from .reading import TRIANGLE

_MODES = {0: "points", 1: "lines", 2: "lines", 3: "lines"}


def primitives(file: Document, index: int, materials: Materials) -> Iterator[tuple[str, Mesh]]:
    """The parts of a mesh, and what tells their names from one another."""
    mesh = file.item("meshes", index)
    name = file.name(mesh, f"mesh_{index}")
    table = file.table(mesh, "primitives")
    for k, primitive in enumerate(table):
        where = f"meshes[{index}].primitives[{k}]"
        if not isinstance(primitive, dict):
            file.fail(f"{where} is not a JSON object; export it again")
        attributes, mode = file.entry(primitive, "attributes"), primitive.get("mode", 4)
        if mode not in (4, 5, 6) or "POSITION" not in attributes:
            has = f"{_MODES[mode]}, which have no surface" if mode in (0, 1, 2, 3) else "no triangles"
            file.note(f"{where} of {name!r} has {has}; left out")
            continue
        if "targets" in primitive:
            file.note(f"morph targets of {name!r} are not used")
        suffix = f"_{k}" if len(table) > 1 else ""
        yield suffix, _primitive(file, primitive, mode, name, where, materials)


def _primitive(
    file: Document, primitive: dict[str, Any], mode: int, name: str, where: str, materials: Materials
) -> Mesh:
    attributes = file.entry(primitive, "attributes")
    packed = file.extension(primitive, "KHR_draco_mesh_compression")
    if packed and "bufferView" not in file.item("accessors", attributes["POSITION"]):
        file.fail(f"{where} is compressed (KHR_draco_mesh_compression); export it without")
    vertices = file.accessor(attributes["POSITION"], ("VEC3",))

    def column(attribute: str, what: str, *kinds: str) -> np.ndarray | None:
        if attribute not in attributes:
            return None
        a = file.accessor(attributes[attribute], kinds)
        if len(a) != len(vertices):
            file.fail(f"{where} has {len(vertices)} vertices but {len(a)} {what}; export it again")
        return a

    corners = np.arange(len(vertices))
    if "indices" in primitive:
        corners = file.accessor(primitive["indices"], ("SCALAR",))[:, 0]
        if corners.dtype.kind != "u" or corners.max(initial=0) >= len(vertices):
            file.fail(f"{where} names a vertex outside 0..{len(vertices) - 1}; export it again")
    if len(corners) < 3 or (mode == 4 and len(corners) % 3):
        file.fail(f"{where} has {len(corners)} corners, which are not triangles; export it again")
    file.spend(TRIANGLE // 3 * len(corners))
    used, faces = np.unique(_triangles(corners.astype(np.int64), mode), return_inverse=True)
    numbers = (key.removeprefix("TEXCOORD_") for key in attributes if key.startswith("TEXCOORD_"))
    colors = column("COLOR_0", "colours", "VEC3", "VEC4")
    tint, values = _tint(None if colors is None else colors[used])
    look = materials.get(primitive.get("material"), frozenset(int(n) for n in numbers if n.isdecimal()), tint)
    columns = {
        "normals": column("NORMAL", "normals", "VEC3"),
        "uvs": column(f"TEXCOORD_{look.coordinates}", "uvs", "VEC2"),
    }
    tangents = column("TANGENT", "tangents", "VEC4")
    if tangents is not None and look.turned and (tangents[used, 3] < 0).any():
        file.note(f"{where} of {name!r}: where its texture coordinates are mirrored, slopes of normals are turned over")
    columns = {key: None if a is None else a[used] for key, a in columns.items()}
    return Mesh(
        id=name,
        vertices=vertices[used],
        faces=faces.reshape(-1, 3),
        bsdf=look.bsdf,
        attributes=values,
        **columns,
        **look.emission,
    )


def _tint(colors: np.ndarray | None) -> tuple[Tint, dict[str, np.ndarray]]:
    """Colours of vertices as a material takes them, and as attributes of a mesh where they vary."""
    if colors is None:
        return None, {}
    colors = np.clip(np.nan_to_num(colors.astype(np.float64)), 0.0, 1.0)
    if (colors == colors[0]).all():
        return (*colors[0].tolist(), 1.0)[:4], {}
    alpha = {VERTEX_ALPHA: colors[:, 3:]} if colors.shape[1] == 4 and (colors[:, 3] < 1).any() else {}
    return 3 + len(alpha), {VERTEX_COLOR: colors[:, :3], **alpha}


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """Triangles of a list (4), strip (5) or fan (6), as 3.7.2.1 orders them."""
    if mode == 4:
        return corners.reshape(-1, 3)
    i = np.arange(len(corners) - 2)
    order = (i, i + 1 + i % 2, i + 2 - i % 2) if mode == 5 else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1)]


def unmirrored(mesh: Mesh) -> Mesh:
    """A transform that mirrors turns the winding of front faces (3.7.4): apply it, and turn the faces back."""
    linear, normals = mesh.to_world[:3, :3], mesh.normals
    if normals is not None:
        normals = normals @ np.linalg.inv(linear)  # the inverse transpose, on rows
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    vertices = mesh.vertices @ linear.T + mesh.to_world[:3, 3]
    return dataclasses.replace(mesh, vertices=vertices, normals=normals, faces=mesh.faces[:, ::-1], to_world=np.eye(4))
