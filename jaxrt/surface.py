"""A point of M, recomputed differentiably from the face that a search found."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from . import coordinates, nodes
from .brdf import LOBES, Material, MaterialColumns
from .intersect.grids import meet
from .scene import FACE, KINDS
from .texture import Place, _row
from .vector import Frame, Spectrum, Vec3, cross, dot, normalise, safe_sqrt, where
from .world import World


class SurfacePoint(eqx.Module):
    """Where a ray lands. Everything but `face` carries derivatives; unit normals.

    position (m); normal: of the face, on its front side; shading: the normal that reflectance uses;
    uv: coordinates on the face; face: its number, −1 for the enclosure; distance along the ray (m,
    infinite for the enclosure); tangent and bitangent, ∂p/∂u and ∂p/∂v, and the place for textures, where the plan has
    a use for them.
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
    bitangent: Vec3 | None = None
    place: Place | None = None


def _vec(row: Any, start: int) -> Vec3:
    return Vec3(row[start], row[start + 1], row[start + 2])


def _sphere(center: Vec3, radius: Any, o: Vec3, d: Vec3, least: Any) -> tuple[Any, Vec3]:
    """Distance to a sphere beyond `least`, and the outward unit normal there."""
    s, r2 = o - center, radius * radius
    b = dot(s, d)
    away = s - d * b
    q = -(b + jnp.where(b >= 0, 1.0, -1.0) * safe_sqrt(r2 - dot(away, away)))
    other = (dot(s, s) - r2) / jnp.where(q == 0, 1.0, q)
    near, far = jnp.minimum(q, other), jnp.maximum(q, other)
    t = jnp.where(near > least, near, far)
    return t, normalise(s + d * t)


def _cylinder(foot: Vec3, radius: Any, axis: Vec3, o: Vec3, d: Vec3, least: Any) -> tuple[Any, Vec3]:
    """Distance to an open cylinder beyond `least`, and the outward unit normal there."""
    s, inverse = o - foot, 1.0 / dot(axis, axis)
    so, across = s - axis * (dot(s, axis) * inverse), d - axis * (dot(d, axis) * inverse)
    a, b, c = dot(across, across), dot(so, across), dot(so, so) - radius * radius
    turn = cross(so, across)
    q = -(b + jnp.where(b >= 0, 1.0, -1.0) * safe_sqrt(a * radius * radius - dot(turn, turn)))
    t0, t1 = q / jnp.where(a == 0, 1.0, a), c / jnp.where(q == 0, 1.0, q)
    near, far = jnp.minimum(t0, t1), jnp.maximum(t0, t1)
    height = (dot(s, axis) + near * dot(d, axis)) * inverse
    t = jnp.where((near > least) & (height >= 0) & (height <= 1), near, far)
    return t, normalise(so + across * t)


def surface_point(world: World, face: Any, o: Vec3, d: Vec3) -> SurfacePoint:
    """The point where the ray (o, d) meets a face; the enclosure for face −1: finite, far, normal −d."""
    plan, first = world.plan, world.first
    miss = face < 0
    number, move, turn = face, lambda n, c: (n, c), lambda v: v
    if world.instances is not None:
        number, k = world.instances.find(face)
        placement = world.instances.placement(k)
        move, turn = placement.function, placement.vector
    row = _row(world.faces, jnp.where(miss, world.faces.shape[0] - 1, number))
    center = Vec3(*world.center)
    function = lambda name: move(_vec(row, FACE[name]), row[FACE[name] + 3])
    at, side = o - center, row[FACE["side"]]
    n, c0 = function("n")
    if world.instances is not None:
        size = jnp.where(face < world.instances.rows, 1.0, 1.0 / safe_sqrt(dot(n, n)))
        n, c0 = n * size, c0 * size
    # Where the ray meets the face's plane, put back onto the plane against rounding over the distance.
    slope = dot(n, d)
    t, height = -(dot(n, at) + c0) / jnp.where(slope == 0, 1.0, slope), 0.0
    p = at + d * t
    p, normal = p - n * (dot(n, p) + c0), n
    (nu, cu), (nv, cv) = function("u"), function("v")
    u, v = dot(nu, p) + cu, dot(nv, p) + cv
    for kind in ("sphere", "cylinder"):
        if world.blocks[KINDS.index(kind)] == 0:
            continue
        # Other rows go through as the unit sphere or cylinder: no 0/0 in derivatives.
        here = number >= first(kind)
        middle, radius = where(here, n, Vec3(0.0, 0.0, 0.0)), jnp.where(here, c0, 1.0)
        axis = where(here, _vec(row, FACE["u"]), Vec3(0.0, 0.0, 1.0))
        least = -0.5 * world.epsilon
        if kind == "sphere":
            tc, nc = _sphere(middle, radius, at, d, least)
            pc = middle + nc * radius
        else:
            tc, nc = _cylinder(middle, radius, axis, at, d, least)
            pc = at + d * tc
            height = jnp.where(here, dot(pc - middle, axis) / dot(axis, axis), 0.0)
        t, u, v = (jnp.where(here, a, b) for a, b in ((tc, t), (0.0, u), (0.0, v)))
        normal, p = where(here, nc * side, normal), where(here, pc, p)
    grid, smooth_grid = False, normal
    if world.grids is not None:
        grid = number >= first("sdfgrid")
        k = jnp.where(grid, number - first("sdfgrid"), 0)
        bound = jnp.where(grid, -0.5 * world.epsilon, jnp.inf)  # nothing is searched for other rows
        tc = meet(world.grids, k, at, d, bound)[1]
        tc, pc, nc, sc = world.grids.land(k, at, d, jnp.where(grid, tc, 0.0), plan.smooth_normals)
        t, u, v = (jnp.where(grid, a, b) for a, b in ((tc, t), (0.0, u), (0.0, v)))
        normal, smooth_grid, p = where(grid, nc * side, normal), sc * side, where(grid, pc, p)
    p = where(miss, at + d * (4.0 * world.radius + 1.0), p)
    normal = where(miss, -d, normal)
    u, v = jnp.where(miss, 0.0, u), jnp.where(miss, 0.0, v)
    shading, tangent, bitangent, extra = normal, None, None, FACE["extra"]
    out = normal * side  # of curved faces the outward normal
    if plan.smooth_normals:
        smooth = move(_interpolated(row, u, v), 0.0)[0] * side
        given = (dot(smooth, smooth) > 1e-12) & ~miss
        shading, extra = normalise(where(given, smooth, normal)), extra + 9
    if world.grids is not None:
        shading = where(grid, smooth_grid, shading)
    if plan.tangents:
        tangent, bitangent = _tangents(world, row, number, p, (u, v), out, turn, extra)
        given = (dot(tangent, tangent) > 0) & ~miss
        # as Mitsuba, and not about the shading normal but for grids
        frame = Frame.around(normal if world.grids is None else where(grid, shading, normal))
        tangent = where(given, tangent, frame.s)
        bitangent = where(given, bitangent, frame.t) if plan.bumps else None
    place = coordinates.place(world, row, number, (u, v), out, height) if plan.coordinates else None
    if world.environment is not None and place is not None:
        place = Place(where(miss, world.environment.coordinates(d), place.uv), place.row, place.on_face)
    return SurfacePoint(
        position=p + center,
        normal=normal,
        shading=shading,
        uv=(u, v),
        face=face,
        distance=jnp.where(miss, jnp.inf, t),
        finish=jax.lax.stop_gradient(row[FACE["finish"]]).astype(jnp.int32),
        light_density=jax.lax.stop_gradient(row[FACE["density"]]),
        tangent=tangent,
        bitangent=bitangent,
        place=place,
    )


def _interpolated(row: Any, u: Any, v: Any) -> Vec3:
    """The mean of a face's vertex normals at a point, 0 where it has none."""
    n0, n1, n2 = (_vec(row, FACE["extra"] + 3 * k) for k in range(3))
    return n0 * (1.0 - u - v) + n1 * u + n2 * v


def light_normal(world: World, face: Any, u: Any, v: Any, front: Vec3) -> Vec3:
    """The normal that a point of a light's face emits about: of its vertices as Mitsuba's, else `front`, its face's."""
    if not world.plan.smooth_lights:
        return front
    row = _row(world.faces, face)
    smooth = _interpolated(row, u, v) * row[FACE["side"]]
    return normalise(where(dot(smooth, smooth) > 1e-12, smooth, front))


def _tangents(
    world: World, row: Any, number: Any, p: Vec3, on_face: tuple[Any, Any], out: Vec3, turn: Any, column: int
) -> tuple[Vec3, Vec3]:
    """∂p/∂u and ∂p/∂v (that only where the plan has bumps) at p, counted from the world's centre; 0 where unknown."""
    first = turn(_vec(row, column))
    second = turn(_vec(row, column + 3)) if world.plan.bumps else first
    disks = world.blocks[KINDS.index("disk")]
    middle = _vec(row, FACE["n"])
    if disks:
        disk = (number >= world.first("disk")) & (number < world.first("sphere"))
        middle = where(disk, _vec(_row(world.geometry, jnp.maximum(number, 0)), 0) - Vec3(*world.center), middle)
    return coordinates.curved_tangents(world, row, p - middle, number, on_face, out, (first, second))


def radiance_of(world: World, x: SurfacePoint, w: Vec3) -> Spectrum:
    """L⁰(x, ω): emitted radiance, on the front side only: as in Mitsuba that of vertex normals, if there are such."""
    row, plan = _row(world.finishes, x.finish), world.plan
    k = world.finishes.shape[1] - plan.channels - plan.textured_lights
    emitted = Spectrum(tuple(row[k + c] for c in range(plan.channels)))
    if plan.textured_lights:
        emitted = textured(world, row[k + plan.channels], x.place, emitted)
    front = dot(x.shading if plan.smooth_lights else x.normal, w) > 0
    emitted = emitted.map(lambda c: jnp.where(front, c, 0.0))
    if world.sun is None:
        return emitted
    return emitted + world.sun.radiance(-w).map(lambda c: jnp.where(x.face < 0, c, 0.0))


def textured(world: World, index: Any, place: Place | None, value: Spectrum) -> Spectrum:
    """The value of a texture at a place, or `value` where its number is 0."""
    assert world.textures is not None
    assert place is not None
    index = jax.lax.stop_gradient(index).astype(jnp.int32)
    return where(index > 0, world.textures.at(index, place), value)


class Shading(eqx.Module):
    """Local coordinates at a point for reflection of light towards ω_o: frame, side, material, ω_o itself."""

    frame: Frame
    side: Any
    material: Material
    wo: Vec3
    even: Any = True  # whether the material is the same all over the face, and the face one that has coordinates
    found: nodes.Found | None = None  # where the plan has materials made of others

    def to_local(self, w: Vec3) -> Vec3:
        v = self._base(w)
        return v if self.found is None or self.found.tilt is None else self.found.tilt.to_local(v)

    def _base(self, w: Vec3) -> Vec3:
        v = self.frame.to_local(w)
        return Vec3(v.x, v.y, v.z * self.side)

    def to_world(self, v: Vec3) -> Vec3:
        if self.found is not None and self.found.tilt is not None:
            v = self.found.tilt.to_world(v)
        return self.frame.to_world(Vec3(v.x, v.y, v.z * self.side))

    def factor(self, w: Vec3) -> Any:
        """What light from ω is worth beside what the lobe makes of it: the share of the choice of that lobe, and what a
        turned normal lets through; nothing, where that and the surface see ω on different sides."""
        if self.found is None:
            return 1.0
        if self.found.tilt is None:
            return self.found.share
        base, local = self._base(w), self.to_local(w)
        cos2 = jnp.maximum(base.z * base.z, 1e-12)
        through = 2.0 / (1.0 + safe_sqrt(1.0 + self.found.shade * (1.0 - cos2) / cos2))
        return jnp.where(base.z * local.z > 0, self.found.share * through, 0.0)


def choice(world: World, s: Any) -> Any:
    """A uniform number where a plan has mixtures to choose from."""
    return s.child(9).pair_at(0)[0] if "blend" in world.plan.nodes else None


def shading_at(world: World, x: SurfacePoint, wo: Vec3, u: Any = None, moving: bool = False) -> Shading:
    """Where ω_o is behind a two-sided surface the local frame is mirrored, so that cosines are positive.

    `u`: from `choice`. `moving`: whether derivatives are taken.
    """
    plan = world.plan
    frame = Frame.around(x.shading) if x.tangent is None else Frame.along(x.shading, x.tangent)
    columns = MaterialColumns(plan.channels, plan.fields)
    row, behind, found = _row(world.finishes, x.finish), dot(x.shading, wo) < 0, None
    if plan.nodes:
        found = nodes.found(world, x, frame, wo, row, u, moving)
        row = found.row
    material = Material.of(row, columns, lambda k, v: textured(world, k, x.place, v))
    even = True if (maps := columns.at.get("map:reflectance")) is None else row[maps[0]] == 0
    if plan.twosided == "all":
        side = jnp.where(behind, -1.0, 1.0)
    elif plan.twosided == "some":
        side = jnp.where(behind & (material.twosided > 0.5), -1.0, 1.0)
    else:
        side = jnp.ones_like(wo.x)
    at = Shading(frame, side, material, wo, even if found is None else even & found.single, found)
    if world.grids is not None:  # whose surface has no elements
        at = dataclasses.replace(at, even=at.even & (x.face < world.first("sdfgrid")))
    return dataclasses.replace(at, wo=at.to_local(wo))


def is_diffuse(world: World, at: Shading) -> Any:
    """Whether a point reflects alike in all directions, and all over its face."""
    lobe = at.material.lobe
    if lobe is None:
        return at.even if world.plan.lobes == ("diffuse",) else False
    return at.even & (jnp.round(lobe) == LOBES["diffuse"].number)


def leave(world: World, x: Any, w: Vec3) -> Vec3:
    """Origin of a ray that leaves x (with position and normal) along ω: moved off the surface by more than rounding
    can reach.

    Faces coplanar with x's own are then behind the ray by `epsilon`, and a search that accepts
    distances above −epsilon/2 still sees a wall that rounding put the origin just behind.
    """
    out = jnp.where(dot(x.normal, w) < 0, -world.epsilon, world.epsilon)
    return x.position + x.normal * jax.lax.stop_gradient(out)
