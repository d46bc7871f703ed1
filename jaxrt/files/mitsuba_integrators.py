"""Integrators of a Mitsuba scene: what they ask of the method, with Mitsuba's defaults."""

from __future__ import annotations

import re
from typing import Any

from .. import parts
from .mitsuba_context import Context
from .mitsuba_xml import Element

NO_EFFECT = "has no effect here"


def integrator(ctx: Context, element: Element, outside: str = "") -> dict[str, Any]:
    """Fields of `parts.Integrator`. `outside`: the plugin that it stands in, which only wraps another one."""
    if element.plugin in ("moment", "aov") and element.plugin != outside:
        return _wrapped(ctx, element)
    if element.plugin not in _DEPTHS:
        depth = "; for distances give --aov depth" if element.plugin == "depth" else ""
        element.fail(f"is not supported; use {', '.join(_DEPTHS)}, or one of them in a moment or an aov{depth}")
    fields: dict[str, Any] = {"hide_emitters": ctx.boolean(element, "hide_emitters", False)}
    ignored = dict(_ORGANISATION)
    if _DEPTHS[element.plugin] == 2:
        fields["max_depth"] = 2
        splits = ("emitter_samples", "bsdf_samples", "shading_samples")
        ignored |= dict.fromkeys(splits, f"{NO_EFFECT}: each sample combines one of the light and one of the BSDF")
        none = [name for name in splits if name in element.values and element.values[name].content == 0]
        ignored |= dict.fromkeys(none, f"{NO_EFFECT}: what only such samples find is in the picture all the same")
    else:
        fields["max_depth"] = ctx.integer(element, "max_depth", _DEPTHS[element.plugin])
        fields["rr_depth"] = ctx.integer(element, "rr_depth", 5)
    if "vol" in element.plugin and fields["max_depth"] > 0:
        ctx.notes.append(f"{element.node.label}: max_depth also counts surfaces that light goes straight through")
    ctx.part(element, parts.Integrator, **fields)
    ctx.finish(element, ignored)
    return fields


def _wrapped(ctx: Context, element: Element) -> dict[str, Any]:
    inner = ctx.children(element, "integrator")
    if len(inner) != 1:
        element.fail(f"has {len(inner)} integrators inside; give one")
    ctx.boolean(element, "hide_emitters", False)  # Mitsuba, too, takes the inner one's
    fields = integrator(ctx, inner[0], element.plugin)
    if element.plugin == "aov":
        fields["aovs"] = (*_aovs(ctx, element), *fields.get("aovs", ()))
    ctx.finish(element, _ORGANISATION)
    return fields


def _aovs(ctx: Context, element: Element) -> list[str]:
    """What is asked of the first surface, as "name:kind"; kinds that there are not are noted."""
    found = []
    for asked in re.split(r"[,\s]+", ctx.string(element, "aovs").strip(", ")):
        name, colon, kind = asked.rpartition(":")
        if not (name and colon):
            element.fail(f"aovs has {asked[:80]!r}; write it as name:kind, with kinds {', '.join(_AOVS)}")
        if kind in _AOVS:
            found.append(f"{name}:{_AOVS[kind]}")
        else:
            ctx.notes.append(
                f"{element.node.label}: {asked[:80]} is left out; of its kind there are {', '.join(_AOVS)}"
            )
    return found


_AOVS = {
    "depth": "depth",
    "position": "position",
    "uv": "uv",
    "sh_normal": "normal",
    "geo_normal": "geo_normal",
    "albedo": "albedo",
}
_DEPTHS = {
    "path": -1, "volpath": -1, "volpathmis": -1, "ptracer": -1, "direct": 2, "direct_projective": 2,
    **dict.fromkeys(("prb", "prb_basic", "prb_projective", "prbvolpath"), 6),
}  # fmt: skip
"""Integrators that give the same picture, and Mitsuba's default max_depth."""
_ORGANISATION = {"block_size": "", "samples_per_pass": "", "timeout": NO_EFFECT}
