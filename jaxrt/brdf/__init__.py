"""Reflectance f_r (and transmittance, where a plan has lobes that transmit): a few lobes, driven by rows of a table.

A lobe is one file and one line in `LOBES`. Directions are unit, local (cosθ is z) and face away from
the surface; f_r(ω_i, ω_e) in sr⁻¹ is reciprocal; densities are over solid angle. Only the lobes that
a plan names are compiled, and only the columns of the table that those lobes read are carried.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..vector import Spectrum, Vec3, where
from . import diffuse, ggx, glass, mirror, plastic, rough
from .lobe import Lobe

LOBES: dict[str, Lobe] = {
    lobe.name: lobe
    for lobe in (
        diffuse.LOBE, mirror.LOBE, ggx.LOBE, rough.SEPARABLE, rough.BECKMANN, glass.SOLID, glass.THIN, glass.NOTHING,
        plastic.LOBE,
    )
}  # fmt: skip

SPECTRA = ("reflectance", "eta", "k", "transmittance", "specular")
"""Fields of a material with a value a channel."""

ALBEDOS = ("reflectance", "transmittance", "specular")
"""Those without which a material takes all light in."""

SMOOTHEST = 1e-4
"""Roughness below which a lobe would leave float32; an optimisation may walk there."""


class MaterialColumns:
    """Which columns of a material's row hold which field, for a number of channels and a set of lobes."""

    def __init__(self, channels: int, fields: tuple[str, ...] | None = None):
        sizes = {"lobe": 1, "twosided": 1, "alpha": 2} | dict.fromkeys(SPECTRA, channels) | {"ior": 1, "nonlinear": 1}
        self.channels, self.at, start = channels, {}, 0
        for name in sizes if fields is None else fields:
            self.at[name] = (start, start + sizes[name])
            start += sizes[name]
        self.width = start

    def __getitem__(self, field: str) -> tuple[int, int]:
        return self.at[field]

    def row(self, lobe: int, twosided: bool = False, **fields: Any) -> np.ndarray:
        row = np.zeros(self.width)
        for name in ("alpha", "ior"):  # lobes that do not use a row still evaluate it, and must stay finite
            row[slice(*self.at[name])] = 1.0
        row[slice(*self.at["lobe"])], row[slice(*self.at["twosided"])] = lobe, twosided
        for name, value in fields.items():
            row[slice(*self.at[name])] = value
        return row


class Material(eqx.Module):
    """The fields of one row; None where the plan's lobes have no use for them."""

    lobe: Any = None
    twosided: Any = None
    alpha: tuple[Any, Any] | None = None
    reflectance: Any = None
    eta: Any = None
    k: Any = None
    transmittance: Any = None
    specular: Any = None
    ior: Any = None
    nonlinear: Any = None

    @classmethod
    def of(cls, row: Any, columns: MaterialColumns) -> Material:
        values: dict[str, Any] = {}
        for name, (start, stop) in columns.at.items():
            cells = tuple(row[j] for j in range(start, stop))
            if name == "alpha":
                values[name] = tuple(jnp.maximum(c, SMOOTHEST) for c in cells)
            else:
                values[name] = Spectrum(cells) if name in SPECTRA else cells[0]
        return cls(**values)


def _select(lobes: tuple[str, ...], m: Material, values: list[Any]) -> Any:
    out = values[0]
    for name, value in zip(lobes[1:], values[1:], strict=True):
        out = where(m.lobe == LOBES[name].number, value, out)
    return out


def eval(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Spectrum:
    """f_r(ω_i, ω_o), 0 below the surface and for delta lobes; `lobes`: those of the plan."""
    above = (wi.z > 0) & (wo.z > 0)
    values = [LOBES[name].eval(m, wi, wo) for name in lobes]
    f = _select(lobes, m, values)
    return f.map(lambda c: jnp.where(above, c, 0.0))


def pdf(lobes: tuple[str, ...], m: Material, wi: Vec3, wo: Vec3) -> Any:
    """Density over solid angle with which `sample` takes ω_i for ω_o; 0 for delta lobes."""
    above = (wi.z > 0) & (wo.z > 0)
    return jnp.where(above, _select(lobes, m, [LOBES[name].pdf(m, wi, wo) for name in lobes]), 0.0)


def sample(lobes: tuple[str, ...], m: Material, wo: Vec3, u: tuple[Any, Any]) -> tuple[Vec3, Any]:
    """A direction ω_i for ω_o, and whether it is that of a delta."""
    wi = _select(lobes, m, [LOBES[name].sample(m, wo, u) for name in lobes])
    no = jnp.zeros(jnp.shape(wo.z), bool)
    return wi, _select(lobes, m, [LOBES[name].is_delta(m, wo, u) if LOBES[name].delta else no for name in lobes])


def has_delta(lobes: tuple[str, ...]) -> bool:
    return any(LOBES[name].delta for name in lobes)


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
    "ALBEDOS", "LOBES", "SPECTRA", "Lobe", "Material", "MaterialColumns", "delta_weight", "eval", "has_delta", "pdf",
    "sample",
]  # fmt: skip
