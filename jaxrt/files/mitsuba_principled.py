"""Disney's principled BSDFs of a Mitsuba scene."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .. import parts
from . import spectra
from .mitsuba_context import Context
from .mitsuba_textures import as_number
from .mitsuba_xml import Element

_SAMPLED = (
    "main_specular", "clearcoat", "diffuse_reflectance", "specular_reflectance", "specular_transmittance",
    "diffuse_transmittance",
)  # fmt: skip
RATES = tuple(f"{name}_sampling_rate" for name in _SAMPLED)
"""Parameters that change no picture."""


def _color(ctx: Context, element: Element, name: str, default: Any, role: spectra.Role = "reflectance") -> Any:
    from .mitsuba_materials import color  # which reads these BSDFs among others

    return color(ctx, element, name, default, role)


def _scalar(ctx: Context, element: Element, name: str, default: float | None) -> Any:
    given = _color(ctx, element, name, default, "ior")
    if given is None:
        return given
    if isinstance(given, parts.Texture):
        return as_number(given)
    value = np.atleast_1d(given)
    if (value != value[0]).any():
        element.fail(f"{name} is a colour; give a <float>")
    return float(value[0])


def _read(ctx: Context, element: Element, part: Any) -> dict[str, Any]:
    """Every parameter of a part, whose names and defaults are Mitsuba's."""
    defaults: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(part) if field.name != "id"}
    color = _color(ctx, element, "base_color", defaults.pop("base_color"))
    return {"base_color": color} | {name: _scalar(ctx, element, name, value) for name, value in defaults.items()}


def principled(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return _read(ctx, element, parts.Principled)


def principled_thin(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return _read(ctx, element, parts.PrincipledThin)
