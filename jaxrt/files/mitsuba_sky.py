"""The sun and the sky of a Mitsuba scene as parts: an enclosure with a sky, and the sun's disc."""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np

from .. import parts
from . import sky
from .mitsuba_context import Context
from .mitsuba_materials import SAMPLING, color
from .mitsuba_xml import Element
from .solar_position import sun_direction

TOKYO = {"latitude": 35.6894, "longitude": 139.6917, "timezone": 9.0}
DAY = {"year": 2010, "month": 7, "day": 10}
TIME = {"hour": 15.0, "minute": 0.0, "second": 0.0}

UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""From an enclosure's own space, where +y is up, to Mitsuba's sky, where +z is."""


def sunsky(ctx: Context, element: Element) -> tuple[parts.Enclosure, list[parts.Sun]]:
    """The sky, and the sun if there is one above the horizon and not black."""
    to_world = ctx.transform(element)
    scale = np.linalg.norm(to_world[:3, 0])
    if not scale > 0 or not np.allclose(
        to_world[:3, :3].T @ to_world[:3, :3], scale**2 * np.eye(3), atol=1e-4 * scale**2
    ):
        element.fail("is stretched or shrunk to nothing by its to_world; only turn it")
    turn = to_world[:3, :3] / scale
    towards = _towards_sun(ctx, element, turn)
    number = lambda name, default, **bounds: ctx.part(
        element, lambda: parts.scalar(ctx.number(element, name, default), name, **bounds)
    )
    turbidity = number("turbidity", 3.0, least=1.0, most=10.0)
    given = color(ctx, element, "albedo", 0.3, "reflectance")
    albedo = np.broadcast_to(ctx.part(element, lambda: parts.spectrum(given, "albedo", most=1.0)), 3)
    sun_scale, sky_scale = (number(name, 1.0, least=0.0) for name in ("sun_scale", "sky_scale"))
    aperture = number("sun_aperture", sky.APERTURE)
    if not 0 < aperture < 180:
        element.fail(f"sun_aperture: is {aperture:g}; give an angle between 0 and 180 degrees")
    if ctx.boolean(element, "complex_sun", False):
        element.fail("has a complex_sun, which is not supported; leave it out for a disc that is even")
    ctx.finish(element, SAMPLING)
    name, sun_name = ctx.name(element, "enclosure"), f"{element.id}_sun" if element.id else ctx.name(element, "sun")
    if towards[2] < -1e-6:  # and not for rounding
        ctx.notes.append(f"{element.node.label}: its sun is below the horizon, so that it is dark, as in Mitsuba")
        sun_scale = sky_scale = 0.0
    elevation = float(np.arcsin(np.clip(towards[2], 0, 1)))
    radiance: Any = 0.0
    if sky_scale > 0:
        found = sky.coefficients(turbidity, albedo, elevation) * np.append(np.ones(9), sky_scale)
        radiance = ctx.part(element, parts.Sky, coefficients=found, sun=UPRIGHT[:3, :3].T @ towards)
    around = ctx.part(element, parts.Enclosure, radiance=radiance, to_world=to_world @ UPRIGHT, id=name)
    if not sun_scale > 0:
        return around, []
    light = np.maximum(sky.sun_radiance(turbidity, elevation, aperture), 0) * sun_scale
    return around, [
        ctx.part(
            element,
            parts.Sun,
            direction=-turn @ towards,
            radiance=light,
            angle=aperture,
            horizon=turn[:, 2],
            id=sun_name,
        )
    ]


def _towards_sun(ctx: Context, element: Element, turn: np.ndarray) -> np.ndarray:
    """The unit vector towards the sun in the sky's own space, from a direction of the world or from place and time."""
    if "sun_direction" in element.values:
        for other in (*TOKYO, *DAY, *TIME):
            if other in element.values:
                element.fail(f"has a sun_direction and also {other}; give only one")
        given = ctx.point(element, "sun_direction", (0.0, 0.0, 1.0))
        return turn.T @ ctx.part(element, parts.unit, value=given, element="sun_direction")
    place = {name: ctx.number(element, name, default) for name, default in TOKYO.items()}
    day = {name: ctx.integer(element, name, default) for name, default in DAY.items()}
    time = [ctx.number(element, name, default) for name, default in TIME.items()]
    try:
        date = datetime.date(**day)
    except (ValueError, OverflowError) as problem:
        element.fail(f"has no such date: {problem}; give year, month and day of the calendar")
    hours = time[0] - place["timezone"] + (time[1] + time[2] / 60) / 60
    return sun_direction(date, hours, place["latitude"], place["longitude"])
