"""The material table: which fields a row has, and the fields of one row as lobes read them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..vector import Spectrum

SPECTRA = ("reflectance", "eta", "k", "transmittance", "specular")
"""Fields with a value a channel."""

ALBEDOS = ("reflectance", "transmittance", "specular")
"""Those without which a material takes all light in."""

NUMBERS = {
    "lobe": 0.0, "twosided": 0.0, "ior": 1.0, "nonlinear": 0.0,
    "roughness": 1.0, "anisotropic": 0.0, "metallic": 0.0, "spec_trans": 0.0, "spec_tint": 0.0, "sheen": 0.0,
    "sheen_tint": 0.0, "flatness": 0.0, "clearcoat": 0.0, "clearcoat_gloss": 0.0, "diff_trans": 0.0,
    "weight": 0.0, "first": 0.0, "second": 0.0, "shadowed": 0.0,
}  # fmt: skip
"""Fields of one number, and what rows hold where their lobe has no use for it: other lobes still evaluate the row, and
must stay finite. `alpha`, the roughness along both tangents, has two numbers."""

NODES = {"blend": 100, "sides": 101, "normalmap": 102, "bumpmap": 103}
"""Rows that refer to other rows (`first`, `second`) instead of having a lobe: one or the other by chance (`weight`) or
by the side that is seen, or one with its normal turned."""

MAPPED = (*SPECTRA, "alpha", *(n for n in NUMBERS if n not in ("lobe", "twosided", "first", "second", "shadowed")))
"""Fields that may have textures; the column `map:reflectance` holds the number of one, 0 for none."""

DERIVED = {"coat": 10, "inside": 1}
"""Numbers that no scene holds: a lobe finds them from the others of its row, once a render (`Lobe.derive`)."""

SMOOTHEST = 1e-4
"""Roughness below which a lobe would leave float32; an optimisation may walk there."""


class MaterialColumns:
    """Which columns of a material's row hold which field, for a number of channels and a set of lobes' fields; by
    default all that a scene holds."""

    def __init__(self, channels: int, fields: tuple[str, ...] | None = None):
        held = dict.fromkeys(NUMBERS, 1) | {"alpha": 2} | dict.fromkeys(SPECTRA, channels)
        held |= {f"map:{name}": 2 if name == "alpha" else 1 for name in MAPPED}
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
    def of(
        cls, row: Any, columns: MaterialColumns, textured: Callable[[Any, Spectrum], Spectrum] = lambda k, v: v
    ) -> Material:
        """The material of a row. `textured`: the value of the texture of a number, or what is given where that is 0."""
        values: dict[str, Any] = {}
        for name, (start, stop) in columns.at.items():
            if name.startswith("map:"):
                continue
            cells = tuple(row[j] for j in range(start, stop))
            if (maps := columns.at.get(f"map:{name}")) is not None:
                if name in SPECTRA:
                    cells = textured(row[maps[0]], Spectrum(cells)).channels
                else:
                    cells = tuple(
                        textured(row[maps[0] + k], Spectrum.full(columns.channels, c)).channels[0]
                        for k, c in enumerate(cells)
                    )
            if name == "alpha":
                values[name] = tuple(jnp.maximum(c, SMOOTHEST) for c in cells)
            elif name in SPECTRA:
                values[name] = Spectrum(cells)
            else:
                values[name] = cells if stop - start > 1 else cells[0]
        return cls(**values)
