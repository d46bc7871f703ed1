"""From parts to a scene: packs shapes, materials, emitters and sensors into padded tables (numpy, host)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from .brdf import SPECTRA
from .coordinates import NONE
from .effects import plan
from .pack import Materials, Names, Textures, fields_of, spread
from .parts import (
    Cube,
    Cylinder,
    Directional,
    Disk,
    Enclosure,
    Goniometric,
    Group,
    Instance,
    Integrator,
    Lamp,
    Mesh,
    Point,
    Rectangle,
    SceneError,
    SdfGrid,
    Sensor,
    Shape,
    Sky,
    Sphere,
    Spot,
    Sun,
    Texture,
    brightness,
)
from .scene import KINDS, Scene, Structure
from .sensor.rows import Rows

SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
_SQUARE = [[-1, -1, 0, 2, 0, 0, 0, 2, 0]]  # corner, first edge, second edge
_CUBE = [  # the first edge of each side runs as Mitsuba's u, the second against its v
    [1, -1, 1, 0, 2, 0, -2, 0, 0],
    [1, 1, -1, 0, -2, 0, -2, 0, 0],
    [1, -1, -1, 0, 2, 0, 0, 0, 2],
    [-1, -1, 1, 0, 2, 0, 0, 0, -2],
    [1, 1, -1, -2, 0, 0, 0, 0, 2],
    [1, -1, -1, 0, 0, 2, -2, 0, 0],
]
_DISK = _GRID = [[0, 0, 0, 1, 0, 0, 0, 1, 0]]


def bucket(n: int) -> int:
    """The next of 0, 1, 2, 4, 8, 12, 16, 24, 32, 48, ...: sizes that scenes share."""
    if n <= 2:
        return n
    size = 4
    while size < n:
        size = size * 3 // 2 if size & (size - 1) == 0 and size >= 8 else (1 << (size.bit_length()))
    return size


def _padded(a: np.ndarray, n: int, fill: Any = 0) -> np.ndarray:
    out = np.full((n, *a.shape[1:]), fill, a.dtype)
    out[: len(a)] = a
    return out


def _patches(shape: Shape) -> tuple[str, np.ndarray]:
    if isinstance(shape, Rectangle):
        return "parallelogram", np.array(_SQUARE, float)
    if isinstance(shape, Cube):
        return "parallelogram", np.array(_CUBE, float)
    if isinstance(shape, Disk):
        return "disk", np.array(_DISK, float)
    if isinstance(shape, Sphere):
        return "sphere", np.array([[*shape.center, shape.radius, 0, 0, 0, 0, 0]], float)
    if isinstance(shape, Cylinder):
        return "cylinder", np.array([[*shape.p0, *shape.p1, shape.radius, 0, 0]], float)
    if isinstance(shape, SdfGrid):
        return "sdfgrid", np.array(_GRID, float)
    raise SceneError(f"{shape.id or shape}: is not a shape that jaxrt knows")


def _as_mesh(shape: Shape) -> Mesh:
    """A rectangle or cube as triangles, with Mitsuba's texture coordinates."""
    if isinstance(shape, Mesh):
        return shape
    rows = _patches(shape)[1].reshape(-1, 3, 3)
    corners = np.stack([rows[:, 0], rows[:, :2].sum(1), rows.sum(1), rows[:, ::2].sum(1)], 1)
    mirrored = np.linalg.det(shape.to_world[:3, :3]) < 0  # fronts stay where the shape has them
    four = np.arange(4 * len(rows)).reshape(-1, 4)[:, :: -1 if mirrored else 1]
    return Mesh(
        vertices=corners.reshape(-1, 3),
        faces=four[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3),
        uvs=np.tile(SQUARE if isinstance(shape, Rectangle) else SQUARE * [1, -1] + [0, 1], (len(rows), 1)),
        **{k: getattr(shape, k) for k in ("id", "to_world", "bsdf", "flip_normals")},
    )


def build(
    shapes: Sequence[Shape | Instance],
    *,
    sensors: Sequence[Sensor] = (),
    enclosure: Enclosure | None = None,
    lamps: Sequence[Lamp] = (),
    integrator: Integrator | None = None,
    channels: int | None = None,
    source: str = "",
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Scene:
    """A scene from parts.

    `origin`: where in the world the point is from which all of them are counted, which `Scene.origin` keeps (m).
    `channels`: length of a spectrum; by default the longest that a part has. Raises `SceneError`
    for a scene without shapes and for spectra of other lengths.
    """
    for s in shapes:
        if isinstance(s, Group):
            raise SceneError(f"{s.id or 'group'}: is not in the scene by itself; place it by an Instance")
        if isinstance(s, Instance):
            s.group.__post_init__()  # a shape may have been changed since
    shapes = [e for s in shapes for e in (s.written_out() if isinstance(s, Instance) and not s.group.flat else [s])]
    instances = [s for s in shapes if isinstance(s, Instance)]
    grouped: dict[int, Group] = {id(s.group): s.group for s in instances}
    placed = [s for s in shapes if not isinstance(s, Instance)]
    members = [[_as_mesh(s) for s in group.shapes] for group in grouped.values()]
    shapes = [*placed, *(s for group in members for s in group)]
    if not shapes:
        raise SceneError(f"{source or 'scene'}: has no shapes; add at least one")
    enclosure, integrator = enclosure or Enclosure(), integrator or Integrator()
    keys = [brightness(lamp) for lamp in lamps]
    bright = [getattr(lamp, key) for lamp, key in zip(lamps, keys, strict=True)]
    means = [v.mean() if isinstance(v, Texture) else v for v in bright]
    around = enclosure.radiance.mean() if isinstance(enclosure.radiance, Texture) else enclosure.radiance
    longest = max([around.size] + [v.size for s in shapes for v in _spectra(s)] + [v.size for v in means])
    c = longest if channels is None else channels
    if len(suns := [lamp for lamp in lamps if isinstance(lamp, Sun)]) > 1:
        raise SceneError(f"{suns[1].id or 'sun'}: is a second sun; keep one")
    names = Names()
    ids = [names.part(s.id or type(s).__name__.lower()) for s in shapes]
    textures = Textures(c, names)
    materials = Materials(c, names, textures)
    firsts = np.cumsum([0, *(len(s.faces) if isinstance(s, Mesh) else 0 for s in shapes)])
    material_of = [materials.row(s.bsdf, s, int(first)) for s, first in zip(shapes, firsts[:-1], strict=True)]

    radiance, emitter_of = [np.zeros(c), spread(around, c, "enclosure.radiance")], {}
    radiance_map, around_name = [0, 0], names.part(enclosure.id or "enclosure")
    emitters = ["", around_name]
    if isinstance(enclosure.radiance, Texture):
        radiance_map[1] = textures.number(enclosure.radiance, f"{around_name}.radiance", shapes[0], 0, False)[0]
        if not isinstance(enclosure.radiance, Sky):
            names.add(f"{around_name}.to_world", "around_to_world", 0)
    else:
        names.add(f"{around_name}.radiance", "radiance", 1)
    by_kind: dict[str, list[tuple[int, np.ndarray]]] = {k: [] for k in KINDS}
    vertices, normals, uvs, vertex_of, first = [], [], [], [], 0
    distances, grids = [], []
    finishes: list[tuple[int, int]] = [(0, 1)]  # row 0: the enclosure, black and luminous
    shape_finish = []
    for k, shape in enumerate(shapes):
        emitter = 0
        if shape.emission is not None:
            wanted = shape.emission_id or f"{ids[k]}.emitter"
            number, value = 0, shape.emission
            if isinstance(value, Texture):
                number, value = textures.number(value, f"{wanted}.radiance", shape, int(firsts[k]), False)
            value = spread(value, c, f"{wanted}.radiance")
            if (wanted, number) not in emitter_of:
                emitter_of[wanted, number] = len(radiance)
                emitters.append(wanted if number else names.part(wanted))
                if not number:
                    names.add(f"{emitters[-1]}.radiance", "radiance", len(radiance))
                radiance.append(value)
                radiance_map.append(number)
            elif (radiance[emitter_of[wanted, number]] != value).any():
                raise SceneError(f"{ids[k]}: emitter {wanted} has another radiance elsewhere; give another emission_id")
            emitter = emitter_of[wanted, number]
        finish = (material_of[k], emitter)
        if finish not in finishes:
            finishes.append(finish)
        shape_finish.append(finishes.index(finish))
        if isinstance(shape, Mesh):
            n = len(shape.vertices)
            by_kind["triangle"].append((k, shape.faces + first))
            vertices.append(shape.vertices)
            normals.append(np.zeros((n, 3)) if shape.normals is None else shape.normals)
            uvs.append(np.full((n, 2), NONE) if shape.uvs is None else shape.uvs)
            names.add(f"{ids[k]}.vertices", "vertices", (first, first + n))
            if shape.normals is not None:
                names.add(f"{ids[k]}.normals", "normals", (first, first + n))
            vertex_of.append(k)
            first += n
        else:
            kind, rows = _patches(shape)
            by_kind[kind].append((k, rows))
        if isinstance(shape, SdfGrid):
            start, shown = sum(map(len, distances)), shape.grid.shape
            grids.append([start, *shown[::-1], shape.smooth_normals])
            distances.append(shape.grid.ravel())
            names.add(f"{ids[k]}.grid", "distances", (start, start + shape.grid.size), shape=shown)
        names.add(f"{ids[k]}.to_world", "to_world", k)

    lamp_rows, lamp_radiance = [lamp.row() for lamp in lamps], []
    for k, (lamp, key, value) in enumerate(zip(lamps, keys, bright, strict=True)):
        name = names.part(lamp.id or type(lamp).__name__.lower())
        number = 0
        if isinstance(value, Texture):
            number, value = textures.number(value, f"{name}.{key}", shapes[0], 0, False)
        else:
            names.add(f"{name}.{key}", "radiance", len(radiance))
        lamp_radiance.append(len(radiance))
        radiance.append(spread(value, c, f"{name}.{key}"))
        radiance_map.append(number)
        emitters.append(name)
        if isinstance(lamp, Goniometric):
            lamp_rows[k][6] = number
        if isinstance(lamp, (Point, Goniometric)):
            names.add(f"{name}.position", "lamps", k, (0, 3))
        if isinstance(lamp, (Spot, Directional, Goniometric)):
            names.add(f"{name}.direction", "lamps", k, (3, 6))

    counts = [sum(len(rows) for _, rows in by_kind[kind]) for kind in KINDS]
    blocks = [bucket(n) for n in counts]
    sizes = [sum(len(mesh.faces) for mesh in group) for group in members]
    counts[0] -= sum(sizes)
    groups = [(counts[0] + sum(sizes[:k]), n) for k, n in enumerate(sizes)]
    group_of = [list(grouped).index(id(s.group)) for s in instances]
    copies = bucket(sum(sizes[g] for g in group_of))
    if sum(blocks) + copies >= 1 << 31:
        raise SceneError(f"{source or 'scene'}: instances stand for more than 2³¹ triangles; take fewer")
    for k, instance in enumerate(instances):
        names.add(f"{names.part(instance.id or 'instance')}.to_world", "instances", k)
    face_shape, patches, layout, lights = [], [], [], []
    for kind, block in zip(KINDS, blocks, strict=True):
        owner, at, start = [], sum(blocks[: KINDS.index(kind)]), 0
        for k, rows in by_kind[kind]:
            owner.append(np.full(len(rows), k))
            layout.append((ids[k], kind, at + start, at + start + len(rows)))
            if shapes[k].emission is not None:
                lights.extend(range(at + start, at + start + len(rows)))
            if kind in ("sphere", "cylinder"):
                row = at + start - blocks[0]
                for key, columns in _LOCAL[kind].items():
                    names.add(f"{ids[k]}.{key}", "patches", row, columns, columns[1] - columns[0] == 1)
            start += len(rows)
        face_shape.append(_padded(np.concatenate([np.zeros(0, int), *owner]), block))
        if kind != "triangle":
            patches.append(_padded(np.concatenate([np.zeros((0, 9)), *(r for _, r in by_kind[kind])]), block))

    spans = {name: tuple(span) for name, *span in layout}
    numbers = {id(s): k for k, s in enumerate(placed)}
    views = Rows(names, lambda shape: spans[ids[numbers[id(shape)]]] if id(shape) in numbers else None)
    sensor_structures = views.structures(sensors)

    real = np.float64 if jax.config.jax_enable_x64 else np.float32  # pyright: ignore[reportAttributeAccessIssue]
    put = jax.device_put  # unlike jnp.asarray, compiles nothing for a new shape

    def f(a: Any, shape: tuple[int, ...], n: int, fill: Any = 0.0) -> Any:
        return put(_padded(np.array(a, real).reshape(-1, *shape), n, fill))

    def i(a: Any, n: int, fill: Any = 0) -> Any:
        return put(_padded(np.array(a, np.int32), n, fill))

    join = lambda parts, width: np.concatenate([np.zeros((0, width)), *parts])
    rows, pad = bucket(len(shapes)), bucket(first)
    to_world = f([s.to_world for s in shapes], (4, 4), rows)
    scene = Scene(
        vertices=f(join(vertices, 3), (3,), pad),
        normals=f(join(normals, 3), (3,), pad),
        uvs=f(join(uvs, 2), (2,), pad),
        triangles=i(np.concatenate([np.zeros((0, 3), int), *(r for _, r in by_kind["triangle"])]), blocks[0]),
        patches=f(join(patches, 9), (9,), sum(blocks[1:])),
        face_shape=put(np.concatenate(face_shape).astype(np.int32)),
        counts=put(np.array(counts, np.int32)),
        to_world=to_world,
        flip=f([-1.0 if s.flip_normals else 1.0 for s in shapes], (), rows, 1.0),
        shape_finish=i(shape_finish, rows),
        finishes=i(finishes, bucket(len(finishes))),
        materials=f(materials.rows, (materials.columns.width,), bucket(len(materials.rows))),
        radiance=f(radiance, (c,), bucket(len(radiance))),
        radiance_map=i(radiance_map, bucket(len(radiance))),
        texels=f(join(textures.texels, c), (c,), bucket(sum(map(len, textures.texels)))),
        textures=i(np.array(textures.layout), bucket(len(textures.layout))),
        to_uv=f(textures.to_uv, (6,), bucket(len(textures.layout))),
        distances=f(np.concatenate([np.zeros(0), *distances]), (), bucket(sum(map(len, distances)))),
        grids=i(np.array(grids, int).reshape(-1, 5), blocks[5]),
        instances=f([s.to_world for s in instances] or np.zeros((0, 4, 4)), (4, 4), bucket(len(instances)), np.eye(4)),
        instance_group=i(group_of, bucket(len(instances)), -1),
        groups=i(np.array(groups, int).reshape(-1, 2), bucket(len(groups)), (sum(blocks), 0)),
        lights=i(lights, bucket(len(lights)), -1),
        around_to_world=f([enclosure.to_world], (4, 4), 1),
        lamps=f(lamp_rows or np.zeros((0, 12)), (12,), bucket(len(lamps))),
        lamp_radiance=i(lamp_radiance, bucket(len(lamps))),
        sensor_to_world=f(views.to_world, (4, 4), len(views.to_world)),
        lens=f(views.lens, (5,), len(views.lens)),
        targets=f(join(views.targets, 10), (10,), sum(map(len, views.targets))),
        blocks=tuple(blocks),
        copies=copies,
        structure=Structure(
            slots=tuple(names.slots.items()),
            shapes=tuple(layout),
            materials=tuple(materials.row_names),
            emitters=tuple(emitters),
            sensors=sensor_structures,
            sensor_ids=tuple(views.ids),
            integrator=dataclasses.astuple(integrator),
            source=source,
            origin=origin,
        ),
    )
    return dataclasses.replace(scene, plan=plan(scene))


_LOCAL = {
    "sphere": {"center": (0, 3), "radius": (3, 4)},
    "cylinder": {"p0": (0, 3), "p1": (3, 6), "radius": (6, 7)},
}


def _spectra(shape: Shape) -> list[np.ndarray]:
    """One value of each spectrum of a shape, for its number of channels."""
    found = [v for name, v in fields_of(shape.bsdf) if name in SPECTRA]
    found += [shape.emission] if shape.emission is not None else []
    return [v.mean() if isinstance(v, Texture) else v for v in found]
