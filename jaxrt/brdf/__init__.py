"""Reflectance f_r (and transmittance, where a plan has lobes that transmit): a few lobes, driven by rows of a table.

A lobe is one file and one line in `LOBES`; its fields stand in `material`. Directions are unit, local (cosθ is z) and
face away from the surface; f_r(ω_i, ω_e) in sr⁻¹ is reciprocal; densities are over solid angle. Only the lobes that a
plan names are compiled, and only the columns of the table that those lobes read are carried.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ..vector import Spectrum, Vec3, where
from . import diffuse, ggx, glass, mirror, plastic, principled, principled_thin, rough, rough_glass, rough_plastic
from .lobe import Lobe
from .material import ALBEDOS, DERIVED, MAPPED, NODES, NUMBERS, SPECTRA, Material, MaterialColumns

LOBES: dict[str, Lobe] = {
    lobe.name: lobe
    for lobe in (
        diffuse.LOBE, mirror.LOBE, ggx.LOBE, *rough.LOBES, glass.SOLID, glass.THIN, glass.NOTHING, plastic.LOBE,
        *rough_glass.LOBES, *rough_plastic.LOBES, principled.LOBE, principled_thin.LOBE,
    )
}  # fmt: skip


def _select(lobes: tuple[str, ...], m: Material, values: list[Any]) -> Any:
    out = values[0]
    for name, value in zip(lobes[1:], values[1:], strict=True):
        out = where(m.lobe == LOBES[name].number, value, out)
    return out


def _seen(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Any:
    """Whether a lobe has a value for these directions: both are above the surface, or it is translucent."""
    above = (wi.z > 0) & (wo.z > 0)
    if not is_translucent(lobes):
        return above
    return above | _select(lobes, m, [jnp.full(jnp.shape(wo.z), LOBES[name].translucent) for name in lobes])


def eval(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Spectrum:
    """f_r(ω_i, ω_o), 0 for deltas and, unless the lobe is translucent, below the surface; `lobes`: the plan's."""
    above = _seen(lobes, m, wi, wo)
    values = [LOBES[name].eval(m, wi, wo) for name in lobes]
    f = _select(lobes, m, values)
    return f.map(lambda c: jnp.where(above, c, 0.0))


def pdf(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Any:
    """Density over solid angle with which `sample` takes ω_i for ω_o; 0 for delta lobes."""
    above = _seen(lobes, m, wi, wo)
    return jnp.where(above, _select(lobes, m, [LOBES[name].pdf(m, wi, wo) for name in lobes]), 0.0)


def sample(lobes: tuple[str, ...], m: Material, wo: Vec3, u: tuple[Any, ...]) -> tuple[Vec3, Any]:
    """A direction ω_i for ω_o, and whether it is that of a delta. `u`: numbers in [0, 1), see `Lobe`."""
    wi = _select(lobes, m, [LOBES[name].sample(m, wo, u) for name in lobes])
    no = jnp.zeros(jnp.shape(wo.z), bool)
    return wi, _select(lobes, m, [LOBES[name].is_delta(m, wo, u) if LOBES[name].delta else no for name in lobes])


def derive(lobes: tuple[str, ...], columns: MaterialColumns, rows: Any) -> list[Any]:
    """Columns of the fields in `DERIVED`, for rows (Q, width) of a scene's table, where a lobe reads them."""
    able = {name: LOBES[name].derive for name in lobes}
    able = {name: f for name, f in able.items() if f is not None}
    if not able:
        return []

    def one(row: Any) -> Any:
        m = Material.of(row, columns)
        found = _select(tuple(able), m, [f(m) for f in able.values()])
        return jnp.stack([a for field in DERIVED for a in jax.tree.leaves(found[field])])

    return [jax.vmap(one)(rows)]


def cosine(lobes: tuple[str, ...], w: Vec3) -> Any:
    """cosθ of projected solid angle, of both sides where a lobe transmits by more than a delta."""
    return jnp.abs(w.z) if is_translucent(lobes) else w.z


def chooses(lobes: tuple[str, ...]) -> bool:
    return any(LOBES[name].chooses for name in lobes)


def is_translucent(lobes: tuple[str, ...]) -> bool:
    return any(LOBES[name].translucent for name in lobes)


def has_delta(lobes: tuple[str, ...]) -> bool:
    return any(LOBES[name].delta for name in lobes)


def has_straight(lobes: tuple[str, ...]) -> bool:
    return any(LOBES[name].straight for name in lobes)


def is_straight(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Any:
    """Whether light from ω_i goes to ω_o through the surface as if it were not there."""
    able = _select(lobes, m, [jnp.full(jnp.shape(wo.z), LOBES[name].straight) for name in lobes])
    return able & (wi.z * wo.z < 0)


def delta_weight(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Spectrum:
    """Radiance towards ω_o per incident radiance of the deltas, over the chance of their direction; 0 for others."""
    zero = m.reflectance * 0.0

    def one(lobe: Lobe) -> Spectrum:
        if not lobe.delta:
            return zero
        w = lobe.weight(m, wi, wo)
        return w if lobe.transmits else w.map(lambda c: jnp.where(wo.z > 0, c, 0.0))

    return _select(lobes, m, [one(LOBES[name]) for name in lobes])


__all__ = [
    "ALBEDOS", "DERIVED", "LOBES", "MAPPED", "NODES", "NUMBERS", "SPECTRA", "Lobe", "Material", "MaterialColumns",
    "chooses", "cosine", "delta_weight", "derive", "eval", "has_delta", "has_straight", "is_straight", "is_translucent",
    "pdf", "sample",
]  # fmt: skip
