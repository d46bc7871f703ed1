"""A scene in world space: the tables that rays read, made once a call of `measure` from scene and plan.

Pure and differentiable: positions, reflectances and radiances keep their derivatives; what only steers
sampling or the search does not. One row a face is gathered at each hit, and one short row of its finish.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from . import coordinates
from .brdf import SPECTRA, MaterialColumns, derive
from .compiler import program, remembered
from .effects import Plan, fitting, without
from .environment import Environment
from .grids import Grids
from .instances import Instances
from .intersect import Faces, Search, affine, build_search
from .parts import LAMPS
from .scene import FACE, KINDS, Scene, Structure, in_working_precision
from .sun import Sun
from .texture import Textures

FEW_LIGHTS = 16
"""Lights that are looked at one by one; of more, one is searched for."""


class World(eqx.Module):
    """Tables of one scene in world space.

    `geometry` rows: origin, edge e₁, edge e₂, meaning by kind: corner and sides of a triangle or parallelogram;
    centre and radii of a disk; centre and radii of a sphere; foot, axis and radius of a cylinder; corner and two sides
    of the cube of a grid of distances.
    `faces` rows, gathered at each hit (`FACE` names the columns), about `center`: the affine maps of a flat
    face to its height and coordinates, or centre and radius of a curved one; side, finish, light density
    (1/m²); and as the plan calls for, three vertex normals, tangents, and coordinates for textures. The last
    row is the enclosure. `finishes` rows: material fields, derived ones last, radiance, and its texture's number where
    there are such; and, where some refer to others, rows of all materials. `light_rows`: geometry, normal, density,
    chance, radiance, face, and again that number. `light_bounds`: spheres (centre, radius) that hold all lights, m.
    """

    geometry: Float[Array, "P 9"]
    faces: Float[Array, "P1 columns"]
    finishes: Float[Array, "Q fields"]
    light_rows: Float[Array, "L fields"]
    light_cdf: Float[Array, " L"]
    light_bounds: Float[Array, "K 4"]
    search: Search
    center: Float[Array, " 3"]
    radius: Float[Array, ""]  # of a sphere that holds all surfaces, m
    epsilon: Float[Array, ""]  # how far rounding may move a surface point, m
    present: Bool[Array, ""]  # true, in a way that the compiler cannot know
    instances: Instances | None
    grids: Grids | None
    textures: Textures | None
    environment: Environment | None
    sun: Sun | None
    plan: Plan = eqx.field(static=True)
    inner: int = eqx.field(static=True)  # rows of `finishes`, the last ones, to which other rows refer
    blocks: tuple[int, ...] = eqx.field(static=True)

    def settle(self, tree: Any) -> Any:
        """The same values, computed once and stored.

        XLA on the CPU writes one kernel an output and repeats in each what several share; a branch is the
        border that it does not fuse across (3 to 7 times faster; `optimization_barrier` works in jax 0.12 only).
        """
        return jax.lax.cond(self.present, lambda t: t, lambda t: jax.tree.map(jnp.zeros_like, t), tree)

    def first(self, kind: str) -> int:
        return sum(self.blocks[: KINDS.index(kind)])


def _normals_matrix(m: Any) -> Any:
    """Cofactors of the linear part, with the sign of the determinant: maps normals for any invertible m."""
    a, b, c = m[..., :3, 0], m[..., :3, 1], m[..., :3, 2]
    cof = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], -1)
    det = jnp.sum(a * cof[..., 0], -1)
    return cof * jnp.sign(det)[..., None, None], det


def _unit(v: Any) -> Any:
    n = jnp.sum(v * v, -1, keepdims=True)
    return v * jax.lax.rsqrt(jnp.where(n > 0, n, 1.0))


def _face_geometry(scene: Scene, plan: Plan) -> tuple[Any, Any, list[Any]]:
    """(origin, e₁, e₂) of every face in world space, its side, and the columns a plan adds."""
    to_world = scene.to_world[scene.face_shape]
    linear, shift = to_world[:, :3, :3], to_world[:, :3, 3]
    apply = lambda m, v: jnp.einsum("pij,pj->pi", m, v, precision="highest")
    normal_matrix, det = _normals_matrix(to_world)
    mirrored = jnp.where(det < 0, -1.0, 1.0)
    geometry, sides, normals, tangents, places = [], [], [], [], []
    for kind, n in zip(KINDS, scene.blocks, strict=True):
        if n == 0:
            continue
        start = scene.offset(kind)
        at = slice(start, start + n)
        m, t, cof = linear[at], shift[at], normal_matrix[at]
        if kind == "triangle":
            corner = [apply(m, scene.vertices[scene.triangles[:, j]]) + t for j in range(3)]
            o, a, b = corner[0], corner[1] - corner[0], corner[2] - corner[0]
            sides.append(jnp.ones(n))
        else:
            p = scene.patches[start - scene.blocks[0] : start - scene.blocks[0] + n]
            o, a, b = apply(m, p[:, :3]) + t, apply(m, p[:, 3:6]), apply(m, p[:, 6:9])
            if kind == "sphere":
                a, b = m[:, :, 0] * p[:, 3:4], m[:, :, 1] * p[:, 3:4]
            elif kind == "cylinder":
                a = apply(m, p[:, 3:6] - p[:, 0:3])
                b = apply(m, coordinates.first_axis(p[:, 3:6] - p[:, 0:3]) * p[:, 6:7])
            sides.append(mirrored[at] if kind in ("parallelogram", "disk") else jnp.ones(n))
        geometry.append(jnp.concatenate([o, a, b], -1))
        if plan.smooth_normals:
            shading = jnp.zeros((n, 3, 3))
            if kind == "triangle":
                shading = _unit(jnp.einsum("pij,pkj->pki", cof, scene.normals[scene.triangles]))
            normals.append(shading.reshape(n, 9))
        if plan.tangents:
            tangents.append(coordinates.tangents(scene, kind, a, b)[:, : 6 if plan.bumps else 3])
        if plan.coordinates:
            places.append(coordinates.of_rows(scene, kind, m, a, b))
    side = jnp.concatenate(sides) * scene.flip[scene.face_shape]
    extra = [jnp.concatenate(columns) for columns in (normals, tangents, places) if columns]
    return jnp.concatenate(geometry), side, extra


def safe_norm(a: Any) -> Any:
    n = jnp.sum(a * a, -1)
    return jnp.where(n > 0, jnp.sqrt(jnp.where(n > 0, n, 1.0)), 0.0)


AREA = {
    "triangle": 0.5,
    "parallelogram": 1.0,
    "disk": np.pi,
    "sphere": 4 * np.pi,
    "cylinder": 2 * np.pi,
    "sdfgrid": 0.0,
}
"""The area of a face of each kind, in units of |e₁ × e₂|; that of a grid of distances is not known."""


def face_areas(geometry: Any, blocks: tuple[int, ...]) -> Any:
    """Area of every face (m²); 0 for padding."""
    factor = np.repeat([AREA[kind] for kind in KINDS], blocks)
    return safe_norm(jnp.cross(geometry[:, 3:6], geometry[:, 6:9])) * jnp.asarray(factor, geometry.dtype)


def _boxes(scene: Scene, geometry: Any) -> tuple[Any, Any]:
    """Low and high corners of the box of every face, (P, 3) each."""
    boxes = []
    for kind, n in zip(KINDS, scene.blocks, strict=True):
        if n == 0:
            continue
        o, a, b = (geometry[scene.offset(kind) : scene.offset(kind) + n, k : k + 3] for k in (0, 3, 6))
        far = {"triangle": [o + a, o + b], "parallelogram": [o + a, o + b, o + a + b], "cylinder": [o + a]}
        if kind == "sdfgrid":
            c = scene.to_world[scene.face_shape[scene.offset(kind) :], :3, 2]
            far[kind] = [o + a, o + b, o + c, o + a + b, o + a + c, o + b + c, o + a + b + c]
        corners, reach = jnp.stack([o, *far.get(kind, [])]), 0.0  # and how far the face reaches around each
        if kind == "disk":
            reach = jnp.sqrt(a * a + b * b)
        elif kind == "sphere":
            reach = jnp.linalg.norm(a, axis=-1, keepdims=True)
        elif kind == "cylinder":
            reach = jnp.linalg.norm(b, axis=-1, keepdims=True) * jnp.sqrt(jnp.maximum(1.0 - _unit(a) ** 2, 0.0))
        boxes.append((corners.min(0) - reach, corners.max(0) + reach))
    return jnp.concatenate([low for low, _ in boxes]), jnp.concatenate([high for _, high in boxes])


def _bounds(scene: Scene, geometry: Any, instances: Instances | None) -> tuple[Any, Any, Any]:
    """Centre and radius of the sphere around the box that holds all faces, and the largest coordinate."""
    used = jnp.concatenate([jnp.arange(n) < scene.counts[k] for k, n in enumerate(scene.blocks) if n])
    low, high = _boxes(scene, geometry)
    boxes = [(jnp.where(used[:, None], low, jnp.inf), jnp.where(used[:, None], high, -jnp.inf))]
    if instances is not None:
        boxes.append(instances.boxes(low, high))
    low = jnp.concatenate([box[0] for box in boxes]).min(0)
    high = jnp.concatenate([box[1] for box in boxes]).max(0)
    return 0.5 * (low + high), 0.5 * jnp.linalg.norm(high - low), jnp.maximum(jnp.abs(low), jnp.abs(high)).max()


def front_and_faces(scene: Scene, plan: Plan) -> Any:
    """Rows of `World.geometry`, and which side is the front, (P, 10)."""
    geometry, side, _ = _face_geometry(scene, plan)
    return jnp.concatenate([geometry, side[:, None]], -1)


def bounding_sphere(scene: Scene, plan: Plan) -> Any:
    """Centre and radius of the sphere around the box that holds all faces, (4,). Held fixed."""
    instances = Instances.of(scene) if plan.instances else None
    center, radius, _ = _bounds(scene, *jax.lax.stop_gradient((_face_geometry(scene, plan)[0], instances)))
    return jnp.append(center, radius)


def _light_bounds(scene: Scene, geometry: Any, real: Any) -> Any:
    """Spheres (centre, radius) around the real lights, (L, 4); where there are many, one around all of them."""
    face = jnp.where(real, scene.lights, 0)
    o, a, b = (geometry[face, k : k + 3] for k in (0, 3, 6))
    kind = jnp.searchsorted(jnp.cumsum(jnp.asarray(scene.blocks)), face, side="right")[:, None]
    # Shares of e₁ and e₂ in the centre: triangle, parallelogram, disk and sphere, cylinder (e₁ is its axis).
    share = jnp.asarray([[1 / 3, 1 / 3], [0.5, 0.5], [0, 0], [0, 0], [0.5, 0]], geometry.dtype)[kind[:, 0]]
    center = o + share[:, :1] * a + share[:, 1:] * b
    norm = lambda v: jnp.linalg.norm(v, axis=-1, keepdims=True)
    corners = jnp.stack([o, o + a, o + b, jnp.where(kind == KINDS.index("triangle"), o, o + a + b)])
    flat = norm(corners - center[None]).max(0)
    radius = jnp.where(kind < 2, flat, jnp.where(kind < 4, jnp.maximum(norm(a), norm(b)), norm(a / 2) + norm(b)))
    radius = jnp.where(real[:, None], radius, 0.0)
    if len(face) > FEW_LIGHTS:
        middle = jnp.where(real[:, None], center, 0.0).sum(0, keepdims=True) / jnp.maximum(real.sum(), 1)
        radius = jnp.where(real[:, None], norm(center - middle) + radius, 0.0).max(0, keepdims=True)
        center = middle
    return jnp.concatenate([center, radius], -1)


def _power(lamps: Any, intensity: Any, radius: Any) -> Any:
    """Flux of each lamp that is no surface over π: what area times radiance is of a face."""
    kind, cutoff = lamps[:, 8], lamps[:, 6]
    cap = 2.0 * (1.0 - jnp.cos(cutoff))
    share = jnp.where(kind == LAMPS.index("spot"), cap, radius * radius)
    share = jnp.where((kind == LAMPS.index("point")) | (kind == LAMPS.index("goniometric")), 4.0, share)
    share = jnp.where(kind == LAMPS.index("sun"), 2.0 * np.pi * cutoff * radius * radius, share)
    share = jnp.where(kind == LAMPS.index("projector"), 4.0 / np.pi * lamps[:, 6] * lamps[:, 7], share)
    return intensity * share


def prepare(scene: Scene, plan: Plan) -> World:
    """The world of a scene under a plan. Pure; the search structure carries no derivatives."""
    sg = jax.lax.stop_gradient
    scene = without(scene, plan) if plan.cut else scene
    geometry, side, extra = _face_geometry(scene, plan)
    area = sg(face_areas(geometry, scene.blocks))
    instances = Instances.of(scene) if plan.instances else None
    center, radius, reach = _bounds(scene, sg(geometry), sg(instances))
    finish = scene.shape_finish[scene.face_shape].astype(geometry.dtype)

    # Lights are chosen by power; a share spread evenly keeps lamps at radiance 0 in the derivative.
    face = jnp.where(scene.lights >= 0, scene.lights, 0)
    shape = scene.face_shape[face]
    power = sg(area[face] * scene.radiance[scene.finishes[scene.shape_finish[shape], 1]].mean(-1))
    faces_real = (scene.lights >= 0) & (area[face] > 0)
    faces_real &= bool(
        plan.light_kinds or not (plan.lamp_kinds or plan.environment)
    )  # else only other lights are sampled
    lamps, of_table = (a if plan.lamp_kinds else a[:0] for a in (scene.lamps, scene.lamp_radiance))
    intensity = scene.radiance[of_table]
    power = jnp.concatenate([power, sg(_power(lamps, intensity.mean(-1), radius))])
    used = jnp.isin(lamps[:, 8].astype(int), jnp.array([LAMPS.index(k) for k in plan.lamp_kinds], int))
    real = jnp.concatenate([faces_real, used & (of_table > 0)])
    if plan.environment:  # as likely as all other lights together
        others = jnp.where(real, power, 0).sum()
        power = jnp.concatenate([power, jnp.where(others > 0, others, 1.0)[None]])
        real = jnp.concatenate([real, jnp.ones(1, bool)])
    n = jnp.maximum(real.sum(), 1)
    total = jnp.where(real, power, 0).sum()
    chance = jnp.where(total > 0, 0.95 * power / jnp.where(total > 0, total, 1.0) + 0.05 / n, 1.0 / n)
    chance = jnp.where(real, chance, 0.0)
    density = (
        jnp.zeros(scene.faces)
        .at[jnp.where(faces_real, scene.lights, scene.faces)]
        .add(chance[: len(face)] / jnp.where(faces_real, area[face], 1.0), mode="drop")
    )

    o = geometry[:, :3] - sg(center)[None]
    if instances is not None:  # a group's rows are about its own centre
        middles, group = instances.centers(geometry[:, :3]), instances.group_of_row
        o = jnp.where(group[:, None] < 0, o, geometry[:, :3] - middles[jnp.maximum(group, 0)])
        instances = instances.about(sg(center), middles)
    maps = affine(o, geometry[:, 3:6], geometry[:, 6:9])
    n, height, u, v = maps[:, :3] * side[:, None], maps[:, 3] * side, maps[:, 4:8], maps[:, 8:12]
    if sum(scene.blocks[3:5]):
        number = jnp.arange(scene.faces)
        ball, tube = number >= scene.offset("sphere"), number >= scene.offset("cylinder")
        radius_of = safe_norm(jnp.where(tube[:, None], geometry[:, 6:9], geometry[:, 3:6]))
        axis = jnp.where(tube[:, None], geometry[:, 3:6], jnp.cross(geometry[:, 3:6], geometry[:, 6:9]))
        n, height = jnp.where(ball[:, None], o, n), jnp.where(ball, radius_of, height)
        u = jnp.where(ball[:, None], jnp.concatenate([axis, u[:, 3:]], -1), u)
    columns = [n, height[:, None], side[:, None], finish[:, None], density[:, None].astype(side.dtype), u, v, *extra]
    rows = jnp.concatenate(columns, -1)
    last = jnp.zeros((1, rows.shape[1]), rows.dtype).at[0, FACE["side"]].set(1.0)
    last = last.at[0, FACE["density"]].set(chance[-1]) if plan.environment else last
    rows = jnp.concatenate([rows, last])
    kept = np.where(np.arange(len(scene.radiance)) == 1, plan.enclosure, plan.area_light)
    radiance, textured = scene.radiance * kept[:, None], scene.radiance_map * kept
    lit = radiance[scene.finishes[scene.shape_finish[shape], 1]][:, : plan.channels]
    joined = lambda *columns: jnp.concatenate([a.astype(side.dtype) for a in columns], -1)
    of_face, of_lamp = chance[: len(face), None], chance[len(face) : len(face) + len(lamps), None]
    light_rows = joined(geometry[face], rows[face, :3], density[face][:, None], of_face, lit, face[:, None])
    if plan.textured_lights:
        light_rows = joined(light_rows, textured[scene.finishes[scene.shape_finish[shape], 1]][:, None])
    if plan.lamp_kinds:  # position, direction, cutoff, beam, kind, up; then as for faces
        bright = intensity[:, : plan.channels]
        more = [scene.radiance_map[of_table][:, None]] if plan.textured_lights else []
        light_rows = jnp.concatenate([light_rows, joined(lamps, 0 * of_lamp, of_lamp, bright, 0 * of_lamp - 2, *more)])
    if plan.environment:  # like a face, of number −1
        row = jnp.zeros((1, light_rows.shape[1])).at[0, 13].set(chance[-1]).at[0, 14 + plan.channels].set(-1.0)
        light_rows = joined(jnp.concatenate([light_rows, row.astype(side.dtype)]))
    around = "sky" if "sky" in plan.textures else "bitmap"
    sun = Sun.of(scene, plan.channels, of_lamp[:, 0]) if "sun" in plan.lamp_kinds else None
    table = MaterialColumns(scene.channels)
    held = [f for f in plan.fields if f in table.at]
    columns = [j for f in held for j in range(*table[f])]
    if plan.channels == 1:
        columns = [j for f in held for j in range(*table[f])[: 1 if f in SPECTRA else None]]
    materials = jnp.concatenate(
        [scene.materials[:, np.array(columns)], *derive(plan.lobes, table, scene.materials)], -1
    )
    bright = [radiance[:, : plan.channels]]
    if plan.textured_lights:
        bright.append(textured[:, None].astype(radiance.dtype))
    bright = jnp.concatenate(bright, -1)
    finishes = jnp.concatenate([materials[scene.finishes[:, 0]], bright[scene.finishes[:, 1]]], -1)
    if plan.nodes:  # then rows of all materials, to which others refer
        dark = jnp.zeros((len(materials), bright.shape[1]), finishes.dtype)
        finishes = jnp.concatenate([finishes, jnp.concatenate([materials, dark], -1)])
    epsilon = 8 * 2.0**-23 * jnp.maximum(sg(reach), sg(radius))
    grids = Grids.of(scene, sg(center)) if "sdfgrid" in plan.kinds else None
    origins = jnp.concatenate([o, geometry[:, 3:]], -1)
    faces = Faces(origins, maps, scene.counts, center, epsilon, scene.blocks, instances, grids, scene.copies)
    search = build_search(sg(faces), plan)
    return World(
        geometry=geometry,
        faces=rows,
        finishes=finishes,
        light_rows=light_rows,
        light_cdf=jnp.cumsum(chance),
        light_bounds=_light_bounds(scene, sg(geometry), faces_real),
        search=search,
        center=sg(center),
        radius=sg(radius),
        epsilon=epsilon,
        present=jax.lax.rng_uniform(0.0, 1.0, ()) >= 0,  # not of the scene, which a closure may make constant
        instances=instances,
        grids=grids,
        environment=Environment.of(scene, plan.environment, around) if plan.environment else None,
        sun=sun,
        textures=Textures.of(scene, plan.channels, plan.textures, plan.nested) if plan.textures or plan.web else None,
        plan=plan,
        inner=len(scene.materials) if plan.nodes else 0,
        blocks=scene.blocks,
    )


@remembered
def prepared(scene: Scene, plan: Plan) -> tuple[World, Scene]:
    """The world of a scene by a compiled `prepare`, and the scene's tables: names and sensors make no other world."""
    tables = dataclasses.replace(in_working_precision(scene), structure=Structure(), plan=None)
    return program(prepare, tables, plan, keep=plan.storable)(tables, plan), tables


def world_of(scene: Scene | World, plan: Plan | None = None) -> World:
    """The world of a scene under its own plan (made here if it has none) or another; a world as it is."""
    if isinstance(scene, World):
        return scene
    return prepare(*fitting(scene, plan))


__all__ = ["FACE", "FEW_LIGHTS", "World", "prepare", "prepared", "world_of"]
