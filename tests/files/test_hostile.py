"""Files from strangers: what they may read, how much memory they may take, and that damage is one line."""

import contextlib
import itertools
import os
import re
import subprocess
import sys
from pathlib import Path

import hostile
import numpy as np
import pytest
from hostile import whole
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxrt
from jaxrt import cli
from jaxrt.files import load_description
from jaxrt.parts import SceneError

SECRET = "topaz:x:7:7:quartz"


def shape(kind: str, name: object) -> str:
    return f'<shape type="{kind}"><string name="filename" value="{name}"/></shape>'


def texture(name: object) -> str:
    inner = f'<texture type="bitmap" name="reflectance"><string name="filename" value="{name}"/></texture>'
    return f'<shape type="sphere"><bsdf type="diffuse">{inner}</bsdf></shape>'


def spectrum(name: object) -> str:
    return f'<emitter type="constant"><spectrum name="radiance" filename="{name}"/></emitter><shape type="sphere"/>'


def include(name: object) -> str:
    return f'<shape type="sphere"/><include filename="{name}"/>'


REFERS = {
    "obj": lambda name: shape("obj", name),
    "ply": lambda name: shape("ply", name),
    "serialized": lambda name: shape("serialized", name),
    "sdfgrid": lambda name: shape("sdfgrid", name),
    "bitmap": texture,
    "envmap": lambda name: (
        f'<emitter type="envmap"><string name="filename" value="{name}"/></emitter><shape type="sphere"/>'
    ),
    "spectrum": spectrum,
    "include": include,
}
"""Each way in which an XML file may name another file."""


def refused(path: Path, **options: object) -> str:
    with pytest.raises(SceneError) as error:
        load_description(path, **options)
    message = str(error.value)
    assert message.isprintable() and str(path.parent) in message
    return message


# ---------------------------------------------------------------------------------------------- the sandbox


@pytest.fixture
def box(tmp_path):
    """A folder for scenes, with a file beside it that is not theirs."""
    (tmp_path / "box").mkdir()
    (tmp_path / "secret.ply").write_bytes(hostile.ply("ascii"))
    return tmp_path / "box"


@pytest.mark.parametrize("kind", sorted(REFERS))
@pytest.mark.parametrize("way", ["../secret.ply", "../none", "absolute", "link"])
def test_nothing_outside_of_a_sandbox_is_read(box, kind, way):
    (box / "link").symlink_to(box.parent / "secret.ply")
    name = box.parent / "secret.ply" if way == "absolute" else way
    (box / "a.xml").write_text(whole("", REFERS[kind](name)))
    assert "lies outside of the sandbox; move it there" in refused(box / "a.xml", sandbox=box)


def test_a_sandbox_is_left_out_by_default_and_holds_what_lies_in_it(box):
    (box / "sub").mkdir()
    (box / "sub" / "mesh.ply").write_bytes(hostile.ply("ascii"))
    (box / "inner").symlink_to(box / "sub")
    (box / "a.xml").write_text(whole('<path value="sub"/>', shape("ply", "mesh.ply") + shape("ply", "inner/mesh.ply")))
    assert len(load_description(box / "a.xml", sandbox=box).shapes) == 2
    (box / "a.xml").write_text(whole("", shape("ply", "../secret.ply")))
    assert len(load_description(box / "a.xml").shapes) == 1
    assert len(load_description(box / "a.xml", sandbox=box.parent).shapes) == 1
    (box / "a.xml").write_text(whole('<path value=".."/>', shape("ply", "secret.ply")))
    assert "outside of the sandbox" in refused(box / "a.xml", sandbox=box)


def test_scenes_of_other_formats_in_a_sandbox(box):
    doc = hostile.document()
    for uri in ("../secret.ply", "%2e%2e/secret.ply", str(box.parent / "secret.ply")):
        doc["buffers"] = [{"byteLength": 4, "uri": uri}]
        (box / "a.gltf").write_text(hostile.json.dumps(doc))
        assert "outside of the sandbox" in refused(box / "a.gltf", sandbox=box)
        doc["buffers"] = hostile.json.loads(hostile.gltf())["buffers"]
        doc["images"], doc["textures"] = [{"uri": uri}], [{"source": 0}]
        doc["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        (box / "a.gltf").write_text(hostile.json.dumps(doc))
        assert "outside of the sandbox" in refused(box / "a.gltf", sandbox=box)
    (box.parent / "secret.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (box / "a.obj").write_bytes(hostile.OBJ.replace(b"a.mtl", b"../secret.mtl"))
    assert "outside of the sandbox" in refused(box / "a.obj", sandbox=box)
    assert "outside of the sandbox" in refused(box.parent / "secret.ply", sandbox=box)
    with pytest.raises(SceneError, match="there is no folder"):
        jaxrt.load(box / "a.obj", sandbox=box / "no")


def test_the_sandbox_of_the_command_line(box, capsys):
    (box / "a.xml").write_text(whole("", shape("ply", "../secret.ply")))
    for more, said in ((["--sandbox", str(box)], "outside of the sandbox"), (["-D", "sandbox=x"], "-D: sandbox")):
        assert cli.main(["explain", str(box / "a.xml"), *more]) == 2
        assert said in capsys.readouterr().err


# -------------------------------------------------------------------------------- what no scene should name


@pytest.mark.parametrize("kind", sorted(REFERS))
def test_no_device_pipe_or_folder_is_opened(tmp_path, kind):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name in ("/dev/zero", "pipe", "/proc", ".", "loop", "", "a" * 5000, "/proc/self/mem", "/proc/kmsg"):
        (tmp_path / "a.xml").write_text(whole("", REFERS[kind](name)))
        with pytest.raises(SceneError, match=r"a\.xml|/proc/.*not well-formed"):
            load_description(tmp_path / "a.xml")


@pytest.mark.parametrize("kind", sorted(REFERS))
def test_the_content_of_a_file_is_never_quoted(tmp_path, kind):
    heads = ("", "v ", "f ", "ply\n", "P5 ", "P3\n", "II*\0", "%!PS\n", "<", "<scene ", "400 1\n", "VOL\3")
    tails = (f"{SECRET}\n", f"{SECRET}\nend_header\n", f"{SECRET} version='3.0.0'/>")
    for head, tail in itertools.product(heads, tails):
        (tmp_path / "other").write_text(f"{head}{tail}")
        (tmp_path / "a.xml").write_text(whole("", REFERS[kind]("other")))
        message = refused(tmp_path / "a.xml")
        assert "topaz" not in message and "quartz" not in message


def test_the_content_of_lamps_and_materials_is_never_quoted(tmp_path):
    for text in (f"TILT={SECRET}\n", f"TILT=NONE\n{SECRET}\n"):
        (tmp_path / "a.ies").write_text(text)
        with pytest.raises(SceneError) as error:
            jaxrt.load_ies(tmp_path / "a.ies")
        assert "topaz" not in str(error.value)
    (tmp_path / "a.mtl").write_text(f"newmtl red\nKd {SECRET}\n")
    (tmp_path / "a.obj").write_bytes(hostile.OBJ)
    assert "topaz" not in refused(tmp_path / "a.obj")


def test_names_cannot_steer_a_terminal(tmp_path, capsys):
    doc = hostile.document()
    doc["meshes"][0]["name"] = "\x1b[2J\nred"
    doc["extensionsUsed"] = ["\x1b]0;title\x07"]
    (tmp_path / "a.glb").write_bytes(hostile.glb(doc))
    jaxrt.load(tmp_path / "a.glb")
    assert "\x1b" not in capsys.readouterr().err
    assert str(SceneError("a\x1b[2J\n\tb")) == "a?[2J b"


# ------------------------------------------------------------------------------------------------- bombs


def _many(head: str, one: str, count: int) -> str:
    return whole(head, one * count)


def _gltf(**changes: object) -> bytes:
    return hostile.glb(hostile.document() | changes)


def _copies(count: int, **primitive: object) -> bytes:
    """A mesh of 30 000 triangles that shines, at many nodes."""
    doc = hostile.document()
    doc["bufferViews"] = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 90_000}]
    doc["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5121, "count": 90_000, "type": "SCALAR"},
    ]
    doc["buffers"] = [{"byteLength": 90_036}]
    doc["materials"] = [{"emissiveFactor": [1, 1, 1]}]
    doc["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}]
    doc["nodes"], doc["scenes"] = [{"mesh": 0}] * count, [{"nodes": list(range(count))}]
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    return hostile.glb(doc, triangle + b"\0\1\2" * 30_000)


def _pictures(folder: Path) -> bytes:
    """Many pictures of next to no bytes, each of 4096 x 4096 pixels."""
    import base64

    blank = base64.b64encode(hostile.png((4096, 4096), "1")).decode()
    doc = hostile.document()
    doc["images"] = [{"uri": f"data:image/png;base64,{blank}", "name": str(k)} for k in range(40)]
    doc["textures"] = [{"source": k} for k in range(40)]
    doc["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in range(40)]
    doc["meshes"] = [{"primitives": [{**doc["meshes"][0]["primitives"][0], "material": k} for k in range(40)]}]
    return hostile.glb(doc)


def _exr(width: int, height: int, folder: Path) -> bytes:
    """An EXR whose data window is a lie."""
    data = hostile.exr(folder)
    return data.replace(
        np.array([0, 0, 3, 2], "<i4").tobytes(), np.array([0, 0, width - 1, height - 1], "<i4").tobytes()
    )


def _fan(properties: int) -> bytes:
    """A polygon of many corners, and many values of it."""
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "element face 1\nproperty list uint uchar vertex_indices\n"
    head += "".join(f"property uchar a{k}_0\n" for k in range(properties)) + "end_header\n"
    return head.encode() + bytes(36) + np.uint32(300_000).tobytes() + b"\0\1\2" * 100_000 + bytes(properties)


def bombs(folder: Path) -> dict[str, str | bytes]:
    """Files below 1 MB that ask for far more, by name."""
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\nend_header\n"
    (folder / "small.ply").write_bytes(hostile.ply("ascii"))
    (folder / "fan.ply").write_bytes(_fan(0))
    (folder / "hd.png").write_bytes(hostile.png((4000, 4000), "1"))
    (folder / "head.png").write_bytes(hostile.png_head(50_000, 50_000))
    (folder / "head2.png").write_bytes(hostile.png_head(12_000, 12_000))
    (folder / "window.exr").write_bytes(_exr(30_000, 30_000, folder))
    (folder / "window2.exr").write_bytes(_exr(1 << 30, 1 << 30, folder))
    (folder / "head.hdr").write_bytes(b"#?RADIANCE\n\n-Y 32768 +X 32768\n" + b"\0" * 200_000)
    (folder / "head.serialized").write_bytes(hostile.serialized(40_000_000, 1, b"\0" * 500_000_000))
    (folder / "many.xml").write_text(whole("", '<bsdf type="diffuse"/>' * 20_000))
    (folder / "self.xml").write_text(whole("", include("self.xml")))
    entities = "".join(f'<!ENTITY a{k + 1} "&a{k};&a{k};">' for k in range(40))
    camera = '<sensor type="perspective"><film type="hdrfilm">{}</film></sensor><shape type="sphere"/>'
    doc = hostile.document()
    doc["accessors"].append({"componentType": 5126, "count": 1_000_000, "type": "VEC3"})
    doc["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 4}}}
    views = [{"bufferView": 3, "componentType": 5121, "count": n, "type": "SCALAR"} for n in (10**9, 1 << 39)]
    size = '<integer name="width" value="40000"/><integer name="height" value="40000"/>'
    deep = "".join(f'<bsdf type="twosided" id="b{k}"><ref id="b{k + 1}"/></bsdf>' for k in range(2000))
    return {
        "entities.xml": f'<!DOCTYPE a [<!ENTITY a0 "lol">{entities}]><scene version="3.0.0">&a40;</scene>',
        "external.xml": '<!DOCTYPE a [<!ENTITY b SYSTEM "/etc/passwd">]><scene version="3.0.0">&b;</scene>',
        "self.xml": (folder / "self.xml").read_text(),
        "includes.xml": whole("", include("many.xml") * 900),
        "paths.xml": _many("", '<path value="."/>', 20_000),
        "defaults.xml": whole("".join(f'<default name="d{k}" value="1"/>' for k in range(20_000))),
        "doubling.xml": whole("".join(f'<default name="a{k}" value="$a{k - 1}$a{k - 1}"/>' for k in range(1, 60)).replace("$a0", "x")),
        "long.xml": _many(f'<default name="a" value="{"x" * 60_000}"/>', '<bsdf type="$a"/>', 30_000),
        "deep.xml": '<scene version="3.0.0">' + "<a>" * 100_000 + "</a>" * 100_000 + "</scene>",
        "chain.xml": whole("", deep + '<bsdf type="diffuse" id="b2000"/><shape type="sphere"><ref id="b0"/></shape>'),
        "fans.xml": _many("", shape("ply", "fan.ply"), 2000),
        "instances.xml": _many(
            '<shape type="shapegroup" id="g"><shape type="sphere"/>' + shape("ply", "fan.ply") + "</shape>",
            '<shape type="instance"><ref id="g"/></shape>',
            5000,
        ),
        "textures.xml": _many("", texture("hd.png"), 500),
        "head.xml": whole("", texture("head.png")),
        "head2.xml": whole("", texture("head2.png")),
        "window.xml": whole("", texture("window.exr")),
        "window2.xml": whole("", texture("window2.exr")),
        "hdr.xml": whole("", texture("head.hdr")),
        "serialized.xml": whole("", shape("serialized", "head.serialized")),
        "film.xml": whole("", camera.format(size)),
        "lobes.xml": whole("", camera.format('<rfilter type="lanczos"><integer name="lobes" value="1000000000"/></rfilter>')),
        "blur.xml": whole("", camera.format('<rfilter type="gaussian"><float name="stddev" value="1e9"/></rfilter>')),
        "samples.xml": whole("", '<shape type="sphere"/><sensor type="perspective"><sampler type="independent"><integer name="sample_count" value="99999999999999"/></sampler></sensor>'),
        "count.ply": head.encode() + bytes(1000),
        "values.ply": _fan(20_000),
        "index.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 1000000000\n",
        "count.glb": _gltf(accessors=[*hostile.document()["accessors"][:3], views[0]]),
        "count2.glb": _gltf(accessors=[*hostile.document()["accessors"][:3], views[1]]),
        "instances.glb": hostile.glb(doc),
        "copies.glb": _copies(20_000),
        "pictures.glb": _pictures(folder),
    }  # fmt: skip


CHILD = """
import resource, sys, time
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
from pathlib import Path
import PIL.Image, OpenEXR, numpy
from jaxrt.files import load_description, mitsuba, gltf
from jaxrt.parts import SceneError
for name in sys.argv[2:]:
    start = time.perf_counter()
    try:
        load_description(Path(name))
        said = "is a scene"
    except SceneError as error:
        said = str(error)
    except BaseException as error:
        said = f"{type(error).__name__} {error}"
    print(f"{time.perf_counter() - start:.1f} {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss} {said}", flush=True)
"""


HEAVY = ("includes.xml", "fans.xml", "instances.xml", "textures.xml", "copies.glb", "pictures.glb")
"""Those that take some of their allowance before they are refused."""


@pytest.mark.parametrize("heavy", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_no_small_file_takes_much_memory(tmp_path, heavy):
    made = {name: content for name, content in bombs(tmp_path).items() if (name in HEAVY) == heavy}
    for name, content in made.items():
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    assert not [file.name for file in tmp_path.iterdir() if file.stat().st_size >= 1_000_000]
    child = [sys.executable, "-c", CHILD, str(2 << 30), *made]
    env = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(child, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300)
    lines = done.stdout.splitlines()
    assert len(lines) == len(made), (done.stderr[-500:], list(made)[len(lines)])
    for name, line in zip(made, lines, strict=True):
        seconds, _, said = line.split(" ", 2)
        assert re.match(r"[a-z0-9]+\.[a-z]+:.*; ", said), (name, said, done.stdout)
        assert float(seconds) < 30, (name, line)


# ------------------------------------------------------------------------------------------------ damage


FORMATS = ("a.xml", "a.obj", "ascii.ply", "little.ply", "big.ply", "a.gltf", "a.glb", "a.exr", "a.png", "a.ies", "a.spd",
           "a.pfm", "a.hdr", "a.vol", "a.serialized")  # fmt: skip


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    return folder, hostile.seeds(folder)


def harmless(folder: Path, name: str, data: bytes) -> bool:
    """Whether a file is read; it may also be refused in one line that names it."""
    path = folder / name
    path.write_bytes(data)
    try:
        hostile.read(path)
    except SceneError as error:
        assert name in str(error) and str(error).isprintable()
        return False
    return True


@pytest.mark.parametrize("name", FORMATS)
def test_whole_files_are_read(good, name):
    assert harmless(good[0], name, good[1][name])


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=60)
@given(number=st.integers(0, 1 << 30))
def test_damage_anywhere_is_refused_or_harmless(good, name, number):
    harmless(good[0], name, hostile.damaged(good[1][name], number))


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_much_damage_anywhere_is_refused_or_harmless(good, name):
    for number in range(4000):
        harmless(good[0], name, hostile.damaged(good[1][name], number))


SOURCES = ["", "cornell_box.xml", "veach_mis.xml", "sphere_light.xml", "furnace.xml"]


@settings(max_examples=150)
@given(source=st.sampled_from(SOURCES), number=st.integers(0, 1 << 30))
def test_altered_scenes_are_refused_or_parts(good, source, number):
    text = (hostile.SCENES / source).read_text() if source else hostile.XML
    harmless(good[0], "a.xml", hostile.altered(text, number).encode())


def make(folder: Path, text: str) -> None:
    """From a file to a scene and its plan, with nothing but `SceneError`."""
    (folder / "a.xml").write_text(text)
    with contextlib.suppress(SceneError):
        jaxrt.load(folder / "a.xml")


@settings(max_examples=40)
@given(source=st.sampled_from(SOURCES[:2]), number=st.integers(0, 1 << 30))
def test_altered_scenes_are_refused_or_scenes(good, source, number):
    make(good[0], hostile.altered((hostile.SCENES / source).read_text() if source else hostile.XML, number))


@pytest.mark.slow
def test_much_altered_scenes_are_refused_or_scenes(good):
    for number in range(500):
        source = SOURCES[number % len(SOURCES)]
        make(good[0], hostile.altered((hostile.SCENES / source).read_text() if source else hostile.XML, number))


# -------------------------------------------------------------------------------------------------- many


def test_a_huge_film_is_refused_before_anything_is_rendered(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    size = '<integer name="width" value="32768"/><integer name="height" value="32768"/>'
    film = f'<sensor type="perspective"><film type="hdrfilm">{size}</film></sensor>'
    Path("a.xml").write_text(whole(film))
    assert cli.main(["render", "a.xml", "--no-cache", "--memory", "2000"]) == 2
    assert "do not hold a picture of 32768x32768" in capsys.readouterr().err
    assert os.listdir() == ["a.xml"]


@pytest.mark.slow
def test_ten_thousand_lights_and_a_thousand_materials(tmp_path):
    """Light on a floor is the sum over the lamps, each of them found."""
    places = np.random.default_rng(0).uniform([-1, -1, 9], [1, 1, 11], (10_000, 3))
    lamps = "".join(
        f'<emitter type="point"><point name="position" x="{x}" y="{y}" z="{z}"/><rgb name="intensity" value="1"/></emitter>'
        for x, y, z in places
    )
    paints = "".join(
        f'<bsdf type="diffuse" id="m{k}"><rgb name="reflectance" value="{k / 1000} .5 .5"/></bsdf><shape type="rectangle">'
        f'<transform name="to_world"><scale value=".01"/><translate x="{k}" z="-5"/></transform><ref id="m{k}"/></shape>'
        for k in range(1000)
    )
    (tmp_path / "a.xml").write_text(whole("", paints + lamps))
    scene = jaxrt.load(tmp_path / "a.xml")
    assert len(jaxrt.params(scene)) > 20_000
    found = jaxrt.irradiance(scene, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], spp=4096)
    distance = np.linalg.norm(places, axis=1)
    np.testing.assert_allclose(np.ravel(found), (places[:, 2] / distance**3).sum(), rtol=0.01)
