"""Closed scenes: furnaces, energy, spheres, plates without end, and rooms without a solution."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from cases import Case, Fact, Look, Slope, square
from helpers import WALLS, box_room, icosphere

import jaxrt

SPOTS = Look(np.zeros((6, 3)) + 0.1, np.array(list(WALLS.values())) + 0.2, 1.0)
"""Rays from within the room to its six walls."""


def means_of_walls() -> Look:
    """Gauss's points on all six walls, for the mean over them."""
    looks = []
    for n in WALLS.values():
        n = np.array(n, float)
        a, b = np.roll(n, 1), np.roll(n, 2)
        looks.append(square(n, a, b, 3) if np.cross(a, b) @ n < 0 else square(n, b, a, 3))
    return Look(*(np.concatenate(part) for part in zip(*looks, strict=True)))


def furnace(rho: float) -> jaxrt.Scene:
    return box_room(rho, {name: 1.0 for name in WALLS})


def one_wall(rho: float) -> jaxrt.Scene:
    """Of exitance 1."""
    return box_room(rho, {"ceiling": 1.0 / np.pi})


def closed_furnace(rho: float, depth: int, **more: Any) -> Case:
    """To a number of edges; the derivative by the albedo is Σ n ρⁿ⁻¹."""
    n = np.arange(1, depth)
    want, slope = (1 - rho**depth) / (1 - rho), float((n * rho ** (n - 1)).sum())
    return Case(f"furnace, ρ {rho:g}, {depth} edges", functools.partial(furnace, rho), SPOTS, want, "(1 − ρᵈ)/(1 − ρ)",
                rtol=1e-4, depth=depth, slope=Slope("wall.reflectance", 1.0, slope, rtol=2e-3), **more)  # fmt: skip


def solved(rho: float, scene: Any = furnace, **options: Any) -> jaxrt.Field:
    room = scene(rho)
    options = {"resolution": 200, "directions": 64, "max_depth": -1, "rtol": 1e-5} | options
    return jaxrt.solve(room, 0, plan=jaxrt.plan(room), **options)


def whole_furnace(rho: float) -> float:
    """The largest relative error of what elements store, R = ρ/(1 − ρ)."""
    field = solved(rho)
    real = np.asarray(field.elements.size) > 0
    want = rho / (1 - rho)
    return (
        float(np.abs(np.asarray(field.values, np.float64)[real] / want - 1).max())
        if field.result == _good()
        else np.nan
    )


def unsolved(rho: float, scene: Any = furnace) -> float:
    """1 where a field says that it was not found and why, and its spectral radius is 1; else 0."""
    field = solved(rho, scene)
    said = field.result != _good() and "no solution exists" in field.why
    return float(said and abs(float(field.spectral_radius) - 1) < 1e-3)


def _good() -> Any:
    import optimistix

    return optimistix.RESULTS.successful


def render_unsolved() -> float:
    """1 where a picture by such a field is not called a success."""
    sol = jaxrt.render(furnace(1.0), 16, method="field", max_depth=-1)
    return float(sol.failed and "no solution exists" in sol.stats["unsolved"])


def sphere(fraction: bool) -> jaxrt.Scene:
    """An icosphere seen from within, the upper half of which has exitance 1: an integrating sphere nearly."""
    v, f = icosphere(4)
    up = v[f].mean(1)[:, 2] > 0
    part = lambda faces, **more: jaxrt.Mesh(
        vertices=v, faces=faces[:, ::-1], bsdf=jaxrt.Diffuse(0.5, id="wall"), **more
    )
    return jaxrt.Scene.build(
        [part(f[up], id="top", emission=1 / np.pi, emission_id="light"), part(f[~up], id="bottom")]
    )


def concentric() -> jaxrt.Scene:
    """Spheres of radii .5 and 1; the inner one has exitance 1."""
    paint = jaxrt.Diffuse(0.5, id="paint")
    inner = jaxrt.Sphere(radius=0.5, id="inner", bsdf=paint, emission=1 / np.pi, emission_id="light")
    return jaxrt.Scene.build([inner, jaxrt.Sphere(radius=1.0, id="outer", bsdf=paint, flip_normals=True)])


def endless(rho: float) -> jaxrt.Scene:
    """A floor of exitance 1 and a ceiling between mirrors: plates without end."""
    mirror, paint = jaxrt.Conductor(0.0, id="mirror"), jaxrt.Diffuse(rho, id="wall")
    sides = {name: mirror for name in ("left", "right", "back", "front")}
    return box_room(paint, {"floor": 1 / np.pi}, sides)


_DOWN, _UP = Look((0.1, 0.2, 0), (0, 0, -1.0), 1.0), Look((0.1, 0.2, 0), (0, 0, 1.0), 1.0)
_P = np.pi
_deep: dict[str, Any] = {"depth": 60, "rtol": 1e-3, "field": 1e-2, "spp": 64}

CASES = [
    closed_furnace(0.5, 5, field=1e-4, quick=True),
    closed_furnace(0.9, 5, field=1e-4, quick=True),
    closed_furnace(0.0, 5, quick=True),
    closed_furnace(1.0 - 1e-9, 5),
    closed_furnace(0.99, 60, spp=32, noise=0.05, field=1e-4),
    closed_furnace(0.999, 60, spp=32, noise=0.05, field=1e-4),
    *(Fact(f"furnace, ρ {rho:g}, all edges", functools.partial(whole_furnace, rho), 0.0, "ρ/(1 − ρ)", 1e-4, method="field",
           quick=rho == 0.999) for rho in (0.5, 0.9, 0.99, 0.999)),
    Fact("a closed room of albedo 1 with lamps has no solution", functools.partial(unsolved, 1.0), 1.0, "energy", method="field",
         quick=True),
    Fact("a closed room of albedo 1 with one lamp has none", functools.partial(unsolved, 1.0, one_wall), 1.0, "energy",
         method="field"),
    Fact("a picture of a room without a solution says so", render_unsolved, 1.0, "energy", method="field"),
    *(Case(f"energy identity, ρ {rho}", functools.partial(one_wall, rho), means_of_walls(), want / _P, "Σ A E/(1 − ρ)",
           depth=depth, field=1e-2, rtol=2e-3, spp=64) for rho, want, depth in ((0.5, 1 / 3, 30), (0.9, 1.6666667, 90))),
    Case("integrating sphere, dark half", functools.partial(sphere, True), Look((0, 0, 0), (0.1, 0.2, -1.0), 1.0), 0.5 / _P,
         "ρ f M/(1 − ρ)", **(_deep | {"rtol": 1e-2, "spp": 512, "field": 2e-2})),
    Case("concentric spheres, inner", concentric, Look((0.1, 0.2, 0.9), (-0.1, -0.2, -0.9), 1.0), 1.111111 / _P, "oracle", **_deep),
    Case("concentric spheres, outer", concentric, Look((0, 0, 0.7), (0.1, 0.2, 1.0), 1.0), 0.222222 / _P, "oracle", **_deep),
    *(Case(f"plates without end, ρ {rho}, {name}", functools.partial(endless, rho), look, want / _P, "M/(1 − ρ²), ρM/(1 − ρ²)",
           **(_deep | {"depth": 400, "field": 2e-2}))
      for rho, name, look, want in ((0.5, "low", _DOWN, 1.333333), (0.5, "high", _UP, 0.666667),
                                    (0.9, "low", _DOWN, 5.263158), (0.9, "high", _UP, 4.736842))),
    Case("a lamp in a closed box", functools.partial(box_room, 0.5, {}, None, [jaxrt.Sphere(radius=0.5, id="lamp", emission=1.0,
         emission_id="light", bsdf=jaxrt.Diffuse(0.0, id="black"))]), Look((0, 0, 3.0), (0, 0, -1.0), 1.0), 0.0,
         "nothing leaves", depth=5, quick=True),
]  # fmt: skip
