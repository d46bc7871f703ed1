"""PLY and OBJ meshes (and MTL materials), read by hand.

trimesh reads these formats too, but joins vertices across normals and texture coordinates, does not
keep Mitsuba's vertex order, loses OBJ materials' numbers and takes truncated files for whole ones.
"""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..parts import Description, Diffuse, Mesh, MeshAttribute, SceneError
from .textures import linear


@dataclasses.dataclass
class MeshData:
    """Triangles: vertices (V, 3), faces (F, 3) int32, unit normals (V, 3) and uvs (V, 2) if the file has them, and
    further values of vertices or faces by name."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    attributes: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)


def read_bytes(path: str | Path) -> bytes:
    """The content of a regular file (a device or pipe could be endless); `SceneError` if it cannot be read."""
    try:
        if not Path(path).is_file():
            fail(path, "no such file; check the path")
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        fail(path, f"cannot be read ({getattr(error, 'strerror', None) or error}); check the path and its permissions")


def fail(path: str | Path, problem: str) -> NoReturn:
    raise SceneError(f"{path}: {problem}")


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


def _checked(path: str | Path, mesh: MeshData) -> MeshData:
    """Finite numbers where a face uses them, and unit normals; a missing (zero) normal becomes the smooth one."""
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


# -------------------------------------------------------------------------------------------- PLY

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
def read_ply(path: str | Path) -> MeshData:
    """A PLY mesh, ASCII or binary. Polygons become fans; per-vertex `nx ny nz` and `u v` or `s t` are read, and colours
    and the like of vertices and faces, named as Mitsuba does.

    Raises `SceneError` for a file that is missing, malformed, truncated, or has data left over.
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
    of_faces = {k: np.repeat(v, length - 2) for k, (v, size) in face.items() if size is None}
    attributes |= _attributes("face_", of_faces)
    return _checked(path, MeshData(vertices, faces, normals, column(*pair) if pair else None, attributes))


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
    for line in data[: end.start()].decode("latin-1").replace("\r", "\n").split("\n")[1:]:
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
        fail(path, f"its header has the line {line.strip()[:60]!r}, which is not PLY; export it again")
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


# -------------------------------------------------------------------------------------------- OBJ


def read_obj(path: str | Path, flip_v: bool = True) -> MeshData:
    """An OBJ mesh, all groups joined; each distinct v/vt/vn is a vertex, in the order in which faces first use it.

    Polygons become fans. `flip_v`: texture coordinates (u, 1 - v), so that v runs down as in glTF and
    Mitsuba (whose `flip_tex_coords` this is). Corners without a normal get a smooth one, without a
    texture coordinate (0, 0). Raises `SceneError` for a file that is missing or malformed.
    """
    return _read_obj(path, flip_v)[0]


_TABLES = (("v", 3), ("vt", 2), ("vn", 3))  # in the order of a face's indices, with their widths


@dataclasses.dataclass
class _Run:
    """Triangles from `first` on have this material and belong to this object."""

    first: int
    material: str
    object: str


@np.errstate(over="ignore", invalid="ignore")
def _read_obj(path: str | Path, flip_v: bool) -> tuple[MeshData, list[_Run], list[str]]:
    text = read_bytes(path).decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    tables: dict[str, list[float]] = {name: [] for name, _ in _TABLES}
    vertex_of: dict[Any, int] = {}  # by v/vt/vn triple, and by word as a shortcut
    corners: list[tuple[int, int, int]] = []  # 1-based v/vt/vn of each vertex; 0: none
    triangles: list[int] = []
    runs, libraries = [_Run(0, "", "")], []

    def vertex(word: str) -> int:
        fields = word.split("/")
        key = [0, 0, 0]
        for k, field in enumerate(fields):  # a fourth one is an IndexError
            if field or k == 0:
                key[k] = int(field)
                if key[k] < 0:  # −1 is the last one so far
                    key[k] += len(tables[_TABLES[k][0]]) // _TABLES[k][1] + 1
                if not 0 < key[k] < 1 << 31:
                    raise ValueError(word)
        triple = (key[0], key[1], key[2])
        if triple not in vertex_of:
            vertex_of[triple] = len(corners)
            corners.append(triple)
        return vertex_of[triple]

    number = 0
    try:
        for number, line in enumerate(text.split("\n"), 1):  # noqa: B007
            words = line.split()
            if not words:
                continue
            key = words[0]
            if key == "v" or key == "vn":
                tables[key] += float(words[1]), float(words[2]), float(words[3])
            elif key == "vt":
                tables[key] += float(words[1]), float(words[2]) if len(words) > 2 else 0.0
            elif key == "f":
                ids = []
                for word in words[1:]:
                    if word[0] == "#":
                        break
                    k = vertex_of.get(word)
                    if k is None:
                        k = vertex(word)
                        if "-" not in word:  # which means another vertex the next time
                            vertex_of[word] = k
                    ids.append(k)
                if len(ids) < 3:
                    raise ValueError(line)
                for k in range(2, len(ids)):
                    triangles += ids[0], ids[k - 1], ids[k]
            elif key in ("usemtl", "o", "g"):
                name, last, n = " ".join(words[1:]), runs[-1], len(triangles) // 3
                runs.append(_Run(n, name, last.object) if key == "usemtl" else _Run(n, last.material, name))
            elif key == "mtllib":
                libraries += re.findall(r"\S.*?\.mtl(?!\S)", line.strip()[7:999], re.IGNORECASE)  # may hold spaces
    except (ValueError, IndexError):
        fail(path, f"line {number} cannot be read ({text.split(chr(10))[number - 1].strip()[:60]!r}); correct it")
    if not triangles:
        fail(path, "has no faces; jaxrt needs a surface mesh")

    key = np.array(corners)
    v, vt, vn = (np.array(tables[t], np.float64).reshape(-1, n) for t, n in _TABLES)
    for what, a, column in (("vertex", v, 0), ("texture coordinate", vt, 1), ("normal", vn, 2)):
        if key[:, column].max() > len(a):
            fail(path, f"a face names {what} {key[:, column].max()} of {len(a)}; repair the mesh")
    vt = np.stack([vt[:, 0], 1 - vt[:, 1]], 1) if flip_v else vt
    pick = lambda a, k: np.concatenate([np.zeros((1, a.shape[1])), a])[key[:, k]] if key[:, k].any() else None
    mesh = MeshData(v[key[:, 0] - 1], np.array(triangles, np.int32).reshape(-1, 3), pick(vn, 2), pick(vt, 1))
    return _checked(path, mesh), runs, libraries


def load_obj(path: str | Path) -> Description:
    """An OBJ file and its MTL as a scene: one mesh a material, `Kd` its reflectance, `Ke` its emitted radiance.

    A mesh is named after its object if the two share all their faces, else after the material. What a
    material asks for beyond `Kd` and `Ke` is named in the notes. Raises as `read_obj`, and for MTL
    numbers that are not possible.
    """
    mesh, runs, libraries = _read_obj(path, True)
    notes: list[str] = []
    library: dict[str, dict[str, list[str]]] = {}
    for name in libraries:
        try:
            library |= _read_mtl(Path(path).parent / name)
        except SceneError as error:
            notes.append(f"{error} (its materials are grey)")
    spans: dict[str, list[np.ndarray]] = {}
    objects_of: dict[str, set[str]] = {}
    materials_of: dict[str, set[str]] = {}
    for run, end in zip(runs, [r.first for r in runs[1:]] + [len(mesh.faces)], strict=True):
        if end > run.first:
            spans.setdefault(run.material, []).append(np.arange(run.first, end))
            objects_of.setdefault(run.material, set()).add(run.object)
            materials_of.setdefault(run.object, set()).add(run.material)
    unknown = [name for name in spans if name and name not in library]
    if unknown:
        notes.append(f"{path}: not defined in an MTL file, so grey: {listed(unknown)}")
    shapes, unused = [], {}
    for name, span in spans.items():
        used, faces = np.unique(mesh.faces[np.concatenate(span)], return_inverse=True)
        part = {k: None if a is None else a[used] for k, a in vars(mesh).items() if k not in ("faces", "attributes")}
        owner = min(objects_of[name])
        alone = len(objects_of[name]) == 1 and len(materials_of[owner]) == 1
        id = owner if owner and alone else f"{name}_mesh" if name else Path(path).stem
        try:
            look = _material(name, library.get(name, {}), unused)
            shapes.append(Mesh(id=id, faces=faces.reshape(-1, 3), **part, **look))
        except SceneError as error:
            fail(path, f"{error}")
    notes += [f"{path}: {what} not used: {listed(names)}" for what, names in unused.items()]
    return Description(shapes, notes=notes)


def listed(names: Sequence[str]) -> str:
    """A list for a note, of a length that can be read."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _read_mtl(path: Path) -> dict[str, dict[str, list[str]]]:
    """{material: {keyword: its words}}"""
    materials: dict[str, dict[str, list[str]]] = {}
    current: dict[str, list[str]] = {}
    for line in read_bytes(path).decode("utf-8", "replace").split("\n"):
        words = line.split()
        if words and words[0] == "newmtl":
            current = materials.setdefault(" ".join(words[1:]), {})
        elif words and words[0][0] != "#":
            current[words[0]] = words[1:]
    return materials


def _material(name: str, words: dict[str, list[str]], unused: dict[str, list[str]]) -> dict[str, Any]:
    """bsdf and emission of a mesh; `unused` takes what is left out, {what: where}."""

    def numbers(key: str, default: float) -> list[float]:
        try:
            values = [float(w) for w in words.get(key, [default])[:3]]
        except ValueError:
            values = []
        if len(values) not in (1, 3):  # one stands for all three
            raise SceneError(f"{name}.{key}: {' '.join(words[key])!r} is not a colour; give three numbers")
        return values

    maps = [f"{v[-1]} ({name}.{k})" for k, v in words.items() if v and k.lower().startswith(("map_", "bump", "norm"))]
    unused.setdefault("textures are", []).extend(maps) if maps else None
    for key, default in (("Ks", 0.0), ("Tr", 0.0), ("d", 1.0)):
        if key in words and words[key][:1] != ["-halo"] and any(x != default for x in numbers(key, default)):
            what = "highlights (Ks) are" if key == "Ks" else "transparency is"
            unused.setdefault(what, []).append(name)
    look: dict[str, Any] = {"bsdf": Diffuse(numbers("Kd", 0.5), id=name)}
    emission = numbers("Ke", 0.0)
    if any(emission):
        look |= {"emission": emission, "emission_id": f"{name}.emitter"}
    return look
