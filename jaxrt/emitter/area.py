"""Area lights: a face is chosen by power, then a direction towards it.

Spheres are sampled by the cone that they subtend, triangles and parallelograms by their solid angle where the
plan says that it pays, all else by area; flat ones more densely towards the corners that light the point more.
Faces with vertex normals light, and have densities, by the cosine of these, as Mitsuba's: by the face's own cosine
they would be a little brighter or darker (3 % under an icosahedron, .4 % in the mean).
Densities are over solid angle at the lit point; sampling and densities are held fixed under differentiation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import coordinates
from ..gradient.material import towards
from ..parts import LAMPS
from ..radiometry import one_minus_cos
from ..sampling import warp
from ..sampling.sobol import Drawn, Stream
from ..surface import SurfacePoint, _row, _vec, light_normal, radiance_of, surface_point, textured
from ..texture import Place
from ..vector import Frame, Spectrum, Vec3, cross, dot, length, normalise, safe_sqrt, where
from ..world import FACE, FEW_LIGHTS, World
from . import delta, spherical


class LightSample(eqx.Module):
    """Direction from the lit point, distance (m), emitted radiance towards it, density (sr⁻¹), the face.

    `known`: the density as `density` gives it, which does not know how the lit surface is turned. Weights against
    reflection have to use this one on both sides; any will do there, as long as it is the same.
    """

    w: Vec3
    distance: Any
    radiance: Spectrum
    pdf: Any
    known: Any
    face: Any
    jacobian: Any  # 1; carries derivatives, see gradient.material
    hidden: Any  # whether the light's own face lies before it: the near side of a tube that shines inwards


def _choose(world: World, u: Any) -> tuple[Any, Any]:
    """A light by its chance, and u made uniform again."""
    cdf = world.light_cdf
    total = cdf[-1]
    n = cdf.shape[0]
    if n <= FEW_LIGHTS:
        k = sum((u * total >= cdf[j]).astype(jnp.int32) for j in range(n - 1))
    else:
        k = jnp.searchsorted(cdf, u * total, side="right", method="scan").astype(jnp.int32)
    k = jnp.minimum(k, n - 1)
    high = _row(cdf, k)
    low = jnp.where(k > 0, _row(cdf, jnp.maximum(k - 1, 0)), 0.0)
    width = high - low
    return k, jnp.clip((u * total - low) / jnp.where(width > 0, width, 1.0), 0.0, 1.0 - 2.0**-23)


def _cone(x: Vec3, center: Vec3, r2: Any) -> tuple[Vec3, Any, Any, Any]:
    """Axis towards a sphere, its squared distance, 1 − cos of the cone, and whether x is outside."""
    axis = center - x
    d2 = dot(axis, axis)
    outside = d2 > r2 * (1.0 + 1e-5)
    s = safe_sqrt(jnp.where(outside, r2 / jnp.where(outside, d2, 1.0), 0.0))
    return axis, d2, jnp.where(outside, one_minus_cos(s), 2.0), outside


def _per_area(pdf_area: Any, distance2: Any, cos: Any) -> Any:
    """Density over solid angle from one over area."""
    return pdf_area * distance2 / jnp.maximum(cos, 1e-12)


def _sphere_normal(x: Vec3, row: Any, u: tuple[Any, Any]) -> tuple[Vec3, Any]:
    """The outward normal where a direction into a sphere's cone meets it, and 1/σ; anywhere, and 0, from inside."""
    center, r2 = _vec(row, 0), dot(_vec(row, 3), _vec(row, 3))
    axis, d2, omc, outside = _cone(x, center, r2)
    local = warp.uniform_cone(u, omc)
    w = Frame.around(normalise(axis)).to_world(local)
    near = safe_sqrt(d2) * local.z - safe_sqrt(r2 - d2 * (1.0 - local.z) * (1.0 + local.z))
    n = where(outside, normalise(x + w * near - center), warp.uniform_sphere(u))
    return n, jnp.where(outside, 1.0 / (2.0 * np.pi * omc), 0.0)


def _cylinder_normal(row: Any, u: tuple[Any, Any]) -> Vec3:
    axis, across = normalise(_vec(row, 3)), normalise(_vec(row, 6))
    c, s = warp.circle(u[1])
    return across * c + cross(axis, across) * s


def _behind_own_side(x: Vec3, w: Vec3, distance: Any, cos: Any, row: Any, epsilon: Any) -> Any:
    """Whether the ray from x to a cylinder's inner side, met at cosine `cos`, crosses the cylinder before."""
    axis, radius = _vec(row, 3), safe_sqrt(dot(_vec(row, 6), _vec(row, 6)))
    l2 = dot(axis, axis)
    slope = dot(w, axis)
    t = distance - 2.0 * radius * cos / jnp.maximum(1.0 - slope * slope / l2, 1e-12)
    height = (dot(x - _vec(row, 0), axis) + t * slope) / l2
    return (t > 8.0 * epsilon) & (height >= 0) & (height <= 1)


def leaning(to: Vec3, e1: Vec3, e2: Vec3, n: Vec3, kind: str, u: tuple[Any, Any]) -> tuple[tuple[Any, Any], Any]:
    """u moved to where more light comes from, on a flat face that starts at `to` from a point with normal n, and the
    density of that: bilinear between cosθ/r⁴, to which light goes from a place in the face's plane, at four of them."""

    def light(f: float, g: float) -> Any:
        at = to + e1 * f + e2 * g
        d2 = dot(at, at)
        return jnp.maximum(dot(n, at), 0.0) / jnp.maximum(d2 * d2, 1e-30)

    corners = [light(*at) for at in warp.CORNERS[kind]]
    total = sum(corners)
    scale = jnp.where(total > 0, 4.0 / jnp.where(total > 0, total, 1.0), 0.0)
    least = jnp.where(total > 0, warp.FAINTEST, 1.0)
    a, b, c, d = (least + (1.0 - least) * scale * corner for corner in corners)
    return warp.bilinear(u, (a, b, c, d))


def sample(world: World, x: Vec3, s: Stream | Drawn, pair: int, n: Vec3 | None = None) -> LightSample:
    """A direction from x, where the normal is n if that is known, to a light. Uses the pairs `pair` and, to choose
    among several lights, `pair + 1`."""
    plan = world.plan
    index = _choose(world, s.pair_at(pair + 1)[0])[0] if plan.many_lights else 0
    row = _row(world.light_rows, index)
    face = row[14 + plan.channels].astype(jnp.int32)
    light = _of_face(world, x, row, face, s.pair_at(pair), n) if plan.light_kinds else None
    if plan.lamp_kinds:
        w, distance, radiance, pdf, known = delta.sample(world, x, row, s.pair_at(pair))
        one = jnp.ones_like(distance)
        lamp = LightSample(w, distance, radiance, pdf, known, face, one, one < 0)
        light = lamp if light is None else where(face < 0, lamp, light)
    if plan.environment:
        around = _of_environment(world, x, row[13], s.pair_at(pair))
        light = around if light is None else where(face == -1, around, light)
    assert light is not None
    if world.sun is None:
        return light
    # Whether drawn for the sun or for what is around it, both are met there, and either could have been drawn for it.
    y = surface_point(world, jnp.full_like(face, -1), x, light.w)
    pdf = density(world, x, y, light.w)
    beyond = replace(light, radiance=radiance_of(world, y, -light.w), pdf=pdf, known=pdf, face=y.face)
    return where((face == -1) | ((face < -1) & (row[8] == LAMPS.index("sun"))), beyond, light)


def _of_environment(world: World, x: Vec3, chance: Any, u: tuple[Any, Any]) -> LightSample:
    """A direction from x to the enclosure."""
    assert world.environment is not None
    w, pdf = jax.lax.stop_gradient(world.environment.sample(u))
    place = Place(world.environment.coordinates(w), jnp.zeros_like(u[0], jnp.int32), u)
    radiance = textured(world, _row(world.finishes, 0)[-1], place, Spectrum.full(world.plan.channels, 0.0 * u[0]))
    one, far = jnp.ones_like(u[0]), 4.0 * world.radius + 1.0 + 0.0 * u[0]
    return LightSample(w, far, radiance, pdf * chance, pdf * chance, jnp.full_like(one, -1, jnp.int32), one, one < 0)


def _of_face(world: World, x: Vec3, row: Any, face: Any, u: tuple[Any, Any], n: Vec3 | None) -> LightSample:
    """A direction from x to the light of a row, which is a face."""
    plan = world.plan
    moving, attached = x, row
    x, fixed, n = jax.lax.stop_gradient((x, [row[k] for k in range(14)], n))
    front, density, chance = _vec(fixed, 9), fixed[12], fixed[13]
    found: Any = None
    for kind in plan.light_kinds:
        if kind == "sphere":
            up, cone = _sphere_normal(x, fixed, u)
            radius, side = safe_sqrt(dot(_vec(attached, 3), _vec(attached, 3))), _row(world.faces, face)[FACE["side"]]
            one = (_vec(attached, 0) + up * radius, up * side, up * radius * radius, cone, 0.0 * u[0] + 1.0)
            on_face = u, up, 0.0 * u[0]
        elif kind == "cylinder":
            up, side = _cylinder_normal(attached, u), _row(world.faces, face)[FACE["side"]]
            axis, radius = _vec(attached, 3), safe_sqrt(dot(_vec(attached, 6), _vec(attached, 6)))
            y, area = _vec(attached, 0) + axis * u[0] + up * radius, up * (radius * safe_sqrt(dot(axis, axis)))
            one = (y, up * side, area, 0.0 * u[0], 0.0 * u[0] + 1.0)
            on_face = u, up, u[0]
        else:
            e1, e2 = _vec(attached, 3), _vec(attached, 6)
            o, f1, f2 = (_vec(fixed, k) for k in (0, 3, 6))
            moved, more = (u, 0.0 * u[0] + 1.0) if n is None else leaning(o - x, f1, f2, n, kind, u)
            uv, cone = warp.FLAT[kind](moved), 0.0 * u[0]
            if plan.solid_angle and kind != "disk":
                four = kind == "parallelogram"
                f, g, cone = spherical.sample(x, o, f1, f2, four, u)
                uv, more = where(cone > 0, ((f, g), 0.0 * more + 1.0), (uv, more))
            normal, area = front, cross(e1, e2)
            if plan.smooth_lights:
                normal = light_normal(world, face, *uv, front)
                area = normal * length(area)
            one = (_vec(attached, 0) + e1 * uv[0] + e2 * uv[1], normal, area, cone, more)
            on_face = uv, front, 0.0 * u[0]
        one = (one, on_face if plan.textured_lights else None)
        found = one if found is None else where(face >= world.first(kind), one, found)
    (y, normal, area, cone, more), on_face = found
    w, jacobian = towards(moving, y, area)
    y, fixed_w, normal = jax.lax.stop_gradient((y, w, normal))
    to = y - x
    d2 = dot(to, to)
    cos = -dot(normal, fixed_w)
    pdf = _per_area(density, d2, cos)
    pdf = jnp.where(cone > 0, chance * cone, pdf)
    lit = (cos > 0) & (d2 > 0)
    radiance = Spectrum(tuple(row[14 + c] for c in range(plan.channels)))
    if plan.textured_lights:
        of_face = _row(world.faces, face)
        assert on_face is not None
        place = coordinates.place(world, of_face, face, *on_face)
        radiance = textured(world, row[15 + plan.channels], place, radiance)
    radiance = radiance.map(lambda c: jnp.where(lit, c, 0.0))
    distance, hidden = safe_sqrt(d2), jnp.zeros_like(lit)
    if "cylinder" in plan.light_kinds:
        inwards = (face >= world.first("cylinder")) & (_row(world.faces, face)[FACE["side"]] < 0)
        hidden = inwards & _behind_own_side(x, fixed_w, distance, cos, fixed, world.epsilon)
    known = jnp.where(lit, pdf, 0.0)
    return LightSample(w, distance, radiance, known * more, known, face, jacobian, hidden)


def may_meet(world: World, o: Vec3, w: Vec3) -> Any:
    """Whether a ray from o along ω comes near enough to a light that it may meet it."""
    near = jnp.zeros_like(o.x, dtype=bool)
    for k in range(world.light_bounds.shape[0]):
        to, radius = _vec(world.light_bounds[k], 0) - o, world.light_bounds[k, 3]
        along, d2 = dot(to, w), dot(to, to)
        reach = radius * radius * 1.001 + d2 * 1e-5  # and what rounding adds
        near = near | ((d2 - along * along <= reach) & ((along > 0) | (d2 <= reach)))
    return near


def density(world: World, x: Vec3, y: SurfacePoint, w: Vec3) -> Any:
    """Density (sr⁻¹) with which `sample` at x takes the direction ω in which y was met."""
    x, y, w = jax.lax.stop_gradient((x, y, w))
    around = y.light_density * world.environment.pdf(w) if world.environment is not None else 0.0
    if world.sun is not None:
        around = around + world.sun.density(w)
    if not world.plan.light_kinds:
        return jnp.where(y.face < 0, around, 0.0)
    cos = -dot(y.shading if world.plan.smooth_lights else y.normal, w)
    hit = jnp.isfinite(y.distance) & (cos > 0)
    distance = jnp.where(hit, y.distance, 1.0)
    pdf = _per_area(y.light_density, distance * distance, cos)
    if "sphere" in world.plan.light_kinds:
        row = _row(world.faces, jnp.where(y.face < 0, 0, y.face))
        r2 = row[FACE["height"]] ** 2
        _, _, omc, outside = _cone(x - Vec3(*world.center), _vec(row, FACE["n"]), r2)
        cone = y.light_density * 4.0 * np.pi * r2 / (2.0 * np.pi * omc)
        ball = (y.face >= world.first("sphere")) & (y.face < world.first("cylinder")) & outside
        pdf = jnp.where(ball, cone, pdf)
    if world.plan.solid_angle:
        row = jax.lax.stop_gradient(_row(world.geometry, jnp.where(y.face < 0, 0, y.face)))
        o, e1, e2 = (_vec(row, k) for k in (0, 3, 6))
        four = y.face >= world.first("parallelogram")
        cone = spherical.per_solid_angle(x, o, e1, e2, four)
        twice = cross(e1, e2)
        area = safe_sqrt(dot(twice, twice)) * jnp.where(four, 1.0, 0.5)
        flat = (y.face < world.first("disk")) & (cone > 0)
        pdf = jnp.where(flat, y.light_density * area * cone, pdf)
    nothing = world.environment is None and world.sun is None
    return jnp.where(hit, pdf, around if nothing else jnp.where(y.face < 0, around, 0.0))


__all__ = ["LightSample", "density", "may_meet", "sample"]
