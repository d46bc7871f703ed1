"""Reflectances at their limits: GGX from mirror to chalk, glass of index 1, light that is caught, mirrors that face."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from cases import Case, Look, Slope, plate
from cases_geometry import BLACK, X, Y
from helpers import icosphere

import jaxrt

AROUND = jaxrt.Enclosure(1.0)


def metal(alpha: float) -> jaxrt.Scene:
    """A plate that reflects everything once, under a sky of radiance 1."""
    bsdf = jaxrt.Conductor(alpha, id="metal")
    return jaxrt.Scene.build([plate((0, 0, 0), X, Y, bsdf=bsdf, id="plate")], enclosure=AROUND)


def towards(mu: float) -> Look:
    """A ray that meets the origin's plate at cosine μ."""
    o = np.array([np.sqrt(1 - mu * mu), 0, mu])
    return Look(3.0 * o, -o, 1.0)


def furnace(alpha: float, mu: float, want: float, **more: Any) -> Case:
    return Case(f"GGX furnace, α {alpha:g}, μ {mu:g}", functools.partial(metal, alpha), towards(mu), want,
                "quadrature", rtol=5e-4, spp=2048, depth=3, **more)  # fmt: skip


def glass(outer: float, inner: float | None = None, emission: float | None = None) -> jaxrt.Scene:
    """A ball of glass under a sky of 1, and one within it."""
    balls = [jaxrt.Sphere(radius=1.0, bsdf=jaxrt.Dielectric(outer, 1.0, id="glass"), id="ball")]
    if inner is not None:
        balls.append(jaxrt.Sphere(radius=0.5, bsdf=jaxrt.Dielectric(inner, outer, id="core"), id="within"))
    return jaxrt.Scene.build(balls, enclosure=AROUND)


def cube_of_glass() -> jaxrt.Scene:
    """From within a cube of index 2 light at 45° to the sides of a section never leaves: it is met again and again."""
    return jaxrt.Scene.build([jaxrt.Cube(bsdf=jaxrt.Dielectric(2.0, 1.0, id="glass"), id="cube")], enclosure=AROUND)


def facing(rho: float) -> jaxrt.Scene:
    """Two mirrors that face each other and shine with 1."""
    mirror = jaxrt.Conductor(0.0, specular_reflectance=rho, id="mirror")
    return jaxrt.Scene.build([
        plate((0, 0, 0), X, Y, bsdf=mirror, id="low", emission=1.0, emission_id="light"),
        plate((0, 0, 1), Y, X, bsdf=mirror, id="high", emission=1.0, emission_id="light"),
    ])  # fmt: skip


def thousand(count: int = 1000) -> jaxrt.Scene:
    """A row of plates under a sky of 1, number k of albedo (k + 1)/count."""
    plates = [
        plate((2.0 * k, 0, 0), 0.4 * X, Y, id=f"p{k}", bsdf=jaxrt.Diffuse((k + 1) / count, id=f"m{k}"))
        for k in range(count)
    ]
    return jaxrt.Scene.build(plates, enclosure=AROUND)


def smooth_ball(level: int, tilt: float) -> jaxrt.Scene:
    """A coarse ball with vertex normals, each turned by up to `tilt` radians, under a sky of 1."""
    v, f = icosphere(level)
    n = v + tilt * np.random.default_rng(0).normal(size=v.shape)
    mesh = jaxrt.Mesh(vertices=v, faces=f, normals=n / np.linalg.norm(n, axis=1)[:, None], id="ball",
                      bsdf=jaxrt.Diffuse(0.9, id="paint"))  # fmt: skip
    return jaxrt.Scene.build([mesh], enclosure=AROUND)


def beside(count: int = 64) -> Look:
    """Rays that graze the unit ball's outline."""
    at = np.linspace(0.999, 0.9999, count)
    turn = np.linspace(0.0, 2 * np.pi, count)
    return Look(np.stack([at * np.cos(turn), at * np.sin(turn), np.full(count, 3.0)], 1), (0, 0, -1.0), 1.0)


_GGX = {1.0: (0.30685, 0.45069, 0.76021), 0.5: (0.68785, 0.69825, 0.86010), 0.2: (0.94766, 0.89523, 0.89127),
        0.05: (0.99730, 0.99272, 0.91135)}  # fmt: skip
_ALMOST = [
    Case(f"GGX furnace, α {alpha:g}, {name}", functools.partial(metal, alpha), towards(mu), low, "energy", most=1.0 + 1e-5,
         spp=2048, depth=3, slope=Slope("plate.to_world", np.zeros((4, 4))) if slope else None, quick=alpha == 1e-3)
    for alpha, low, mu, name, slope in [(1e-3, 0.999, 1.0, "from above", False), (1e-3, 0.98, 0.1, "aslant", False),
                                        (2e-3, 0.99, 0.5, "half way", False), (0.01, 0.98, 0.3, "half way", False),
                                        (1e-3, 0.0, 1e-4, "grazing", False), (1.0, 0.0, 1e-4, "grazing", False)]
]  # fmt: skip

CASES = [
    *(furnace(alpha, mu, want, quick=alpha in (1.0, 0.05)) for alpha, values in _GGX.items()
      for mu, want in zip((1.0, 0.5, 0.1), values, strict=True)),
    *_ALMOST,
    Case("α 0 is a mirror", functools.partial(metal, 0.0), towards(0.5), 1.0, "energy", depth=3, quick=True,
         slope=Slope("metal.specular_reflectance", 1.0, 1.0)),
    Case("glass of index 1", functools.partial(glass, 1.0), towards(0.3), 1.0, "it is not there", depth=5, quick=True),
    Case("glass of index 1, grazing", functools.partial(glass, 1.0), beside(), 1.0, "it is not there", depth=5),
    Case("a ball of glass in a furnace", functools.partial(glass, 1.5), beside(), 1.0, "furnace", depth=60, rtol=1e-3, quick=True),
    Case("nested glass in a furnace", functools.partial(glass, 1.5, 1.8), towards(0.3), 1.0, "furnace", depth=100, rtol=2e-3,
         quick=True),
    Case("light that glass has caught", cube_of_glass, Look((0.1, 0.2, 0.3), (1.0, 1.0, 0.02), 1.0), 0.0,
         "total internal reflection", depth=50, quick=True),
    Case("light within a ball of glass", functools.partial(glass, 1.5), Look((0, 0, 0), (0, 0, 1.0), 1.0), 2.25, "furnace, n²",
         depth=60, rtol=1e-3),
    Case("facing mirrors", functools.partial(facing, 0.9), Look((0, 0, 0.5), (0, 0, 1.0), 1.0), 10 * (1 - 0.9**40),
         "geometric series", depth=40, slope=Slope("light.radiance", 1.0, 10 * (1 - 0.9**40))),
    Case("facing mirrors that keep all", functools.partial(facing, 1.0), Look((0, 0, 0.5), (0, 0, 1.0), 1.0), 40.0,
         "geometric series", depth=40),
    Case("a thousand materials", thousand, Look([(2.0 * k, 0, 1) for k in range(0, 1000, 16)], (0, 0, -1.0), 1.0),
         np.mean([(k + 1) / 1000 for k in range(0, 1000, 16)]), "furnace", backends=("bvh",),
         slope=Slope("m0.reflectance", 1.0, 1 / 63)),
    Case("normals that turn away, seen aslant", functools.partial(smooth_ball, 1, 0.3), beside(), 0.0, "energy", most=1.0,
         depth=5, slope=Slope("paint.reflectance", 1.0), quick=True),
]  # fmt: skip

__all__ = ["BLACK", "CASES"]
