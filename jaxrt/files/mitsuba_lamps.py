"""Lamps without extent, and light from all around, of a Mitsuba scene as parts, with Mitsuba's defaults."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .. import parts
from ..sensor.camera import half_width
from .mitsuba_context import Context
from .mitsuba_materials import SAMPLING, color
from .mitsuba_sensors import field_of_view
from .mitsuba_sky import sunsky
from .mitsuba_xml import Element
from .textures import read_picture


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


def _projector(ctx: Context, element: Element) -> dict[str, Any]:
    picture = color(ctx, element, "irradiance", 1.0, "radiance")
    if not isinstance(picture, parts.Bitmap):
        element.fail("has no picture; give it a bitmap as irradiance")
    picture = dataclasses.replace(
        picture, data=picture.data * (np.pi * ctx.number(element, "scale", 1.0))
    )  # as Mitsuba
    height, width = picture.data.shape[:2]
    view = field_of_view(ctx, element)
    half = float(half_width(view["fov_axis"], view["fov"], width / height))
    fov = float(np.degrees(2 * np.arctan(half)))
    return {"irradiance": picture, "to_world": ctx.transform(element), "fov": fov}


LAMPS: dict[str, tuple[Any, Any]] = {
    "point": (parts.Point, _point),
    "spot": (parts.Spot, _spot),
    "directional": (parts.Directional, _directional),
    "projector": (parts.Projector, _projector),
}


ENCLOSURES = ("constant", "envmap", "sunsky")


def enclosure(ctx: Context, element: Element) -> tuple[parts.Enclosure, list[parts.Sun]]:
    """Light from all around, and the sun in it."""
    if element.plugin == "sunsky":
        return sunsky(ctx, element)
    to_world = ctx.transform(element)
    if element.plugin == "constant":  # Mitsuba takes its transform, which moves nothing
        radiance: Any = color(ctx, element, "radiance", 1.0, "radiance")
    else:
        path = ctx.file(element)
        try:
            data = read_picture(path)
        except parts.SceneError as problem:
            element.fail(problem)
        scale = ctx.number(element, "scale", 1.0)
        radiance = ctx.part(element, parts.Bitmap, data=np.maximum(data, 0.0) * scale)
    ctx.finish(element, {**SAMPLING, "mis_compensation": SAMPLING["sampling_weight"]})
    name = ctx.name(element, "enclosure")
    return ctx.part(element, parts.Enclosure, radiance=radiance, to_world=to_world, id=name), []
