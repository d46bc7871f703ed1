"""Effects of what emits, and of how it is sampled."""

from __future__ import annotations

from ..near_lamps import solid_angle_pays
from ..parts import LAMPS
from ..parts.textures import TEXTURES
from .effect import Chosen, Effect, Found, named
from .facts import Facts


def _dark(facts: Facts, effect: str, rows: list[int]) -> tuple:
    what = f"{named(facts.of_lights(rows), 'emitter')} at radiance 0 stays dark"
    return (facts.assume(effect, "radiance", rows, None, "zero", what),)


def _enclosure(facts: Facts, chosen: Chosen) -> Found:
    if facts.dark(1):
        return Found(False, "black", _dark(facts, "enclosure", [1]))
    return Found(True, f"light from all around, of {facts.structure.emitters[1]}")


def _environment(facts: Facts, chosen: Chosen) -> Found:
    kind = TEXTURES[facts.layout[facts.radiance_map[1], 0]]
    on = bool(facts.radiance_map[1]) and chosen["enclosure"] and chosen[f"texture:{kind}"]
    return Found(on, f"{facts.structure.emitters[1]} has a texture" if on else "that light has no texture")


def _size(facts: Facts, chosen: Chosen) -> dict:
    width, height = facts.layout[facts.radiance_map[1], 2:4]
    return {"environment": (int(width), int(height))}


def _area_light(facts: Facts, chosen: Chosen) -> Found:
    bright = [r for r in facts.light_rows if not facts.dark(r)]
    if bright:
        return Found(True, f"{facts.lights.size} emitting faces: {named(facts.of_lights(bright))}")
    if not facts.light_rows:
        return Found(False, "no face emits")
    return Found(False, "all dark", _dark(facts, "area_light", facts.light_rows))


def _smooth(facts: Facts, chosen: Chosen) -> Found:
    owners = facts.smooth_lights
    return Found(bool(owners), f"vertex normals of {named(owners, 'emitter')}" if owners else "no such emitter")


def _lamp(kind: str) -> Effect:
    def find(facts: Facts, chosen: Chosen) -> Found:
        here = (facts.lamp_rows > 0) & (facts.lamps[:, 8] == LAMPS.index(kind))
        rows = facts.lamp_rows[here].tolist()
        bright = [r for r in rows if not facts.dark(r)]
        if bright:
            return Found(True, named(facts.of_lights(bright), "lamp"))
        return Found(False, "all dark", _dark(facts, kind, rows)) if rows else Found(False, "no such lamp")

    able = lambda facts, chosen: bool(facts.lights.size or (facts.lamp_rows > 0).any())
    needs = ("texture:bitmap",) if kind == "projector" else ()
    sets = lambda facts, chosen: {"lamp_kinds": (kind,)} | ({"web": facts.web} if kind == "goniometric" else {})
    return Effect(kind, find, sets, needs, able)


def _sampling(facts: Facts, chosen: Chosen) -> Found:
    on = chosen["area_light"]
    return Found(on, "rays towards emitting faces" if on else "no face emits")


def _solid_angle(facts: Facts, chosen: Chosen) -> Found:
    if chosen["smooth_lights"]:
        return Found(False, "they are sampled by the cosines of their vertex normals")
    pays = chosen["light_sampling"] and solid_angle_pays(facts.scene, facts.lights)
    return Found(pays, "they are large and near" if pays else "none is large and near")


def _selection(facts: Facts, chosen: Chosen) -> Found:
    lamps, around = any(chosen[kind] for kind in LAMPS), chosen["environment"]
    faces = facts.lights.size if chosen["light_sampling"] or lamps or around else 0  # rows of one table
    n = int(faces + lamps * (facts.lamp_rows > 0).sum() + around)
    return Found(n > 1, f"one of {n} by its power" if n > 1 else "at most one light")


EFFECTS = (
    Effect("enclosure", _enclosure, lambda facts, chosen: {"enclosure": True}),
    Effect("environment", _environment, _size, ("enclosure", "texture:"), lambda facts, chosen: False),
    Effect(
        "area_light",
        _area_light,
        lambda facts, chosen: {"area_light": True},
        able=lambda facts, chosen: facts.lights.size > 0,
    ),
    Effect(
        "smooth_lights",
        _smooth,
        lambda facts, chosen: {"smooth_lights": True},
        ("smooth_normals", "area_light"),
        able=lambda facts, chosen: False,
    ),
    *(_lamp(kind) for kind in LAMPS),
    Effect(
        "light_sampling",
        _sampling,
        lambda facts, chosen: {"light_kinds": facts.light_kinds},
        ("area_light",),
        changes=False,
    ),
    Effect(
        "solid_angle",
        _solid_angle,
        lambda facts, chosen: {"solid_angle": True},
        ("light_sampling",),
        able=lambda facts, chosen: not chosen["smooth_lights"],
        changes=False,
    ),
    Effect(
        "light_selection",
        _selection,
        lambda facts, chosen: {"many_lights": True},
        able=lambda facts, chosen: bool(facts.lights.size or (facts.lamp_rows > 0).any()),
        stays="all lights but one would be lost; leave out area_light or a kind of lamp",
    ),
)
