"""BSDFs of a Mitsuba scene that are made of others, as parts, with Mitsuba's defaults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .. import parts
from .mitsuba_context import Context
from .mitsuba_textures import as_number
from .mitsuba_xml import Element

Reader = Callable[[Context, Element, str], Any]


def _nested(ctx: Context, element: Element, read: Reader, name: str, count: int, *more: int) -> list[Any]:
    inner = ctx.children(element, "bsdf")
    if len(inner) not in (count, *more):
        element.fail(f"has {len(inner)} BSDFs inside; give {' or '.join(map(str, (count, *more)))}")
    suffixes = [""] if len(inner) == 1 else [f"_{k}" for k in range(len(inner))]
    return [read(ctx, e, f"{name}.bsdf{suffix}") for e, suffix in zip(inner, suffixes, strict=True)]


def two_sided(ctx: Context, element: Element, name: str, read: Reader, color: Any) -> dict[str, Any]:
    for inner in ctx.children(element, "bsdf"):
        if inner.plugin == "twosided":
            inner.fail("stands inside another twosided; remove one of the two")
    bsdf, *back = _nested(ctx, element, read, name, 1, 2)
    return {"bsdf": bsdf, "back": back[0] if back else None}


def blend(ctx: Context, element: Element, name: str, read: Reader, color: Any) -> dict[str, Any]:
    first, second = _nested(ctx, element, read, name, 2)
    return {"first": first, "second": second, "weight": _number(ctx, element, "weight", None, color)}


def mask(ctx: Context, element: Element, name: str, read: Reader, color: Any) -> dict[str, Any]:
    (bsdf,) = _nested(ctx, element, read, name, 1)
    return {"bsdf": bsdf, "opacity": _number(ctx, element, "opacity", 0.5, color)}


def _number(ctx: Context, element: Element, name: str, default: float | None, color: Any) -> Any:
    value = color(ctx, element, name, default, "reflectance")
    if value is None:
        element.fail(f"has no {name}; add a texture or a <float>")
    if isinstance(value, parts.Texture):
        return as_number(value)
    value = np.atleast_1d(value)
    return float(value @ parts.LUMINANCE) if value.size == 3 else float(value[0])


def _turned(ctx: Context, element: Element) -> dict[str, Any]:
    if not ctx.boolean(element, "flip_invalid_normals", True):
        ctx.notes.append(f"{element.node.label}: flip_invalid_normals is taken as true")
    return {"shadowed": ctx.boolean(element, "use_shadowing_function", True)}


def normal_map(ctx: Context, element: Element, name: str, read: Reader, color: Any) -> dict[str, Any]:
    (bsdf,) = _nested(ctx, element, read, name, 1)
    value = color(ctx, element, "normalmap", None, "reflectance")
    if not isinstance(value, parts.Texture):
        element.fail("has no texture named normalmap; add one")
    return {"bsdf": bsdf, "normalmap": value, **_turned(ctx, element)}


def bump_map(ctx: Context, element: Element, name: str, read: Reader, color: Any) -> dict[str, Any]:
    (bsdf,) = _nested(ctx, element, read, name, 1)
    found = [key for key, child in element.children if ctx.resolve(child).tag == "texture"]
    if len(found) != 1:
        element.fail(f"has {len(found)} textures; give one")
    value = color(ctx, element, found[0], None, "ior")
    if not isinstance(value, parts.Bitmap):
        element.fail("has a texture that is no bitmap; give one, whose slope can be taken")
    return {"bsdf": bsdf, "texture": value, "scale": ctx.number(element, "scale", 1.0), **_turned(ctx, element)}


READERS = {
    "twosided": (parts.TwoSided, two_sided),
    "blendbsdf": (parts.Blend, blend),
    "mask": (parts.Mask, mask),
    "normalmap": (parts.NormalMap, normal_map),
    "bumpmap": (parts.BumpMap, bump_map),
}
