"""From a scene to its plan, on the host.

By default a plan looks at structure only, so that any value may move inside it. `free=` names the
parameters that will move; everything else is then specialised on its value, and `Plan.assumes` lists
what was taken for granted. `jaxrt.render` specialises on everything.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..brdf import DERIVED, LOBES, NODES
from ..intersect import BACKENDS, choose, refusal
from ..parts import SceneError
from ..scene import Scene
from .effect import Effect, Found
from .facts import Facts
from .registry import EFFECTS
from .static import Plan


def plan(scene: Scene, free: str | Iterable[str] | None = (), *, backend: str | None = None, **overrides: bool) -> Plan:
    """The plan of a scene, made on the host from concrete values.

    `free`: names or patterns of parameters that will move; () means all of them (the plan looks at
    structure only), None means none. `backend`: of the ray search, by default chosen by number of faces and
    machine. `overrides` force an effect in or out by name, as `enclosure=False` or `**{"lobe:ggx": True}`; what the
    picture loses is named in `Plan.dropped`. What the scene has nothing for stays out. Raises `SceneError` for
    unknown names, for effects that cannot be forced, and for a backend that does not run here.
    """
    facts = Facts(scene, free, _backend(scene, backend))
    forced = _forced(overrides)
    chosen: dict[str, bool] = {}
    reasons, assumes, dropped, cut = [], [], [], []
    fields: dict[str, Any] = {}
    for name, effect in EFFECTS.items():
        found = effect.find(facts, chosen)
        on, why = _decided(effect, found, forced.get(name), facts, chosen)
        chosen[name] = on
        reasons.append((name, on, why))
        if on:
            _join(fields, effect.sets(facts, chosen))
        elif found.on:
            dropped += [name] * effect.changes
            cut += [name] * effect.cut
        elif name not in forced:
            assumes += found.assumes
    if any(name in NODES for name in cut):
        _join(fields, {"depth": facts.depth})  # levels of tables to be gone through
    return Plan(
        **_completed(fields, facts),
        out_channels=scene.channels,
        cut=tuple(cut),
        reasons=tuple(reasons),
        assumes=tuple(assumes),
        forced=tuple(forced.items()),
        dropped=tuple(dropped),
    )


def _backend(scene: Scene, asked: str | None) -> tuple[str, str]:
    if asked is None:
        group = np.asarray(scene.instance_group)
        copies = np.asarray(scene.groups)[group[group >= 0], 1].sum()
        return choose(int(np.asarray(scene.counts)[:2].sum() + copies))
    if asked not in BACKENDS:
        raise SceneError(f"backend: {asked!r} is not known; there are {', '.join(BACKENDS)}")
    if (refused := refusal(asked)) is not None:
        raise SceneError(f"backend: {asked} cannot be used: {refused}")
    return asked, "asked for"


def effect_named(name: str) -> Effect:
    """The effect of a name. Raises `SceneError` with the closest names."""
    if name in EFFECTS:
        return EFFECTS[name]
    close = difflib.get_close_matches(name, EFFECTS, 3, 0.4)
    close += [n for n in EFFECTS if n.endswith(f":{name}") and n not in close]
    raise SceneError(f"{name}: no such effect; " + (f"closest: {', '.join(close)}" if close else "see print(plan)"))


def _forced(overrides: Mapping[str, bool]) -> dict[str, bool]:
    """What is forced, with what that needs."""
    forced: dict[str, bool] = {}
    for name, value in overrides.items():
        effect = effect_named(name)
        if effect.fixed:
            raise SceneError(f"{name}: {effect.fixed}")
        # A texture of the enclosure goes with the light that it is on.
        forced["enclosure" if name == "environment" else name] = bool(value)
    for name in [n for n, on in forced.items() if on]:
        for need in EFFECTS[name].needs:
            if not any(n.startswith(need) for n in forced):
                forced[next(n for n in EFFECTS if n.startswith(need))] = True
    return forced


def _decided(
    effect: Effect, found: Found, asked: bool | None, facts: Facts, chosen: Mapping[str, bool]
) -> tuple[bool, str]:
    """Whether an effect is in, and why."""
    lack = effect.lacks(chosen)
    if asked is None or asked == found.on:
        return (found.on, found.why) if lack is None or not found.on else (False, f"needs {lack}; {found.why}")
    if not asked:
        if effect.stays:
            raise SceneError(f"{effect.name}: cannot be left out: {effect.stays}")
        return False, f"forced out; {found.why}"
    if lack is not None:
        return False, f"asked for, but needs {lack}"
    return (True, f"forced in; {found.why}") if effect.able(facts, chosen) else (False, f"asked for, but {found.why}")


def _join(fields: dict[str, Any], more: Mapping[str, Any]) -> None:
    for name, value in more.items():
        old = fields.get(name)
        if old is None:
            fields[name] = value
        elif isinstance(value, tuple):
            fields[name] = old + value
        else:
            fields[name] = old | value if isinstance(value, (set, bool)) else max(old, value)


def _completed(fields: dict[str, Any], facts: Facts) -> dict[str, Any]:
    """With what follows from several effects together: the columns of the material table that are carried."""
    fields = {"lobes": ("diffuse",), "fields": set(LOBES["diffuse"].fields)} | fields
    wanted, maps = fields["fields"], fields.pop("maps", set())
    wanted = wanted | {m for m in maps if m.removeprefix("map:") in wanted}
    if len(fields["lobes"]) > 1:
        wanted |= {"lobe"}
    if fields.get("twosided") == "some":
        wanted |= {"twosided"}
    return fields | {"fields": tuple(f for f in (*facts.columns.at, *DERIVED) if f in wanted)}
