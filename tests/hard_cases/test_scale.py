"""Scale and place do not matter: a scene of any size, anywhere, gives the same picture."""

import numpy as np
import pytest
import trimesh
from helpers import icosphere

import jaxrt

pytestmark = pytest.mark.usefixtures("short_loops")

SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="5"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/>
  <float name="near_clip" value="{near}"/><float name="far_clip" value="{far}"/>
  <transform name="to_world"><lookat origin="{eye}" target="{aim}" up="0, 0, 1"/></transform>
  <film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="16"/><rfilter type="box"/></film>
</sensor>
<bsdf type="twosided" id="paint"><bsdf type="diffuse"><rgb name="reflectance" value=".7, .5, .3"/></bsdf></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="2"/>{to}</transform><ref id="paint"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value=".4"/><rotate x="1" angle="180"/>
  <translate z="2.5" x=".2"/>{to}</transform><emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>
<shape type="sphere"><transform name="to_world"><scale value=".5"/><translate x="-.8" z=".5"/>{to}</transform>
  <bsdf type="dielectric"/></shape>
<shape type="cylinder"><transform name="to_world"><scale value=".3"/><translate x=".2" y=".5"/>{to}</transform>
  <ref id="paint"/></shape>
<shape type="ply"><string name="filename" value="ball.ply"/><transform name="to_world"><scale value=".4"/>
  <translate x=".9" z=".4" y="-.3"/>{to}</transform><ref id="paint"/></shape>
<emitter type="point"><point name="position" value="{at}"/><rgb name="intensity" value="{power}"/></emitter>
</scene>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scale")
    v, f = icosphere(1)
    trimesh.Trimesh(v, f, process=False).export(folder / "ball.ply")
    return folder


def drawn(folder, scale, move):
    to = f'<scale value="{scale}"/><translate x="{move}" y="{-2 * move}" z="{move}"/>'
    place = lambda *p: ", ".join(repr(v * scale + move * m) for v, m in zip(p, (1, -2, 1), strict=True))
    places = {"at": place(-1.0, -1.5, 2.0), "eye": place(0.3, -4.0, 1.2), "aim": place(0.0, 0.0, 0.7)}
    (folder / "scene.xml").write_text(
        SCENE.format(to=to, power=3 * scale**2, near=1e-2 * scale, far=1e2 * scale, **places)
    )
    scene = jaxrt.load(folder / "scene.xml")
    return scene, jaxrt.render(scene, 32, seed=1, method="path")


@pytest.fixture(scope="module")
def original(folder):
    return drawn(folder, 1.0, 0.0)[1]


@pytest.mark.parametrize("scale, move", [(1e-3, 0.0), (1e4, 0.0), (1.0, 1e4), (1e4, 1e4), (1.0, 1e7), (1e-3, 1e4)])
def test_pictures_are_the_same(folder, original, scale, move):
    scene, sol = drawn(folder, scale, move)
    off = np.abs(sol.image - original.image)
    z = off / np.maximum(np.hypot(sol.stderr, original.stderr), 1e-4 * original.image + 1e-6)
    assert (z < 4.5).all()
    assert (off <= 1e-4 * original.image).mean() > 0.9  # the same paths, but for those that glass sends elsewhere
    assert abs(sol.image.mean() / original.image.mean() - 1) < 2e-3
    far = np.array([1.0, -2.0, 1.0]) * move
    assert np.abs(scene.origin - far).max() <= 8 * scale
    # What is counted from the origin is small, whatever the place.
    small = [np.abs(np.asarray(v)[:3, 3]).max() for k, v in jaxrt.params(scene).items() if k.endswith("to_world")]
    assert max(small) <= 16 * scale + np.abs(far - scene.origin).max()


def test_where_it_is_counted_from_is_said(folder, capsys):
    drawn(folder, 1.0, 1e4)
    assert "all is counted from (10000, -20000, 10000)" in capsys.readouterr().err
    drawn(folder, 1.0, 3.0)
    assert not capsys.readouterr().err


def test_vertices_that_float32_cannot_hold_are_named(folder, capsys):
    v, f = icosphere(1)
    trimesh.Trimesh(1e-3 * v + 1e4, f, process=False).export(folder / "far.ply")
    jaxrt.load(folder / "far.ply")
    said = [line for line in capsys.readouterr().err.splitlines() if "float32" in line]
    assert len(said) == 1 and "known to 0.001" in said[0] and "to_world" in said[0]
    trimesh.Trimesh(1e3 * v + 1e4, f, process=False).export(folder / "large.ply")
    jaxrt.load(folder / "large.ply")
    assert "float32" not in capsys.readouterr().err
