"""Path or field: which method a picture is made with when nobody asks for one, and why."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..brdf import MaterialColumns
from ..casting import cast
from ..chart import even_point, off_surface
from ..compiler import program, remembered
from ..sampling.sobol import Stream
from ..sampling.warp import cosine_hemisphere
from ..scene import Scene
from ..surface import _row, surface_point
from ..vector import Frame, dot
from ..world import FACE, World
from .partition import areas_of_faces, diffuse_sides

FIELD_FROM = 1 << 21
"""Paths of a picture from which a field is worth its compiling and solving."""

AGAIN = 0.2
"""The share of reflected light that has to be reflected diffusely once more for a field to pay."""

RAYS = 1024


def choose(world: World, scene: Scene, depth: int, paths: int) -> tuple[str, str]:
    """The method, and the reason. A field pays where diffuse light goes to and fro, in pictures of many paths."""
    plan = world.plan
    if not plan.bounces or 0 <= depth <= 2:
        return "path", "no light is reflected twice"
    if paths < FIELD_FROM:
        return "path", f"{paths} paths are sooner traced than a field is compiled and solved (from {FIELD_FROM} on)"
    if plan.instances:
        return "path", "instances have no elements"
    if plan.enclosure or not plan.lights:
        return "path", "light comes from all around or is not sampled"
    again = interreflection(world, scene)
    said = f"{again:.0%} of light from diffuse surfaces is reflected diffusely once more"
    return ("field" if again >= AGAIN else "path"), said


@remembered
def interreflection(world: World, scene: Scene) -> float:
    """The share of light leaving diffuse sides that others like them reflect again."""
    faces = sum(world.blocks)
    area, (diffuse, _) = areas_of_faces(world), diffuse_sides(world, scene)
    weight = np.tile(area, 2) * diffuse
    if not weight.sum() > 0:
        return 0.0
    sides = np.random.default_rng(0).choice(2 * faces, RAYS, p=weight / weight.sum()).astype(np.int32)
    args = world, sides, (weight > 0).astype(np.float32)
    return float(program(_again, *args, keep=world.plan.storable)(*args))


def _again(world: World, sides: Any, diffuse: Any) -> Any:
    faces = sum(world.blocks)
    columns = MaterialColumns(world.plan.channels, world.plan.fields)["reflectance"]

    def one(side: Any, k: Any) -> Any:
        s = Stream(k, jnp.uint32(1))
        face = side % faces
        y, n = even_point(world, face, s.pair_at(0))
        n = n * jnp.where(side < faces, 1.0, -1.0)
        w = Frame.around(n).to_world(cosine_hemisphere(s.pair_at(1)))
        x = cast(world, surface_point(world, face, off_surface(world, y, n), -n), w)
        met = jnp.maximum(x.face, 0) + jnp.where(dot(x.normal, w) > 0, faces, 0)
        finish = _row(world.faces, jnp.maximum(x.face, 0))[FACE["finish"]].astype(jnp.int32)
        albedo = _row(world.finishes, finish)[slice(*columns)].mean()
        return jnp.where((x.face >= 0) & (x.face < faces), _row(diffuse, met) * albedo, 0.0)

    return jax.vmap(one)(sides, jnp.arange(RAYS, dtype=jnp.uint32)).mean()
