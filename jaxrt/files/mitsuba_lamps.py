"""Lamps without extent of a Mitsuba scene as parts, with Mitsuba's defaults."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import parts
from .mitsuba_context import Context
from .mitsuba_materials import SAMPLING, color
from .mitsuba_xml import Element


def lamp(ctx: Context, element: Element, place: str) -> parts.Lamp:
    name = ctx.name(element, place)
    fields = LAMPS[element.plugin][1](ctx, element)
    ctx.finish(element, SAMPLING)
    return ctx.part(element, LAMPS[element.plugin][0], id=name, **fields)


def _one_of(element: Element, key: str) -> bool:
    if key in element.values and "to_world" in element.values:
        element.fail(f"has {key} and also to_world; give only one")
    return key in element.values


def _intensity(ctx: Context, element: Element) -> dict[str, Any]:
    return {"intensity": color(ctx, element, "intensity", 1.0, "radiance")}


def _point(ctx: Context, element: Element) -> dict[str, Any]:
    given = _one_of(element, "position")
    position = ctx.point(element, "position", (0, 0, 0)) if given else ctx.transform(element)[:3, 3]
    return {"position": position, **_intensity(ctx, element)}


def _spot(ctx: Context, element: Element) -> dict[str, Any]:
    m, cutoff = ctx.transform(element), ctx.number(element, "cutoff_angle", 20.0)
    width = ctx.number(element, "beam_width", 0.75 * cutoff)
    fields = {"cutoff_angle": cutoff, "beam_width": width, **_intensity(ctx, element)}
    return {"position": m[:3, 3], "direction": m[:3, 2], **fields}


def _directional(ctx: Context, element: Element) -> dict[str, Any]:
    given = _one_of(element, "direction")
    direction = ctx.point(element, "direction", (0, 0, 1)) if given else ctx.transform(element)[:3, 2]
    irradiance = color(ctx, element, "irradiance", 1.0, "radiance")
    return {"direction": np.asarray(direction, float), "irradiance": irradiance}


LAMPS: dict[str, tuple[Any, Any]] = {
    "point": (parts.Point, _point),
    "spot": (parts.Spot, _spot),
    "directional": (parts.Directional, _directional),
}
