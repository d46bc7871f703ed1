"""What a surface is made of at a point, where its material refers to others: mixtures, sides, turned normals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from .brdf import NODES, MaterialColumns
from .vector import Frame, Spectrum, Vec3, cross, dot, normalise, where

if TYPE_CHECKING:
    from .surface import SurfacePoint
    from .world import World

LEAST = 0.05
"""Of the chance of either part of a mixture under differentiation: what a scene has none of has a derivative."""


class Found(eqx.Module):
    """The row of a lobe, what the choices on the way to it weigh (1, but for derivatives), and the frame in which it
    reflects, in coordinates of the surface's own frame, with the squared roughness that shades what it turns away."""

    row: Any
    share: Any
    tilt: Frame | None
    shade: Any
    single: Any  # whether there was no choice and no turn


def found(world: World, x: SurfacePoint, frame: Frame, wo: Vec3, row: Any, u: Any, moving: bool) -> Found:
    """From a surface's own row to that of a lobe, seen from ω_o. `u`: a uniform number, for mixtures."""
    behind = dot(x.shading, wo) < 0
    plan, columns = world.plan, MaterialColumns(world.plan.channels, world.plan.fields)
    offset = world.finishes.shape[0] - world.inner
    one = 1.0 + 0.0 * frame.n.x
    share, shade, tilt = one, 0.0 * one, None
    if plan.tilts:
        tilt = Frame(*(Vec3(*(one * (j == k) for j in range(3))) for k in range(3)))
    lobe = columns["lobe"][0]
    single = row[lobe] < 99.5
    for _ in range(plan.depth):
        is_node = lambda name, row=row: jnp.round(row[lobe]) == NODES[name]
        second = jnp.zeros_like(behind)
        if "blend" in plan.nodes:
            weight, least = _number(world, x, row, columns, "weight"), LEAST if moving else 0.0
            chance = sg(jnp.clip(weight, least, 1.0 - least))
            takes = u < chance
            ratio = jnp.where(takes, weight, 1.0 - weight) / jnp.where(takes, chance, 1.0 - chance)
            again = jnp.where(
                takes, u / jnp.where(chance > 0, chance, 1.0), (u - chance) / jnp.where(chance < 1, 1.0 - chance, 1.0)
            )
            blends = is_node("blend")
            share = share * jnp.where(blends, ratio, 1.0)
            u = jnp.where(blends, jnp.clip(again, 0.0, 1.0 - 2.0**-24), u)
            second = second | (blends & takes)
        if "sides" in plan.nodes:
            second = second | (is_node("sides") & behind)
        for name, turned in (("normalmap", _mapped), ("bumpmap", _bumped)):
            if name in plan.nodes:
                here, towards = is_node(name), _towards(world, frame, wo, row, columns)
                new = turned(world, x, frame, row, columns, towards)
                assert tilt is not None
                tilt = where(here, new, tilt)
                cos2 = jnp.maximum(new.n.z * new.n.z, 1e-6)
                alpha2 = jnp.clip(0.125 * (1.0 - cos2) / cos2, 0.0, 1.0) * (row[columns["shadowed"][0]] > 0.5)
                shade = jnp.where(here, alpha2, shade)
        child = jnp.where(second, row[columns["second"][0]], row[columns["first"][0]])
        child = offset + sg(child).astype(jnp.int32)
        row = jnp.where(row[lobe] > 99.5, world.finishes.at[child].get(mode="clip"), row)
    return Found(row, share, tilt, shade, single)


def _number(world: World, x: SurfacePoint, row: Any, columns: MaterialColumns, field: str) -> Any:
    from .surface import textured

    value = row[columns[field][0]]
    if f"map:{field}" not in columns.at:
        return value
    number = row[columns[f"map:{field}"][0]]
    return textured(world, number, x.place, Spectrum.full(columns.channels, value)).channels[0]


def _towards(world: World, frame: Frame, wo: Vec3, row: Any, columns: MaterialColumns) -> Vec3:
    """ω_o in a surface's own coordinates, mirrored where it is behind one that has two sides."""
    v, plan = frame.to_local(wo), world.plan
    two = plan.twosided == "all" if plan.twosided != "some" else row[columns["twosided"][0]] > 0.5
    return Vec3(v.x, v.y, jnp.where(two, jnp.abs(v.z), v.z))


def _aligned(frame: Frame, x: SurfacePoint, n: Vec3, wo: Vec3) -> Frame:
    """The frame of a normal in a surface's own coordinates, its first axis along ∂p/∂u. A normal that ω_o cannot see
    from where it sees the surface is turned to the other side of the surface's own."""
    assert x.tangent is not None
    around = jnp.where(dot(n, wo) * wo.z > 0, 1.0, -1.0)
    n = Vec3(n.x * around, n.y * around, n.z)
    return Frame.along(n, frame.to_local(x.tangent))


def _mapped(world: World, x: SurfacePoint, frame: Frame, row: Any, columns: MaterialColumns, wo: Vec3) -> Frame:
    from .surface import textured

    start, stop = columns["reflectance"]
    value = Spectrum(tuple(row[k] for k in range(start, stop)))
    r = textured(world, row[columns["map:reflectance"][0]], x.place, value).channels
    n = normalise(Vec3(*(2.0 * r[min(k, len(r) - 1)] - 1.0 for k in range(3))))
    return _aligned(frame, x, n, wo)


def _bumped(world: World, x: SurfacePoint, frame: Frame, row: Any, columns: MaterialColumns, wo: Vec3) -> Frame:
    assert world.textures is not None
    assert x.place is not None
    assert x.tangent is not None
    assert x.bitangent is not None
    number = sg(row[columns["map:roughness"][0]]).astype(jnp.int32)
    slope, scale = world.textures.slope(number, x.place), row[columns["weight"][0]]
    along = [
        p + x.shading * (scale * g - dot(x.shading, p)) for p, g in zip((x.tangent, x.bitangent), slope, strict=True)
    ]
    n = normalise(cross(along[0], along[1]))
    n = n * jnp.where(dot(x.normal, n) < 0, -1.0, 1.0)
    return _aligned(frame, x, frame.to_local(n), wo)
