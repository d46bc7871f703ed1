"""glTF 2.0 (.glb and .gltf), as far as the parts of a scene can express it.

Read from the JSON and the buffers themselves: trimesh rounds material factors to 8 bits and drops
emission strengths. Section numbers are those of the glTF 2.0 specification (Khronos, 2021).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np

from ..parts import Description, Group, Instance, Lamp, Mesh, SceneError, Sensor, matrix
from .gltf_document import KNOWN, Document
from .gltf_lamps import LAMPS
from .gltf_materials import Materials
from .gltf_meshes import primitives, unmirrored
from .gltf_nodes import copies, nodes, sensor
from .mesh import listed
from .reading import COPY, TRIANGLE

SHARED = 4096
"""Triangles that sharing a mesh has to save before its nodes become instances, whose hits cost a little more."""


def load_gltf(path: str | Path) -> Description:
    """A glTF scene: meshes with their places, metallic-roughness materials, emission, lights and cameras.

    A material is a `Principled` surface (see `gltf_reflectance`), alone or mixed with what transmits; one without any
    specular reflection is `Diffuse`. Animation, skins, morph targets and further extensions are named in the notes.
    Raises `SceneError` for a file that is missing, damaged or requires an unknown extension.
    """
    file = Document(path)
    try:
        with np.errstate(all="ignore"):  # whatever overflows is refused by name where a part is made
            return _load(file)
    except SceneError as error:
        if str(error).startswith(f"{path}:"):
            raise
        file.fail(str(error))


def _load(file: Document) -> Description:
    shapes: list[Mesh | Instance] = []
    places: dict[int, list[tuple[str, np.ndarray]]] = {}
    sensors: list[Sensor] = []
    meshes: dict[int, list[tuple[str, Mesh]]] = {}
    materials = Materials(file)
    lamps, hidden = cast(list[Lamp], []), []
    for number, node, to_world in nodes(file):
        name, where = file.name(node, f"node_{number}"), f"nodes[{number}]"
        for extension, make in LAMPS.items():
            if extension in file.entry(node, "extensions"):
                lamps.append(make(file, file.extension(node, extension), name, to_world))
        if not ("mesh" in node or "camera" in node):
            continue
        if np.linalg.det(to_world[:3, :3]) == 0:  # a usual way to hide something
            hidden.append(name)
            continue
        if "mesh" in node:
            index = file.integer(node, "mesh", where=f"{where}.")
            if index not in meshes:
                meshes[index] = list(primitives(file, index, materials))
            for place in copies(file, node, where):
                if np.linalg.det(place[:3, :3]) == 0:
                    hidden.append(f"an instance of {name}")
                    continue
                places.setdefault(index, []).append((file.name(node, ""), matrix(to_world @ place, where)))
        if "camera" in node:
            sensors.append(sensor(file, file.integer(node, "camera", where=f"{where}."), name, to_world))
    for index, where in places.items():
        shapes += _placed(file, meshes[index], where)
    used = {str(e) for e in file.table(file.json, "extensionsUsed")} - KNOWN
    for what, names in (
        ("scaled to nothing, so left out:", hidden),
        ("extensions are not used:", sorted(used)),
        ("animations are not used, things stand as without:", ["all"] * bool(file.table(file.json, "animations"))),
        ("skins are not used, meshes stand as modelled:", ["all"] * bool(file.table(file.json, "skins"))),
    ):
        if names:
            file.note(f"{what} {listed(list(dict.fromkeys(names)))}")
    if not shapes:
        file.fail("has no triangle meshes in its scene; jaxrt needs surfaces")
    return Description(shapes, sensors, lamps=lamps, notes=list(dict.fromkeys(file.notes)))


def _placed(
    file: Document, meshes: list[tuple[str, Mesh]], where: list[tuple[str, np.ndarray]]
) -> Iterator[Mesh | Instance]:
    """A mesh's parts at each of its nodes: as instances of one group where that saves much, else each for itself."""
    if (len(where) - 1) * sum(len(mesh.faces) for _, mesh in meshes) >= SHARED and all(
        mesh.emission is None for _, mesh in meshes
    ):
        group = Group(shapes=[dataclasses.replace(mesh, id=mesh.id + suffix) for suffix, mesh in meshes])
        for name, to_world in where:
            yield Instance(id=name or meshes[0][1].id, group=group, to_world=to_world)
        return
    for k, (name, to_world) in enumerate(where):
        for suffix, mesh in meshes:
            if k:
                file.spend(COPY + TRIANGLE * len(mesh.faces))
            placed = copy.copy(mesh)  # shares the arrays
            placed.id, placed.to_world = (name or mesh.id) + suffix, to_world
            if np.linalg.det(to_world[:3, :3]) < 0:
                placed = unmirrored(placed)
            yield placed
