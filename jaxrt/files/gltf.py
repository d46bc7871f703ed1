"""glTF 2.0 (.glb and .gltf), as far as the parts of a scene can express it.

Read from the JSON and the buffers themselves: trimesh rounds material factors to 8 bits and drops
emission strengths. Section numbers are those of the glTF 2.0 specification (Khronos, 2021).
"""

from __future__ import annotations

import base64
import binascii
import copy
import dataclasses
import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn, cast
from urllib.parse import unquote

import numpy as np

from ..parts import Description, Film, Group, Instance, Lamp, Mesh, SceneError, Sensor, matrix
from .gltf_lamps import LAMPS
from .gltf_materials import Materials
from .mesh import fail, listed, read_bytes

SHARED = 4096
"""Triangles that sharing a mesh has to save before its nodes become instances, whose hits cost a little more."""

_KNOWN = {"KHR_materials_emissive_strength", "KHR_mesh_quantization", "KHR_texture_transform", *LAMPS}
_NOTED = {"KHR_texture_basisu", "EXT_texture_webp", "KHR_xmp_json_ld"}
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # 3.6.2.2
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_CAMERA = np.diag([-1.0, 1.0, -1.0, 1.0])  # theirs looks along −z with +x right, ours along +z with +x left


class _File:
    """One document: its JSON and buffers, and look-ups that fail with the name of what is wrong."""

    def __init__(self, path: str | Path):
        self.path, self.notes, self.binary = path, cast(list[str], []), cast(bytes | None, None)
        self.buffers: dict[int, bytes] = {}
        self.arrays: dict[int, np.ndarray] = {}
        data = read_bytes(path)
        if data[:4] == b"glTF":
            data = self._chunks(data)
        try:
            self.json = json.loads(data)
        except (ValueError, RecursionError):
            self.fail("is not glTF, or its JSON is damaged; check the path or export it again")
        if not isinstance(self.json, dict) or not str(self.entry(self.json, "asset").get("version")).startswith("2."):
            self.fail("is not glTF 2; export it as glTF 2.0")
        required = [str(e) for e in self.table(self.json, "extensionsRequired")]
        if missing := sorted(set(required) - _KNOWN - _NOTED):
            self.fail(f"requires {', '.join(missing)}, which jaxrt cannot read; export it without")
        self.budget = 1 << 24  # corners of triangles; 64 more for each byte of data. Beyond, memory is in danger

    def _chunks(self, data: bytes) -> bytes:
        """The JSON of a GLB (4.4); its binary chunk is kept."""
        if len(data) < 20 or int.from_bytes(data[8:12], "little") > len(data):
            self.fail("is truncated; copy or export it again")
        if data[4:8] != b"\2\0\0\0" or data[16:20] != b"JSON":
            self.fail("is not a GLB of version 2; export it as glTF 2.0")
        at, parts = 12, {}
        while at + 8 <= len(data):
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > len(data):
                self.fail("is truncated; copy or export it again")
            parts.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        self.binary = parts.get(b"BIN\0")
        return parts[b"JSON"]

    def fail(self, problem: str) -> NoReturn:
        fail(self.path, problem)

    # Typed look-ups in the JSON

    def entry(self, owner: Any, key: str) -> dict[str, Any]:
        value = owner.get(key, {})
        if not isinstance(value, dict):
            self.fail(f"{key} is not a JSON object; export it again")
        return value

    def table(self, owner: dict[str, Any], key: str) -> list[Any]:
        value = owner.get(key, [])
        if not isinstance(value, list):
            self.fail(f"{key} is not a JSON list; export it again")
        return value

    def item(self, key: str, index: Any) -> dict[str, Any]:
        """The `index`-th entry of a top-level list."""
        table = self.table(self.json, key)
        if not isinstance(index, int) or not 0 <= index < len(table) or not isinstance(table[index], dict):
            self.fail(f"there is no {key}[{index}] among {len(table)}; export it again")
        return table[index]

    def integer(self, owner: dict[str, Any], key: str, default: int | None = None, where: str = "") -> int:
        value = owner.get(key, default)
        if type(value) is not int or not 0 <= value < 1 << 40:
            self.fail(f"{where}{key} is {str(value)[:40]}, not a whole number; export it again")
        return value

    def numbers(self, owner: dict[str, Any], key: str, default: Any, where: str) -> np.ndarray:
        value = owner.get(key, default)
        try:
            a = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            a = np.array(np.nan)
        if a.shape != np.shape(default) or not np.isfinite(a).all():
            self.fail(f"{where}.{key} is {str(value)[:40]}, not {np.size(default)} finite number(s); export it again")
        return a

    def name(self, owner: dict[str, Any], default: str) -> str:
        name = owner.get("name")
        return name if isinstance(name, str) and name else default

    # Buffers

    def buffer(self, index: int) -> bytes:
        if index not in self.buffers:
            entry = self.item("buffers", index)
            uri, size = entry.get("uri"), self.integer(entry, "byteLength", where=f"buffers[{index}].")
            if uri is None and index == 0 and self.binary is not None:
                data = self.binary
            else:
                data = self.content(uri, f"buffers[{index}]")
            if len(data) < size:
                self.fail(f"buffers[{index}] has {len(data)} bytes of {size}; it is truncated, export it again")
            self.buffers[index] = data[:size]
            self.budget += 64 * size
        return self.buffers[index]

    def content(self, uri: Any, where: str) -> bytes:
        """What stands at the URI of `where`, or in it."""
        if not isinstance(uri, str):
            self.fail(f"{where} has no data; export it again")
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2])
            except (binascii.Error, ValueError):
                self.fail(f"{where} holds damaged base64 data; export it again")
        if "://" in uri:
            self.fail(f"{where} is at {uri[:60]}; download it and refer to the local file")
        return read_bytes(Path(self.path).parent / unquote(uri))

    def view(self, index: Any) -> tuple[memoryview, dict[str, Any]]:
        """The bytes of a buffer view (3.6.1), and what the JSON says of it."""
        entry, where = self.item("bufferViews", index), f"bufferViews[{index}]."
        data = memoryview(self.buffer(self.integer(entry, "buffer", where=where)))
        first, length = self.integer(entry, "byteOffset", 0, where), self.integer(entry, "byteLength", where=where)
        if first + length > len(data):
            self.fail(f"{where[:-1]} lies outside of its buffer; it is truncated, export it again")
        return data[first : first + length], entry

    def spend(self, corners: int) -> None:
        self.budget -= corners
        if self.budget < 0:
            self.fail("repeats the same data far too often; export it with fewer copies")

    def accessor(self, index: Any, kinds: tuple[str, ...]) -> np.ndarray:
        """The numbers of an accessor (3.6.2), (count, width); normalised integers as floats."""
        entry, where = self.item("accessors", index), f"accessors[{index}]."
        count, start = self.integer(entry, "count", where=where), self.integer(entry, "byteOffset", 0, where)
        kind, component = entry.get("type"), entry.get("componentType")
        if kind not in kinds or not isinstance(component, int) or component not in _COMPONENTS:
            self.fail(
                f"{where}type is {str(kind)[:20]} of {str(component)[:20]}, not {' or '.join(kinds)}; export it again"
            )
        if "sparse" in entry or "bufferView" not in entry:
            self.fail(f"{where[:-1]} has sparse or compressed data; export it without")
        (data, view), width = self.view(entry["bufferView"]), _WIDTHS[kind]
        dtype = np.dtype(_COMPONENTS[component])
        size = dtype.itemsize * width
        stride = self.integer(view, "byteStride", size, f"bufferViews[{entry['bufferView']}].")
        last = start + stride * (count - 1) + size
        if not count or stride < size or last > len(data):
            self.fail(f"{where[:-1]} lies outside of its buffer; it is truncated, export it again")
        if index not in self.arrays:
            a = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))
            if entry.get("normalized") is True and dtype.kind in "iu":
                a = np.maximum(a / np.iinfo(dtype).max, -1.0)
            self.arrays[index] = a
        return self.arrays[index]


def load_gltf(path: str | Path) -> Description:
    """A glTF scene: meshes with their places, metallic-roughness factors, emission, lights and cameras.

    A metallic factor from 1/2 on makes a `Conductor` with GGX roughness α = roughness², below it a `Diffuse`. Base
    colour, its alpha, emission and normals may have textures. Other textures, animation and further material extensions
    are named in the notes. Raises `SceneError` for a file that is missing, damaged or requires an unknown extension.
    """
    file = _File(path)
    try:
        with np.errstate(all="ignore"):  # whatever overflows is refused by name where a part is made
            return _load(file)
    except SceneError as error:
        if str(error).startswith(f"{path}:"):
            raise
        file.fail(str(error))


def _load(file: _File) -> Description:
    shapes: list[Mesh | Instance] = []
    places: dict[int, list[tuple[str, np.ndarray]]] = {}
    sensors: list[Sensor] = []
    meshes: dict[int, list[tuple[str, Mesh]]] = {}
    materials = Materials(file)
    lamps, hidden = cast(list[Lamp], []), []
    for number, node, to_world in _nodes(file):
        name = file.name(node, f"node_{number}")
        for extension, make in LAMPS.items():
            if extension in file.entry(node, "extensions"):
                lamps.append(make(file, file.entry(node["extensions"], extension), name, to_world))
        if not ("mesh" in node or "camera" in node):
            continue
        if np.linalg.det(to_world[:3, :3]) == 0:  # a usual way to hide something
            hidden.append(name)
            continue
        if "mesh" in node:
            index = file.integer(node, "mesh", where=f"nodes[{number}].")
            if index not in meshes:
                meshes[index] = list(_primitives(file, index, materials))
            places.setdefault(index, []).append((file.name(node, ""), matrix(to_world, f"nodes[{number}]")))
        if "camera" in node:
            index = file.integer(node, "camera", where=f"nodes[{number}].")
            sensors.append(_sensor(file, index, name, to_world))
    for index, where in places.items():
        shapes += _placed(file, meshes[index], where)
    used = {str(e) for e in file.table(file.json, "extensionsUsed")} - _KNOWN
    for what, names in (
        ("scaled to nothing, so left out:", hidden),
        ("extensions are not used:", sorted(used)),
        ("animations are not used, things stand as without:", ["all"] * bool(file.table(file.json, "animations"))),
        ("skins are not used, meshes stand as modelled:", ["all"] * bool(file.table(file.json, "skins"))),
    ):
        if names:
            file.notes.append(f"{file.path}: {what} {listed(names)}")
    if not shapes:
        file.fail("has no triangle meshes in its scene; jaxrt needs surfaces")
    return Description(shapes, sensors, lamps=lamps, notes=list(dict.fromkeys(file.notes)))


def _placed(
    file: _File, meshes: list[tuple[str, Mesh]], where: list[tuple[str, np.ndarray]]
) -> Iterator[Mesh | Instance]:
    """A mesh's parts at each of its nodes: as instances of one group where that saves much, else each for itself."""
    if (len(where) - 1) * sum(len(mesh.faces) for _, mesh in meshes) >= SHARED and all(
        mesh.emission is None for _, mesh in meshes
    ):
        group = Group(shapes=[dataclasses.replace(mesh, id=mesh.id + suffix) for suffix, mesh in meshes])
        for name, to_world in where:
            yield Instance(id=name or meshes[0][1].id, group=group, to_world=to_world)
        return
    for name, to_world in where:
        for suffix, mesh in meshes:
            placed = copy.copy(mesh)  # shares the arrays
            placed.id, placed.to_world = (name or mesh.id) + suffix, to_world
            if np.linalg.det(to_world[:3, :3]) < 0:
                file.spend(3 * len(mesh.faces))
                placed = _unmirrored(placed)
            yield placed


def _nodes(file: _File) -> Iterator[tuple[int, dict[str, Any], np.ndarray]]:
    """Every node of the scene with its number and place in the world, parents before children."""
    nodes = file.table(file.json, "nodes")
    if file.table(file.json, "scenes"):
        scene = file.item("scenes", file.integer(file.json, "scene", 0))
        roots = file.table(scene, "nodes")
    else:
        below = [c for n in range(len(nodes)) for c in file.table(file.item("nodes", n), "children")]
        roots = [n for n in range(len(nodes)) if n not in {c for c in below if isinstance(c, int)}]
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


def _local(file: _File, node: dict[str, Any], where: str) -> np.ndarray:
    """Column-major `matrix`, or translation · rotation · scale (3.5.3)."""
    if "matrix" in node:
        return file.numbers(node, "matrix", np.eye(4).ravel(), where).reshape(4, 4).T
    x, y, z, w = q = file.numbers(node, "rotation", [0.0, 0.0, 0.0, 1.0], where)
    n = float(q @ q)
    if not 0 < n < math.inf:
        file.fail(f"{where}.rotation is no quaternion; export it again")
    m = np.eye(4)
    m[:3, :3] = np.eye(3) - 2 / n * np.array(
        [[y * y + z * z, z * w - x * y, -x * z - y * w], [-x * y - z * w, x * x + z * z, x * w - y * z],
         [y * w - x * z, -y * z - x * w, x * x + y * y]]
    )  # fmt: skip
    m[:3, :3] *= file.numbers(node, "scale", [1.0, 1.0, 1.0], where)
    m[:3, 3] = file.numbers(node, "translation", [0.0, 0.0, 0.0], where)
    return m


def _unmirrored(mesh: Mesh) -> Mesh:
    """A transform that mirrors turns the winding of front faces (3.7.4): apply it, and turn the faces back."""
    linear, normals = mesh.to_world[:3, :3], mesh.normals
    if normals is not None:
        normals = normals @ np.linalg.inv(linear)  # the inverse transpose, on rows
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    vertices = mesh.vertices @ linear.T + mesh.to_world[:3, 3]
    return dataclasses.replace(mesh, vertices=vertices, normals=normals, faces=mesh.faces[:, ::-1], to_world=np.eye(4))


def _primitives(file: _File, index: int, materials: Materials) -> Iterator[tuple[str, Mesh]]:
    mesh = file.item("meshes", index)
    name = file.name(mesh, f"mesh_{index}")
    primitives = file.table(mesh, "primitives")
    for k, primitive in enumerate(primitives):
        where = f"meshes[{index}].primitives[{k}]"
        if not isinstance(primitive, dict):
            file.fail(f"{where} is not a JSON object; export it again")
        attributes, mode = file.entry(primitive, "attributes"), primitive.get("mode", 4)
        if mode not in (4, 5, 6) or "POSITION" not in attributes:
            file.notes.append(f"{file.path}: {where} of {name!r} has no triangles; left out")
            continue
        vertices = file.accessor(attributes["POSITION"], ("VEC3",))
        columns: dict[str, np.ndarray | None] = {"normals": None, "uvs": None}
        for key, attribute, kind in (("normals", "NORMAL", "VEC3"), ("uvs", "TEXCOORD_0", "VEC2")):
            if attribute in attributes:
                columns[key] = a = file.accessor(attributes[attribute], (kind,))
                if len(a) != len(vertices):
                    file.fail(f"{where} has {len(vertices)} vertices but {len(a)} {key}; export it again")
        corners = np.arange(len(vertices))
        if "indices" in primitive:
            corners = file.accessor(primitive["indices"], ("SCALAR",))[:, 0]
            if corners.dtype.kind != "u" or corners.max() >= len(vertices):
                file.fail(f"{where} names a vertex outside 0..{len(vertices) - 1}; export it again")
        if len(corners) < 3 or (mode == 4 and len(corners) % 3):
            file.fail(f"{where} has {len(corners)} corners, which are not triangles; export it again")
        file.spend(3 * len(corners))
        used, faces = np.unique(_triangles(corners.astype(np.int64), mode), return_inverse=True)
        if "targets" in primitive:
            file.notes.append(f"{file.path}: morph targets of {name!r} are not used")
        bsdf, look = materials.get(primitive.get("material"), columns["uvs"] is not None)
        columns = {key: None if a is None else a[used] for key, a in columns.items()}
        vertices, faces = vertices[used], faces.reshape(-1, 3)
        yield (
            f"_{k}" if len(primitives) > 1 else "",
            Mesh(id=name, vertices=vertices, faces=faces, bsdf=bsdf, **columns, **look),
        )


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """Triangles of a list (4), strip (5) or fan (6), as 3.7.2.1 orders them."""
    if mode == 4:
        return corners.reshape(-1, 3)
    i = np.arange(len(corners) - 2)
    order = (i, i + 1 + i % 2, i + 2 - i % 2) if mode == 5 else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1)]


def _sensor(file: _File, index: int, name: str, to_world: np.ndarray) -> Sensor:
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
