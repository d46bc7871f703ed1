"""Whether a scene keeps to what its plan takes for granted. Asked on the host; traced values are known by name only."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from ..brdf import NODES
from ..compiler import remembered
from ..parts import LAMPS, SceneError
from ..scene import Scene, moved
from .make import plan as make_plan
from .registry import EFFECTS
from .static import Assumption, Plan

LIGHTS = {"area_light", "light_sampling", "environment", *LAMPS}
CHOICES = {"light_sampling", "solid_angle"}
"""Effects that leave the picture as it is: no plan lacks them."""


def fitting(scene: Scene, plan: Plan | None) -> tuple[Scene, Plan]:
    """The plan to use for a scene, by default its own, and the scene: derivatives in what the plan assumes raise.

    Raises `SceneError` where the scene has what the plan has not, and where values are not what it assumes.
    """
    plan = plan or scene.plan or make_plan(scene)
    if scene.plan is not None and plan is not scene.plan:
        _fits(scene, scene.plan, plan)
    for assumed in plan.assumes:
        _keeps(scene, assumed)
    unknown = {a.leaf: _constant(a, scene) for a in plan.assumes if a.alone and moved(getattr(scene, a.leaf)) is None}
    return (dataclasses.replace(scene, **unknown) if unknown else scene), plan


# ----------------------------------------------------------------------------------------- structure


def _fits(scene: Scene, own: Plan, plan: Plan) -> None:
    """`own`: the scene's plan by structure alone."""
    here, there = own.effects, plan.effects
    left_out = {name for name, on in plan.forced if not on} | {a.effect for a in plan.assumes}
    lacking = {name for name in here - there - left_out - CHOICES if EFFECTS[name].changes and not EFFECTS[name].fixed}
    lacking = {name for name in lacking if EFFECTS[name].lacks({n: True for n in there}) is None}
    if not plan.lights or (here - there) & LIGHTS:
        lacking.discard("light_selection")
    why = {name: why for name, _, why in own.reasons}
    for name in sorted(lacking):
        raise _of_another(scene, f"has {name} ({why[name]}), which the plan leaves out")
    cut = any(name.startswith("texture:") for name in left_out)
    order = {"none": 0, "some": 2, "all": 1}
    for name, fits in {
        "channels": plan.out_channels == own.out_channels and plan.channels in (1, own.channels),
        "instances": plan.instances == own.instances,
        "two-sided materials": "twosided" in left_out or order[own.twosided] <= order[plan.twosided],
        "materials made of others": own.depth <= plan.depth or bool(left_out & set(NODES)),
        "textures": cut or set(own.mapped) <= set(plan.mapped) | (set(own.mapped) - set(plan.fields)),
        "textures of lights": cut or own.textured_lights <= plan.textured_lights,
        "kinds of lights": not plan.light_kinds or set(own.light_kinds) <= set(plan.light_kinds),
        "a light's texture": plan.environment in (None, own.environment),
        "lights": not plan.lights or bool(scene.lights.size or scene.lamps.size or own.environment),
    }.items():
        if not fits:
            raise _of_another(scene, f"has other {name} than the plan")


def _of_another(scene: Scene, what: str) -> SceneError:
    return SceneError(f"{scene.structure.source or 'scene'}: {what}, so that it is another scene's; give plan(scene)")


# -------------------------------------------------------------------------------------------- values


def _names(scene: Scene, a: Assumption, rows: Any = None, only: Any = None) -> list[str]:
    """Parameters that an assumption is about; of some rows alone, and among those `only`."""
    rows = a.rows if rows is None else rows
    touches = lambda row: (
        rows is None or (row in rows if not isinstance(row, tuple) else any(row[0] <= r < row[1] for r in rows))
    )
    within = lambda c: not (c and a.columns) or any(c[0] < stop and start < c[1] for start, stop in a.columns)
    return [
        name
        for name, slot in scene.structure.slots
        if slot.leaf == a.leaf and touches(slot.row) and within(slot.columns) and (only is None or name in only)
    ]


def _refused(a: Assumption, names: list[str], what: str) -> SceneError:
    free = names[0] if names else a.leaf
    said = ", ".join(names[:3]) or a.leaf
    return SceneError(f'{said}: {what}, but the plan relies on it ({a.what}); give it plan(scene, free="{free}")')


def _keeps(scene: Scene, a: Assumption) -> None:
    leaf = getattr(scene, a.leaf)
    if isinstance(leaf, Tracer):
        names = moved(leaf)
        if names and (named := _names(scene, a, only=names)):
            raise _refused(a, named, "is traced")
        return
    broken = _broken(leaf, a) if isinstance(leaf, jax.Array) else _broken.__wrapped__(leaf, a)
    if broken:
        rows, value = broken
        raise _refused(a, _names(scene, a, rows), f"is {value}")


@remembered
def _broken(leaf: Any, a: Assumption) -> tuple[list[int], str] | None:
    """Rows for which an assumption does not hold, and what the first of them has."""
    values = np.asarray(leaf)
    rows = np.arange(len(values)) if a.rows is None else np.array(a.rows, int)
    values = values if a.rows is None else values[rows]
    for start, stop in a.columns or ((0, values.shape[1]),):
        part = values[:, start:stop]
        bad = (part != (0.0 if a.holds == "zero" else part[:, :1])).any(1)
        if bad.any():
            return rows[bad].tolist(), " ".join(f"{v:.4g}" for v in part[bad][0])
    return None


def _constant(a: Assumption, scene: Scene) -> Any:
    """A traced table as it is, of which derivatives are refused."""

    @jax.custom_jvp
    def same(table: Any) -> Any:
        return table

    @same.defjvp
    def _(*_: Any) -> Any:
        raise _refused(a, _names(scene, a), "is differentiated")

    return same(getattr(scene, a.leaf))
