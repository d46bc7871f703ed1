"""The scenes in scenes/: they load, give sensible pictures, and the same ones as Mitsuba 3."""

import functools
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import assert_same_picture
from test_catalogue import SCENE, two

import jaxrt
from jaxrt.files import image

FOLDER = Path(__file__).parent.parent / "scenes"
SCENES = sorted(path.name for path in FOLDER.glob("*.xml"))
SIZE = 24  # pixels to a side: one size, so that tests share compiled programs


@functools.cache
def scene(name, **defaults):
    return jaxrt.load(FOLDER / name, res=SIZE, **defaults)


def module(path):
    """A script of the repository, as a module."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, FOLDER.parent / path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def test_there_are_scenes():
    assert len(SCENES) >= 6


def test_files_stay_small():
    assert all(path.stat().st_size < 1_000_000 for path in FOLDER.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", SCENES)
def test_loads_in_silence_with_its_three_defaults(name, capsys):
    loaded = jaxrt.load(FOLDER / name, res=SIZE, spp=3, max_depth=2)
    assert loaded.structure.sensors[0].film[:2] == (SIZE, SIZE)
    assert (loaded.structure.asked().spp, loaded.structure.asked().max_depth) == (3, 2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", SCENES)
def test_renders_a_sensible_picture(name):
    sol = jaxrt.render(scene(name), spp=4)
    assert sol.image.shape == (SIZE, SIZE, 3)
    assert np.isfinite(sol.image).all() and (sol.image >= 0).all()
    # neither dark nor burnt out: the sRGB picture has a middling brightness
    shown = np.clip(sol.image, 0, 1) ** (1 / 2.2)
    assert 0.1 < shown.mean() < 0.8


@pytest.mark.parametrize("rho, depth", [(0.5, 16), (0.9, 40)])
def test_the_furnace_hides_what_is_in_it(rho, depth):
    sol = jaxrt.render(scene("furnace.xml", rho=rho, le=0.25), spp=64, max_depth=depth)
    exact = 0.25 * (1 - rho**depth) / (1 - rho)
    # light samples make noise, but each pixel has to agree within it, and all together much better
    assert sol.image.mean() == pytest.approx(exact, rel=5e-3 if rho > 0.5 else 1e-3)
    assert (np.abs(sol.image - exact) < 4.5 * sol.stderr + 1e-5 * exact).mean() > 0.9975


def test_meshes_are_what_the_script_makes(tmp_path):
    script = (FOLDER / "make.py").read_text()
    (tmp_path / "make.py").write_text(script)
    subprocess.run([sys.executable, "-W", "ignore", str(tmp_path / "make.py")], check=True)
    made = sorted((tmp_path / "meshes").iterdir())
    assert [path.name for path in made] == sorted(path.name for path in (FOLDER / "meshes").iterdir())
    for path in made:
        ours, theirs = (
            np.array(p.read_text().split("end_header")[1].split(), float) for p in (path, FOLDER / "meshes" / path.name)
        )
        np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.peer
@pytest.mark.parametrize("name", SCENES)
def test_mitsuba_renders_the_same_picture(name):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    peer = mi.load_file(str(FOLDER / name), res=SIZE)
    runs = np.stack([np.array(mi.render(peer, spp=64, seed=k), np.float64)[..., :3] for k in range(16)])
    assert_same_picture(runs, [jaxrt.render(scene(name), spp=256, seed=k) for k in range(4)], most=0.015)


@pytest.mark.slow
@pytest.mark.peer
def test_a_baked_sky_is_the_sky_that_mitsuba_has(tmp_path, short_loops):
    """The sky in a picture, and the sun by what it sends onto a floor; float32 knows the sun's rim to half a percent."""
    pytest.importorskip("mitsuba")
    mi, variant = module("experiments/peer.py").load_mitsuba()
    if variant != "llvm_ad_rgb":
        pytest.skip("LLVM is not here")
    bake, matt = module("scenes/bake_sky.py"), '<bsdf type="diffuse"/>'
    sky = """<emitter type="sunsky"><vector name="sun_direction" x="-.5" y="-.3" z=".6"/>
    <float name="turbidity" value="4"/><float name="{}_scale" value="0"/></emitter>"""
    envmap = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    for name, emitter in (("sky", sky.format("sun")), ("baked", envmap), ("sun", sky.format("sky"))):
        text = SCENE.format(depth=3, emitter=emitter, shape=two(matt, matt))
        (tmp_path / f"{name}.xml").write_text(re.sub('<emitter type="area">.*?</emitter>', "", text))
    image.write_exr(tmp_path / "sky.exr", bake.bake(tmp_path / "sky.xml", 512))
    sun, (height, width) = bake.bake(tmp_path / "sun.xml", 1024).astype(float), (512, 1024)
    d = bake.directions(np.arange(height * width), width, 1).reshape(height, width, 3)
    area = np.hypot(d[..., 0], d[..., 2]) * np.pi / (height - 1) * 2 * np.pi / width
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}
    parts = {"type": "scene", "floor": floor, "sun": mi.load_file(str(tmp_path / "sun.xml")).environment()}
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    above = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    parts |= {"sensor": {"type": "orthographic", "to_world": above, "film": film}, "method": {"type": "direct"}}
    seen = np.array(mi.render(mi.load_dict(parts), spp=1 << 14)).mean((0, 1))
    np.testing.assert_allclose(
        (sun * (area * np.maximum(d[..., 2], 0))[..., None]).sum((0, 1)), np.pi * seen, rtol=5e-3
    )
    peer = mi.load_file(str(tmp_path / "sky.xml"))
    runs = np.stack([np.array(mi.render(peer, spp=256, seed=k), np.float64)[..., :3] for k in range(16)])
    mi.set_variant("scalar_rgb")
    baked = jaxrt.load(tmp_path / "baked.xml")
    assert_same_picture(runs, [jaxrt.render(baked, 256, seed=k, method="path") for k in range(4)], most=0.01)
