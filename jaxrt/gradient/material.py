"""Direct light under differentiation: samples stay where they are on the emitter (the material form).

An integral over directions may be differentiated with directions fixed in space or with the points that
light comes from fixed on their surface. Held in space, a moving lamp changes the picture only through its
outline; held on the lamp, the integrand f_r G L⁰ carries the whole change where nothing occludes. Direct
light D takes the second form, all further transport T R the first. Values are not touched: every factor
here is 1.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from ..scene import KINDS
from ..surface import Shading, SurfacePoint, light_normal
from ..vector import Spectrum, Vec3, cross, dot, length, normalise, where
from ..world import World


def _direction(x: Vec3, y: Vec3, area: Vec3) -> tuple[Vec3, Any]:
    """Direction from x to y, and the solid angle of the area vector at y, over its own value."""
    to = y - x
    d2 = dot(to, to)
    ok = d2 > 0
    w = normalise(to)
    omega = jnp.abs(dot(area, w)) / jnp.where(ok, d2, 1.0)
    seen = ok & (omega > 0)
    return w, jnp.where(seen, omega / jnp.where(seen, sg(omega), 1.0), 1.0)


@jax.custom_jvp
def towards(x: Vec3, y: Vec3, area: Vec3) -> tuple[Vec3, Any]:
    """Direction from x to a point y of an emitter and a factor 1, which carries how the solid angle of y's
    surroundings (area vector `area`) changes. Costs nothing where nothing is differentiated."""
    return normalise(y - x), jnp.ones_like(x.x + y.x)


@towards.defjvp
def _towards_jvp(primals: Any, tangents: Any) -> Any:
    return towards(*primals), jax.jvp(_direction, primals, tangents)[1]


def emitter_point(world: World, x: SurfacePoint) -> tuple[Vec3, Vec3]:
    """The point of M that moves with its face where x is now, and its area vector."""
    row = world.geometry.at[jnp.maximum(x.face, 0)].get(mode="clip", wrap_negative_indices=False)
    o, a, b = (Vec3(row[k], row[k + 1], row[k + 2]) for k in (0, 3, 6))
    u, v = sg(x.uv)
    y, area = o + a * u + b * v, cross(a, b)
    n = sg(x.normal)
    for kind in ("sphere", "cylinder"):
        if world.blocks[KINDS.index(kind)]:
            here = x.face >= world.first(kind)
            radius2 = dot(a, a) if kind == "sphere" else dot(b, b)
            radius = jnp.sqrt(jnp.where(here, radius2, 1.0))
            if kind == "cylinder":  # the normal turns with the axis
                axis = normalise(where(here, a, Vec3(0.0, 0.0, 1.0)))
                across = normalise(where(here, b, Vec3(1.0, 0.0, 0.0)))
                beside = cross(axis, across)
                out = across * sg(dot(n, across)) + beside * sg(dot(n, beside))
            else:
                out = n
            out = out * jnp.where(dot(n, sg(x.position - o)) < 0, -1.0, 1.0)
            if kind == "sphere":
                there, patch = o + out * radius, out * (radius * radius)
            else:
                along = sg(dot(x.position - o, a) / jnp.where(here, dot(a, a), 1.0))
                there, patch = o + a * along + out * radius, out * (radius * jnp.sqrt(jnp.where(here, dot(a, a), 1.0)))
            y, area = where(here, there, y), where(here, patch, area)
    if world.plan.smooth_lights:
        area = light_normal(world, jnp.maximum(x.face, 0), u, v, normalise(area)) * length(area)
    return y, area


def slope(reflected: Any, at: Shading, w: Vec3) -> tuple[Vec3, ...]:
    """∇ log(f_r cosθ) with respect to ω_i, for each channel; `reflected(at, w)` is f_r cosθ."""
    at, w = sg((at, w))
    value, along = jax.linearize(lambda v: reflected(at, v), w)
    one, zero = jnp.ones_like(w.x), jnp.zeros_like(w.x)
    changes = [along(Vec3(*(one if k == axis else zero for k in range(3)))).channels for axis in range(3)]
    inverse = [1.0 / jnp.where(v > 0, v, 1.0) for v in value.channels]
    return sg(tuple(Vec3(*(change[c] for change in changes)) * k for c, k in enumerate(inverse)))


def met(world: World, before: Vec3, x: SurfacePoint, slopes: tuple[Vec3, ...], direct: Any) -> Spectrum:
    """Factors 1 for emission that a reflected ray met at x: they turn its derivative into the material form.

    `before`: the point that reflected, `slopes`: its `slope`; `direct`: where the factor applies (an emitter
    met by a ray that is not a delta's).
    """
    y, area = emitter_point(world, x)
    y, area = where(direct, y, Vec3(*(sg(c) + 1.0 for c in before))), where(direct, area, Vec3(1.0, 1.0, 1.0))
    w, jacobian = _direction(before, y, area)
    turned = w - sg(w)
    return Spectrum(tuple(jnp.where(direct, jacobian * (1.0 + dot(s, turned)), 1.0) for s in slopes))
