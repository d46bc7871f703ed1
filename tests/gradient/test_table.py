"""README's table of derivatives, told by the code: run as a script, this writes it.

Programs are traced, not compiled: what is refused raises, and boundary terms are asked for where they are.
"""

import contextlib
import functools
import re
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from helpers import ball_of_distances, camera, frame, icosphere, look_at, moved

import jaxrt
from jaxrt.files import sky
from jaxrt.solver import field as field_of
from jaxrt.solver import measure

README = Path(__file__).parents[2] / "README.md"
BEGIN, END = "<!-- derivatives: written by tests/gradient/test_table.py -->", "<!-- end of derivatives -->"

DOWN = frame((0, 0, -1), (1, 0, 0))
POSE = look_at((0.0, -4.0, 3.0), (0, 0, 0))
EYE = camera((0.0, -4.0, 3.0), (0, 0, 0), id="eye")
LAMP = jaxrt.Rectangle(id="lamp", to_world=moved(0.5, (0, 0, 3), DOWN), emission=5.0, bsdf=jaxrt.Diffuse(0.0))


def room(*more, floor=None, sensors=(EYE,), lamp=LAMP, **parts):
    """A floor under a lamp, and more."""
    floor = jaxrt.Rectangle(id="floor", to_world=moved(2.0), bsdf=floor or jaxrt.Diffuse(0.5, id="paint"))
    return jaxrt.Scene.build([floor, lamp, *more], sensors=list(sensors), **parts)


def plain():
    """All that has a derivative."""
    v, f = icosphere(0)
    lens = jaxrt.Sensor(
        "thinlens", POSE, film=jaxrt.Film(8, 8, "box"), aperture_radius=0.1, focus_distance=4.0, id="lens"
    )
    metal = jaxrt.Conductor(0.3, 0.2, 3.9, id="metal")
    block = jaxrt.Mesh(id="block", vertices=v * 0.3, faces=f, to_world=moved(1.0, (1, 0, 0.5)), bsdf=metal)
    ball = jaxrt.Sphere(id="ball", center=(-1, 0, 0.5), radius=0.4, bsdf=jaxrt.Diffuse(0.5, id="red"))
    sky = jaxrt.Enclosure(jaxrt.Bitmap(np.ones((2, 4))), id="sky")
    wood = jaxrt.Diffuse(jaxrt.Bitmap(np.full((2, 2), 0.5)), id="wood")
    return room(block, ball, floor=wood, sensors=[EYE, lens], enclosure=sky)


def on(bsdf):
    """A ball of some material."""
    return lambda: room(jaxrt.Sphere(id="ball", center=(0, 0, 1), radius=0.5, bsdf=bsdf))


def instance():
    group = jaxrt.Group(shapes=[jaxrt.Cube()])
    return room(jaxrt.Instance(group=group, to_world=moved(0.3), id="copy"))


def smooth():
    v, f = icosphere(0)
    return room(jaxrt.Mesh(id="block", vertices=v * 0.3, faces=f, normals=v))


def smooth_lamp():
    v, f = icosphere(0)
    return room(lamp=jaxrt.Mesh(id="lamp", vertices=v + [0, 0, 3], faces=f, normals=v, emission=1.0))


def of_kind(kind, **more):
    sensor = jaxrt.Sensor(kind, POSE, film=jaxrt.Film(8, 8, "box"), id="eye", **more)
    ball = jaxrt.Sphere(id="ball", center=(0, 0, 1), radius=0.5)
    return lambda: room(ball, sensors=[sensor])


GRID = jaxrt.SdfGrid(grid=ball_of_distances(4), id="grid")
BOARD = jaxrt.Diffuse(jaxrt.Checkerboard(0.2, 0.8), id="board")
MOVES = ["floor.to_world"]


def bulb():
    return room(lamps=[jaxrt.Point((0, 0, 2), id="bulb")])


def open_air():
    light = jaxrt.parts.Sky(sky.coefficients(3.0, np.full(3, 0.3), 0.5), (0, 1, 1))
    return room(lamps=[jaxrt.Sun((0, 0, -1), id="sun")], enclosure=jaxrt.Enclosure(light))


ROWS = [  # what, a scene, parameters of it (one of each table), and how it is measured
    ("reflectance, roughness, index of refraction", plain, ["metal.alpha"], {}),
    ("texels, and where they lie", plain, ["wood.reflectance.data", "wood.reflectance.to_uv"], {}),
    ("radiance of area lights and enclosures, their pictures", plain, ["lamp.emitter.radiance", "sky.radiance.data"], {}),
    ("the turn of an enclosure", plain, ["sky.to_world"], {}),
    ("values that a plan takes for granted", room, ["enclosure.radiance"], {"free": "paint.*"}),
    ("intensity of lamps without extent", bulb, ["bulb.intensity"], {}),
    ("radiance of the sun", open_air, ["sun.radiance"], {}),
    ("vertices, `to_world` of shapes", plain, ["block.vertices", "floor.to_world"], {}),
    ("centres and radii", plain, ["ball.center", "ball.radius"], {}),
    ("pose, field of view and lens of a camera", plain, ["eye.to_world", "eye.fov", "lens.to_world", "lens.focus_distance"], {}),
    ("the same of the second order", room, [*MOVES, "eye.to_world"], {"twice": True}),
    ("whatever moves, with lamps without extent", bulb, [*MOVES, "eye.to_world", "bulb.position"], {}),
    ("with a sun or a sky", open_air, [*MOVES, "eye.to_world"], {}),
    ("with instances", instance, [*MOVES, "copy.to_world"], {}),
    ("with grids of distances", lambda: room(GRID), [*MOVES, "grid.grid"], {}),
    ("with glass or curved mirrors", on(jaxrt.Dielectric()), [*MOVES, "ball.center"], {}),
    ("with textures that jump", lambda: room(floor=BOARD), [*MOVES, "board.reflectance.to_uv"], {}),
    ("with vertex normals, and by these", smooth, [*MOVES, "eye.to_world", "block.vertices", "block.normals"], {}),
    ("with lamps with vertex normals", smooth_lamp, [*MOVES, "lamp.vertices"], {}),
    ("with `hide_emitters`", lambda: room(integrator=jaxrt.Integrator(hide_emitters=True)), MOVES, {}),
    ("seen by orthographic cameras, with curved shapes", of_kind("orthographic"), [*MOVES, "eye.to_world"], {}),
    ("without a limit of depth", room, ["paint.reflectance"], {"max_depth": -1}),
]  # fmt: skip


@functools.cache
def made(build):
    scene = build()
    return scene, jaxrt.plan(scene)


@contextlib.contextmanager
def probing():
    """Answers whether boundary terms were asked for. They, caches of programs, and the light itself stand aside."""
    asked = []

    def dark(channels, lanes):
        return jnp.zeros((lanes, channels))

    def surfaces(world, edges, begin, motion, steps, depths, seed, row, spp):
        asked.append("surfaces")
        return dark(world.plan.channels, len(row))

    def picture(world, edges, view, motion, steps, depths, seed, n, samples):
        asked.append("picture")
        return dark(world.plan.channels, n)

    def paths(world, begin, steps, depths, seed, row, spp, field, moving):
        return dark(world.plan.channels, len(row))

    found = lambda *args: SimpleNamespace(stored=jnp.zeros(()), max_depth=args[-2])
    with (
        mock.patch.object(measure, "_pixels", measure._pixels.__wrapped__),
        mock.patch.object(measure.path, "trace_fixed", paths),
        mock.patch.object(measure.visibility, "surfaces", surfaces),
        mock.patch.object(measure.silhouettes, "picture", picture),
        mock.patch.object(field_of, "links_of", return_value=(None, None)),
        mock.patch.object(field_of, "_found", found),
    ):
        yield lambda: bool(asked)


def reason(error):
    """Why a derivative is refused, in a few words."""
    words = {
        "relies on it": "free them",
        "finite number": "give `max_depth`",
        "second": "boundary terms are of first order",
    }
    known = re.search(r"do not know (.*?)(;| \(|, or give)", error)
    return known[1] if known else next(why for word, why in words.items() if word in error)


def cell(build, name, field, max_depth=2, twice=False, free=()):
    """What becomes of a derivative by one parameter."""
    scene, plan = made(build)
    sensor = int(name.startswith("lens."))
    plan = plan if free == () else jaxrt.plan(scene, free=free)

    def picture(value):
        here, radiance = jaxrt.with_params(scene, {name: value}), None
        if field:
            radiance = jaxrt.solve(here, plan=plan, elements=(), max_depth=max_depth)
        return jaxrt.measure(here, 0, plan=plan, spp=1, max_depth=max_depth, sensor=sensor, radiance=radiance)

    along = lambda f: lambda v: jax.jvp(f, (v,), (jnp.ones_like(v),))[1]
    slope = along(along(picture)) if twice else along(picture)
    with probing() as terms:
        try:
            jax.eval_shape(slope, jaxrt.params(scene)[name])
        except ValueError as e:
            return "refused: " + reason(str(e))
        return "with boundary terms" if terms() else "exact"


def table():
    lines = ["| derivatives by | paths | field |", "|---|---|---|"]
    for what, build, names, how in ROWS:
        cells = []
        for field in (False, True):
            found = {cell(build, name, field, **how) for name in names}
            assert len(found) == 1, (what, found)
            cells.append(found.pop())
        lines.append(f"| {what} | {cells[0]} | {cells[1]} |")
    return "\n".join(lines)


def split():
    """README before the table, the table, and after it."""
    before, rest = README.read_text().split(BEGIN + "\n")
    held, after = rest.split("\n" + END)
    return before, held, after


def test_the_table_is_what_the_code_does():
    assert split()[1] == table()


if __name__ == "__main__":
    before, _, after = split()
    README.write_text(before + BEGIN + "\n" + table() + "\n" + END + after)
