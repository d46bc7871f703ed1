"""OBJ meshes, and MTL materials."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..parts import Description, Diffuse, Mesh, SceneError
from .mesh import MeshData, checked, fail, listed
from .reading import RefusedError, read_bytes


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
        fail(path, f"line {number} is none that an OBJ file has; correct it, or check the path")
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
    return checked(path, mesh), runs, libraries


def load_obj(path: str | Path) -> Description:
    """An OBJ file and its MTL as a scene: one mesh a material, `Kd` its reflectance, `Ke` its emitted radiance.

    A mesh is named after its object if the two share all their faces, else after the material. What a
    material asks for beyond `Kd` and `Ke` is named in the notes. Raises as `read_obj`, and for MTL
    numbers that are not possible.
    """
    mesh, runs, libraries = _read_obj(path, True)
    notes: list[str] = []
    library: dict[str, dict[str, list[str]]] = {}
    for name in dict.fromkeys(libraries):
        try:
            library |= _read_mtl(Path(path).parent / name)
        except RefusedError as error:
            fail(path, f"mtllib {error}")
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
            raise SceneError(f"{name}.{key}: is not a colour; give three numbers")
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
