"""Mitsuba 3 XML scenes as parts, so that the same file gives the same picture here and there."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from .. import parts
from . import mitsuba_xml
from .mitsuba_context import Context
from .mitsuba_integrators import integrator
from .mitsuba_lamps import ENCLOSURES, LAMPS, enclosure, lamp
from .mitsuba_materials import UNSEEN, bsdf
from .mitsuba_nodes import OBJECTS
from .mitsuba_sensors import sensor
from .mitsuba_shapes import shape, unmerged
from .mitsuba_xml import Document, Element


def load(path: pathlib.Path, defaults: Mapping[str, str | float | int]) -> parts.Description:
    """The scene in a Mitsuba 3 XML file, on the host, with numpy only.

    defaults: values for the file's `$names`; they win over its `<default>`s. Colours come out as linear
    sRGB, or as one number where the file gives a grey. `notes` says, with file and line, what has no
    effect here. A scene may have no sensor; it has shapes.

    Raises `SceneError`, one line with file, element and remedy, for a file that is missing, malformed or
    refers to nothing, for what is not supported, and for a default that the file does not use.
    """
    # numbers beyond float64 are found by the checks on finite results
    with np.errstate(all="ignore"):
        return _describe(mitsuba_xml.read(pathlib.Path(path), defaults))


def _describe(document: Document) -> parts.Description:
    ctx, root = Context(document), document.root
    objects: dict[str, list[Element]] = {
        tag: list(dict.fromkeys(ctx.children(root, tag))) for tag in sorted(OBJECTS | {"spectrum"})
    }
    objects["shape"] = unmerged(ctx, objects["shape"])
    made = [shape(ctx, element, f"shape_{i}") for i, element in enumerate(objects["shape"])]
    shapes = [s for s in made if not isinstance(s, parts.Group)]  # a group alone is not in the scene
    if not shapes:
        root.fail("has no shapes; add a <shape>")
    inside = [(e, made[k]) for k, parent in enumerate(objects["shape"]) for e in ctx.children(parent, "sensor")]
    sensors = _sensors(ctx, [(element, None) for element in objects["sensor"]] + inside)
    fields: dict[str, Any] = {"spp": sensors[0][1]} if sensors else {}
    if len(objects["integrator"]) > 1:
        objects["integrator"][1].fail("is a second integrator; keep one")
    for element in objects["integrator"]:
        fields |= integrator(ctx, element)
    _check_unseen(ctx, objects, fields.get("hide_emitters", False))
    around, suns = _enclosure(ctx, [e for e in objects["emitter"] if e.plugin not in LAMPS])
    found = [e for e in objects["emitter"] if e.plugin in LAMPS]
    lamps = [lamp(ctx, element, f"{element.plugin}_{k}" if k else element.plugin) for k, element in enumerate(found)]
    _note_unused(ctx, objects)
    ctx.finish(root)
    return parts.Description(
        shapes=shapes,
        sensors=[made for made, _ in sensors],
        enclosure=around,
        lamps=[*lamps, *suns],
        integrator=parts.Integrator(**fields),
        notes=ctx.notes,
    )


def _sensors(ctx: Context, elements: list[tuple[Element, Any]]) -> list[tuple[parts.Sensor, int]]:
    """The parts and samples of sensors, each with the shape that it stands in, or None."""
    sensors, nameless = [], 0
    for element, standing in elements:
        sensors.append(sensor(ctx, element, f"sensor_{nameless}" if nameless else "sensor", standing))
        nameless += not element.id
    if len({samples for _, samples in sensors}) > 1:
        label = elements[0][0].node.label
        ctx.notes.append(f"{label}: its sample_count is taken for all sensors, whose own ones differ")
    return sensors


def _check_unseen(ctx: Context, objects: dict[str, list[Element]], hidden: bool) -> None:
    """Fail where an emitter that only light tracing sees is more, or less, than a dark surface in Mitsuba's picture."""
    asked = [e for given in objects["integrator"] for e in (given, *ctx.children(given, "integrator"))]
    for element in [e for owner in objects["shape"] for e in ctx.children(owner, "emitter") if e.plugin == UNSEEN]:
        if hidden:
            element.fail("is hidden by hide_emitters, which here hides what shines only; remove its shape")
        if any(e.plugin == "ptracer" for e in asked):
            element.fail(
                "is seen by the light tracing of ptracer, which jaxrt does not do; use an area emitter, or path"
            )


def _enclosure(ctx: Context, elements: list[Element]) -> tuple[parts.Enclosure | None, list[parts.Sun]]:
    found, suns = None, []
    for element in elements:
        if element.plugin in ("area", UNSEEN):
            continue  # it belongs to the shape that references it
        if element.plugin not in ENCLOSURES:
            element.fail(f"is not supported; use {', '.join((*LAMPS, *ENCLOSURES))}, or area in a shape")
        if found is not None:
            element.fail("is a second environment; keep one")
        found, suns = enclosure(ctx, element)
    return found, suns


def _note_unused(ctx: Context, objects: dict[str, list[Element]]) -> None:
    """Whatever does nothing at the top of a scene unless something refers to it. Good BSDFs are left unsaid."""
    for tag, elements in objects.items():
        for element in elements:
            if (
                tag in ("shape", "sensor", "integrator")
                or element.plugin in (*ENCLOSURES, *LAMPS)
                or element in ctx.referenced
            ):
                continue
            try:
                reason = "stands alone"
                if tag == "bsdf":
                    bsdf(ctx, element, "bsdf")
                    continue
            except parts.SceneError as problem:
                reason = str(problem).split(">: ", 1)[-1]
            ctx.notes.append(f"{element.node.label}: has no effect, for nothing refers to it ({reason})")
