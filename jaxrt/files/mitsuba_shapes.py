"""Shapes of a Mitsuba scene as parts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import parts
from . import transforms
from .mitsuba_context import Context
from .mitsuba_materials import area_emission, bsdf
from .mitsuba_meshes import READERS, mesh
from .mitsuba_xml import Element
from .reading import TRIANGLE, take
from .vol import read_vol


def shape(ctx: Context, element: Element, place: str) -> parts.Shape | parts.Group | parts.Instance:
    """The part of a <shape>, the same each time. `place`: its name if it has no id."""
    make = {"shapegroup": _group, "instance": _instance}.get(element.plugin, _shape)
    return ctx.once(element, lambda: make(ctx, element, place))


def unmerged(ctx: Context, elements: Iterable[Element]) -> list[Element]:
    """The shapes, each once, with those in a <shape type="merge"> in its place: joined or not, they look the same."""
    found: list[Element] = []
    for element in elements:
        if element.plugin == "merge":
            found += unmerged(ctx, ctx.children(element, "shape"))
            ctx.finish(element)
        else:
            found.append(element)
    return list(dict.fromkeys(found))


def _shape(ctx: Context, element: Element, place: str) -> parts.Shape:
    if element.plugin not in _SHAPES:
        remedy = _INSTEAD.get(element.plugin, f"use {', '.join(_SHAPES)}, merge, shapegroup or instance")
        element.fail(f"is not supported; {remedy}")
    name = ctx.name(element, place)
    emitter, reflector = ctx.child(element, "emitter"), ctx.child(element, "bsdf")
    emission, emission_id = area_emission(ctx, emitter, f"{name}.emitter") if emitter else (None, "")
    # without a BSDF, Mitsuba's emitters are black and other shapes are diffuse
    default = parts.Diffuse(0.5 if emitter is None else 0.0, id=f"{name}.bsdf")
    fields: dict[str, Any] = {
        "id": name,
        "to_world": ctx.transform(element),
        "flip_normals": ctx.boolean(element, "flip_normals", False),
        "emission": emission,
        "emission_id": emission_id,
        "bsdf": bsdf(ctx, reflector, f"{name}.bsdf") if reflector else default,
    }
    ctx.child(element, "sensor")  # made when all shapes are
    make, more = _SHAPES[element.plugin]
    ctx.part(element, parts.Shape, **fields)  # checked before it is computed with
    fields |= more(ctx, element, fields) if more else {}
    ctx.finish(element, {"silhouette_sampling_weight": "is a matter of sampling, and has no effect here"})
    return ctx.part(element, make, **fields)


def _group(ctx: Context, element: Element, place: str) -> parts.Group:
    name = ctx.name(element, place)
    inside = unmerged(ctx, ctx.children(element, "shape"))
    members = [shape(ctx, member, f"{name}.shape_{k}") for k, member in enumerate(inside)]
    if any(ctx.children(member, "sensor") for member in inside):
        element.fail("holds a sensor; put one into shapes of the scene only")
    if any(isinstance(member, (parts.Group, parts.Instance)) for member in members):
        element.fail("holds a group or an instance; put the shapes themselves there")
    ctx.finish(element)
    return ctx.part(element, parts.Group, id=name, shapes=members)


def _instance(ctx: Context, element: Element, place: str) -> parts.Instance:
    name, group = ctx.name(element, place), ctx.child(element, "shape")
    if group is None or group.plugin != "shapegroup":
        element.fail("refers to no shapegroup; give it one by <ref>")
    made, to_world = shape(ctx, group, f"{name}.group"), ctx.transform(element)
    if isinstance(made, parts.Group) and not made.flat:  # which the scene writes out
        cost = TRIANGLE * sum(len(s.faces) for s in made.shapes if isinstance(s, parts.Mesh))
        take(element.node.file, cost, "place its group fewer times, or without curved shapes")
    ctx.finish(element)
    return ctx.part(element, parts.Instance, id=name, group=made, to_world=to_world)


def _flat(ctx: Context, element: Element, fields: dict[str, Any]) -> dict[str, Any]:
    ctx.boolean(element, "face_normals", False)  # they are flat anyway
    return {}


def _sphere(ctx: Context, element: Element, fields: dict[str, Any]) -> dict[str, Any]:
    # a mirror turns a sphere inside out in Mitsuba, and no other shape of closed form
    mirrored = bool(np.linalg.det(fields["to_world"][:3, :3]) < 0)
    return {
        "center": ctx.point(element, "center", (0.0, 0.0, 0.0)),
        "radius": ctx.number(element, "radius", 1.0),
        "flip_normals": fields["flip_normals"] != mirrored,
    }


def _cylinder(ctx: Context, element: Element, fields: dict[str, Any]) -> dict[str, Any]:
    p0, p1 = ctx.point(element, "p0", (0.0, 0.0, 0.0)), ctx.point(element, "p1", (0.0, 0.0, 1.0))
    radius = ctx.number(element, "radius", 1.0)
    return {"p0": p0, "p1": p1, "radius": radius, **_straightened(fields["to_world"], p0, p1, radius)}


def _straightened(m: np.ndarray, p0: np.ndarray, p1: np.ndarray, radius: float) -> dict[str, Any]:
    """A cylinder stretched along its axis is a longer one under a rigid motion: that one's fields, if it is so."""
    s = np.linalg.svd(m[:3, :3], compute_uv=False)
    length = np.linalg.norm(p1 - p0)
    if s[0] - s[2] <= 1e-4 * s[0] or not length > 0:
        return {}
    axis = (p1 - p0) / length
    first = transforms.perpendicular(axis)  # from which its angle counts
    u, v = np.stack([first, np.cross(axis, first)]) @ m[:3, :3].T
    w = m[:3, :3] @ axis
    size, stretch = np.linalg.norm(u), np.linalg.norm(w)
    skew = max(abs(u @ v) / size**2, abs(u @ w) / (size * stretch), abs(v @ w) / (size * stretch))
    if abs(np.linalg.norm(v) - size) > 1e-4 * size or skew > 1e-4:
        return {}  # an elliptic or slanted one, which the part refuses
    rigid = np.eye(4)
    rigid[:3, :3] = np.stack([u, v, w], 1) / [size, size, stretch]
    rigid[:3, 3] = m[:3, :3] @ p0 + m[:3, 3]
    return {"to_world": rigid, "p0": [0.0, 0.0, 0.0], "p1": [0.0, 0.0, stretch * length], "radius": radius * size}


def _sdfgrid(ctx: Context, element: Element, fields: dict[str, Any]) -> dict[str, Any]:
    normals = ctx.string(element, "normals", "smooth")
    if normals not in ("smooth", "analytic"):
        element.fail(f"normals: is {normals!r}; give smooth or analytic")
    try:
        grid = read_vol(ctx.file(element))
        if grid.shape[-1] != 1:
            raise parts.SceneError(f"has {grid.shape[-1]} channels; give a grid of one, the distance")
    except parts.SceneError as problem:
        element.fail(problem)
    return {"grid": grid, "smooth_normals": normals == "smooth"}


_SHAPES: dict[str, tuple[Any, Any]] = {
    "rectangle": (parts.Rectangle, _flat),
    "cube": (parts.Cube, _flat),
    "disk": (parts.Disk, None),
    "sphere": (parts.Sphere, _sphere),
    "cylinder": (parts.Cylinder, _cylinder),
    "sdfgrid": (parts.SdfGrid, _sdfgrid),
    **dict.fromkeys(READERS, (parts.Mesh, mesh)),
}

_TUBES = "make a mesh of the curves, or cylinders and spheres"
_INSTEAD = {
    "bsplinecurve": _TUBES,
    "linearcurve": _TUBES,
    "ellipsoids": "make a mesh of each ellipsoid",
    "ellipsoidsmesh": "make a mesh of each ellipsoid",
}
