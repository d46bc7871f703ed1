"""The scenes in scenes/: they load, give sensible pictures, and the same ones as Mitsuba 3."""

import functools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import assert_same_picture

import jaxrt

FOLDER = Path(__file__).parent.parent / "scenes"
SCENES = sorted(path.name for path in FOLDER.glob("*.xml"))
SIZE = 24  # pixels to a side: one size, so that tests share compiled programs


@functools.cache
def scene(name, **defaults):
    return jaxrt.load(FOLDER / name, res=SIZE, **defaults)


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
