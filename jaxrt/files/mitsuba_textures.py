"""Textures of a Mitsuba scene as parts, with Mitsuba's defaults."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .. import parts
from .mitsuba_context import Context
from .mitsuba_xml import Element
from .textures import read_picture

TEXTURES = ("bitmap", "checkerboard", "mesh_attribute")


def texture(ctx: Context, element: Element, color: Any, most: float) -> parts.Texture:
    """The part of a <texture>. `color`: reads a colour parameter; `most`: the largest value that has a meaning."""

    def build() -> parts.Texture:
        fields: dict[str, Any] = {"id": element.id or "", "to_uv": ctx.transform(element, "to_uv")}
        made = {"bitmap": _bitmap, "checkerboard": _checkerboard, "mesh_attribute": _attribute}[element.plugin]
        part, more = made(ctx, element, color, most)
        if element.plugin == "mesh_attribute":
            fields.pop("to_uv")
        ctx.finish(element, {"format": "", "accel": ""})
        return ctx.part(element, part, **fields, **more)

    return ctx.once(element, build)


def as_number(texture: parts.Texture) -> parts.Texture:
    """A texture where one number is asked for: there Mitsuba 3 has a checkerboard's colours the other way around."""
    if not isinstance(texture, parts.Checkerboard):
        return texture
    first, second = (as_number(c) if isinstance(c, parts.Texture) else c for c in texture.colors)
    return dataclasses.replace(texture, color0=second, color1=first)


def _bitmap(ctx: Context, element: Element, color: Any, most: float) -> tuple[Any, dict[str, Any]]:
    raw = ctx.boolean(element, "raw", False)
    filter_type, wrap = ctx.string(element, "filter_type", "bilinear"), ctx.string(element, "wrap_mode", "repeat")
    path = ctx.file(element)
    try:
        data = read_picture(path, raw)
    except parts.SceneError as problem:
        element.fail(problem)
    if (data > most).any():
        ctx.notes.append(f"{element.node.label}: has values above {most:g}, which are taken as {most:g}")
        data = np.minimum(data, most)
    if (data < 0).any():
        ctx.notes.append(f"{element.node.label}: has values below 0, which are taken as 0")
        data = np.maximum(data, 0.0)
    return parts.Bitmap, {"data": data, "filter": filter_type, "wrap": wrap}


def _checkerboard(ctx: Context, element: Element, color: Any, most: float) -> tuple[Any, dict[str, Any]]:
    colors: dict[str, Any] = {}
    for key, default in (("color0", 0.4), ("color1", 0.2)):
        nested = ctx.named(element, key)
        textured = nested is not None and nested.tag == "texture" and nested.plugin in TEXTURES
        given = lambda key=key, default=default: color(ctx, element, key, default, "reflectance")
        colors[key] = texture(ctx, nested, color, most) if nested is not None and textured else given()
    return parts.Checkerboard, colors


def _attribute(ctx: Context, element: Element, color: Any, most: float) -> tuple[Any, dict[str, Any]]:
    name = ctx.string(element, "name")
    if not name.startswith(("vertex_", "face_")):
        element.fail(f"name {name[:80]!r} is no attribute; it begins with vertex_ or face_")
    return parts.MeshAttribute, {"name": name, "scale": ctx.number(element, "scale", 1.0)}
