"""GGX microfacet reflection of a rough conductor, anisotropic, single scattering.

f_r = F D G₂ / (4 cosθ_i cosθ_o) with the height-correlated Smith G₂ (Heitz 2014); directions come from the
visible normals of the upper hemisphere only (bounded VNDF: Eto and Tokuyoshi 2023).
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..sampling.warp import circle
from ..vector import Spectrum, Vec3, dot, normalise, safe_sqrt
from .fresnel import conductor
from .lobe import Lobe
from .material import Material


def distribution(m: Any, h: Vec3) -> Any:
    """D(h): density of normals per projected area; the stretched square sums small terms only."""
    ax, ay = m.alpha
    x, y = h.x / ax, h.y / ay
    q = x * x + y * y + h.z * h.z
    return 1.0 / (np.pi * ax * ay * q * q)


def length(m: Any, w: Vec3) -> Any:
    """Length of the stretched direction: cosθ √(1 + α² tan²θ) = cosθ (1 + 2Λ)."""
    ax, ay = m.alpha
    return safe_sqrt((ax * w.x) ** 2 + (ay * w.y) ** 2 + w.z * w.z)


def positive(x: Any) -> Any:
    """x, or 1 where x is no use as a denominator: directions below the surface, whose value is dropped."""
    return jnp.where(x > 1e-12, x, 1.0)  # its inverse square is finite in float32


def facet(m: Any, h: Vec3, wo: Vec3) -> Spectrum:
    """What a facet with normal h reflects: Fresnel's share, coloured."""
    return m.reflectance * conductor(m.eta, m.k, jnp.clip(dot(h, wo), 0.0, 1.0))


def eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    h = normalise(wi + wo)
    # G₂/(4 cosθ_i cosθ_o) without forming the quotient of small numbers
    g = 0.5 / positive(wi.z * length(m, wo) + wo.z * length(m, wi))
    return facet(m, h, wo) * (distribution(m, h) * g)


def _bound(m: Any, wo: Vec3) -> Any:
    """k of the paper: the cap of reflected directions above the surface reaches down to −k z."""
    ax, ay = m.alpha
    a = jnp.clip(jnp.minimum(ax, ay), 0.0, 1.0)
    s = 1.0 + safe_sqrt(wo.x * wo.x + wo.y * wo.y)
    a2, s2 = a * a, s * s
    return (1.0 - a2) * s2 / (s2 + a2 * wo.z * wo.z)


def visible_normal(alpha: tuple[Any, Any], wo: Vec3, u: tuple[Any, ...], bound: Any = 1.0) -> Vec3:
    """A normal drawn by how much of it ω_o, above the surface, sees (Dupuy and Benyoub 2023): its reflection is even
    over a cap that reaches down to −z, or `bound` of that, where facets are stretched to a sphere."""
    ax, ay = alpha
    stretched = normalise(Vec3(ax * wo.x, ay * wo.y, wo.z))
    c, sn = circle(u[0])
    b = bound * stretched.z
    z = (1.0 - u[1]) * (1.0 + b) - b
    s = safe_sqrt(1.0 - z * z)
    cap = Vec3(s * c, s * sn, z) + stretched
    return normalise(Vec3(ax * cap.x, ay * cap.y, cap.z))


def visible_density(alpha: tuple[Any, Any], h: Vec3, wo: Vec3) -> Any:
    """Density over solid angle of `visible_normal`, G₁(ω_o) D(h) (ω_o · h) / cosθ_o."""
    m = Material(alpha=alpha)
    return distribution(m, h) * (2.0 * jnp.maximum(dot(h, wo), 0.0) / positive(wo.z + length(m, wo)))


def sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    h = visible_normal(m.alpha, wo, u, _bound(m, wo))
    return normalise(h * (2.0 * dot(wo, h)) - wo)


def pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    h = normalise(wi + wo)
    t = length(m, wo)
    return distribution(m, h) / positive(2.0 * (_bound(m, wo) * wo.z + t))


LOBE = Lobe("ggx", 2, ("alpha", "reflectance", "eta", "k"), sample, eval, pdf)
