"""Sensors, films and integrators of a Mitsuba scene as parts, with Mitsuba's defaults."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from .. import parts
from ..parts.sensors import FILM_FILTERS
from .mitsuba_context import Context
from .mitsuba_shapes import shape
from .mitsuba_xml import Element
from .transforms import look_at

SAMPLES = 4  # of Mitsuba's samplers, where a file does not say

_PIXELS = ("luminance", "luminance_alpha", "rgb", "rgba", "xyz", "xyza")
_SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
_DIAGONAL = np.hypot(36.0, 24.0)  # mm, of the 35 mm film that a focal_length refers to
_CROP = ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y")


def sensor(ctx: Context, element: Element, place: str, standing: Any = None) -> tuple[parts.Sensor, int]:
    """The part of a <sensor>, and its samples per pixel. `standing`: the shape that it stands in."""
    if element.plugin not in _SENSORS:
        element.fail(f"is not supported; use {', '.join(_SENSORS)}")
    if "srf" in element.values or any(name == "srf" for name, _ in element.children):
        element.fail("srf is not supported; remove it")
    if (standing is None) == (element.plugin == "irradiancemeter"):
        element.fail("is out of place; put an irradiancemeter, and no other sensor, into the <shape> it measures")
    name, fields = ctx.name(element, place), _SENSORS[element.plugin](ctx, element)
    if element.plugin == "irradiancemeter":
        fields["target"] = standing
    elif element.plugin == "distant":
        fields["target"] = _target(ctx, element, name)
    elif element.plugin == "batch":
        fields["sensors"] = _members(ctx, element, name)
    film_element, sampler = ctx.child(element, "film"), ctx.child(element, "sampler")
    samples = _samples(ctx, sampler) if sampler else SAMPLES
    seen = film(ctx, film_element) if film_element else parts.Film()
    made = ctx.part(element, parts.Sensor, kind=element.plugin, film=seen, id=name, **fields)
    ctx.finish(element, {"shutter_open": "", "shutter_close": ""})  # nothing moves
    return made, samples


def _camera(ctx: Context, element: Element) -> dict[str, Any]:
    to_world = ctx.transform(element)
    fields: dict[str, Any] = {"to_world": to_world, "far": ctx.number(element, "far_clip", 1e4)}
    if element.plugin != "orthographic":
        _unscaled(element, to_world)
        fields |= field_of_view(ctx, element)
    focus = ctx.number(element, "focus_distance", fields["far"])
    if element.plugin == "thinlens":
        fields |= {"aperture_radius": ctx.number(element, "aperture_radius"), "focus_distance": focus}
    if element.plugin == "perspective":
        shift = [ctx.number(element, f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
        fields["principal_point"] = tuple(shift)
    return fields | {"near": ctx.number(element, "near_clip", 1e-2)}


def _unscaled(element: Element, to_world: np.ndarray) -> None:
    if (abs(np.linalg.norm(to_world[:3, :3], axis=0) - 1) > 1e-3).any():
        element.fail("to_world scales; remove its scale (only a mirror, scale -1, is allowed)")


def _radiancemeter(ctx: Context, element: Element) -> dict[str, Any]:
    given = {key for key in ("origin", "direction") if key in element.values}
    if "to_world" not in element.values and len(given) == 1:
        element.fail(f"has {given.pop()} alone; give origin and direction, or to_world")
    origin, direction = ctx.point(element, "origin", (0, 0, 0)), ctx.point(element, "direction", (0, 0, 1))
    if "to_world" in element.values or not given:  # which Mitsuba, too, prefers
        return _aimed(ctx, element)
    return {"to_world": _pose(ctx, element, origin, direction)}


def _distant(ctx: Context, element: Element) -> dict[str, Any]:
    if "direction" not in element.values:
        return _aimed(ctx, element)
    if "to_world" in element.values:
        element.fail("has direction and also to_world; give only one")
    return {"to_world": _pose(ctx, element, np.zeros(3), ctx.point(element, "direction", (0, 0, 1)))}


def _aimed(ctx: Context, element: Element) -> dict[str, Any]:
    to_world = ctx.transform(element)
    _unscaled(element, to_world)
    return {"to_world": to_world}


def _pose(ctx: Context, element: Element, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """A pose at `origin` that looks along `direction`."""
    d = ctx.part(element, parts.unit, value=direction, element="direction")
    pose = look_at(np.zeros(3), d)
    pose[:3, 3] = origin
    return pose


def _placed_by_others(ctx: Context, element: Element) -> dict[str, Any]:
    if "to_world" in element.values:
        element.fail("has a to_world; remove it, for it measures where others put it")
    return {}


def _target(ctx: Context, element: Element, name: str) -> Any:
    if "target" in element.values:
        return ctx.point(element, "target", (0, 0, 0))
    found = ctx.named(element, "target")
    if found is not None and found.tag != "shape":
        element.fail("target is neither a point nor a shape; give one of them")
    return None if found is None else shape(ctx, found, f"{name}.target")


def _members(ctx: Context, element: Element, name: str) -> list[parts.Sensor]:
    """The sensors of a batch, of which those may stand in shapes that are not in the scene."""
    made: list[parts.Sensor] = []
    for k, child in enumerate(ctx.children(element, "sensor", "shape")):
        place = f"{name}.sensor_{k}"
        if child.tag == "sensor":
            made.append(sensor(ctx, child, place)[0])
        else:
            inner = ctx.child(child, "sensor")
            if inner is None:
                child.fail("has no sensor inside; put an irradiancemeter there, or take it out of the batch")
            made.append(sensor(ctx, inner, place, shape(ctx, child, f"{name}.shape_{k}"))[0])
    return made


def field_of_view(ctx: Context, element: Element) -> dict[str, Any]:
    if "fov" in element.values:
        if "focal_length" in element.values:
            element.fail("has fov and also focal_length; give only one")
        return {"fov": ctx.number(element, "fov"), "fov_axis": ctx.string(element, "fov_axis", "x")}
    text = ctx.string(element, "focal_length", "50mm")
    match = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(mm)?\s*", text, re.ASCII)
    if not match or not 0 < float(match[1]) < np.inf:
        element.fail("focal_length is not a positive length; write it as 50mm")
    if "fov_axis" in element.values:
        ctx.string(element, "fov_axis")
        ctx.notes.append(f"{element.node.label}: fov_axis has no effect without fov")
    return {"fov": float(np.degrees(2 * np.arctan(_DIAGONAL / 2 / float(match[1])))), "fov_axis": "diagonal"}


_SENSORS: dict[str, Callable[[Context, Element], dict[str, Any]]] = {
    "perspective": _camera,
    "thinlens": _camera,
    "orthographic": _camera,
    "radiancemeter": _radiancemeter,
    "irradiancemeter": _placed_by_others,
    "distant": _distant,
    "batch": _placed_by_others,
}


def _samples(ctx: Context, element: Element) -> int:
    if element.plugin not in _SAMPLERS:
        element.fail(f"is not supported; use {', '.join(_SAMPLERS)}")
    samples = ctx.integer(element, "sample_count", SAMPLES)
    ctx.part(element, parts.Integrator, spp=samples)
    ctx.finish(element, {"seed": "has no effect here; give a seed when rendering", "jitter": "", "strength": ""})
    return samples


def film(ctx: Context, element: Element) -> parts.Film:
    if element.plugin != "hdrfilm":
        element.fail("is not supported; use hdrfilm")
    rfilter = ctx.child(element, "rfilter")
    fields = _filter(ctx, rfilter) if rfilter else {}
    width, height = ctx.integer(element, "width", 768), ctx.integer(element, "height", 576)
    if any(key in element.values for key in _CROP):
        x, y = (ctx.integer(element, f"crop_offset_{axis}", 0) for axis in "xy")
        fields["crop"] = (x, y, width, height)
        width, height = (ctx.integer(element, f"crop_{k}", n) for k, n in (("width", width), ("height", height)))
    fields["border"] = ctx.boolean(element, "sample_border", False)
    pixels = ctx.string(element, "pixel_format", "rgb").lower()
    if pixels not in _PIXELS:
        element.fail(f"pixel_format {pixels[:80]!r} is not known; give one of {', '.join(_PIXELS)}")
    if pixels.startswith("xyz"):
        ctx.notes.append(f"{element.node.label}: pixel_format {pixels} is written as rgb")
    fields["grey"] = pixels.startswith("luminance")
    made = ctx.part(element, parts.Film, width=width, height=height, **fields)
    ctx.finish(element, dict.fromkeys(("component_format", "file_format", "banner", "compensate"), ""))
    return made


def _filter(ctx: Context, element: Element) -> dict[str, Any]:
    if element.plugin not in FILM_FILTERS:
        element.fail(f"is not supported; use {', '.join(FILM_FILTERS)}")
    fields: dict[str, Any] = {"filter": element.plugin}
    if element.plugin == "tent":
        fields["radius"] = ctx.number(element, "radius", 1.0)
    elif element.plugin == "gaussian":
        fields["stddev"] = ctx.number(element, "stddev", 0.5)
        if not fields["stddev"] > 0:
            element.fail("stddev is not positive; give a positive one")
    elif element.plugin == "mitchell":
        fields["bc"] = (ctx.number(element, "B", 1 / 3), ctx.number(element, "C", 1 / 3))
    elif element.plugin == "lanczos":
        fields["radius"] = float(ctx.integer(element, "lobes", 3))
    ctx.finish(element)
    return fields
