"""What pixels see first: closed forms of a sphere and a plane, files, and names that are not known."""

import numpy as np
import pytest
from helpers import camera, moved

import jaxrt
from jaxrt import cli
from jaxrt.files.image import AOVS, read_exr

pytestmark = pytest.mark.usefixtures("short_loops")

SIZE, HEIGHT = 8, 5.0


def scene(kind="orthographic"):
    """A ball of radius .5 on the left of a wall of another colour in the lower half of [−1, 1]², seen from above."""
    wall = moved(1.0, (0, -1, 0)) @ np.diag([2.0, 1.0, 1.0, 1.0])
    shapes = [
        jaxrt.Rectangle(id="wall", to_world=wall, bsdf=jaxrt.Diffuse([0.2, 0.4, 0.6])),
        jaxrt.Sphere(id="ball", center=(-0.5, 0.5, 0), radius=0.5, bsdf=jaxrt.Plastic([0.9, 0.1, 0.3])),
    ]
    view = camera((0, 0, HEIGHT), (0, 0, 0), SIZE, SIZE, 2 * np.degrees(np.arctan(1 / HEIGHT)), (0, 1, 0), kind=kind)
    return jaxrt.Scene.build(shapes, sensors=[view], enclosure=jaxrt.Enclosure(1.0))


@pytest.fixture(scope="module")
def solution():
    return jaxrt.render(scene(), 64, aov=tuple(AOVS))


def test_a_plane_and_a_miss(solution):
    found, low, miss = solution.aovs, np.s_[SIZE // 2 :], np.s_[: SIZE // 2, SIZE // 2 :]
    assert {name: a.shape[2:] for name, a in found.items()} == {
        name: (len(AOVS[name]),) if AOVS[name] else () for name in AOVS
    }
    np.testing.assert_allclose(found["depth"][low], HEIGHT - 0.01, rtol=1e-5)  # from the near plane
    np.testing.assert_allclose(found["normal"][low], np.broadcast_to([0, 0, 1], (4, SIZE, 3)), atol=1e-6)
    np.testing.assert_allclose(found["albedo"][low], np.broadcast_to([0.2, 0.4, 0.6], (4, SIZE, 3)), rtol=1e-5)
    middle = (np.arange(SIZE) + 0.5) / (SIZE / 2) - 1
    x, y = np.broadcast_arrays(middle[None, :], -middle[SIZE // 2 :, None])
    np.testing.assert_allclose(found["position"][low], np.stack([x, y, 0 * x], -1), atol=0.02)
    np.testing.assert_allclose(found["uv"][low], np.stack([(x + 2) / 4, (y + 2) / 2], -1), atol=0.02)
    assert (found["face"][low] == 0).all() and (found["face"][miss] == -1).all()
    assert all(not found[name][miss].any() for name in AOVS if name != "face")


def test_a_sphere(solution):
    """Sampled normals and depths are those of their mean position on the ball, as far as a pixel is flat."""
    found = {name: a[1:3, 1:3] for name, a in solution.aovs.items()}  # wholly on the ball
    out = (found["position"] - [-0.5, 0.5, 0.0]) / 0.5
    np.testing.assert_allclose(found["normal"], out, atol=1e-5)
    np.testing.assert_allclose(found["depth"] + found["position"][..., 2], HEIGHT - 0.01, rtol=1e-5)
    np.testing.assert_allclose(found["albedo"], np.broadcast_to([0.9, 0.1, 0.3], (2, 2, 3)), rtol=1e-5)
    edge = np.linspace(-0.25, 0.25, 3)  # of the four pixels around the axis
    fine = (np.linspace(edge[0], edge[1], 200)[:-1, None] + 0.5 / 800) ** 2
    z = np.sqrt(0.25 - fine - fine.T).mean()
    np.testing.assert_allclose(found["position"][..., 2], z, atol=3e-3)


def test_depth_is_along_the_ray():
    far = jaxrt.render(scene("perspective"), 16, aov=("depth", "position")).aovs
    position = far["position"][-1, -1]
    assert far["depth"][-1, -1] == pytest.approx(np.linalg.norm(position - [0, 0, HEIGHT]) - 0.01, abs=2e-3)


def test_the_picture_is_the_same_and_files_hold_all(solution, tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")
    plain = jaxrt.render(scene(), 64)
    np.testing.assert_array_equal(plain.image, solution.image)
    assert plain.aovs == {}
    solution.save(tmp_path / "a.exr")
    image, stderr, _ = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(image, solution.image)
    assert stderr is not None
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = {name: c.pixels for name, c in file.channels().items()}
    for name, suffixes in AOVS.items():
        planes = solution.aovs[name].reshape(SIZE, SIZE, -1)
        for k, c in enumerate([f".{c}" for c in suffixes] or [""]):
            np.testing.assert_array_equal(channels[name + c], planes[..., k].astype(np.float32))


def test_meters_of_irradiance_see_none():
    plate = jaxrt.Disk()
    sensor = jaxrt.Sensor("irradiancemeter", target=plate, film=jaxrt.Film(1, 1, "box"))
    with pytest.raises(jaxrt.SceneError, match="sees no first surface"):
        jaxrt.render(jaxrt.Scene.build([plate], sensors=[sensor]), 1, aov=("depth",))


def test_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAXRT_CACHE", "off")
    file, out = tmp_path / "s.xml", tmp_path / "o.exr"
    file.write_text('<scene version="3.0.0"><shape type="sphere"/><sensor type="perspective"/></scene>')
    run = ["render", str(file), "--size", "4x4", "--spp", "1", "-o", str(out), "--aov"]
    assert cli.main([*run, "depth,colour"]) == 2
    assert "aov: 'colour' is not known; there are depth, normal, geo_normal" in capsys.readouterr().err
    assert not out.exists()
    assert cli.main([*run, "depth,normal"]) == 0
    assert read_exr(out)[0].shape == (4, 4, 3)


def test_what_a_scene_file_asks(tmp_path):
    """AOVs under its names, as Mitsuba has them, and a picture of luminance alone."""
    OpenEXR = pytest.importorskip("OpenEXR")
    file = tmp_path / "s.xml"
    aovs = '<string name="aovs" value="d.y:depth,n:sh_normal"/><integrator type="path"/>'
    film = '<film type="hdrfilm"><rfilter type="box"/>{}<integer name="width" value="4"/><integer name="height" value="4"/></film>'
    body = '<shape type="sphere"><transform name="to_world"><translate z="5"/></transform></shape>'
    body += '<emitter type="constant"><rgb name="radiance" value="1,2,4"/></emitter>'
    text = f'<scene version="3.0.0"><integrator type="aov">{aovs}</integrator>{body}<sensor type="perspective">{film}</sensor></scene>'
    file.write_text(text.format(""))
    colours = jaxrt.render(jaxrt.load(file), 4, method="path")
    file.write_text(text.format('<string name="pixel_format" value="luminance"/>'))
    scene = jaxrt.load(file)
    grey = jaxrt.render(scene, 4, method="path")
    assert grey.image.shape == grey.stderr.shape == (4, 4, 1)
    weights = [0.212671, 0.71516, 0.072169]
    np.testing.assert_allclose(grey.image[..., 0], colours.image @ weights, rtol=1e-5)
    assert jaxrt.measure(scene, 0, spp=1).shape == (4, 4, 1)
    assert set(grey.aovs) == {"d.y:depth", "n:normal"} and jaxrt.render(scene, 4, aov=()).aovs == {}
    grey.save(tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as found:
        assert {"R", "stderr.G", "d.y.T", "n.X", "n.Y", "n.Z"} <= found.channels().keys()


def test_albedo_and_coordinates_of_textures(short_loops):
    """Of a picture on a square, and of a mixture with white by a quarter."""
    data = np.random.default_rng(0).uniform(0.2, 0.8, (2, 2, 3))
    bsdf = jaxrt.Blend(jaxrt.Diffuse(jaxrt.Bitmap(data, filter="nearest")), jaxrt.Diffuse(1.0), weight=0.25)
    view = camera((0, 0, 9), (0, 0, 0), 2, 2, fov=10.0, up=(0, 1, 0))
    scene = jaxrt.Scene.build([jaxrt.Rectangle(bsdf=bsdf)], sensors=[view], enclosure=jaxrt.Enclosure(1.0), channels=3)
    found = jaxrt.render(scene, 16, method="path", aov=("albedo", "uv")).aovs
    u, v = found["uv"][..., 0], found["uv"][..., 1]
    texel = data[(v > 0.5).astype(int), (u > 0.5).astype(int)]
    np.testing.assert_allclose(found["albedo"], 0.75 * texel + 0.25, atol=0.08)
    assert np.ptp(u) > 0.3
    assert np.ptp(v) > 0.3
