"""The material table: which fields a row has, and the fields of one row as lobes read them."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..vector import Spectrum

SPECTRA = ("reflectance", "eta", "k", "transmittance", "specular")
"""Fields with a value a channel."""

ALBEDOS = ("reflectance", "transmittance", "specular")
"""Those without which a material takes all light in."""

NUMBERS = {"lobe": 0.0, "twosided": 0.0, "ior": 1.0, "nonlinear": 0.0}
"""Fields of one number, and what rows hold where their lobe has no use for it: other lobes still evaluate the row, and
must stay finite. `alpha`, the roughness along both tangents, has two numbers."""

DERIVED = {"coat": 10, "inside": 1}
"""Numbers that no scene holds: a lobe finds them from the others of its row, once a render (`Lobe.derive`)."""

SMOOTHEST = 1e-4
"""Roughness below which a lobe would leave float32; an optimisation may walk there."""


class MaterialColumns:
    """Which columns of a material's row hold which field, for a number of channels and a set of lobes' fields; by
    default all that a scene holds."""

    def __init__(self, channels: int, fields: tuple[str, ...] | None = None):
        held = dict.fromkeys(NUMBERS, 1) | {"alpha": 2} | dict.fromkeys(SPECTRA, channels)
        sizes = held | DERIVED
        self.channels, self.at, start = channels, {}, 0
        for name in held if fields is None else fields:
            self.at[name] = (start, start + sizes[name])
            start += sizes[name]
        self.width = start

    def __getitem__(self, field: str) -> tuple[int, int]:
        return self.at[field]

    def row(self, lobe: int, twosided: bool = False, **fields: Any) -> np.ndarray:
        row = np.zeros(self.width)
        for name, value in (NUMBERS | {"alpha": 1.0, "lobe": lobe, "twosided": twosided} | fields).items():
            row[slice(*self.at[name])] = value
        return row


class Material(eqx.Module):
    """The fields of one row as attributes; None where the plan's lobes have no use for them."""

    fields: dict[str, Any]

    def __init__(self, **fields: Any):
        self.fields = fields

    def __getattr__(self, name: str) -> Any:
        if name in SPECTRA or name in NUMBERS or name in DERIVED or name == "alpha":
            return self.fields.get(name)
        raise AttributeError(name)

    @classmethod
    def of(cls, row: Any, columns: MaterialColumns) -> Material:
        values: dict[str, Any] = {}
        for name, (start, stop) in columns.at.items():
            cells = tuple(row[j] for j in range(start, stop))
            if name == "alpha":
                values[name] = tuple(jnp.maximum(c, SMOOTHEST) for c in cells)
            elif name in SPECTRA:
                values[name] = Spectrum(cells)
            else:
                values[name] = cells if stop - start > 1 else row[start]
        return cls(**values)
