"""Failure is a value: samples that are no numbers are counted and told of with their place, and stay in their pixel."""

import numpy as np
import pytest
from helpers import box_room, moved

import jaxrt
from jaxrt.cli import main
from jaxrt.solver.nonfinite import NonFiniteError

pytestmark = [pytest.mark.nans, pytest.mark.usefixtures("short_loops")]

BAD = (5, 3)
"""Row and column of the texel that is no number; the picture has one pixel for each texel."""


def scene(lamp=True, value=np.nan, leaf="reflectance"):
    """A floor of 8 x 8 texels, seen from above, each by one pixel."""
    data = np.full((8, 8, 1), 0.5)
    map_ = jaxrt.Bitmap(data, filter="nearest")
    more = {"emission": map_, "emission_id": "paint"} if leaf == "radiance" else {}
    paint = jaxrt.Diffuse(0.5 if more else map_, id="paint" if not more else "grey")
    shapes = [jaxrt.Rectangle(id="floor", bsdf=paint, **more)]
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    if lamp:
        shapes.append(jaxrt.Rectangle(id="lamp", to_world=moved(0.5, (0, 0, 4.0)) @ flip, emission=3.0))
    view = jaxrt.Sensor("orthographic", moved(1.0, (0, 0, 2.0)) @ flip, film=jaxrt.Film(8, 8, "box"))
    built = jaxrt.Scene.build(shapes, sensors=[view], enclosure=jaxrt.Enclosure(0.0 if lamp else 1.0))
    name = f"paint.{leaf}.data"
    texels = np.asarray(jaxrt.params(built)[name]).reshape(8, 8, -1).copy()
    texels[BAD[0], BAD[1]] = value
    return jaxrt.with_params(built, {name: texels.reshape(jaxrt.params(built)[name].shape)})


@pytest.mark.parametrize(
    "lamp, value, leaf, effect",
    [
        (True, np.nan, "reflectance", "reflection"),
        (False, np.nan, "reflectance", "reflection"),  # which roulette would end without a word
        (True, np.inf, "radiance", "emission"),
    ],
)
def test_it_is_told_where(lamp, value, leaf, effect):
    sol = jaxrt.render(scene(lamp, value, leaf), 16, max_depth=2, method="path")
    bad = ~np.isfinite(sol.image).all(-1)
    assert 1 <= bad.sum() <= 4 and sol.stats["nonfinite"] == bad.sum()  # a texture looks at four texels
    assert sol.stats["nonfinite_samples"] >= 16
    first = sol.stats["nonfinite_at"][0]
    assert first.pixel == tuple(np.argwhere(bad)[0]) and first.effect == effect
    assert first.edges[-1].shape == "floor" and f"on floor, face {first.face}" in str(first)
    assert (np.isfinite(sol.stderr).all(-1) == ~bad).all()  # its neighbours know theirs
    # Which is what they are without it.
    whole = jaxrt.render(scene(lamp, 0.5, leaf), 16, max_depth=2, method="path")
    np.testing.assert_allclose(sol.image[~bad], whole.image[~bad], rtol=1e-5)
    assert "nonfinite_at" not in whole.stats


def test_debug_stops_at_the_first():
    with pytest.raises(NonFiniteError) as found:
        jaxrt.render(scene(), 16, max_depth=2, method="path", debug=True)
    lines = str(found.value).splitlines()
    assert lines[0].startswith("a sample is not finite: pixel (") and "floor" in lines[1]
    assert "throughput" in lines[1] and len(lines) == 2


def test_a_tolerance_ends_as_well():
    sol = jaxrt.render(scene(), rtol=0.1, max_depth=2, method="path")
    assert sol.failed and np.isnan(sol.error.claim) and sol.stats["nonfinite"] > 0


@pytest.mark.slow
def test_a_field_of_it_is_not_found():
    room = box_room(0.5, {"ceiling": 1.0})
    sol = jaxrt.render(jaxrt.with_params(room, {"wall.reflectance": np.nan}), 16, max_depth=-1, method="field")
    assert sol.failed and "not finite" in sol.stats["unsolved"]


def test_on_the_command_line(tmp_path, monkeypatch, capsys):
    bad = scene()
    monkeypatch.setattr("jaxrt.loading.load", lambda path, **defaults: bad)
    (tmp_path / "scene.xml").write_text("")
    out = tmp_path / "out.exr"
    command = ["render", str(tmp_path / "scene.xml"), "-o", str(out), "--spp", "4", "--max-depth", "2", "--no-cache"]
    assert main([*command, "--method", "path", "--debug"]) == 1
    said = capsys.readouterr().err
    assert "jaxrt: a sample is not finite: pixel (" in said and "edge 1: floor" in said and not out.exists()
    assert main([*command, "--method", "path"]) == 0
    assert "values are not finite" in (said := capsys.readouterr().err) and "the first: pixel (" in said
    assert out.exists()
