"""Lamps of all kinds: spheres near and far, lamps without extent, skies with a sun of one texel, and very many."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from cases import Case, Look, Slope, corners, plate, point, polygon
from cases_geometry import BLACK, PI, X, Y

import jaxrt

PAINT = jaxrt.Diffuse(0.5, id="paint")


def ball(theta: float, distance: float = 2.0, radius: float = 1.0, radiance: float = 1.0) -> jaxrt.Scene:
    """A sphere above a floor that is tilted by θ about the point below the sphere."""
    t = np.radians(theta)
    floor = plate((0, 0, 0), 3 * np.array([np.cos(t), 0, np.sin(t)]), 3 * Y, id="floor", bsdf=PAINT)
    lamp = jaxrt.Sphere(
        center=(0, 0, distance), radius=radius, id="lamp", bsdf=BLACK, emission=radiance, emission_id="light"
    )
    return jaxrt.Scene.build([floor, lamp])


def lit_by_ball(theta: float, irradiance: float, **more: Any) -> Case:
    t = np.radians(theta)
    n = np.array([-np.sin(t), 0, np.cos(t)])
    want = 0.5 / PI * irradiance
    options: dict[str, Any] = {"slope": Slope("light.radiance", 1.0, want), "rtol": 1e-3} | more
    return Case(
        f"sphere light, tilt {theta}°", functools.partial(ball, theta), point(normal=n), want, "oracle", **options
    )


def far_ball(name: str, distance: float, radius: float, **more: Any) -> Case:
    want = 0.5 * (radius / distance) ** 2
    scene = functools.partial(ball, 0.0, distance, radius)
    return Case(
        name,
        scene,
        point(height=1e-4),
        want,
        "E = π (R/d)²",
        rtol=1e-3,
        slope=Slope("light.radiance", 1.0, want),
        **more,
    )


def at_a_point(*lamps: Any, enclosure: Any = None) -> jaxrt.Scene:
    return jaxrt.Scene.build([plate((0, 0, 0), 2 * X, 2 * Y, id="floor", bsdf=PAINT)], lamps=lamps, enclosure=enclosure)


def both() -> jaxrt.Scene:
    """A point lamp on the very surface, where its light arrives along it, and a beam that grazes: of both nothing."""
    return at_a_point(jaxrt.Point((0.5, 0, 0), 1.0), jaxrt.Directional((1.0, 0, 0), 1.0))


WIDE, HIGH = 64, 32


def texel_sky(radiance: float = 1e6) -> jaxrt.Scene:
    """One texel shines, of a sky whose +y is up, onto a floor that faces +y, from half way up."""
    sky = np.zeros((HIGH, WIDE, 1))
    sky[HIGH // 4, WIDE // 4] = radiance
    floor = plate((0, 0, 0), 2 * np.array([0, 0, 1.0]), 2 * X, id="floor", bsdf=PAINT)
    return jaxrt.Scene.build([floor], enclosure=jaxrt.Enclosure(jaxrt.Bitmap(sky)))


def _texel_irradiance() -> float:
    """1e6 ∫ cosθ dσ of the texel's share, which falls to nothing at its neighbours'; first and last row are poles."""
    step = PI / (HIGH - 1)
    t = np.linspace(-1.0, 1.0, 4001)
    theta = (HIGH // 4 + t) * step
    return 1e6 * 2 * PI / WIDE * step * np.trapezoid((1 - np.abs(t)) * np.sin(theta) * np.cos(theta), t)


def many(count: int) -> jaxrt.Scene:
    """A square lamp at height 1 in so many triangles."""
    n = round(float(np.sqrt(count / 2)))
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1))
    v = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], 1)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    f = np.concatenate([np.stack([i, i + n + 1, i + 1], 1), np.stack([i + 1, i + n + 1, i + n + 2], 1)])
    lamp = jaxrt.Mesh(vertices=v, faces=f, id="lamp", bsdf=BLACK, emission=1.0, emission_id="light")
    return jaxrt.Scene.build([plate((0, 0, 0), 2 * X, 2 * Y, id="floor", bsdf=PAINT), lamp])


def unlike(ratio: float) -> jaxrt.Scene:
    """Two lamps side by side, one `ratio` times as bright as the other."""
    lamps = [
        plate((s * 0.5, 0, 1), 0.25 * Y, 0.25 * X, id=f"lamp{k}", bsdf=BLACK, emission=e, emission_id=f"light{k}")
        for k, (s, e) in enumerate([(-1, 1.0), (1, ratio)])
    ]
    return jaxrt.Scene.build([plate((0, 0, 0), 2 * X, 2 * Y, id="floor", bsdf=PAINT), *lamps])


def nothing_beside() -> jaxrt.Scene:
    """A lamp, and one whose faces have no area."""
    none = jaxrt.Mesh(vertices=np.array([[0, 0, 0.5], [0.1, 0, 0.5], [0.2, 0, 0.5]]), faces=np.array([[0, 1, 2]]),
                      id="none", bsdf=BLACK, emission=1e6, emission_id="line")  # fmt: skip
    lamp = plate((0, 0, 1), 0.5 * Y, 0.5 * X, id="lamp", bsdf=BLACK, emission=1.0, emission_id="light")
    return jaxrt.Scene.build([plate((0, 0, 0), 2 * X, 2 * Y, id="floor", bsdf=PAINT), lamp, none])


def sun(angle: float) -> jaxrt.Scene:
    return at_a_point(jaxrt.Sun(direction=(0, 0, -1.0), radiance=1.0, angle=angle, id="sun"))


_SQUARE = 0.5 / PI * polygon(corners((0, 0, 1), 0.5 * Y, 0.5 * X))
_QUARTER = 0.5 / PI * polygon(corners((0.5, 0, 1), 0.25 * Y, 0.25 * X))

CASES = [
    lit_by_ball(0, 0.785398, quick=True),
    lit_by_ball(30, 0.680175),
    lit_by_ball(60, 0.392699),
    lit_by_ball(75, 0.221201, rtol=2e-3),
    lit_by_ball(90, 0.0905861, rtol=2e-3, noise=0.02),
    lit_by_ball(100, 0.0354490, rtol=2e-3, noise=0.02),
    lit_by_ball(115, 0.00124003, rtol=5e-3, noise=0.03, spp=4096),
    far_ball("a sphere light 1e4 away, 1e-8 sr", 1e4, 0.5641896, quick=True),
    far_ball("a sphere light 1e-3 above a floor", 1.001, 1.0, quick=True),
    far_ball("a sphere light of radius 1e-4", 1.0, 1e-4),
    far_ball("a sphere light of radius 1e-6, 10 away", 10.0, 1e-6),
    Case("a point lamp on a surface, and a beam along it", both, point(), 0.0, "cosine 0", most=1e-3, quick=True),
    Case("a point lamp above a surface", functools.partial(at_a_point, jaxrt.Point((0, 0, 1e-2), 1.0)), point(), 0.5 / PI * 1e4,
         "I cosθ/d²"),
    Case("a sun of .533°", functools.partial(sun, 0.533), point(), 0.5 / PI * 6.796666e-5, "π sin²", rtol=2e-4, quick=True),
    Case("a sky of one texel of 1e6", texel_sky, point(normal=(0, 1.0, 0)), 0.5 / PI * _texel_irradiance(), "its solid angle",
         rtol=2e-3, quick=True),
    Case("ten thousand lights", functools.partial(many, 10082), point(), _SQUARE, "Lambert 1760", rtol=1e-3, noise=0.02,
         spp=1024, slope=Slope("light.radiance", 1.0, _SQUARE), backends=("bvh",)),
    Case("two lamps, one 1e12 brighter", functools.partial(unlike, 1e12), point(), 1e12 * _QUARTER, "Lambert 1760",
         slope=Slope("light0.radiance", 1.0, _QUARTER, rtol=1e-2, noise=0.1), rtol=1e-3),
    Case("a lamp without area beside another", nothing_beside, point(), _SQUARE, "Lambert 1760", rtol=1e-3, slope=Slope("light.radiance", 1.0, _SQUARE)),
    Case("inside a lamp that shines outwards", functools.partial(ball, 0.0), Look((0, 0, 2), (0, 0, 1), 1.0), 0.0, "dark within", quick=True),
]  # fmt: skip
