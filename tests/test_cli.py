"""The command line, end to end on tiny pictures: what it writes and says, and that mistakes cost one line."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import jaxrt
from jaxrt import cli, compiler
from jaxrt.files.image import read_exr, write_exr
from jaxrt.parts import SceneError

ROOT = Path(__file__).parent.parent
CORNELL = str(ROOT / "scenes" / "cornell_box.xml")
TINY = ["--size", "16x16", "--spp", "4"]

SCENE = """<scene version="3.0.0">
    <default name="spp" value="4"/>
    <default name="glow" value="2"/>
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 1.9" target="0, 0, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film>
    </sensor>
    <shape type="rectangle" id="floor">
        <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
    </shape>
    <shape type="rectangle" id="lamp">
        <transform name="to_world"><rotate y="1" angle="180"/><translate z="2"/></transform>
        <emitter type="area"><rgb name="radiance" value="$glow"/></emitter>
    </shape>
</scene>"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty current folder, and no compiled programs left behind."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("JAXRT_CACHE", "off")
    return here


@pytest.fixture
def scene(tmp_path):
    """Writes a scene file outside the current folder, with replacements in its text."""

    def scene(*replacements, name="scene.xml"):
        text = SCENE
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return scene


@pytest.fixture
def run(capsys):
    """Runs a command which must succeed; gives its lines on stdout."""

    def run(*argv):
        code = cli.main([str(a) for a in argv])
        out, err = capsys.readouterr()
        assert (code, err) == (0, "")
        return out.splitlines()

    return run


@pytest.fixture
def refused(capsys, folder):
    """Runs a command which must be refused: exit code 2, one line on stderr, nothing written. Gives the line."""

    def refused(*argv):
        before = sorted(folder.iterdir())
        code = cli.main([str(a) for a in argv])
        out, err = capsys.readouterr()
        assert (code, out) == (2, "")
        assert re.fullmatch(r"jaxrt: [^\n]+\n", err)
        assert sorted(folder.iterdir()) == before
        return err

    return refused


# ------------------------------------------------------------------------------------------- render


def test_render_writes_an_exr_and_a_png_and_one_closing_line(run, folder):
    (line,) = run("render", CORNELL, *TINY, "--seed", 7, "--max-depth", 3)
    assert re.fullmatch(
        r"cornell_box\.exr, cornell_box\.png: 16x16, 4 samples a pixel by path, compiled in \d+\.\d s, "
        r"ran \d+\.\d s, relative error \d+\.\d\d%",
        line,
    )
    assert {p.name for p in folder.iterdir()} == {"cornell_box.exr", "cornell_box.png"}
    image, stderr, attributes = read_exr("cornell_box.exr")
    assert image.shape == (16, 16, 3) and stderr is not None and stderr.shape == image.shape
    told = json.loads(attributes["jaxrt"])
    assert (told["version"], told["scene"], told["seed"]) == (jaxrt.__version__, CORNELL, 7)
    assert (told["samples"], told["max_depth"]) == (4, 3)
    expected = jaxrt.render(jaxrt.resized(jaxrt.load(CORNELL), 0, 16, 16), spp=4, seed=7, max_depth=3).image
    np.testing.assert_array_equal(image, expected)


def test_output_may_name_either_file(run, folder, tmp_path, scene):
    run("render", scene(), "-o", tmp_path / "a.exr")
    run("render", scene(), "-o", tmp_path / "b.PNG")
    assert all((tmp_path / name).is_file() for name in ("a.exr", "a.png", "b.PNG", "b.exr"))
    assert not list(folder.iterdir())


def test_the_seed_decides_the_noise(run, scene):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        run("render", scene(), "-o", f"{name}.exr", "--seed", seed)
    a, b, c = (read_exr(f"{name}.exr")[0] for name in "abc")
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_definitions_fill_names_of_the_scene(run, scene):
    run("render", scene(), "-o", "a.exr", "-D", "spp=2")
    run("render", scene(), "-o", "b.exr", "-D", "spp=2", "-D", "glow=4")
    assert json.loads(read_exr("a.exr")[2]["jaxrt"])["samples"] == 2
    np.testing.assert_allclose(read_exr("b.exr")[0], 2 * read_exr("a.exr")[0], rtol=1e-5)


def test_a_tolerance_says_what_it_costs_and_what_was_reached(run, scene):
    (line,) = run("render", scene(), "--rtol", "30%", "--size", "16x16", "--method", "path", "-o", "t.exr")
    assert "asked 30.00%, below" in line and "in 95 of 100 renders" in line
    assert Path("t.exr").exists() and Path("t.png").exists()


def test_exposure_changes_the_png_alone(run, scene):
    import PIL.Image

    run("render", scene(), "-o", "a.exr")
    run("render", scene(), "-o", "b.exr", "--exposure", "-1")
    np.testing.assert_array_equal(read_exr("a.exr")[0], read_exr("b.exr")[0])
    a, b = (np.asarray(PIL.Image.open(f"{name}.png")).astype(int) for name in "ab")
    assert (b <= a).all() and b.sum() < a.sum()


def test_one_sample_has_no_error_to_tell(run, scene):
    (line,) = run("render", scene(), "--spp", 1, "--method", "path")
    assert line.endswith("relative error unknown")
    assert read_exr("scene.exr")[1] is None


def test_another_sensor(run, scene):
    begin, end = SCENE.index("<sensor"), SCENE.index("</sensor>") + 9
    sensor = SCENE[begin:end]
    wide = sensor.replace('name="width" value="16"', 'name="width" value="24"')
    run("render", scene((sensor, sensor + wide)), "--sensor", 1)
    assert read_exr("scene.exr")[0].shape == (16, 24, 3)


def test_several_sensors(run, scene):
    begin, end = SCENE.index("<sensor"), SCENE.index("</sensor>") + 9
    sensor = SCENE[begin:end]
    run("render", scene((sensor, sensor + sensor.replace('value="16"', 'value="8"'))), "--sensor", "all")
    assert read_exr("scene-0.exr")[0].shape == (16, 16, 3)
    assert read_exr("scene-1.exr")[0].shape == (8, 8, 3)
    assert not Path("scene.exr").exists()


def test_a_terminal_gets_a_progress_bar(monkeypatch, scene, capsys):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert cli.main(["render", scene()]) == 0
    assert "100%" in terminal.getvalue()
    assert len(capsys.readouterr().out.splitlines()) == 1


# --------------------------------------------------------------------------- explain, compare, doctor


def test_explain_prints_the_plan_and_what_freedom_would_change(run, scene):
    head, *table, last = run("explain", scene())
    rows = {row.split()[0]: row.split()[1] for row in table if not row.startswith("assumes")}
    assert head.split() == ["effect", "because"]
    assert rows["area_light"] == "in" and rows["rgb"] == "out" and rows["lobe:mirror"] == "out"
    assert last.startswith("with every parameter free: ") and "rgb" in last
    columns = {re.search(r" (in |out) ", row).start() for row in table if not row.startswith("assumes")}
    assert len(columns) == 1
    assert any("lamp.emitter" in row for row in table if row.startswith("area_light"))


def test_explain_says_what_is_lost_without_effects(run, scene, monkeypatch):
    from jaxrt.effects import costs

    monkeypatch.setattr(costs, "dropped_radiance", lambda scene, forced: (2.0, 0.5 * len(forced), 0.01))
    *table, last = run("explain", scene(), "--without", "bounces", "--with", "smooth_normals")
    rows = {row.split()[0]: row for row in table}
    assert "out  forced out" in rows["bounces"] and "in   forced in" in rows["smooth_normals"]
    assert last == "the mean of a small picture loses 1 ± 0.01, 50.00% of 2; left out: bounces"


def test_explain_shows_what_effects_cost(run, scene, monkeypatch):
    from jaxrt.effects import costs

    one = costs.Cost("bounces", True, (0.010, 0.025), (1.0, 3.0), (10**6, 3 * 10**6), 0.001, (0.5, 0.01), 2.0)
    monkeypatch.setattr(costs, "effect_costs", lambda scene, **options: [one])
    (row,) = (row for row in run("explain", scene(), "--measure") if row.startswith("bounces"))
    assert row.split()[1:10] == "in +15.0 ± 1.0 ms +60% -1.7 +2.0 s".split()


def picture(path, values, stderr=None, size=(12, 20)):
    image = np.broadcast_to(np.asarray(values, np.float32), (*size, 3)).copy()
    write_exr(path, image, None if stderr is None else np.full_like(image, stderr))
    return image


def test_compare_finds_no_difference_between_equals(run):
    picture("a.exr", 0.5, 0.1)
    offset, mse, z, worst = run("compare", "a.exr", "a.exr")
    assert offset.split()[-1] == "+0.000%" and float(mse.split()[-1]) == 0 and z.split()[-1] == "100.000%"
    assert "0.00% of the mean" in worst


def test_compare_measures_the_difference(run):
    a = picture("a.exr", 1.0, 0.1)
    a[8:, 16:] = 2.0  # the last block, which is smaller than the others
    write_exr("a.exr", a, np.full_like(a, 0.1))
    picture("b.exr", 1.0, 0.05)
    offset, mse, z, worst = run("compare", "a.exr", "b.exr")
    share = 16 / 240
    assert offset.split()[-1] == f"{share:+.3%}"
    assert float(mse.split()[-1]) == pytest.approx(share / 1.01, rel=1e-3)
    assert z.split()[-1] == f"{1 - share:.3%}"
    assert worst.endswith("100.00% of the mean, at x 16, y 8")


def test_compare_without_standard_errors_or_with_nan(run):
    picture("a.exr", 1.0)
    image = picture("b.exr", 1.0)
    assert run("compare", "a.exr", "b.exr")[2].endswith("unknown: neither picture has standard errors")
    image[3, 4, 1] = np.nan
    write_exr("b.exr", image)
    assert run("compare", "a.exr", "b.exr")[0].split() == "not finite 1 pixels, left out".split()


def test_doctor(run):
    rows = dict(line.split(maxsplit=1) for line in run("doctor"))
    assert rows["jaxrt"] == jaxrt.__version__ and rows["jax"] and rows["devices"] and int(rows["cores"]) >= 1
    assert rows["cache"] == "off, by JAXRT_CACHE"


def test_version_and_help(run):
    assert run("--version") == [f"jaxrt {jaxrt.__version__}"]
    assert "render" in " ".join(run("--help"))
    assert "--max-depth" in " ".join(run("render", "--help"))


# ---------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    "argv, said",
    [
        ([], "COMMAND"),
        (["draw"], "render"),
        (["render"], "SCENE"),
        (["render", "no_such_file.xml"], "no_such_file.xml: no such file; check"),
        (["explain", "no_such_file.glb"], "no_such_file.glb: no such file; check"),
        (["explain", CORNELL, "--without", "blent"], "blent: no such effect; closest: blend"),
        (["compare", "a.exr", "b.exr"], "a.exr: no such file; check"),
        (["render", CORNELL, "--spp", "0"], "--spp: is '0'; give a whole number from 1"),
        (["render", CORNELL, "--spp", "2.5"], "--spp: is '2.5'; give"),
        (["render", CORNELL, "--spp", "99999999999"], "--spp"),
        (["render", CORNELL, "--max-depth", "-2"], "--max-depth: is '-2'; give"),
        (["render", CORNELL, "--seed", "x"], "--seed: is 'x'; give"),
        (["render", CORNELL, "--size", "0x16"], "--size: is '0x16'; give it as"),
        (["render", CORNELL, "--size", "-4x4"], "--size"),
        (["render", CORNELL, "--size", "16"], "--size: is '16'; give it as"),
        (["render", CORNELL, "--size", "99999x2"], "--size"),
        (["render", CORNELL, "--rtol", "little"], "--rtol: is 'little'; give a relative error, as 1% or 0.01"),
        (["render", CORNELL, "--rtol", "0"], "--rtol: is '0'; give"),
        (["render", CORNELL, "--seconds", "-3"], "--seconds: is '-3'; give a positive number"),
        (["render", CORNELL, "--rtol", "1%", "--spp", "4"], "--rtol: is given beside --spp; give one of them"),
        (["render", CORNELL, "--exposure", "nan"], "--exposure: is 'nan'; give"),
        (["render", CORNELL, "--method", "magic"], "path"),
        (["render", CORNELL, "--sensor", "3"], "cornell_box.xml: has 1 sensors"),
        (["render", CORNELL, "-D", "res"], "-D: is 'res'; give it as name=value"),
        (["render", CORNELL, "-D", "rse=16"], "no $rse in this scene; did you mean res?"),
        (["render", CORNELL, "-D", "res=0"], "film.width: is 0; give"),
        (["render", CORNELL, "-D", "spp=0"], "sampler.sample_count: is 0; give"),
        (["render", CORNELL, "-D", "res=many"], "is not an integer; write"),
        (["render", CORNELL, "-o", "out.jpg"], "out.jpg: a picture is written as .exr or .png; change"),
        (["render", CORNELL, "-o", "none/out.exr"], "none/out.exr: the folder none does not exist; make it"),
        (["render", str(ROOT)], "no such file; check"),
        (["render", str(ROOT / "README.md")], "is not a scene format; give"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(refused, argv, said):
    assert said in refused(*argv)


RADIANCE = '<rgb name="radiance" value="$glow"/>'


@pytest.mark.parametrize(
    "replacement, said",
    [
        ((SCENE, ""), "not well-formed"),
        ((SCENE, "<scene version='3.0.0'/>"), "has no shapes; add"),
        ((SCENE, '<!DOCTYPE a [<!ENTITY b "c">]><scene version="3.0.0">&b;</scene>'), "entity, which is refused"),
        (("</scene>", ""), "not well-formed"),
        (('type="diffuse"', 'type="velvet"'), "is not supported; use diffuse"),
        (('type="rectangle" id="floor"', 'type="teapot"'), "is not supported; use"),
        ((RADIANCE, '<rgb name="radiance" value="-1"/>'), "radiance: is -1; give"),
        ((RADIANCE, '<rgb name="radiance" value="nan"/>'), "not a number; give"),
        (('"reflectance" value="0.5"', '"reflectance" value="1.5"'), "reflectance: is 1.5; give"),
        (('<translate z="2"/>', '<scale value="0"/>'), "is singular; give"),
        (("$spp", "$ssp"), "$ssp is not defined"),
        (("$spp", "-4"), "sample_count: is -4; give"),
    ],
)
def test_wrong_scenes_are_refused_in_one_line(refused, scene, replacement, said):
    path = scene(replacement)
    message = refused("render", path)
    assert path in message and said in message


@pytest.mark.parametrize(
    "vertex, face, said",
    [
        ("nan 0 0", "0 1 2", "vertex 2 is not finite; repair"),
        ("inf 0 0", "0 1 2", "vertex 2 is not finite; repair"),
        ("1 0 0", "0 1 3", "repair the mesh"),
        ("1 0 0", "0 1 -1", ""),
        ("1 0 0", "0 1", ""),
        ("one 0 0", "0 1 2", ""),
    ],
)
@pytest.mark.parametrize("inside_xml", [False, True])
def test_broken_meshes_are_refused_in_one_line(refused, scene, tmp_path, vertex, face, said, inside_xml):
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "mesh.ply").write_text(f"{head}0 0 0\n0 1 0\n{vertex}\n{len(face.split())} {face}\n")
    mesh = '<string name="filename" value="mesh.ply"/>'
    path = scene(('type="rectangle" id="floor">', f'type="ply" id="floor">{mesh}'))
    message = refused("render", path if inside_xml else tmp_path / "mesh.ply")
    assert "mesh.ply" in message or '<shape type="ply" id="floor">' in message
    assert said in message


def test_no_sensor_of_that_number(refused, scene):
    assert "scene.xml: has 1 sensors, no number 1" in refused("render", scene(), "--sensor", 1)


def test_pictures_of_different_sizes_do_not_compare(refused):
    picture("a.exr", 1.0)
    picture("b.exr", 1.0, size=(8, 8))
    assert "a.exr is 20x12 and b.exr is 8x8; render both at one size" in refused("compare", "a.exr", "b.exr")


def test_a_broken_picture_does_not_compare(refused):
    picture("a.exr", 1.0)
    Path("b.exr").write_bytes(Path("a.exr").read_bytes()[:200])
    Path("c.exr").write_text("no picture")
    assert "b.exr: cannot be read as EXR" in refused("compare", "a.exr", "b.exr")
    assert "c.exr: is not an EXR file; check" in refused("compare", "c.exr", "a.exr")


def test_a_folder_in_the_way_of_the_picture(refused, folder, scene):
    (folder / "scene.png").mkdir()
    assert "scene.png: is not a file; give another name" in refused("render", scene())


# --------------------------------------------------------------------------------- faults on the way


@pytest.mark.parametrize(
    "error, code, said",
    [
        (KeyboardInterrupt(), 130, "interrupted; nothing was written"),
        (MemoryError(), 1, "out of memory; give a smaller --size"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 1 bytes\nand more"), 1, "out of memory"),
        (SceneError("a\nb; do c"), 2, "a b; do c"),
    ],
)
def test_what_stops_a_render_is_one_line(monkeypatch, capsys, folder, scene, error, code, said):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("jaxrt.solver.render.render", fail)
    assert cli.main(["render", scene()]) == code
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
    assert not list(folder.iterdir())


def test_a_fault_of_our_own_is_not_hidden(monkeypatch, scene):
    def fail(*_, **__):
        raise RuntimeError("a bug")

    monkeypatch.setattr("jaxrt.solver.render.render", fail)
    with pytest.raises(RuntimeError, match="a bug"):
        cli.main(["render", scene()])


# ------------------------------------------------------------------------------- in its own process


def process(*argv, **env):
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {k: v for k, v in os.environ.items() if k != "JAXRT_CACHE"} | {"PYTHONPATH": path, **env}
    return subprocess.run([sys.executable, *argv], env=environment, capture_output=True, text=True)


def test_process_keeps_compiled_programs(scene, tmp_path):
    cache = tmp_path / "cache"
    command = ("-m", "jaxrt", "render", scene())
    done = process(*command, XDG_CACHE_HOME=str(cache))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("scene.exr, scene.png: 16x16, 4 samples a pixel")
    kept = {p.name for p in cache.rglob("*") if p.is_file()}
    assert kept
    done = process(*command, XDG_CACHE_HOME=str(cache))
    assert (done.returncode, done.stderr) == (0, "")
    assert {p.name for p in cache.rglob("*-cache")} == {name for name in kept if name.endswith("-cache")}


def test_process_renders_without_a_cache(scene, tmp_path):
    (tmp_path / "file").write_text("in the way")
    done = process("-m", "jaxrt", "render", scene(), XDG_CACHE_HOME=str(tmp_path / "file"))
    assert (done.returncode, done.stderr) == (0, "") and Path("scene.exr").is_file()


@pytest.mark.parametrize(
    "argv, code",
    [(["--help"], 0), (["--version"], 0), (["render"], 2), (["render", "none.xml"], 2), (["compare", "a", "b"], 2)],
)
def test_help_and_mistakes_come_without_jax(argv, code):
    script = f"import sys; from jaxrt.cli import main; code = main({argv}); print('jax' in sys.modules); sys.exit(code)"
    done = process("-c", script)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (code, "False")


def test_kept_programs_run_under_any_name_of_a_scene(run, folder, scene, monkeypatch):
    """Equal programs are kept once, whatever the file is called, and what was kept runs."""
    monkeypatch.delenv("JAXRT_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    one, two = scene(), scene(name="copy.xml")
    try:
        for k, path in enumerate((one, two, two)):
            compiler._programs.clear()
            run("render", path, "-o", folder / f"{k}.exr")
        assert compiler.folder is not None
        assert len(list(compiler.folder.iterdir())) == 4  # world, two for lamps' borders, picture
    finally:
        compiler.folder = None
    first, again = (read_exr(folder / f"{k}.exr")[0] for k in (0, 2))
    np.testing.assert_array_equal(first, again)


def test_ctrl_c_while_a_module_is_being_imported():
    """Its names are not there yet."""
    code = (
        "import sys, types; from jaxrt import cli; sys.modules['jaxrt.files.writing'] = types.ModuleType('writing'); "
    )
    done = subprocess.run([sys.executable, "-c", code + "cli._interrupted()"], capture_output=True, text=True)
    assert done.returncode == 130
    assert "interrupted" in done.stderr and done.stderr.count("\n") == 1


def test_ctrl_c_ends_a_process_at_once(scene, tmp_path):
    """While jax is being imported, and later: exit code 130, one line, and nothing half written."""
    argv = [sys.executable, "-m", "jaxrt", "render", scene(), "--spp", "100000000", "-o", str(tmp_path / "out.exr")]
    for seconds in (0.0, 4.0):
        job = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True, env={**os.environ, "JAXRT_CACHE": "off"})
        maps = Path(f"/proc/{job.pid}/maps")  # what the process has loaded, where the system tells
        for _ in range(600 if maps.exists() else 20):
            time.sleep(0.05)
            if job.poll() is not None or (maps.exists() and "jaxlib" in maps.read_text()):
                break
        time.sleep(seconds)
        job.send_signal(signal.SIGINT)
        _, err = job.communicate(timeout=60)
        assert job.returncode == 130, err
        assert "interrupted" in err and err.count("\n") == 1
        assert not list(tmp_path.glob("*out*"))
