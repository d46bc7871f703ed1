"""Sensors, films and integrators of a Mitsuba scene as parts, with Mitsuba's defaults."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from .. import parts
from .mitsuba_context import Context
from .mitsuba_xml import Element

SAMPLES = 4  # of Mitsuba's samplers, where a file does not say

_SENSORS = ("perspective", "thinlens", "orthographic")
_SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
_DIAGONAL = np.hypot(36.0, 24.0)  # mm, of the 35 mm film that a focal_length refers to
_CROP = ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y")
_NO_EFFECT = "has no effect here"


def sensor(ctx: Context, element: Element, place: str) -> tuple[parts.Sensor, int]:
    """The part of a <sensor>, and its samples per pixel."""
    if element.plugin not in _SENSORS:
        element.fail(f"is not supported; use {', '.join(_SENSORS)}")
    to_world = ctx.transform(element)
    fields: dict[str, Any] = {"far": ctx.number(element, "far_clip", 1e4)}
    if element.plugin != "orthographic":
        lengths = np.linalg.norm(to_world[:3, :3], axis=0)
        if (abs(lengths - 1) > 1e-3).any():
            element.fail("to_world scales; remove its scale (only a mirror, scale -1, is allowed)")
        fields |= _field_of_view(ctx, element)
    focus = ctx.number(element, "focus_distance", fields["far"])
    if element.plugin == "thinlens":
        fields |= {"aperture_radius": ctx.number(element, "aperture_radius"), "focus_distance": focus}
    if element.plugin == "perspective":
        shift = [ctx.number(element, f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
        fields["principal_point"] = tuple(shift)
    film_element, sampler = ctx.child(element, "film"), ctx.child(element, "sampler")
    samples = _samples(ctx, sampler) if sampler else SAMPLES
    made = ctx.part(
        element,
        parts.Sensor,
        kind=element.plugin,
        to_world=to_world,
        near=ctx.number(element, "near_clip", 1e-2),
        film=film(ctx, film_element) if film_element else parts.Film(),
        id=ctx.name(element, place),
        **fields,
    )
    ctx.finish(element, {"shutter_open": "", "shutter_close": ""})  # nothing moves
    return made, samples


def _field_of_view(ctx: Context, element: Element) -> dict[str, Any]:
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
    made = ctx.part(element, parts.Film, width=width, height=height, **fields)
    silent = dict.fromkeys(("pixel_format", "component_format", "file_format", "banner", "compensate"), "")
    ctx.finish(element, {**silent, "sample_border": _NO_EFFECT})
    return made


def _filter(ctx: Context, element: Element) -> dict[str, Any]:
    if element.plugin not in ("box", "tent", "gaussian"):
        element.fail("is not supported; use box, tent or gaussian")
    fields: dict[str, Any] = {"filter": element.plugin}
    if element.plugin == "tent":
        fields["radius"] = ctx.number(element, "radius", 1.0)
    elif element.plugin == "gaussian":
        fields["stddev"] = ctx.number(element, "stddev", 0.5)
        if not fields["stddev"] > 0:
            element.fail("stddev is not positive; give a positive one")
    ctx.finish(element)
    return fields


def integrator(ctx: Context, element: Element, inside: bool = False) -> dict[str, Any]:
    """Fields of `parts.Integrator`. `inside`: it stands in a `moment`, which only wraps another one."""
    if element.plugin == "moment" and not inside:
        inner = ctx.children(element, "integrator")
        if len(inner) != 1:
            element.fail(f"has {len(inner)} integrators inside; give one")
        ctx.boolean(element, "hide_emitters", False)  # Mitsuba, too, takes the inner one's
        ctx.finish(element, _ORGANISATION)
        return integrator(ctx, inner[0], inside=True)
    if element.plugin not in _DEPTHS:
        element.fail(f"is not supported; use {', '.join(_DEPTHS)} or one of them in a moment")
    fields: dict[str, Any] = {"hide_emitters": ctx.boolean(element, "hide_emitters", False)}
    ignored = dict(_ORGANISATION)
    if element.plugin == "direct":
        fields["max_depth"] = _DEPTHS["direct"]
        splits = ("emitter_samples", "bsdf_samples", "shading_samples")
        ignored |= dict.fromkeys(splits, f"{_NO_EFFECT}: each sample combines one of the light and one of the BSDF")
    else:
        fields["max_depth"] = ctx.integer(element, "max_depth", _DEPTHS[element.plugin])
        fields["rr_depth"] = ctx.integer(element, "rr_depth", 5)
    ctx.part(element, parts.Integrator, **fields)
    ctx.finish(element, ignored)
    return fields


_DEPTHS = {"path": -1, "prb": 6, "direct": 2, "ptracer": -1}  # and Mitsuba's default max_depth
_ORGANISATION = {"block_size": "", "samples_per_pass": "", "timeout": _NO_EFFECT}
