"""Area lights: a face is chosen by power, then a direction towards it.

Spheres are sampled by the cone that they subtend, flat faces and cylinders by area. Densities are over
solid angle at the lit point; sampling and densities are held fixed under differentiation.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..radiometry import one_minus_cos
from ..sampling import warp
from ..sampling.sobol import Drawn, Stream
from ..surface import SurfacePoint, _row, _vec
from ..vector import Frame, Spectrum, Vec3, cross, dot, normalise, safe_sqrt, where
from ..world import FACE, World


class LightSample(eqx.Module):
    """Direction from the lit point, distance (m), emitted radiance towards it, density (sr⁻¹), the face."""

    w: Vec3
    distance: Any
    radiance: Spectrum
    pdf: Any
    face: Any


def _choose(world: World, u: Any) -> tuple[Any, Any]:
    """A light by its chance, and u made uniform again."""
    cdf = world.light_cdf
    total = cdf[-1]
    n = cdf.shape[0]
    if n <= 16:
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


def _sphere_point(x: Vec3, row: Any, u: tuple[Any, Any]) -> tuple[Vec3, Any, Any]:
    """A direction into the cone of a sphere (anywhere on it from inside): its point y, normal, and 1/σ or none."""
    center, r2 = _vec(row, 0), dot(_vec(row, 3), _vec(row, 3))
    axis, d2, omc, outside = _cone(x, center, r2)
    local = warp.uniform_cone(u, omc)
    w = Frame.around(normalise(axis)).to_world(local)
    distance = safe_sqrt(d2)
    half = safe_sqrt(r2 - d2 * (1.0 - local.z) * (1.0 + local.z))
    near = x + w * jnp.where(outside, distance * local.z - half, 0.0)
    anywhere = center + warp.uniform_sphere(u) * safe_sqrt(r2)
    y = where(outside, near, anywhere)
    return y, normalise(y - center), jnp.where(outside, 1.0 / (2.0 * np.pi * omc), 0.0)


def _flat_point(kind: str, row: Any, u: tuple[Any, Any]) -> Vec3:
    uv = {"triangle": warp.uniform_triangle, "parallelogram": lambda u: u, "disk": warp.uniform_disk}[kind](u)
    return _vec(row, 0) + _vec(row, 3) * uv[0] + _vec(row, 6) * uv[1]


def _cylinder_point(row: Any, u: tuple[Any, Any]) -> tuple[Vec3, Vec3]:
    o, axis, across = _vec(row, 0), _vec(row, 3), _vec(row, 6)
    side, (c, s) = normalise(cross(normalise(axis), normalise(across))), warp.circle(u[1])
    n = normalise(across) * c + side * s
    return o + axis * u[0] + n * safe_sqrt(dot(across, across)), n


def sample(world: World, x: Vec3, s: Stream | Drawn, pair: int) -> LightSample:
    """A direction from x to a light. Uses the pairs `pair` and, to choose among several lights, `pair + 1`."""
    plan = world.plan
    u = s.pair_at(pair)
    index = _choose(world, s.pair_at(pair + 1)[0])[0] if plan.many_lights else 0
    row = _row(world.light_rows, index)
    face = row[13 + plan.channels].astype(jnp.int32)
    x, fixed = jax.lax.stop_gradient((x, [row[k] for k in range(13)]))
    front, density = _vec(fixed, 9), fixed[12]
    y, normal, cone = None, None, jnp.zeros_like(x.x)
    for kind in plan.light_kinds:
        if kind == "sphere":
            yk, nk, ck = _sphere_point(x, fixed, u)
            nk = nk * _row(world.faces, face)[FACE["side"]]
        elif kind == "cylinder":
            (yk, nk), ck = _cylinder_point(fixed, u), 0.0
            nk = nk * _row(world.faces, face)[FACE["side"]]
        else:
            yk, nk, ck = _flat_point(kind, fixed, u), front, 0.0
        if y is None or normal is None:
            y, normal, cone = yk, nk, cone + ck
        else:
            here = face >= world.first(kind)
            y, normal, cone = where(here, yk, y), where(here, nk, normal), jnp.where(here, ck, cone)
    assert y is not None and normal is not None
    to = y - x
    d2 = dot(to, to)
    inverse = jax.lax.rsqrt(jnp.where(d2 > 0, d2, 1.0))
    w = to * inverse
    cos = -dot(normal, w)
    pdf = _per_area(density, d2, cos)
    if "sphere" in plan.light_kinds:
        area = 4.0 * np.pi * dot(_vec(fixed, 3), _vec(fixed, 3))
        pdf = jnp.where(cone > 0, density * area * cone, pdf)
    lit = (cos > 0) & (d2 > 0)
    radiance = Spectrum(tuple(jnp.where(lit, row[13 + c], 0.0) for c in range(plan.channels)))
    return LightSample(w, d2 * inverse, radiance, jnp.where(lit, pdf, 0.0), face)


def density(world: World, x: Vec3, y: SurfacePoint, w: Vec3) -> Any:
    """Density (sr⁻¹) with which `sample` at x takes the direction ω in which y was met."""
    x, y, w = jax.lax.stop_gradient((x, y, w))
    cos = -dot(y.normal, w)
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
    return jnp.where(hit, pdf, 0.0)


__all__ = ["LightSample", "density", "sample"]
