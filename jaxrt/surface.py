"""A point of M, recomputed differentiably from the face that a search found."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .brdf import Material, MaterialColumns
from .scene import KINDS
from .vector import Frame, Spectrum, Vec3, cross, dot, normalise, safe_sqrt, where
from .world import World


class SurfacePoint(eqx.Module):
    """Where a ray lands. Everything but `face` carries derivatives; unit normals.

    position (m); normal: of the face, on its front side; shading: the normal that reflectance uses;
    uv: coordinates on the face; face: its number, −1 for the enclosure; distance along the ray (m,
    infinite for the enclosure); tangent: ∂p/∂u where the plan has anisotropic reflectance.
    """

    position: Vec3
    normal: Vec3
    shading: Vec3
    uv: tuple[Any, Any]
    face: Any
    distance: Any
    finish: Any
    light_density: Any
    tangent: Vec3 | None = None


def _row(table: Any, index: Any) -> Any:
    return table.at[index].get(mode="clip", wrap_negative_indices=False)


def _vec(row: Any, start: int) -> Vec3:
    return Vec3(row[start], row[start + 1], row[start + 2])


def _plane(row: Any, o: Vec3, d: Vec3) -> tuple[Any, Any, Any]:
    """Distance and coordinates (u, v) along e₁ and e₂ at which a ray meets the plane of a face."""
    v0, e1, e2 = _vec(row, 0), _vec(row, 3), _vec(row, 6)
    s, p = o - v0, cross(d, e2)
    det = dot(e1, p)
    inverse = 1.0 / jnp.where(det == 0, 1.0, det)
    q = cross(s, e1)
    return dot(e2, q) * inverse, dot(s, p) * inverse, dot(d, q) * inverse


def quadratic(a: Any, b: Any, c: Any) -> tuple[Any, Any]:
    """Both roots of a t² + 2 b t + c, without cancellation; +inf where there is none."""
    disc = b * b - a * c
    ok = disc > 0
    q = -(b + jnp.where(b >= 0, 1.0, -1.0) * safe_sqrt(disc))
    t0 = q / jnp.where(a == 0, 1.0, a)
    t1 = c / jnp.where(q == 0, 1.0, q)
    inf = jnp.inf
    return jnp.where(ok, jnp.minimum(t0, t1), inf), jnp.where(ok, jnp.maximum(t0, t1), inf)


def _sphere(row: Any, o: Vec3, d: Vec3, least: Any) -> tuple[Any, Vec3]:
    """Distance to a sphere beyond `least`, and the outward unit normal there."""
    c, e1 = _vec(row, 0), _vec(row, 3)
    s = o - c
    r2 = dot(e1, e1)
    b = dot(s, d)
    away = s - d * b
    half = safe_sqrt(r2 - dot(away, away))
    c0 = dot(s, s) - r2
    q = -(b + jnp.where(b >= 0, 1.0, -1.0) * half)
    other = c0 / jnp.where(q == 0, 1.0, q)
    near, far = jnp.minimum(q, other), jnp.maximum(q, other)
    t = jnp.where(near > least, near, far)
    return t, normalise(s + d * t)


def _cylinder(row: Any, o: Vec3, d: Vec3, least: Any) -> tuple[Any, Vec3]:
    """Distance to an open cylinder beyond `least`, and the outward unit normal there."""
    p0, axis, e2 = _vec(row, 0), _vec(row, 3), _vec(row, 6)
    s, l2 = o - p0, dot(axis, axis)
    inverse = 1.0 / jnp.where(l2 == 0, 1.0, l2)
    so, dd = s - axis * (dot(s, axis) * inverse), d - axis * (dot(d, axis) * inverse)
    near, far = quadratic(dot(dd, dd), dot(so, dd), dot(so, so) - dot(e2, e2))
    height = (dot(s, axis) + jnp.where(jnp.isfinite(near), near, 0.0) * dot(d, axis)) * inverse
    t = jnp.where((near > least) & (height >= 0) & (height <= 1), near, far)
    t = jnp.where(jnp.isfinite(t), t, 0.0)
    return t, normalise(so + dd * t)


def surface_point(world: World, face: Any, o: Vec3, d: Vec3) -> SurfacePoint:
    """The point where the ray (o, d) meets a face; the enclosure for face −1: finite, far, normal −d."""
    plan, number = world.plan, world.faces.shape[0] - 1
    miss = face < 0
    row = _row(world.faces, jnp.where(miss, number, face))
    flat = any(world.blocks[:3])
    side = row[9]
    e1, e2 = _vec(row, 3), _vec(row, 6)
    if flat:
        t, u, v = _plane(row, o, d)
        normal = normalise(cross(e1, e2)) * side
        position = _vec(row, 0) + e1 * u + e2 * v  # error in proportion to the face, not to the distance
    else:
        t, u, v = jnp.zeros_like(d.x), jnp.zeros_like(d.x), jnp.zeros_like(d.x)
        normal, position = -d, o
    least = -0.5 * world.epsilon
    for kind, meet in (("sphere", _sphere), ("cylinder", _cylinder)):
        if world.blocks[KINDS.index(kind)] == 0:
            continue
        here = face >= world.first(kind)
        # Rows of other kinds go through with a unit sphere's or cylinder's numbers: no 0/0 in derivatives.
        safe = [jnp.where(here, row[k], float(k in (3, 7))) for k in range(9)]
        tc, nc = meet(safe, o, d, least)
        start = _vec(safe, 0)
        if kind == "sphere":
            pc = start + nc * safe_sqrt(dot(_vec(safe, 3), _vec(safe, 3)))
        else:
            pc = o + d * tc
        t, u, v = (jnp.where(here, a, b) for a, b in ((tc, t), (0.0, u), (0.0, v)))
        normal, position = where(here, nc * side, normal), where(here, pc, position)
    far = 4.0 * world.radius + 1.0
    position = where(miss, o + d * far, position)
    normal = where(miss, -d, normal)
    zero = lambda a: jnp.where(miss, 0.0, a)
    shading, tangent, at = normal, None, 12
    if plan.smooth_normals:
        w = 1.0 - u - v
        n0, n1, n2 = _vec(row, 12), _vec(row, 15), _vec(row, 18)
        smooth = n0 * zero(w) + n1 * zero(u) + n2 * zero(v)
        given = (dot(smooth, smooth) > 1e-12) & ~miss
        smooth = normalise(where(given, smooth, normal)) * jnp.where(given, world_flip(row), 1.0)
        shading, at = where(given, smooth, normal), 21
    if plan.anisotropic:
        tangent = _vec(row, at)
        for kind in ("sphere", "cylinder"):
            if world.blocks[KINDS.index(kind)]:
                axis = cross(e1, e2) if kind == "sphere" else e1
                tangent = where(face >= world.first(kind), cross(axis, normal), tangent)
        given = dot(tangent, tangent) > 0
        tangent = where(given & ~miss, tangent, Frame.around(shading).s)
    return SurfacePoint(
        position=position,
        normal=normal,
        shading=shading,
        uv=(zero(u), zero(v)),
        face=face,
        distance=jnp.where(miss, jnp.inf, t),
        finish=jax.lax.stop_gradient(row[10]).astype(jnp.int32),
        light_density=jax.lax.stop_gradient(row[11]),
        tangent=tangent,
    )


def world_flip(row: Any) -> Any:
    """Side of a mesh face: its vertex normals turn with it."""
    return row[9]


def radiance_of(world: World, x: SurfacePoint, w: Vec3) -> Spectrum:
    """L⁰(x, ω): emitted radiance, on the front side only."""
    row = _row(world.finishes, x.finish)
    k = row.shape[0] - world.plan.channels
    front = dot(x.normal, w) > 0
    return Spectrum(tuple(jnp.where(front, row[k + c], 0.0) for c in range(world.plan.channels)))


class Shading(eqx.Module):
    """Local coordinates at a point for reflection of light towards ω_o: frame, side, material, ω_o itself."""

    frame: Frame
    side: Any
    material: Material
    wo: Vec3

    def to_local(self, w: Vec3) -> Vec3:
        v = self.frame.to_local(w)
        return Vec3(v.x, v.y, v.z * self.side)

    def to_world(self, v: Vec3) -> Vec3:
        return self.frame.to_world(Vec3(v.x, v.y, v.z * self.side))


def shading_at(world: World, x: SurfacePoint, wo: Vec3) -> Shading:
    """Where ω_o is behind a two-sided surface the local frame is mirrored, so that cosines are positive."""
    plan = world.plan
    frame = Frame.around(x.shading) if x.tangent is None else Frame.along(x.shading, x.tangent)
    columns = MaterialColumns(plan.channels, plan.fields)
    material = Material.of(_row(world.finishes, x.finish), columns)
    behind = dot(x.shading, wo) < 0
    if plan.twosided == "all":
        side = jnp.where(behind, -1.0, 1.0)
    elif plan.twosided == "some":
        side = jnp.where(behind & (material.twosided > 0.5), -1.0, 1.0)
    else:
        side = jnp.ones_like(wo.x)
    v = frame.to_local(wo)
    return Shading(frame, side, material, Vec3(v.x, v.y, v.z * side))


def leave(world: World, x: SurfacePoint, w: Vec3) -> Vec3:
    """Origin of a ray that leaves x along ω: moved off the surface by more than rounding can reach.

    Faces coplanar with x's own are then behind the ray by `epsilon`, and a search that accepts
    distances above −epsilon/2 still sees a wall that rounding put the origin just behind.
    """
    out = jnp.where(dot(x.normal, w) < 0, -world.epsilon, world.epsilon)
    return x.position + x.normal * jax.lax.stop_gradient(out)
