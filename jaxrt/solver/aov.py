"""What each pixel sees first, beside its radiance: a program of its own, made where it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..casting import cast
from ..compiler import program
from ..files.image import AOVS, aov_of
from ..parts import SceneError
from ..sampling.sobol import Drawn
from ..surface import SurfacePoint, choice, shading_at
from ..vector import Vec3
from ..world import World
from .begin import Picture
from .path import sample_stream

SAMPLES = 16
"""Of a pixel's samples, those that are looked at."""

PIXELS = 4096
"""Of one program."""


def checked(names: Sequence[str], views: Sequence[Picture]) -> tuple[str, ...]:
    """The names of what is asked for. Raises `SceneError` for one that is not known, and where a view sees nothing."""
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        if not all(aov_of(name)) or aov_of(name)[1] not in AOVS:
            raise SceneError(f"aov: {name!r} is not known; there are {', '.join(AOVS)}, each also as name:kind")
    if names and any(view.searches for view in views):
        raise SceneError("aov: an irradiancemeter sees no first surface; take another sensor, or leave it out")
    return names


def aovs(world: World, view: Picture, key: Any, spp: int, names: tuple[str, ...], pool: Executor) -> dict[str, Any]:
    """By name, what the first surface is that pixels see: (H, W), or (H, W, k), 0 where there is none.

    depth: distance along the ray from where it begins, on the near plane (m); normal: that of shading; geo_normal:
    that of the face; albedo: reflectance, of what is diffuse if the material has both; uv: of textures, or on the face
    if the scene has none; position (m); each the mean over the first samples of the pixel. face: number of the one at
    the pixel's centre, −1 for none.
    """
    if not names:
        return {}
    kinds = tuple(sorted({aov_of(name)[1] for name in names}))
    width, height = int(view.width), int(view.height)
    count = width * height
    rows = np.resize(np.arange(count, dtype=np.int32), (-(-count // PIXELS), min(PIXELS, count)))
    more = key, np.int32(min(spp, SAMPLES))
    run = program(_of_pixels, world, view, rows[0], *more, static=(kinds,), keep=world.plan.storable)
    found = list(pool.map(lambda row: jax.tree.map(np.asarray, run(world, view, row, *more)), rows))
    whole = {name: np.concatenate([part[aov_of(name)[1]] for part in found])[:count] for name in names}
    return {name: a.reshape(height, width, *a.shape[1:]) for name, a in whole.items()}


def _of_pixels(world: World, view: Picture, numbers: Any, seed: Any, count: Any, names: tuple[str, ...]) -> Any:
    averaged = [name for name in names if name != "face"]

    def one(number: Any) -> Any:
        def look(i: Any) -> Any:
            s = sample_stream(seed, number, i)
            path = view(world, number, s)
            return _seen(world, cast(world, path.o, path.d), path.d, choice(world, s), averaged)

        zero = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(look, jnp.int32(0)))
        add = lambda i, total: jax.tree.map(jnp.add, total, look(i))
        found = jax.tree.map(lambda a: a / count, jax.lax.fori_loop(0, count, add, zero)) if averaged else {}
        if "face" in names:
            at = tuple(k.astype(world.faces.dtype) + 0.5 for k in (number % view.width, number // view.width))
            path = view.through(world, at, Drawn(((0.5, 0.5), (0.5, 0.5))))
            found["face"] = world.search.closest(path.o, path.d)
        return found

    return jax.vmap(one)(numbers)


def _seen(world: World, x: SurfacePoint, d: Vec3, u: Any, names: list[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if "albedo" in names:
        albedo = shading_at(world, x, -d, u).material.reflectance
        black = jnp.zeros((world.plan.out_channels,), world.faces.dtype)
        values["albedo"] = black if albedo is None else black + albedo.array()
    uv = jnp.stack(x.uv if x.place is None else x.place.uv)
    values |= {"depth": x.distance, "normal": x.shading.array(), "position": x.position.array(), "uv": uv}
    values["geo_normal"] = x.normal.array()
    return {name: jnp.where(x.face >= 0, values[name], 0.0) for name in names}
