"""Plates under lamps: form factors, shadows, and lamps and plates of extreme size, place and brightness."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from cases import Case, Look, Slope, corners, plate, point, polygon, square

import jaxrt

X, Y = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
BLACK = jaxrt.Diffuse(0.0, id="black")
PI = np.pi


def under(lamp: Any, floor: Any, radiance: float = 1.0, albedo: float = 0.5, others: Any = ()) -> jaxrt.Scene:
    """A lamp and a floor, each (centre, half side, half side); fronts by their order."""
    shapes = [
        plate(*floor, id="floor", bsdf=jaxrt.Diffuse(albedo, id="paint")),
        plate(*lamp, id="lamp", bsdf=BLACK, emission=radiance, emission_id="light"),
        *others,
    ]
    return jaxrt.Scene.build(shapes)


def factor(name: str, lamp: Any, floor: Any, want: float, **more: Any) -> Case:
    """The mean of what a floor of albedo .5 reflects is .5 F."""
    scene = functools.partial(under, lamp, floor)
    slope = Slope("light.radiance", 1.0, 0.5 * want)
    options: dict[str, Any] = {"field": 5e-3, "slope": slope} | more
    look = square(*floor, height=min(1e-3, 0.5 * lamp[0][2]))
    return Case(f"form factor: {name}", scene, look, 0.5 * want, "form factors, Howell", **options)


def spot(name: str, lamp: Any, source: str = "Lambert 1760", radiance: float = 1.0, **more: Any) -> Case:
    """A point of a floor, of albedo .5, under a lamp."""
    floor = ((0, 0, 0), 2 * X, 2 * Y)
    want = 0.5 / PI * radiance * polygon(corners(*lamp))
    options: dict[str, Any] = {"slope": Slope("light.radiance", 1.0, want / radiance), "rtol": 1e-3} | more
    return Case(name, functools.partial(under, lamp, floor, radiance), point(), want, source, **options)


def above(h: float, s: float, x: float = 0.0, y: float = 0.0) -> Any:
    """A square lamp of half side s at height h, facing down."""
    return (x, y, h), s * Y, s * X


def unit(s: float) -> Any:
    return (0, 0, 0), s * X, s * Y


def half_plane(e: float) -> jaxrt.Scene:
    """x < e is covered at height 1; the lamp is the unit square at height 2."""
    cover = plate((e - 500.0, 0, 1), 500.0 * X, 500.0 * Y, id="cover", bsdf=BLACK)
    return under(above(2.0, 0.5), unit(0.5), others=[cover])


def _shift(axis: int) -> np.ndarray:
    m = np.zeros((4, 4))
    m[axis, 3] = 1.0
    return m


def _shadow(e: float, name: str, want: float, parameter: str, axis: int, slope: float, **more: Any) -> Case:
    """E at the origin under a half plane, by its edge or by the receiver's height; rays follow the receiver."""
    moved = Slope(parameter, _shift(axis), 0.5 / PI * slope, rtol=2e-3, noise=0.01)
    scene = functools.partial(half_plane, e)
    options: dict[str, Any] = {"spp": 4096, "rtol": 5e-4} | more
    return Case(name, scene, point(), 0.5 / PI * want, "half-plane shadow", slope=moved, **options)


def covered(gap: float) -> jaxrt.Scene:
    """A sheet so high above the floor, below a lamp."""
    sheet = plate((0, 0, gap), X, Y, id="sheet", bsdf=jaxrt.TwoSided(BLACK))
    return under(above(1.0, 0.5), unit(1.0), others=[sheet])


def twice(flipped: bool) -> jaxrt.Scene:
    """A floor that is there twice, the second time the same way round or the other."""
    again = plate((0, 0, 0), 2 * (Y if flipped else X), 2 * (X if flipped else Y), id="again")
    floor = plate((0, 0, 0), 2 * X, 2 * Y, id="floor")
    lamp = plate(*above(1.0, 0.5), id="lamp", bsdf=BLACK, emission=1.0, emission_id="light")
    paint = jaxrt.TwoSided(jaxrt.Diffuse(0.5, id="paint"))
    floor.bsdf = again.bsdf = paint
    return jaxrt.Scene.build([floor, lamp, again])


def one_triangle() -> jaxrt.Scene:
    v = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]])
    mesh = jaxrt.Mesh(vertices=v, faces=np.array([[0, 1, 2]]), id="only", bsdf=BLACK, emission=3.0, emission_id="light")
    return jaxrt.Scene.build([mesh])


_centred = polygon(corners(*above(1.0, 0.5)))
_DARK = Slope("light.radiance", 1.0, 0.5 / PI * _centred)
_FLOOR2 = ((0, 0, 0), 2 * X, 2 * Y)
_parallel = lambda s, gap: (above(gap, s), unit(s))
_upright = (0.0, 0.5, 0.5), 0.5 * X, np.array([0, 0, 0.5])  # faces −y
_coplanar = (2.0, 0, 0), 0.5 * X, 0.5 * Y
_grazing = (1.0, 0, 0.5e-6), 0.5 * Y, np.array([0, 0, 0.5e-6])


def _thin_factor(gap: float) -> float:
    """F of parallel unit squares (Howell C-11)."""
    x = 1.0 / gap
    s = np.sqrt(1 + x * x)
    return (
        2
        / (PI * x * x)
        * (0.5 * np.log((1 + x * x) ** 2 / (1 + 2 * x * x)) + 2 * x * s * np.arctan(x / s) - 2 * x * np.arctan(x))
    )


CASES = [
    factor("parallel unit squares, gap 1", *_parallel(0.5, 1.0), 0.199824896, quick=True),
    factor("perpendicular unit squares", _upright, unit(0.5), 0.200043776, rtol=2e-3, field=0.02),
    factor("parallel 2 x 2, gap 1", *_parallel(1.0, 1.0), 0.415253284),
    factor("parallel 10 x 10, gap 1", *_parallel(5.0, 1.0), 0.826994522, rtol=2e-3, field=0.02, noise=0.02),
    factor("a gap of 4e-5 below a lamp", *_parallel(0.5, 4e-5), _thin_factor(4e-5), field=None,
           rtol=1e-3, noise=0.02, slope=None, quick=True),
    spot("a point under the corner of a unit square", above(1.0, 0.5, 0.5, 0.5), quick=True),
    spot("a point under a centred 1 x 1", above(1.0, 0.5)),
    spot("a point under a centred 2 x 2", above(1.0, 1.0)),
    spot("a lamp of 1e-8 sr, small", above(1.0, 0.5e-4), quick=True),
    spot("a lamp of 1e-8 sr, far", above(1e4, 0.5), quick=True),
    spot("a lamp 1e12 brighter", above(1.0, 0.5), radiance=1e12, quick=True),
    spot("a lamp 1e12 dimmer", above(1.0, 0.5), radiance=1e-12, quick=True),
    spot("a small lamp 1e12 brighter", above(1.0, 0.5e-4), radiance=1e12),
    spot("a lamp 1e6 times as long as wide", ((0, 0, 1), 0.5e-6 * Y, 0.5 * X), quick=True),
    spot("a lamp of area 1e-12 to 1 above it", ((0, 0, 1), 0.5e-6 * Y, 0.5e-6 * X)),
    spot("grazing light, cosine 1e-6", (_grazing[0], _grazing[2], _grazing[1]), rtol=2e-3, quick=True),
    Case("light coplanar with its receiver", functools.partial(under, _coplanar, _FLOOR2), point((0.3, 0.2, 0)), 0.0,
         "nothing above the horizon", slope=Slope("light.radiance", 1.0), quick=True),
    Case("a point on a lamp's edge", functools.partial(under, (_upright[0] - 0.5 * Y, *_upright[1:]), unit(1.0)), point(),
         0.0, "at most ρ/2", most=0.2501, slope=Slope("light.radiance", 1.0), quick=True),
    Case("light coplanar with its receiver, moved", functools.partial(under, _coplanar, _FLOOR2), point((0.3, 0.2, 0)),
         0.0, "nothing above the horizon", slope=Slope("lamp.to_world", _shift(2))),
    Case("a sheet 4e-5 above the floor hides it", functools.partial(covered, 4e-5), square((0, 0, 0), 0.9 * X, 0.9 * Y, height=2e-5),
         0.0, "all covered", quick=True),
    Case("a sheet 4e-5 above the floor is lit", functools.partial(covered, 4e-5), point((0, 0, 4e-5)), 0.0, "it is black"),
    Case("a floor that is there twice", functools.partial(twice, False), point(), 0.5 / PI * _centred, "as once", rtol=1e-3, quick=True),
    Case("a floor that is there twice, inside out", functools.partial(twice, True), point(), 0.5 / PI * _centred, "as once",
         rtol=1e-3, slope=_DARK),
    Case("a lamp of no power", functools.partial(under, above(1.0, 0.5), _FLOOR2, 0.0), point(), 0.0, "dark",
         slope=_DARK, quick=True),
    Case("a black floor", functools.partial(under, above(1.0, 0.5), _FLOOR2, 1.0, 0.0), point(), 0.0, "black",
         slope=Slope("paint.reflectance", 1.0, _centred / PI), quick=True),
    Case("a floor of albedo 1", functools.partial(under, above(1.0, 0.5), _FLOOR2, 1.0, 1.0), point(), _centred / PI, "Lambert 1760",
         rtol=1e-3, slope=Slope("paint.reflectance", 1.0, _centred / PI), quick=True),
    Case("an eye on a surface", functools.partial(under, above(1.0, 0.5), _FLOOR2), Look((0, 0, 0), (0, 0, 1), 1.0), 1.0,
         "it sees the lamp", slope=Slope("light.radiance", 1.0, 1.0), quick=True,
         fails="a ray that begins on a surface meets it: begin it off it by a millionth of the scene's size"),
    Case("an eye just off a surface", functools.partial(under, above(1.0, 0.5), _FLOOR2), Look((0, 0, 1e-5), (0, 0, 1), 1.0),
         1.0, "it sees the lamp", slope=Slope("light.radiance", 1.0, 1.0), quick=True),
    _shadow(0.0, "the edge of a half plane above", 0.115418399, "cover.to_world", 0, -0.480272781),
    _shadow(0.1, "a half plane's edge aside", 0.067702329, "cover.to_world", 0, -0.470990941),
    _shadow(0.1, "a receiver that rises in a shadow", 0.067702329, "floor.to_world", 2, 0.037495484),
    Case("one triangle", one_triangle, Look((0, 0, 2), (0, 0, -1), 1.0), 3.0, "its radiance", depth=1,
         slope=Slope("light.radiance", 1.0, 1.0), backends=("bvh", "embree")),
]  # fmt: skip
