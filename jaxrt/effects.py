"""The plan: which effects a scene calls for. Static and hashable; what it leaves out is not compiled.

By default a plan looks at structure only, so that any value may move inside it. `free=` names the
parameters that will move; everything else is then specialised on its value, and `Plan.assumes` lists
what was taken for granted. `jaxrt.render` specialises on everything.
"""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Callable, Iterable
from typing import Any

import jax
import numpy as np

from .brdf import ALBEDOS, DERIVED, LOBES, MAPPED, NODES, SPECTRA, MaterialColumns
from .intersect import BACKENDS, choose, refusal
from .near_lamps import solid_angle_pays
from .parts import LAMPS, SceneError
from .parts.textures import TEXTURES
from .scene import KINDS, SENSORS, Scene
from .texture import inner_numbers


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Plan:
    """What is compiled. Equal plans share programs; reasons and assumptions do not count for equality.

    A pytree without leaves: as an argument of a jitted function it is static.
    """

    channels: int
    kinds: tuple[str, ...]
    lobes: tuple[str, ...]
    fields: tuple[str, ...]
    twosided: str  # none, some or all
    tangents: bool  # ∂p/∂u at each hit
    bumps: bool  # and ∂p/∂v
    coordinates: bool  # on surfaces, for textures and for tangents of curved ones
    textures: tuple[str, ...]  # kinds of them
    nested: int  # how many checkerboards one of them stands in, at most
    nodes: tuple[str, ...]  # kinds of materials made of others
    depth: int  # how many of those stand inside one another, at most
    textured_lights: bool
    smooth_normals: bool
    light_kinds: tuple[str, ...]  # kinds of faces that emit
    lamp_kinds: tuple[str, ...]  # of lamps without extent
    web: int  # angles of the finest photometric web
    many_lights: bool
    solid_angle: bool  # whether flat lights are sampled by it
    area_light: bool
    enclosure: bool
    environment: tuple[int, int] | None  # width and height of the enclosure's texture, if it is sampled as a light
    bounces: bool
    hide_emitters: bool
    instances: bool
    backend: str
    out_channels: int
    reasons: tuple[tuple[str, bool, str], ...] = dataclasses.field(default=(), compare=False, repr=False)
    assumes: tuple[tuple[str, str], ...] = dataclasses.field(default=(), compare=False, repr=False)

    @property
    def effects(self) -> frozenset[str]:
        """Names of the effects that are in."""
        return frozenset(name for name, present, _ in self.reasons if present)

    @property
    def storable(self) -> bool:
        """Whether later processes may have its programs: other searches may call back into Python."""
        return self.backend == "dense"

    @property
    def lights(self) -> bool:
        return bool(self.light_kinds or self.lamp_kinds or self.environment)

    @property
    def tilts(self) -> bool:
        """Whether normals are turned."""
        return "normalmap" in self.nodes or "bumpmap" in self.nodes

    @property
    def mapped(self) -> tuple[str, ...]:
        """Fields of materials that have textures."""
        return tuple(f.removeprefix("map:") for f in self.fields if f.startswith("map:"))

    def __str__(self) -> str:
        width = max(len(name) for name, _, _ in self.reasons)
        lines = [f"{name:<{width}}  {'in ' if on else 'out'}  {why}" for name, on, why in self.reasons]
        return "\n".join(lines + [f"assumes {name}: {what}" for name, what in self.assumes])


class _View:
    """The scene as host arrays, with the question which values a plan may rely on."""

    def __init__(self, scene: Scene, free: Any):
        self.scene = scene
        self.array = {k: np.asarray(getattr(scene, k)) for k in ("materials", "radiance", "finishes", "shape_finish")}
        self.counts, self.lights = np.asarray(scene.counts), np.asarray(scene.lights)
        self.face_shape, self.normals = np.asarray(scene.face_shape), np.asarray(scene.normals)
        self.columns = MaterialColumns(scene.channels)
        names = [name for name, _ in scene.structure.slots]
        patterns = () if free is None else (free,) if isinstance(free, str) else tuple(free)
        for p in patterns:
            if not fnmatch.filter(names, p):
                scene.structure.slot(p)  # raises with the closest names
        self.free = set(names) if free == () else {n for p in patterns for n in fnmatch.filter(names, p)}
        used = self.array["finishes"][np.unique(self.array["shape_finish"])]
        rows, table, self.depth = {int(r) for r in used[:, 0]} - {0}, self.array["materials"], -1
        inner = rows
        while inner:  # materials made of others, level by level
            rows, self.depth = rows | inner, self.depth + 1
            made = [r for r in inner if table[r, self.columns["lobe"][0]] > 99.5]
            inner = {int(table[r, self.columns[k][0]]) for r in made for k in ("first", "second")} - {0}
        self.depth, self.material_rows = max(self.depth, 0), sorted(rows)
        self.radiance_rows = sorted({int(r) for r in (*used[:, 1], *np.asarray(scene.lamp_radiance))} | {1})
        self.assumes: list[tuple[str, str]] = []

    def field(self, name: str) -> np.ndarray:
        return self.array["materials"][self.material_rows, slice(*self.columns[name])]

    def fixed(self, leaf: str, row: int | None = None) -> bool:
        """Whether no free parameter lives in a table (or in one of its rows)."""
        slots = self.scene.structure.slots
        return not any(n in self.free and s.leaf == leaf and row in (None, s.row) for n, s in slots)


def _grey(view: _View) -> bool:
    if view.scene.channels == 1:
        return True
    if not all(view.fixed(leaf) for leaf in ("materials", "radiance", "texels")):
        return False
    spectra = [view.field(f) for f in SPECTRA] + [view.array["radiance"], np.asarray(view.scene.texels)]
    same = all(bool((s == s[:, :1]).all()) for s in spectra)
    if same:
        view.assumes.append(("*", "every spectrum is grey"))
    return same


def _with_factors(numbers: np.ndarray, layout: np.ndarray) -> np.ndarray:
    """Numbers of textures, with those that products among them are made of."""
    products = numbers[layout[numbers, 0] == TEXTURES.index("product")]
    return np.concatenate([numbers, layout[products, 1:3].ravel()])


def _carriers(kind: str, layout: np.ndarray, mapped: list[str], view: _View, inner: np.ndarray) -> str:
    """Which parameters have textures of a kind. `inner`: the textures that stand in others."""
    made_so = [
        (layout[_with_factors(np.array([k]), layout), 0] == TEXTURES.index(kind)).any() for k in range(len(layout))
    ]
    of_kind = np.flatnonzero(made_so)
    names = [f for f in mapped if np.isin(view.field(f"map:{f}"), of_kind[of_kind > 0]).any()]
    if np.isin(np.asarray(view.scene.radiance_map)[view.radiance_rows], of_kind[of_kind > 0]).any():
        names.append("radiance")
    names += ["checkerboards"] if np.isin(inner, of_kind).any() else []
    return f"on {', '.join(names)}" if names else "no parameter has one"


def plan(scene: Scene, free: str | Iterable[str] | None = (), *, backend: str | None = None, **overrides: bool) -> Plan:
    """The plan of a scene, made on the host from concrete values.

    `free`: names or patterns of parameters that will move; () means all of them (the plan looks at
    structure only), None means none. `backend`: of the ray search, by default chosen by number of faces and
    machine. `overrides` force an effect in or out by name, as `enclosure=False`. Raises `SceneError` for
    unknown names and for a backend that does not run here.
    """
    view = _View(scene, free)
    structure = scene.structure
    kinds = tuple(k for k, n in zip(KINDS, view.counts, strict=True) if n)
    numbers = set(view.field("lobe")[:, 0].astype(int))
    lobes = tuple(name for name, lobe in LOBES.items() if lobe.number in numbers) or ("diffuse",)
    made = {k: n in numbers for k, n in NODES.items()}
    tilts = made["normalmap"] or made["bumpmap"]
    sided = view.field("twosided")[view.field("lobe")[:, 0] < 99.5, 0] > 0.5
    twosided = "all" if sided.size and sided.all() else "some" if sided.any() else "none"
    rough = [lobe.number for lobe in LOBES.values() if "alpha" in lobe.fields]
    alpha = view.field("alpha")[np.isin(view.field("lobe")[:, 0].astype(int), rough)]
    anisotropic = bool((alpha[:, 0] != alpha[:, 1]).any())
    grey = _grey(view)
    mapped = [f for f in MAPPED if view.field(f"map:{f}").any()]
    layout, used = np.asarray(scene.textures), np.asarray(scene.radiance_map)[view.radiance_rows]
    webs, used = used[layout[used, 0] < 0], used[layout[used, 0] >= 0]
    textured_lights = bool(used.any())
    numbers = np.concatenate([used, *(view.field(f"map:{f}").ravel() for f in mapped)]).astype(int)
    levels = [_with_factors(numbers[numbers > 0], layout)]
    while levels[-1].size:  # those in the squares of checkerboards
        levels.append(_with_factors(inner_numbers(layout, levels[-1]), layout))
    inner, nested = np.concatenate([*levels[1:], numbers[:0]]), max(len(levels) - 2, 0)
    textures = tuple(k for k in TEXTURES if TEXTURES.index(k) in layout[np.concatenate(levels), 0])
    anisotropic |= bool((lambda a: a[:, 0] != a[:, 1])(view.field("map:alpha")).any())
    anisotropic |= bool(view.field("anisotropic").any() or view.field("map:anisotropic").any())

    shape_emitter = view.array["finishes"][view.array["shape_finish"], 1]
    dark = {r for r in view.radiance_rows if view.fixed("radiance", r) and not view.array["radiance"][r].any()}
    if not view.fixed("texels"):
        dark -= set(np.flatnonzero(np.asarray(scene.radiance_map)))
    lights = view.lights[view.lights >= 0]
    emitting = bool(set(shape_emitter[view.face_shape[lights]].tolist()) - dark)
    lamp_rows = np.asarray(scene.lamp_radiance)
    shining = (lamp_rows > 0) & ~np.isin(lamp_rows, list(dark))
    lamp_kinds = {LAMPS[int(k)] for k in np.asarray(scene.lamps)[shining, 8]}
    kinds_of_lights = {KINDS[k] for k in np.searchsorted(np.cumsum(scene.blocks), lights, side="right")}
    if any(r > 1 for r in dark):
        view.assumes.append(("*.radiance", "emitters of radiance 0 stay dark"))
    bounces = any(view.field(f).any() for f in ALBEDOS) or not (view.fixed("materials") and view.fixed("texels"))
    if not bounces:
        view.assumes.append(("*.*reflectance, *.*transmittance", "each stays 0"))
    smooth = bool(np.abs(view.normals).any() or np.asarray(scene.grids)[:, 4].any())
    enclosure = 1 not in dark
    chosen: dict[str, Any] = {
        "smooth_normals": smooth,
        "enclosure": enclosure,
        "bounces": bounces,
        "anisotropic": anisotropic,
        "area_light": emitting,
        "light_sampling": emitting,
        "solid_angle": emitting and solid_angle_pays(scene, lights),
        "rgb": not grey,
        **{kind: kind in lamp_kinds for kind in LAMPS},
    }
    if "environment" in overrides:
        overrides["enclosure"] = overrides.pop("environment")
    for name, value in overrides.items():
        if name not in chosen:
            raise SceneError(f"{name}: no effect of that name to force; there are {', '.join(sorted(chosen))}")
        chosen[name] = bool(value)
    sampled = chosen["light_sampling"] and chosen["area_light"] and emitting
    chosen["solid_angle"] &= sampled

    group = np.asarray(scene.instance_group)
    sizes = np.asarray(scene.groups)[group[group >= 0], 1]
    if backend is None:
        backend, why_backend = choose(int(view.counts[:2].sum() + sizes.sum()))
    elif backend not in BACKENDS:
        raise SceneError(f"backend: {backend!r} is not known; there are {', '.join(BACKENDS)}")
    elif (refused := refusal(backend)) is not None:
        raise SceneError(f"backend: {backend} cannot be used: {refused}")
    else:
        why_backend = "asked for"

    # Dark ones too: their rows are among those that are drawn from.
    lamps_in = tuple(kind for kind in LAMPS if chosen[kind] and (lamp_rows > 0).any())
    around = np.asarray(scene.radiance_map)[1] if chosen["enclosure"] else 0
    environment = (int(layout[around, 2]), int(layout[around, 3])) if around else None
    alone = not (lamps_in or around)  # then dark faces are no rows to choose from
    n_lights = len(lights) * (emitting or not alone) + int((lamp_rows > 0).sum()) * bool(lamps_in) + bool(around)
    say: Callable[[bool, str, str], str] = lambda on, yes, no: yes if on else no
    films = {s.film[2] for s in structure.sensors}
    cameras = {part.kind for s in structure.sensors for part in (s, *s.parts)}
    used = lambda on, what: f"a {what} uses it" if on else f"no {what}"
    reasons = [
        ("rgb", chosen["rgb"], say(chosen["rgb"], f"{scene.channels} channels", "grey: one channel")),
        *((k, k in kinds, f"{view.counts[KINDS.index(k)]} faces") for k in KINDS),
        *((f"lobe:{name}", name in lobes, say(name in lobes, "a material uses it", "no material")) for name in LOBES),
        ("instances", sizes.size > 0, f"{sizes.size} of {sizes.sum()} triangles together"),
        ("twosided", twosided != "none", f"{twosided} of the materials"),
        ("anisotropic", chosen["anisotropic"], say(anisotropic, "a roughness has a direction", "no such material")),
        *((k, present, say(present, "a material is made so", "no such material")) for k, present in made.items()),
        *((f"texture:{k}", k in textures, _carriers(k, layout, mapped, view, inner)) for k in TEXTURES),
        ("nested", nested > 0, say(nested > 0, "checkerboards of textures", "no checkerboard has textures")),
        (
            "smooth_normals",
            chosen["smooth_normals"],
            say(smooth, "a mesh or grid has them", "all normals are of faces"),
        ),
        ("area_light", chosen["area_light"], f"{n_lights} emitting faces"),
        *((k, k in lamps_in, "lamps without extent" if k in lamp_kinds else "no such lamp") for k in LAMPS),
        ("light_sampling", sampled, say(sampled, "rays towards lamps", "lamps are met by reflection alone")),
        ("solid_angle", chosen["solid_angle"], say(chosen["solid_angle"], "lamps are large and near", "no such lamps")),
        ("light_selection", n_lights > 1, say(n_lights > 1, "by power", "at most one light")),
        ("enclosure", chosen["enclosure"], say(enclosure, "light from all around", "black")),
        ("environment", bool(around), say(bool(around), "that light has a texture", "it has no texture")),
        ("hide_emitters", structure.asked().hide_emitters, "from the camera, if the integrator asks"),
        ("bounces", chosen["bounces"], say(bounces, "surfaces reflect", "every reflectance is 0")),
        *((f"rays:{name}", name == backend, why_backend if name == backend else "") for name in BACKENDS),
        *((f"sensor:{k}", k in cameras, used(k in cameras, "sensor")) for k in SENSORS),
        *((f"film:{k}", k in films, used(k in films, "film")) for k in ("box", "tent", "gaussian")),
    ]
    wanted = {f for name in lobes for f in LOBES[name].fields}
    if any(made.values()):
        wanted |= {"lobe", "weight", "first", "second", "shadowed"}
        wanted |= {"reflectance"} if made["normalmap"] else set()
        wanted |= {"roughness"} if made["bumpmap"] else set()
    wanted |= {f"map:{f}" for f in mapped if f in wanted}
    curved = any(k in kinds for k in KINDS[2:])
    if len(lobes) > 1:
        wanted.add("lobe")
    if twosided == "some":
        wanted.add("twosided")
    return Plan(
        channels=scene.channels if chosen["rgb"] else 1,
        kinds=kinds,
        lobes=lobes,
        fields=tuple(f for f in (*view.columns.at, *DERIVED) if f in wanted),
        twosided=twosided,
        tangents=chosen["anisotropic"] or tilts,
        bumps=made["bumpmap"],
        coordinates=bool(textures) or (chosen["anisotropic"] and curved),
        textures=textures,
        nested=nested,
        nodes=tuple(k for k, present in made.items() if present),
        depth=view.depth,
        textured_lights=textured_lights,
        smooth_normals=chosen["smooth_normals"],
        light_kinds=tuple(k for k in KINDS if k in kinds_of_lights) if sampled else (),
        lamp_kinds=lamps_in,
        web=int(layout[webs, 2:4].max(initial=0)) if "goniometric" in lamps_in else 0,
        many_lights=n_lights > 1,
        solid_angle=chosen["solid_angle"],
        area_light=chosen["area_light"],
        enclosure=chosen["enclosure"],
        environment=environment,
        bounces=chosen["bounces"],
        hide_emitters=structure.asked().hide_emitters,
        instances=bool(sizes.size),
        backend=backend,
        out_channels=scene.channels,
        reasons=tuple(reasons),
        assumes=tuple(view.assumes),
    )
