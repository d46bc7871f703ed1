"""Effects of materials: channels, textures, lobes, and what turns or mixes them."""

from __future__ import annotations

import numpy as np

from ..brdf import ALBEDOS, LOBES, NODES, SPECTRA
from ..parts.textures import TEXTURES
from .effect import Chosen, Effect, Found, named
from .facts import Facts


def _rgb(facts: Facts, chosen: Chosen) -> Found:
    if facts.scene.channels == 1:
        return Found(False, "the scene has one channel")
    tables = ("materials", facts.material_rows, SPECTRA), ("radiance", None, None), ("texels", None, None)
    if not all(facts.fixed(leaf) for leaf, _, _ in tables):
        return Found(True, f"{facts.scene.channels} channels, and spectra that may move")
    grey = lambda s: bool((s == s[:, :1]).all())
    spectra = {"radiance": facts.radiance, "texels": np.asarray(facts.scene.texels)}
    coloured = [f for f in SPECTRA if not grey(facts.field(f))]
    if coloured:
        rows = np.any([(facts.field(f) != facts.field(f)[:, :1]).any(1) for f in coloured], 0)
        return Found(True, f"colour of {named(facts.of_materials(rows), 'material')}")
    for leaf, values in spectra.items():
        if not grey(values):
            rows = np.flatnonzero((values != values[:, :1]).any(1))
            said = named(facts.of_lights(rows), "light") if leaf == "radiance" else "textures"
            return Found(True, f"colour of {said}")
    grey_ones = (facts.assume("rgb", *table, "grey", "every spectrum is grey") for table in tables)
    return Found(False, "every spectrum is grey", tuple(grey_ones))


def _texture(kind: str) -> Effect:
    def find(facts: Facts, chosen: Chosen) -> Found:
        fields, lit, names = facts.textured(kind)
        said = f"on {named(names)}" if names else "of the enclosure" if lit else "no parameter has one"
        return Found(bool(fields or lit), said)

    def sets(facts: Facts, chosen: Chosen) -> dict:
        fields, lit, _ = facts.textured(kind)
        maps = {f"map:{f}" for f in fields} if fields or lit else {"map:reflectance"}
        stepped = kind == "checkerboard" or (kind == "bitmap" and facts.nearest)
        return {"textures": (kind,), "coordinates": True, "textured_lights": lit, "maps": maps, "stepped": stepped}

    needs = ("texture:",) if kind == "product" else ()  # of other textures
    return Effect(f"texture:{kind}", find, sets, needs, cut=True)


def _nested(facts: Facts, chosen: Chosen) -> Found:
    on = facts.nested > 0 and chosen["texture:checkerboard"]
    return Found(on, "checkerboards of textures" if on else "no checkerboard has textures")


def _of_number(number: int):
    def find(facts: Facts, chosen: Chosen) -> Found:
        here = facts.numbers == number
        on = bool(here.any())
        return Found(on, named(facts.of_materials(here), "material") if on else "no material")

    return find


def _lobe(name: str) -> Effect:
    fields = set(LOBES[name].fields)
    return Effect(
        f"lobe:{name}",
        _of_number(LOBES[name].number),
        lambda facts, chosen: {"lobes": (name,), "fields": fields},
        cut=True,
    )


_READ = {
    "blend": {"fields": {"weight"}},
    "sides": {},
    "normalmap": {"fields": {"reflectance"}, "maps": {"map:reflectance"}, "tangents": True},
    "bumpmap": {"fields": {"weight", "roughness"}, "maps": {"map:roughness"}, "tangents": True, "bumps": True},
}
"""What each kind of node sets."""


def _node(name: str) -> Effect:
    def sets(facts: Facts, chosen: Chosen) -> dict:
        own, shared = _READ.get(name, {}), {"lobe", "weight", "first", "second", "shadowed"}
        return {"nodes": (name,), "depth": max(facts.depth, 1), **own, "fields": own.get("fields", set()) | shared}

    needs = ("texture:",) if name in ("normalmap", "bumpmap") else ()
    return Effect(name, _of_number(NODES[name]), sets, needs=needs, cut=True)


def _mirrors(facts: Facts, chosen: Chosen) -> Found:
    deltas = np.isin(facts.numbers, [lobe.number for lobe in LOBES.values() if lobe.delta])
    on = bool(deltas.any())
    return Found(on, named(facts.of_materials(deltas), "material") if on else "no material")


def _set_mirrors(facts: Facts, chosen: Chosen) -> dict:
    through = np.isin(facts.numbers, [lobe.number for lobe in LOBES.values() if lobe.delta and lobe.transmits])
    return {"mirrors": True, "bent": bool(through.any()) or facts.bent_mirrors}


def _sides(facts: Facts) -> np.ndarray:
    return (facts.field("twosided")[:, 0] > 0.5) & (facts.numbers < 100)


def _twosided(facts: Facts, chosen: Chosen) -> Found:
    two = _sides(facts)
    if not two.any():
        return Found(False, "no material")
    every = bool((two | (facts.numbers >= 100)).all())
    return Found(True, "all materials" if every else named(facts.of_materials(two), "material"))


def _set_twosided(facts: Facts, chosen: Chosen) -> dict:
    two = _sides(facts)
    return {"twosided": "all" if two.any() and (two | (facts.numbers >= 100)).all() else "some"}


def _anisotropic(facts: Facts, chosen: Chosen) -> Found:
    rough = np.isin(facts.numbers, [lobe.number for lobe in LOBES.values() if "alpha" in lobe.fields])
    rows = rough & np.any([(a[:, 0] != a[:, 1]) for a in (facts.field("alpha"), facts.field("map:alpha"))], 0)
    principled = np.isin(facts.numbers, [lobe.number for lobe in LOBES.values() if "anisotropic" in lobe.fields])
    rows |= facts.field("map:anisotropic").any(1) | facts.field("anisotropic").any(1)
    if rows.any():
        return Found(True, f"roughness along a direction: {named(facts.of_materials(rows), 'material')}")
    if not principled.any():
        return Found(False, "no such material")
    if not facts.fixed("materials"):
        return Found(True, f"may move: {named(facts.of_materials(principled), 'material')}")
    rows = np.array(facts.material_rows)[principled].tolist()
    assumed = facts.assume("anisotropic", "materials", rows, ["anisotropic"], "zero", "anisotropic stays 0")
    return Found(False, "no such material", (assumed,))


def _bounces(facts: Facts, chosen: Chosen) -> Found:
    albedo = np.any([facts.field(f).any(1) | facts.field(f"map:{f}").any(1) for f in ALBEDOS], 0)
    if albedo.any() or not facts.fixed("materials"):
        return Found(True, "surfaces reflect" if albedo.any() else "surfaces are black, and may move")
    what = "each reflectance and transmittance stays 0"
    assumed = facts.assume("bounces", "materials", facts.material_rows, ALBEDOS, "zero", what)
    return Found(False, "every reflectance is 0", (assumed,))


EFFECTS = (
    Effect("rgb", _rgb, lambda facts, chosen: {"channels": facts.scene.channels}),
    *(_texture(kind) for kind in TEXTURES),
    Effect("nested", _nested, lambda facts, chosen: {"nested": facts.nested}, able=lambda facts, chosen: False),
    *(_lobe(name) for name in LOBES),
    Effect("mirrors", _mirrors, _set_mirrors, fixed="belongs to the materials; build them as others", changes=False),
    Effect("twosided", _twosided, _set_twosided),
    Effect("anisotropic", _anisotropic, lambda facts, chosen: {"tangents": True, "coordinates": facts.curved}),
    *(_node(name) for name in NODES),
    Effect("bounces", _bounces, lambda facts, chosen: {"bounces": True}),
)
