"""Work-precision diagrams: how errors fall with samples, depth and elements, and what is written of it."""

import csv
import dataclasses
import io
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxrt
from jaxrt import cli
from jaxrt.parts import SceneError
from jaxrt.workprec import Curve, Report, Row, fields, pictures, slope, work_precision
from jaxrt.workprec.page import page
from jaxrt.workprec.stage import Reference, stage_of, stage_with
from jaxrt.workprec.table import csv_of
from jaxrt.workprec.words import sentence
from jaxrt.workprec.write import write

SCENES = Path(__file__).parent.parent / "scenes"
ALWAYS = lambda seconds: True


def plates(max_depth, size=16):
    """A floor that a lamp of its size shines on from above, with nothing in between: all is smooth but edges."""
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 2.0
    white = lambda id: jaxrt.Diffuse([0.6] * 3, id=id)
    eye = np.diag([-1.0, 1.0, -1.0, 1.0])
    eye[2, 3] = 1.0
    return jaxrt.Scene.build(
        [
            jaxrt.Rectangle(id="floor", bsdf=white("paper")),
            jaxrt.Rectangle(to_world=down, id="lamp", bsdf=white("lamp_paper"), emission=[1.0] * 3),
        ],
        sensors=[jaxrt.Sensor(to_world=eye, fov=95.0, film=jaxrt.Film(size, size))],
        integrator=jaxrt.Integrator(max_depth=max_depth),
    )


def test_errors_of_independent_samples_fall_as_the_root_and_of_sobol_points_faster(short_loops):
    scene = plates(max_depth=2)
    truth = jaxrt.render(scene, 1 << 14, 99, method="path")
    stage = stage_with(scene, Reference(truth.image, truth.relative_error, "Sobol"), most=1024)
    (independent,), (sobol,) = (sweep(stage, ALWAYS) for sweep in (pictures.path_independent, pictures.path_sobol))
    assert [row.quantity for row in independent.rows] == [1, 4, 16, 64, 256, 1024]
    assert independent.order == pytest.approx(-0.5, abs=0.04)
    assert sobol.order < -0.65
    assert sobol.rows[-1].error < 0.5 * independent.rows[-1].error
    for row in (*independent.rows[2:], *sobol.rows[3:]):
        assert 0.7 < row.claimed / row.error < 1.5
    assert math.isnan(independent.rows[0].claimed)
    assert all(row.seconds > 0 for row in independent.rows)


def test_depth_is_a_geometric_series(short_loops):
    """In a furnace every bounce more leaves the albedo of what was missing."""
    rho = 0.6
    scene = jaxrt.load(SCENES / "furnace.xml", res=16, rho=rho, max_depth=64)
    truth = np.full((16, 16, 1), 0.25 / (1.0 - rho))
    stage = stage_with(scene, Reference(truth, 0.01, "closed form"), most=256)
    (curve,) = pictures.depth(stage, ALWAYS)
    assert len(curve.above) >= 6
    assert curve.ratio == pytest.approx(rho, rel=0.02)
    assert curve.rows[0].error == pytest.approx(rho, rel=0.03)


def test_elements_that_are_constant_are_of_first_order(short_loops):
    """On a smooth scene the error falls as their size, the root of their number."""
    on = fields.OnSurfaces(plates(max_depth=-1, size=32), spp=4096, points=512)
    assert on.floor < 0.01
    rows = [fields.solved(on, str(n), "elements", resolution=n, directions=4096) for n in (64, 1024)]
    curve = Curve("field", "elements", tuple(rows), on.floor)
    assert rows[1].quantity > 10 * rows[0].quantity
    assert curve.order == pytest.approx(-0.5, abs=0.08)


def report(name="room", left_out=()):
    picture = np.linspace(0.0, 1.0, 48).reshape(4, 4, 3)
    rows = lambda n, c: tuple(
        Row(f"{4**k} samples a pixel", 4**k, 0.01 * 4**k, 0.5, c * 0.5**k, c * 0.45**k, picture * (1 + 0.5**k))
        for k in range(n)
    )
    curves = (
        Curve("path, Sobol", "samples", rows(6, 0.4)),
        Curve("Mitsuba 3, scalar_rgb", "samples", tuple(dataclasses.replace(r, claimed=math.nan) for r in rows(4, 0.8))),
        Curve("depth: path, 256 samples a pixel", "depth", tuple(Row(f"max_depth {d}", d, 0.1 * d, 0, 0.5**d) for d in (1, 2, 3))),
    )  # fmt: skip
    return Report(
        name, (4, 4), Reference(picture, 1e-3, "closed <form>"), curves, left_out, {"cpu": "abacus", "seed": 0}
    )


def test_what_a_line_says():
    samples, theirs, depth = report().curves
    assert samples.order == pytest.approx(-0.5) and samples.slope == pytest.approx(-0.5)
    assert samples.digit == pytest.approx(100.0)
    assert samples.seconds_for(0.1) == pytest.approx(0.16) and samples.seconds_for(0.01) == pytest.approx(16.0)
    assert theirs.seconds_for(0.01) == pytest.approx(64.0)
    assert depth.ratio == pytest.approx(0.5)
    assert slope([1, 2, 4], [1, 2**-3, 4**-3]) == pytest.approx(-3.0) and math.isnan(slope([1], [1]))
    known = dataclasses.replace(samples, floor=0.04)  # below .08 it is the reference that errs
    assert len(known.above) == 3 and known.order == pytest.approx(-0.5)
    assert math.isnan(Curve("flat", "samples", samples.rows[:1]).seconds_for(1e-3))
    assert sentence(report()) == (
        "An error of 1% takes 16 s by path, Sobol, 64 s by Mitsuba 3, scalar_rgb. "
        "One more digit costs 100 times as much by path, Sobol, 100 times as much by Mitsuba 3, scalar_rgb."
    )


def test_files_hold_all_scenes_and_need_no_network(tmp_path):
    reports = [report("room"), report("hall & yard", left_out=("float64",))]
    files = {file.suffix: file for file in write(reports, tmp_path / "new")}
    rows = list(csv.DictReader(io.StringIO(files[".csv"].read_text())))
    assert {row["scene"] for row in rows} == {"room", "hall & yard"} and len(rows) == 2 * 13
    assert float(rows[1]["error"]) == 0.2 and float(rows[0]["order"]) == pytest.approx(-0.5)
    assert json.loads(files[".json"].read_text())["room"]["cpu"] == "abacus"
    assert files[".png"].read_bytes().startswith(b"\x89PNG") and b"<svg" in files[".svg"].read_bytes()
    text = files[".html"].read_text()
    assert text.count("<section") == 2 and "hall &amp; yard" in text and "closed &lt;form&gt;" in text
    assert "Left out for want of time: float64" in text
    assert text.count('class="pixels"') == 2 * (1 + 2 + 10)
    assert "src=" in text and all(part.startswith('"data:') for part in text.split("src=")[1:])
    assert "http" not in text and "@import" not in text and "<script" not in text


def test_the_command_writes_and_prints(monkeypatch, tmp_path, capsys):
    asked = {}
    monkeypatch.setattr(
        "jaxrt.workprec.work_precision", lambda scene, name, **options: asked.update(options) or report(name)
    )
    monkeypatch.setenv("JAXRT_CACHE", "off")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["workprec", str(SCENES / "furnace.xml"), "-D", "res=16", "--seconds", "7", "--quick"]) == 0
    out = capsys.readouterr().out
    assert (asked["seconds"], asked["most"], asked["defaults"]) == (7.0, 256, {"res": "16"})
    assert "one more digit costs 100 times as much" in out and "max_depth 3" in out and "12 %" in out
    assert {file.name for file in (tmp_path / "furnace-workprec").iterdir()} == {
        f"work_precision.{suffix}" for suffix in ("csv", "json", "png", "svg", "html")
    }


def test_matplotlib_that_is_missing_is_told_before_the_work(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setenv("JAXRT_CACHE", "off")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["workprec", str(SCENES / "furnace.xml")]) == 2
    assert capsys.readouterr().err == "jaxrt: matplotlib: is not installed; pip install 'jaxrt[figures]'\n"
    assert not list(tmp_path.iterdir())


def test_wrong_arguments(tmp_path, capsys):
    scene = plates(2)
    for options, said in (
        ({"sweeps": ["speed"]}, "sweeps: 'speed' is not known; give any of path"),
        ({"side": 0}, "side: is 0"), ({"most": 2.5}, "most: is 2.5"), ({"seconds": -1.0}, "seconds: is -1.0"),
    ):  # fmt: skip
        with pytest.raises(SceneError, match=said):
            work_precision(scene, **options)
    with pytest.raises(SceneError, match="sampler: 'halton' is not known; give sobol or independent"):
        jaxrt.render(scene, 1, sampler="halton")
    (tmp_path / "file").write_text("")
    for argv, said in (
        (["none.xml"], "none.xml: no such file"),
        ([str(SCENES / "furnace.xml"), "--seconds", "0"], "--seconds: is '0'; give a positive number of seconds"),
        ([str(SCENES / "furnace.xml"), "-o", str(tmp_path / "file")], "is not a folder"),
    ):
        assert cli.main(["workprec", *argv]) == 2
        err = capsys.readouterr().err
        assert said in err and err.count("\n") == 1


@pytest.mark.peer
def test_mitsuba_is_reference_and_rival(short_loops):
    """Errors against it are those that pictures claim, so it is of the same light in the same size."""
    pytest.importorskip("mitsuba")
    file, defaults = SCENES / "furnace.xml", {"rho": 0.6, "max_depth": 3}
    scene = jaxrt.load(file, **defaults)
    stage = stage_of(scene, "furnace", file=file, defaults=defaults, side=16, seconds=1.5, most=256)
    assert stage.reference.by.startswith("Mitsuba 3") and stage.reference.image.shape == (16, 16, 3)
    row = stage.rendered("256", 256, 256, method="path")
    both = math.hypot(row.claimed, stage.reference.error)
    assert 0.6 < row.error / both < 1.6
    (theirs,) = pictures.mitsuba(stage, lambda seconds: seconds < 1.0)
    assert theirs.rows and theirs.rows[0].error > 0 and math.isnan(theirs.rows[0].claimed)


def test_a_budget_leaves_sweeps_out():
    found = work_precision(plates(2), seconds=1e-3, side=16, most=16, sweeps=["path", "depth", "fields"], peer=False)
    assert [curve.sweep for curve in found.curves] == ["samples"]
    assert found.left_out == ("depth", "fields")
    assert page([found]) and csv_of([found])
