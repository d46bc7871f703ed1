"""Smooth boundaries that transmit: a solid of glass, a thin sheet, and a surface that is not there.

The direction is drawn by Fresnel's reflectance, so that its weight is 1 but for colours; the ratio to that chance
held fixed carries derivatives with respect to the index. Radiance that is transmitted into a medium of index η is
scaled by 1/η² from one side and η² from the other (Veach 1997, section 5.2).
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from ..vector import Spectrum, Vec3, where
from . import mirror
from .fresnel import dielectric
from .lobe import Lobe


def _over_chance(f: Any) -> Any:
    chance = sg(f)
    return jnp.where(chance > 0, f / jnp.where(chance > 0, chance, 1.0), 0.0)


def _reflected_or(m: Any, reflectance: Any, transmitted: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    through = m.transmittance * (_over_chance(1.0 - reflectance) * transmitted)
    return where(wi.z * wo.z > 0, m.reflectance * _over_chance(reflectance), through)


def _solid(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    reflectance, t, ratio = dielectric(m.ior, wo.z)
    through = Vec3(-wo.x / ratio, -wo.y / ratio, jnp.where(wo.z < 0, t, -t))
    return where(u[0] < sg(reflectance), mirror.sample(m, wo, u), through)


def _solid_weight(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    reflectance, _, ratio = dielectric(m.ior, wo.z)
    return _reflected_or(m, reflectance, 1.0 / (ratio * ratio), wi, wo)


def _both_faces(m: Any, wo: Vec3) -> Any:
    """Reflectance of a sheet: light goes to and fro between its faces."""
    r = dielectric(m.ior, jnp.abs(wo.z))[0]
    return jnp.where(r < 1.0, 2.0 * r / (1.0 + r), r)


def _thin(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    return where(u[0] < sg(_both_faces(m, wo)), mirror.sample(m, wo, u), -wo)


def _thin_weight(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    return _reflected_or(m, _both_faces(m, wo), 1.0, wi, wo)


def _nothing(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    return -wo


def _nothing_weight(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    return m.transmittance


FIELDS = ("reflectance", "transmittance", "ior")
SOLID = Lobe("glass", 5, FIELDS, _solid, weight=_solid_weight, delta=True, transmits=True)
THIN = Lobe("thin_glass", 6, FIELDS, _thin, weight=_thin_weight, delta=True, transmits=True, straight=True)
NOTHING = Lobe(
    "nothing",
    7,
    ("reflectance", "transmittance"),
    _nothing,
    weight=_nothing_weight,
    delta=True,
    transmits=True,
    straight=True,
)
