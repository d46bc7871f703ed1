"""What boundary terms do not know: derivatives by what moves are refused there, by name."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax

from ..parts import SceneError
from ..scene import CAMERAS


def check(plan: Any, view: str, deep: bool, lamps: bool, places: bool) -> None:
    """Raises `SceneError` where what moves changes what is seen in ways that have no boundary term here.

    `view`: the kind of sensor, or "" for rays and meters at given points; `deep`: whether light is reflected at all;
    `lamps`: whether those without extent may move, `places`: whether instances do.
    """
    why = None
    if plan.instances or places:
        why = "outlines of instances; write their shapes out"
    elif "sun" in plan.lamp_kinds or "sky" in plan.textures:
        why = "the horizon of a sky, and borders of the sun and of its shadows; take a picture of radiance instead"
    elif deep and (plan.lamp_kinds or lamps):
        kinds = ", ".join(plan.lamp_kinds) or "lamps without extent"
        why = f"the sharp borders of shadows of lamps without extent ({kinds}); give them an area"
    elif "sdfgrid" in plan.kinds:
        why = "outlines of grids of distances; extract a mesh from the grid"
    elif plan.bent:
        why = "outlines seen in curved mirrors or through glass"
    elif plan.stepped and plan.coordinates:
        why = "borders inside textures that jump (checkerboards, bitmaps looked up by nearest); use bilinear bitmaps"
    elif plan.smooth_lights:
        why = "where lamps turn dark by their vertex normals; make those lamps without normals"
    elif plan.hide_emitters and view in CAMERAS:
        why = "outlines of emitters that are hidden from the camera; set hide_emitters to false"
    if why is None and view in ("batch", "distant"):
        why = f"outlines as a {view} sensor sees them; differentiate pictures of single cameras"
    if (
        why is None
        and view == "orthographic"
        and (plan.mirrors or plan.smooth_normals or set(plan.kinds) & {"sphere", "cylinder", "disk"})
    ):
        why = (
            "outlines of curved faces and in mirrors as orthographic cameras see them; use a perspective one from afar"
        )
    if why is not None:
        raise SceneError(
            f"measure: derivatives by what moves do not know {why}, or give boundary=False for interior terms alone"
        )


@jax.custom_jvp
def _once(tree: Any) -> Any:
    return tree


@_once.defjvp
def _(*_: Any) -> Any:
    raise SceneError(
        "measure: second derivatives do not hold where something moves, for boundary terms have only first ones; "
        "differentiate once by vertices, transforms, shapes, cameras and lenses, and take differences of that"
    )


def once(tree: Any) -> Any:
    """The same values, of which a derivative raises `SceneError`: what stands in a first derivative by what moves."""
    floats, others = eqx.partition(tree, eqx.is_inexact_array)
    return eqx.combine(_once(floats), others)
