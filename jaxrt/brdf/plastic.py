"""Diffuse paint below a smooth clear coat, Mitsuba's `plastic`: what enters by Fresnel is reflected diffusely and
leaves by Fresnel; what the coat throws back inside is summed up as if it were even light."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..sampling.warp import cosine_hemisphere
from ..vector import Spectrum, Vec3, where
from . import mirror
from .fresnel import dielectric, diffuse_reflectance
from .lobe import Lobe


def chance_of(m: Any, f: Any) -> Any:
    """Of drawing what the coat reflects, a share f of light: by that, and how bright coat and paint are. Black ones are
    drawn at times, for their derivative."""
    coat, paint = (jnp.maximum(sum(c.channels), 0.05) for c in (m.specular, m.reflectance))
    shine, rest = f * coat, (1.0 - f) * paint
    return sg(shine / (shine + rest))


def paint(m: Any, inside: Any) -> Spectrum:
    """What the paint reflects of light that has entered, with all that the coat throws back, the share `inside`."""
    return m.reflectance.map(lambda c: c / (1.0 - inside * jnp.where(m.nonlinear > 0.5, c, 1.0)))


def _chance(m: Any, wo: Vec3) -> Any:
    return chance_of(m, dielectric(m.ior, wo.z)[0])


def is_delta(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Any:
    return u[0] < _chance(m, wo)


def sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    chance = _chance(m, wo)
    again = (u[0] - chance) / jnp.where(chance < 1.0, 1.0 - chance, 1.0)
    diffuse = cosine_hemisphere((jnp.clip(again, 0.0, 1.0 - 2.0**-24), u[1]))
    return where(u[0] < chance, mirror.sample(m, wo, u), diffuse)


def eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    enters, leaves = (1.0 - dielectric(m.ior, w.z)[0] for w in (wi, wo))
    return paint(m, diffuse_reflectance(1.0 / m.ior)) * (enters * leaves / (np.pi * m.ior * m.ior))


def pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    return (1.0 - _chance(m, wo)) * wi.z / np.pi


def weight(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    chance = _chance(m, wo)
    return m.specular * (dielectric(m.ior, wo.z)[0] / jnp.where(chance > 0, chance, 1.0))


FIELDS = ("reflectance", "specular", "ior", "nonlinear")
LOBE = Lobe("plastic", 8, FIELDS, sample, eval, pdf, weight, delta=True, is_delta=is_delta)
