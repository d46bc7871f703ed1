"""The hierarchy of a glTF scene: which nodes there are, where they stand, and the cameras and lights on them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..parts import Film, Sensor
from .gltf_document import Document
from .reading import COPY

_CAMERA = np.diag([-1.0, 1.0, -1.0, 1.0])  # theirs looks along −z with +x right, ours along +z with +x left


def nodes(file: Document) -> Iterator[tuple[int, dict[str, Any], np.ndarray]]:
    """Every node of the scene with its number and place in the world, parents before children."""
    table, scenes = file.table(file.json, "nodes"), file.table(file.json, "scenes")
    if scenes:
        number = file.integer(file.json, "scene", 0)
        scene = file.item("scenes", number)
        roots = file.table(scene, "nodes")
        if len(scenes) > 1:
            file.note(f"of {len(scenes)} scenes, {file.name(scene, f'scenes[{number}]')!r} is taken")
    else:
        below = [c for n in range(len(table)) for c in file.table(file.item("nodes", n), "children")]
        roots = [n for n in range(len(table)) if n not in {c for c in below if isinstance(c, int)}]
    stack = [(n, np.eye(4)) for n in reversed(roots)]
    seen = set()
    while stack:
        number, parent = stack.pop()
        node = file.item("nodes", number)
        if number in seen:
            file.fail(f"nodes[{number}] has two parents or contains itself; export it again")
        seen.add(number)
        to_world = parent @ _local(file, node, f"nodes[{number}]")
        yield number, node, to_world
        stack += [(n, to_world) for n in reversed(file.table(node, "children"))]


def _local(file: Document, node: dict[str, Any], where: str) -> np.ndarray:
    """Column-major `matrix`, or translation · rotation · scale (3.5.3)."""
    if "matrix" in node:
        return file.numbers(node, "matrix", np.eye(4).ravel(), where).reshape(4, 4).T
    rotation = file.numbers(node, "rotation", [0.0, 0.0, 0.0, 1.0], where)
    scale = file.numbers(node, "scale", [1.0, 1.0, 1.0], where)
    return _placed(file, file.numbers(node, "translation", [0.0, 0.0, 0.0], where), rotation, scale, where)


def _placed(file: Document, translation: Any, rotation: np.ndarray, scale: Any, where: str) -> np.ndarray:
    x, y, z, w = rotation
    n = float(rotation @ rotation)
    if not 0 < n < math.inf:
        file.fail(f"{where}.rotation is no quaternion; export it again")
    m = np.eye(4)
    m[:3, :3] = np.eye(3) - 2 / n * np.array(
        [[y * y + z * z, z * w - x * y, -x * z - y * w], [-x * y - z * w, x * x + z * z, x * w - y * z],
         [y * w - x * z, -y * z - x * w, x * x + y * y]]
    )  # fmt: skip
    m[:3, :3] *= scale
    m[:3, 3] = translation
    return m


def copies(file: Document, node: dict[str, Any], where: str) -> list[np.ndarray]:
    """Where a node's mesh stands, seen from the node: once, or as often as EXT_mesh_gpu_instancing says."""
    given = file.entry(file.extension(node, "EXT_mesh_gpu_instancing"), "attributes")
    kinds = {"TRANSLATION": ("VEC3", [0.0] * 3), "ROTATION": ("VEC4", [0.0, 0, 0, 1]), "SCALE": ("VEC3", [1.0] * 3)}
    found = {key: file.accessor(given[key], (kind,)) for key, (kind, _) in kinds.items() if key in given}
    if not found:
        return [np.eye(4)]
    counts = {len(a) for a in found.values()}
    if len(counts) > 1:
        file.fail(f"{where} has {min(counts)} and {max(counts)} values of its instances; export it again")
    count = counts.pop()
    file.spend(COPY * count)
    rows = [found.get(key, np.tile(default, (count, 1))).astype(np.float64) for key, (_, default) in kinds.items()]
    return [_placed(file, t, q, s, f"{where}.instance") for t, q, s in zip(*rows, strict=True)]


def sensor(file: Document, index: int, name: str, to_world: np.ndarray) -> Sensor:
    """A camera (3.10), 512 pixels high. Its node's scale only sets the unit of its lengths."""
    entry, where = file.item("cameras", index), f"cameras[{index}]"
    kind = entry.get("type")
    if kind not in ("perspective", "orthographic"):
        file.fail(f"{where} is of type {str(kind)[:20]!r}, not perspective or orthographic; export it again")
    values = file.entry(entry, kind)
    back, up = to_world[:3, 2], to_world[:3, 1]
    scale = float(np.linalg.norm(back))
    z = back / scale
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3] = np.stack([x, np.cross(z, x), z, to_world[:3, 3]], 1)
    pose = pose @ _CAMERA
    near = float(file.numbers(values, "znear", 0.0, where)) * scale
    far = float(file.numbers(values, "zfar", 1e10, where)) * scale  # without one the view has no end
    if kind == "orthographic":
        half = file.numbers(values, "xmag", 1.0, where), file.numbers(values, "ymag", 1.0, where)
        width, height = (abs(float(v)) * scale for v in half)
        if not (width > 0 and height > 0):
            file.fail(f"{where} has xmag or ymag 0; export it again")
        pose = pose @ np.diag([width, width, 1.0, 1.0])
        lens: dict[str, Any] = {"kind": kind}
        aspect = width / height
    else:
        fov = math.degrees(float(file.numbers(values, "yfov", math.radians(50), where)))
        aspect = float(file.numbers(values, "aspectRatio", 4 / 3, where))  # if missing: that of our default film
        lens = {"fov": fov, "fov_axis": "y"}
    if not 1 / 64 <= aspect <= 64:  # beyond, no picture: 512 by 32768 pixels
        file.fail(f"{where} has the aspect ratio {aspect:g}; give one between 1/64 and 64")
    film = Film(round(512 * aspect), 512)
    near = near if near > 0 else scale * 1e-3
    return Sensor(to_world=pose, near=near, far=max(far, near * 1.001), film=film, id=name, **lens)
