"""Rough boundaries that transmit, Mitsuba's `roughdielectric` (Walter et al. 2007): facets of GGX or Beckmann normals,
with separable Smith masking, of which each reflects and bends light as glass does.

A facet is drawn by how much of it is seen, of Beckmann normals too (see `rough`), then one of both by Fresnel. What
leaves to the wrong side would be masked by other facets: it is sent along the surface, where nothing is reflected.
Directions are looked at from the side of ω_o, for facets are the same from both.
"""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from ..vector import Spectrum, Vec3, dot, normalise, where
from . import ggx, rough
from .fresnel import dielectric
from .lobe import Lobe

LEAST = 1e-3
"""The index, less 1, that facets bend light by at least: without any, all of it would go on as a delta."""


def _index(m: Any, wo: Vec3) -> Any:
    """On the other side over that on the side of ω_o."""
    away = m.ior - 1.0
    ior = m.ior + sg(jnp.where(jnp.abs(away) < LEAST, jnp.where(away < 0, -LEAST, LEAST) - away, 0.0))
    return jnp.where(wo.z < 0, 1.0 / ior, ior)


def _seen_from(wo: Vec3, w: Vec3) -> Vec3:
    return Vec3(w.x, w.y, jnp.where(wo.z < 0, -w.z, w.z))


class _Facet:
    """The facet that sends light from ω_i to ω_o: its normal h, cosines at it, and whether it reflects or transmits."""

    def __init__(self, m: Any, wi: Vec3, wo: Vec3):
        self.wo, wi, ratio = _seen_from(wo, wo), _seen_from(wo, wi), _index(m, wo)
        self.reflects = wi.z > 0
        v = self.wo + wi * jnp.where(self.reflects, 1.0, ratio)
        h = normalise(v)
        self.h = where(h.z < 0, -h, h)
        self.wi = Vec3(wi.x, wi.y, jnp.abs(wi.z))  # masked alike on both sides
        self.cos_o, cos_i = dot(self.h, self.wo), dot(self.h, wi)
        self.transmits = ~self.reflects & (self.cos_o > 0) & (cos_i < 0)
        self.fresnel = dielectric(ratio, self.cos_o)[0]
        # |ω_i · h| / |ω_o + η ω_i|²: the first part of the Jacobian dω_h/dω_i
        self.spread = jnp.abs(cos_i) / ggx.positive(dot(v, v))
        self.ratio = ratio

    def either(self, reflected: Any, transmitted: Any) -> Any:
        return jnp.where(self.reflects, reflected, jnp.where(self.transmits, transmitted, 0.0))


def _eval(normals: rough.Normals, m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    """Of radiance: light that is bent comes from a cone wider by η² (Veach 1997, section 5.2)."""
    at = _Facet(m, wi, wo)
    f = rough.reflected(normals, m, at.h, at.wi, at.wo)
    through = at.either(0.0, (1.0 - at.fresnel) * f * (4.0 * at.cos_o * at.spread))
    return m.reflectance * at.either(at.fresnel * f, 0.0) + m.transmittance * through


def _pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    at = _Facet(m, wi, wo)
    p = ggx.visible_density(m.alpha, at.h, at.wo)
    through = (1.0 - at.fresnel) * at.spread * at.ratio * at.ratio
    return p * at.either(at.fresnel / (4.0 * ggx.positive(at.cos_o)), through)


def _sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    above, ratio = _seen_from(wo, wo), _index(m, wo)
    h = ggx.visible_normal(m.alpha, above, u)
    cos = dot(h, above)
    reflectance, bent, _ = dielectric(ratio, cos)
    mirrored, through = h * (2.0 * cos) - above, h * (cos / ratio - bent) - above * (1.0 / ratio)
    mirrored, through = (
        Vec3(v.x, v.y, clip(v.z, 0.0)) for v, clip in ((mirrored, jnp.maximum), (through, jnp.minimum))
    )
    return _seen_from(wo, normalise(where(u[2] < sg(reflectance), mirrored, through)))


FIELDS = ("alpha", "reflectance", "transmittance", "ior")


def _lobe(name: str, number: int, normals: rough.Normals) -> Lobe:
    value = functools.partial(_eval, normals)
    return Lobe(name, number, FIELDS, _sample, value, _pdf, transmits=True, translucent=True, chooses=True)


LOBES = _lobe("rough_glass", 10, rough.GGX), _lobe("rough_glass_beckmann", 11, rough.BECKMANN)
