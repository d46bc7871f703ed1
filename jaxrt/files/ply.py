"""PLY meshes."""

from __future__ import annotations

import dataclasses
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..parts import Description, Diffuse, Mesh, MeshAttribute
from .mesh import MeshData, checked, fail
from .reading import read_bytes, take
from .textures import linear

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclasses.dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, np.dtype, np.dtype | None]]  # name, type, and of a list the type of its length


@np.errstate(over="ignore", invalid="ignore")  # infinite and missing numbers are refused by name
def read_ply(path: str | Path, flip_v: bool = False) -> MeshData:
    """A PLY mesh, ASCII or binary. Polygons become fans; per-vertex `nx ny nz` and `u v` or `s t` are read, and colours
    and the like of vertices and faces, named as Mitsuba does.

    `flip_v`: texture coordinates (u, 1 - v), as Mitsuba's `flip_tex_coords`. Raises `SceneError` for a file that is
    missing, malformed, truncated, or has data left over.
    """
    data = read_bytes(path)
    elements, ascii, position = _ply_header(path, data)
    if ascii:  # as one binary type, so that both kinds are unpacked alike
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # fromstring only warns of text which is not a number
                body = data[position:].decode("ascii").strip()  # white space alone would read as −1
                data = np.fromstring(body, np.float64, sep=" ").tobytes() if body else b""
        except (ValueError, DeprecationWarning):
            fail(path, "its data are not all numbers; the file is damaged, export it again")
        position = 0
    found = {}
    for element in elements:
        columns, position = _columns(path, data, position, element)
        found.setdefault(element.name, columns)
    if data[position:].strip():
        fail(path, "has data after the last element, so its header counts too few; export it again")

    vertex, face = found.get("vertex", {}), found.get("face", {})
    index, length = next((face[k] for k in ("vertex_indices", "vertex_index") if k in face), (None, None))
    if not {"x", "y", "z"} <= vertex.keys() or index is None or length is None or not len(length):
        fail(path, "has no vertices or no faces; jaxrt needs a surface mesh, not a point cloud")
    column = lambda *names: np.stack([vertex[k][0].astype(np.float64) for k in names], 1)
    if any(vertex[k][1] is not None for k in vertex):
        fail(path, "has lists in its vertices; export it with single numbers")
    pair = next((p for p in (("u", "v"), ("s", "t"), ("texture_u", "texture_v")) if vertex.keys() >= set(p)), None)
    vertices = column("x", "y", "z")
    faces = _fans(path, index, length, len(vertices))
    normals = column("nx", "ny", "nz") if vertex.keys() >= {"nx", "ny", "nz"} else None
    used = {"x", "y", "z", "nx", "ny", "nz", *(pair or ())}
    attributes = _attributes("vertex_", {k: v[0] for k, v in vertex.items() if k not in used})
    take(path, 16 * len(faces) * len(face), "export it without values of faces")
    of_faces = {k: np.repeat(v, length - 2) for k, (v, size) in face.items() if size is None}
    attributes |= _attributes("face_", of_faces)
    uvs = column(*pair) * [1, -1 if flip_v else 1] + [0, int(flip_v)] if pair else None
    return checked(path, MeshData(vertices, faces, normals, uvs, attributes))


_POSTFIXES = {"rgb": "_color", "xyz": "", "012": "", "123": ""}


def _attributes(of: str, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns that belong together, as `vertex_color` of r, g, b, or `vertex_heat` of heat_0. Others are left out."""
    groups: dict[str, dict[str, np.ndarray]] = {}
    for name, values in columns.items():
        name = {"red": "r", "green": "g", "blue": "b"}.get(name, name)
        base, _, postfix = name.rpartition("_")
        groups.setdefault(base, {})[postfix] = values.astype(np.float64)
    found = {}
    for base, group in groups.items():
        for letters, suffix in _POSTFIXES.items():
            if (group.keys() >= set(letters) or group.keys() == {letters[0]}) and (base or letters == "rgb"):
                name = of + (base + suffix).lstrip("_")
                found.setdefault(name, np.stack([group[c] for c in letters if c in group], 1))
    return found


def _ply_header(path: str | Path, data: bytes) -> tuple[list[_Element], bool, int]:
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\r|\n|\Z)", data)
    if not re.match(rb"ply\s", data) or end is None:
        fail(path, "is not a PLY file, or its header has no end; check the path or export it again")
    order, elements = "", []
    head = data[: end.start()].decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(head.split("\n")[1:], 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as order, "1.0"]:
                continue
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                elements.append(_Element(name, int(count), []))
                continue
            case ["property", kind, name] if elements and order and kind in _TYPES:
                elements[-1].properties.append((name, _ply_type(order, kind), None))
                continue
            case ["property", "list", size, kind, name] if elements and order and {kind, size} <= _TYPES.keys():
                elements[-1].properties.append((name, _ply_type(order, kind), _ply_type(order, size)))
                continue
        fail(path, f"line {number} of its header is not PLY; export it again")
    if not order:
        fail(path, "its header has no format line; export it again")
    return elements, order == "ascii", end.end()


def _ply_type(order: str, kind: str) -> np.dtype:
    return np.dtype("<f8" if order == "ascii" else (_ORDERS.get(order) or "<") + _TYPES[kind])


def _columns(path: Any, data: bytes, start: int, element: _Element) -> tuple[dict[str, tuple], int]:
    """{property: (values of all rows, in turn, and of a list the length in each row)}, and where the element ends."""
    properties, count = element.properties, element.count
    least = sum((size or kind).itemsize for _, kind, size in properties)
    if count * least > len(data) - start:  # before anything is allocated
        fail(path, f"ends before its {count} {element.name} rows do; it is truncated, export it again")
    if not count or not least:
        return {
            name: (np.zeros(0, kind), None if s is None else np.zeros(0, int)) for name, kind, s in properties
        }, start

    def row(at: int) -> tuple[list[tuple[int, int]], int]:
        """(offset, length) of each property of the row at `at`, and where it ends."""
        spans = []
        for name, kind, size in properties:
            length = 1
            if size is not None:
                number = np.frombuffer(data, size, 1, at)[0] if at + size.itemsize <= len(data) else -1
                at += size.itemsize
                if not 0 <= number <= (len(data) - at) // kind.itemsize or number % 1:
                    fail(path, f"a list {name} of {element.name} does not fit into the file; it is damaged")
                length = int(number)
            spans.append((at, length))
            at += length * kind.itemsize
        if at > len(data):
            fail(path, f"ends within its {element.name} rows; it is truncated, export it again")
        return spans, at

    spans, end = row(start)
    stride = end - start
    view = lambda at, kind, n: np.ndarray((count, n), kind, data, at, (stride, kind.itemsize))
    if start + count * stride <= len(data):  # the usual case: all rows are as long as the first
        lists = [(at - s.itemsize, s, n) for (at, n), (_, _, s) in zip(spans, properties, strict=True) if s is not None]
        if all((view(at, size, 1) == n).all() for at, size, n in lists):
            return {
                name: (view(at, kind, n).reshape(-1), None if size is None else np.full(count, n))
                for (at, n), (name, kind, size) in zip(spans, properties, strict=True)
            }, start + count * stride
    pieces: list[list[bytes]] = [[] for _ in properties]
    lengths = np.zeros((count, len(properties)), int)
    for k in range(count):
        spans, start = row(start)
        for j, (at, n) in enumerate(spans):
            pieces[j].append(data[at : at + n * properties[j][1].itemsize])
            lengths[k, j] = n
    return {
        name: (np.frombuffer(b"".join(pieces[j]), kind), None if size is None else lengths[:, j])
        for j, (name, kind, size) in enumerate(properties)
    }, start


def _fans(path: Any, index: np.ndarray, length: np.ndarray, vertices: int) -> np.ndarray:
    """Triangles (0, k, k + 1) of each polygon; `index` holds the corners of all polygons in turn."""
    if (bad := np.flatnonzero(length < 3)).size:
        fail(path, f"face {bad[0]} has {length[bad[0]]} corners; remove it or give it three")
    if not ((index >= 0) & (index < vertices) & (index % 1 == 0)).all():
        fail(path, f"a face names a vertex outside 0..{vertices - 1}; repair the mesh")
    index = index.astype(np.int32)
    first, triangles = np.cumsum(length) - length, length - 2
    face = np.repeat(np.arange(len(length)), triangles)
    k = np.arange(len(face)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([index[first[face]], index[first[face] + k + 1], index[first[face] + k + 2]], 1)


def load_ply(path: str | Path) -> Description:
    """A PLY mesh as a scene: a diffuse mesh, named after the file, in its own colours or grey. Raises as `read_ply`."""
    mesh = read_ply(path)
    name, bsdf = Path(path).stem, Diffuse()
    for key in ("face_color", "vertex_color"):
        if (colour := mesh.attributes.get(key)) is not None and colour.shape[1] == 3:
            colour = linear(colour / 255.0) if colour.max() > 1 else colour  # 8 bits are coded in sRGB
            mesh.attributes[key] = np.clip(colour, 0.0, 1.0)
            bsdf = Diffuse(MeshAttribute(key), id=f"{name}.bsdf")
    return Description([Mesh(id=name, bsdf=bsdf, **vars(mesh))])
