"""Mitsuba 3 XML: what each element means, that mistakes are named in one line, and that Mitsuba agrees."""

import re

import numpy as np
import pytest
from helpers import ball_of_distances
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from serialized import volume

from jaxrt import parts
from jaxrt.files import mitsuba
from jaxrt.parts import SceneError

ROUND = ball_of_distances(3)
SPHERE = '<shape type="sphere"/>'
TENT = "v 0 0 0\nv 1 0 0\nv 1 1 .5\nv 0 1 0\nv 2 0 1\n"


def scene(body, version="3.0.0"):
    return f'<scene version="{version}">\n{body}\n</scene>\n'


@pytest.fixture
def load(tmp_path):
    """Loads a scene with the given inside, with a sphere if it has no shape."""

    def load(body, **defaults):
        path = tmp_path / "scene.xml"
        path.write_text(scene(body if "<shape" in body or "<include" in body else body + SPHERE))
        return mitsuba.load(path, defaults)

    return load


@pytest.fixture
def refused(load):
    """The message, without the folder, with which the loader refuses a scene."""

    def refused(body, **defaults):
        with pytest.raises(SceneError) as problem:
            load(body, **defaults)
        message = str(problem.value)
        assert re.match(r"[^\n]*\.xml:(\d+: )?", message) and message.isprintable()
        return message[message.index("scene.xml") :] if "scene.xml" in message else message

    return refused


def only(load, body, **defaults):
    (shape,) = load(body, **defaults).shapes
    return shape


def material(load, body):
    return only(load, f'<shape type="sphere">{body}</shape>').bsdf


def to_world(load, body):
    return only(load, f'<shape type="rectangle"><transform name="to_world">{body}</transform></shape>').to_world


def write(tmp_path, name, text):
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


# --------------------------------------------------------------------------- parameters, includes, ids


def test_default_is_filled_in_and_an_argument_wins_over_it(load):
    body = '<default name="r" value="2"/><shape type="sphere"><float name="radius" value="$r"/></shape>'
    assert only(load, body).radius == 2
    assert only(load, body, r=3).radius == 3
    assert only(load, body, r="0.5").radius == 0.5


def test_argument_needs_no_default(load):
    body = '<shape type="sphere"><boolean name="flip_normals" value="$flip"/></shape>'
    assert only(load, body, flip=True).flip_normals


def test_first_default_wins_and_may_use_others(load):
    body = '<default name="a" value="1"/><default name="a" value="7"/><default name="b" value="$a$a"/>'
    assert only(load, body + '<shape type="sphere"><float name="radius" value="$b"/></shape>').radius == 11


def test_longest_name_is_taken_and_a_prefix_else(load):
    body = '<default name="r" value="2"/><default name="rr" value="3"/><shape type="sphere" id="$rr $rrr \\$r"/>'
    assert only(load, body).id == "3 32 $r".replace("32", "3r")


def test_parameters_stand_anywhere_in_an_attribute(load):
    body = '<shape type="$kind"><transform name="to_world"><translate x="1$two"/></transform></shape>'
    assert only(load, body, kind="disk", two=2).to_world[0, 3] == 12


def test_unknown_parameter_is_listed(refused):
    message = refused('<default name="res" value="1"/><shape type="sphere" id="$size"/>')
    assert message.startswith("scene.xml:2: <shape") and "$size is not defined" in message and "res" in message


def test_default_after_its_use_does_not_count(refused):
    assert "$r is not defined" in refused('<shape type="sphere" id="$r"/><default name="r" value="1"/>')


def test_unused_argument_names_the_closest(refused):
    body = '<default name="spp" value="1"/><shape type="sphere" id="$spp"/>'
    assert "no $sppp in this scene; did you mean spp" in refused(body, sppp=3)
    assert "it uses: none" in refused(SPHERE, spp=3)


def test_parameters_cannot_fill_the_memory(refused):
    body = '<default name="a" value="xxxxxxxxxxxxxxxx"/>'
    body += "".join(
        f'<default name="{b}" value="{f"${a}" * 10}"/>' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    assert "grows beyond" in refused(body)


def test_reference_backwards_forwards_and_by_alias_is_one_object(load):
    shapes = load(
        '<shape type="sphere"><ref id="red"/></shape><bsdf type="diffuse" id="red"/><alias id="red" as="rouge"/>'
        '<shape type="disk"><ref id="red" name="bsdf"/></shape><shape type="cube"><ref id="rouge"/></shape>'
    ).shapes
    assert shapes[0].bsdf.id == "red"
    assert shapes[0].bsdf is shapes[1].bsdf is shapes[2].bsdf


def test_shared_emitter_has_one_name(load):
    ref = '<shape type="sphere"><ref id="lamp"/></shape>'
    a, b = load(f'{ref}<emitter type="area" id="lamp"><rgb name="radiance" value="1 2 3"/></emitter>{ref}').shapes
    assert a.emission_id == b.emission_id == "lamp"
    assert a.emission is b.emission and a.emission.tolist() == [1, 2, 3]


def test_emitters_that_only_light_tracing_sees_are_dark_and_said(load):
    lamp = '<emitter type="directionalarea" id="beam"><float name="radiance" value="9"/></emitter>'
    made = load(
        lamp
        + '<shape type="sphere"><ref id="beam"/></shape><shape type="cube"><ref id="beam"/><bsdf type="diffuse"/></shape>'
    )
    assert [s.emission for s in made.shapes] == [None, None]
    assert [float(np.mean(s.bsdf.reflectance)) for s in made.shapes] == [0.0, 0.5]
    assert len(made.notes) == 1
    assert "is seen by light tracing alone" in made.notes[0]


def test_missing_reference_names_the_closest(refused):
    message = refused('<bsdf type="diffuse" id="white"/><shape type="sphere"><ref id="whit"/></shape>')
    assert message == "scene.xml:2: <ref>: no element has id 'whit'; did you mean white?"


@pytest.mark.parametrize(
    "body, problem",
    [
        ('<bsdf type="diffuse" id="a"/>\n<bsdf type="diffuse" id="a"/>', "id 'a' is already used at scene.xml:2"),
        ('<alias id="a" as="b"/><bsdf type="diffuse" id="a"/>', "no id 'a' before it"),
        ('<bsdf type="diffuse" id="a"/><alias id="a" as="a"/>', "already used"),
        (
            '<shape type="sphere"><ref id="a"/></shape><bsdf type="twosided" id="a"><ref id="a"/></bsdf>',
            "stands in itself, by a reference",
        ),
    ],
)
def test_ids_that_do_not_work(refused, body, problem):
    assert problem in refused(body)


def test_names_from_places(load):
    scene = load(
        '<shape type="sphere"/><shape type="sphere" id="box"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf>'
        '<emitter type="area"/></shape><shape type="disk"/><sensor type="perspective" id="left"/>'
        '<sensor type="perspective"/><sensor type="orthographic"/><emitter type="constant"/>'
    )
    assert [shape.id for shape in scene.shapes] == ["shape_0", "box", "shape_2"]
    assert [sensor.id for sensor in scene.sensors] == ["left", "sensor", "sensor_1"]
    box = scene.shapes[1]
    assert (box.bsdf.id, box.bsdf.bsdf.id, box.emission_id) == ("box.bsdf", "box.bsdf.bsdf", "box.emitter")
    assert scene.shapes[0].bsdf.id == "shape_0.bsdf" and scene.enclosure.id == "enclosure"


def test_name_from_place_gives_way_to_an_id(load):
    ids = [shape.id for shape in load('<shape type="sphere"/><shape type="sphere" id="shape_0"/>').shapes]
    assert ids[1] == "shape_0" and ids[0] != "shape_0"


def test_include_of_a_scene_with_its_defaults_and_ids(load, tmp_path):
    inner = '<default name="r" value="5"/><bsdf type="diffuse" id="red"/>' + SPHERE
    write(tmp_path, "parts/inner.xml", scene(inner))
    outer = (
        '<include filename="parts/$f"/><shape type="sphere"><float name="radius" value="$r"/><ref id="red"/></shape>'
    )
    shapes = load(outer, f="inner.xml").shapes
    assert [shape.radius for shape in shapes] == [1, 5] and shapes[1].bsdf.id == "red"


def test_include_of_one_object(load, tmp_path):
    write(
        tmp_path,
        "red.xml",
        '<bsdf version="3.0.0" type="diffuse" id="red"><float name="reflectance" value=".1"/></bsdf>',
    )
    assert material(load, '<include filename="red.xml"/>').reflectance == 0.1
    assert only(load, '<include filename="red.xml"/><shape type="disk"><ref id="red"/></shape>').bsdf.id == "red"


def test_includes_search_from_the_including_file_and_meshes_from_the_main_one(load, tmp_path):
    write(tmp_path, "a/one.xml", scene('<include filename="two.xml"/>'))
    write(tmp_path, "a/two.xml", scene('<shape type="obj"><string name="filename" value="m/t.obj"/></shape>'))
    write(tmp_path, "m/t.obj", TENT + "f 1 2 3\n")
    assert len(only(load, '<include filename="a/one.xml"/>').faces) == 1


def test_path_is_searched_first(load, tmp_path):
    write(tmp_path, "t.obj", TENT + "f 1 2 3\n")
    write(tmp_path, "more/t.obj", TENT + "f 1 2 3 4\n")
    shape = '<shape type="obj"><string name="filename" value="t.obj"/></shape>'
    assert len(only(load, shape).faces) == 1
    assert len(only(load, '<path value="more"/>' + shape).faces) == 2
    assert len(only(load, shape + f'<path value="{tmp_path / "more"}"/>').faces) == 2


@pytest.mark.parametrize(
    "body, problem",
    [
        ('<include filename="nowhere.xml"/>', "scene.xml:2: <include>: no such file: 'nowhere.xml'"),
        ('<include filename=""/>', "no such file"),
        ('<include filename="."/>', "no such file"),
        ("<include/>", "has no filename"),
        ('<include filename="scene.xml"/>', "in which it stands itself"),
        ('<include filename="a.xml" as="b"/>', "has no attribute 'as'"),
        ('<path value="nowhere"/>', "no such folder"),
        ('<shape type="sphere"><path value="."/></shape>', "move it to the top"),
    ],
)
def test_includes_and_paths_that_do_not_work(refused, body, problem):
    assert problem in refused(body)


def test_include_cycle_over_two_files(load, tmp_path):
    write(tmp_path, "a.xml", scene('<include filename="b.xml"/>'))
    write(tmp_path, "b.xml", scene('<include filename="a.xml"/>'))
    with pytest.raises(SceneError, match=r"b\.xml:2: <include>: includes a\.xml, in which it stands itself"):
        load('<include filename="a.xml"/>')


def test_include_bomb(load, tmp_path):
    for i in range(20):
        write(tmp_path, f"{i}.xml", scene(f'<include filename="{i + 1}.xml"/>' * 2))
    write(tmp_path, "20.xml", scene(SPHERE))
    with pytest.raises(SceneError, match="more than 1000 includes"):
        load('<include filename="0.xml"/>')


def test_mistake_in_an_included_file_is_said_there(load, tmp_path):
    write(tmp_path, "inner.xml", scene('\n<shape type="torus"/>'))
    with pytest.raises(SceneError, match=r'inner\.xml:3: <shape type="torus">: is not supported'):
        load('<include filename="inner.xml"/>')


# ------------------------------------------------------------------------------------- files and XML


@pytest.mark.parametrize(
    "version, problem",
    [
        ("0.6.0", "snake_case"),
        ("1.2.3", "snake_case"),
        ("3", "not three numbers"),
        ("new", "not three numbers"),
    ],
)
def test_old_and_wrong_versions(tmp_path, version, problem):
    with pytest.raises(SceneError, match=problem):
        mitsuba.load(write(tmp_path, "scene.xml", scene(SPHERE, version)), {})


def test_included_files_have_versions_too(load, tmp_path):
    write(tmp_path, "old.xml", scene("", "0.5.0"))
    with pytest.raises(SceneError, match=r"old\.xml:1: <scene>: is in the old format 0\.5\.0; upgrade it"):
        load('<include filename="old.xml"/>')


BOMB = '<!DOCTYPE s [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>' + scene('<shape type="&b;"/>')


@pytest.mark.parametrize(
    "text, problem",
    [
        (BOMB, "defines an XML entity, which is refused"),
        ('<!DOCTYPE s [<!ENTITY x SYSTEM "file:///etc/hostname">]>' + scene("&x;"), "is refused"),
        ('<!DOCTYPE s SYSTEM "s.dtd">' + scene("&x;"), "refused|not well-formed"),
        ("", "not well-formed"),
        ("<scene", "not well-formed"),
        ('<scene version="3.0.0"><shape></scene>', "scene.xml:1: not well-formed XML .mismatched tag"),
        (scene(SPHERE) + "<scene/>", "not well-formed"),
        (scene("&nbsp;"), "not well-formed"),
        (scene("<shape type='a' type='b'/>"), "not well-formed"),
        ('<?xml version="1.0" encoding="klingon"?>' + scene(SPHERE), "encoding"),
        ("<scene/>", "has no version"),
        ('<bsdf version="3.0.0" type="diffuse"/>', "put it into a <scene>"),
        ('<html version="3.0.0"/>', "put it into a <scene>"),
        ('<scene version="3.0.0" colour="red"/>', "has no attribute 'colour'"),
        (scene("<a>" * 5000 + "</a>" * 5000), "deeper than 64"),
        (scene(""), "has no shapes"),
    ],
)
def test_files_that_are_no_scene(tmp_path, text, problem):
    with pytest.raises(SceneError, match=problem) as error:
        mitsuba.load(write(tmp_path, "scene.xml", text), {})
    assert "scene.xml" in str(error.value) and str(error.value).isprintable()


@pytest.mark.parametrize("name", ["nowhere.xml", ".", "a\0b", "x" * 5000])
def test_file_that_is_not_there(tmp_path, name):
    with pytest.raises(SceneError, match="no such file"):
        mitsuba.load(tmp_path / name, {})


@pytest.mark.parametrize(
    ("data", "more", "problem"),
    [
        (b"", "", "is not a grid of values"),
        (volume(ROUND)[:-4], "", "holds other than 3 x 3 x 3 values"),
        (volume(ROUND, version=2), "", "is of version 2"),
        (volume(ROUND, kind=2), "", "type 2; export it"),
        (volume(np.stack([ROUND] * 2, -1)), "", "has 2 channels; give a grid of one"),
        (volume(ROUND), '<string name="normals" value="flat"/>', "normals: is 'flat'; give smooth or analytic"),
        (volume(ROUND), '<emitter type="area"/>', "emits, which a grid of distances cannot"),
        (volume(ROUND + 9), "", "has samples of one sign only"),
    ],
)
def test_grids_of_distances(tmp_path, data, more, problem):
    (tmp_path / "a.vol").write_bytes(data)
    path = tmp_path / "scene.xml"
    shape = f'<shape type="sdfgrid"><string name="filename" value="a.vol"/>{more}</shape>'
    path.write_text(f'<scene version="3.0.0">{shape}</scene>')
    with pytest.raises(SceneError, match="sdfgrid.*" + problem):
        mitsuba.load(path, {})


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(SceneError, match="not well-formed"):
        mitsuba.load(path, {})


@pytest.mark.parametrize(
    "body, problem",
    [
        ("<foo/>", "<foo>: is not an element of Mitsuba 3"),
        ("<shape/>", "<shape>: has no type"),
        ('<shape type="sphere" colour="red"/>', "has no attribute 'colour'"),
        ('<shape type="torus"/>', '<shape type="torus">: is not supported; use rectangle, cube'),
        ('<shape type="instance"/>', "refers to no shapegroup"),
        ('<shape type="heightfield"/>', "is not supported; use rectangle"),
        ('<shape type="instance"><shape type="sphere"/></shape>', "refers to no shapegroup"),
        ('<shape type="sdfgrid"/>', "no such file"),
        ('<shape type="bsplinecurve"/>', "is not supported; make a mesh of the curves"),
        ('<shape type="linearcurve"/>', "is not supported; make a mesh of the curves"),
        ('<shape type="ellipsoids"/>', "is not supported; make a mesh of each ellipsoid"),
        ('<shape type="serialized"/>', "no such file"),
        ('<shape type="merge"/>', "has no shapes; add a <shape>"),
        ('<shape type="merge"><bsdf type="diffuse"/></shape>', '<bsdf type="diffuse">: is not supported in <shape'),
        (
            '<shape type="shapegroup" id="g"><shape type="sphere" id="s"/></shape><shape type="instance"><ref id="g"/>'
            '<transform name="to_world"><scale x="2"/></transform></shape>',
            '<shape type="instance">: s.to_world: scales unevenly',
        ),
        ('<shape type="merge" id="m"><ref id="m"/></shape>', "stands in itself, by a reference; break the cycle"),
        (
            '<bsdf type="mask" id="a"><ref id="b"/></bsdf><bsdf type="mask" id="b"><ref id="a"/></bsdf>',
            "stands in itself, by a reference; break the cycle",
        ),
        (
            "".join(f'<bsdf type="mask" id="{k}"><ref id="{k + 1}"/></bsdf>' for k in range(99))
            + '<bsdf type="null" id="99"/>',
            "is nested deeper than 64 elements, references followed",
        ),
        ('<shape type="shapegroup"/>', "has no shapes"),
        (
            '<shape type="shapegroup" id="g"><shape type="shapegroup"><shape type="cube"/></shape></shape>',
            "holds a group or an instance",
        ),
        ('<shape type="sphere"><shape type="sphere"/></shape>', "is not supported in <shape"),
        ('<shape type="sphere"><medium type="homogeneous" name="interior"/></shape>', "is not supported in <shape"),
        ('<shape type="sphere"><texture type="bitmap"/></shape>', "is not supported in <shape"),
        ('<shape type="sphere"><bsdf type="diffuse"/><bsdf type="diffuse"/></shape>', "has 2 <bsdf>; keep one"),
        ('<shape type="sphere"><emitter type="constant"/></shape>', "use an area emitter there"),
        (
            '<shape type="sphere"><emitter type="area"><transform name="to_world"/></emitter></shape>',
            "moves with its shape",
        ),
        ('<emitter type="timed_sunsky"/>', '<emitter type="timed_sunsky">: is not supported; use point'),
        ('<emitter type="sun"/>', "is not supported; use point"),
        (
            '<shape type="sphere"><emitter type="directionalarea"><transform name="to_world"/></emitter></shape>',
            "moves with its shape",
        ),
        (
            '<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>'
            '<shape type="sphere"><emitter type="directionalarea"/></shape>',
            "is hidden by hide_emitters",
        ),
        (
            '<integrator type="moment"><integrator type="ptracer"/></integrator>'
            '<shape type="sphere"><emitter type="directionalarea"/></shape>',
            "is seen by the light tracing of ptracer",
        ),
        ('<emitter type="constant"/><emitter type="constant"/>', "second environment"),
        ('<integrator type="depth"/>', "give --aov depth"),
        ('<integrator type="path"/><integrator type="path"/>', "second integrator"),
        ('<integrator type="moment"/>', "has 0 integrators"),
        ('<integrator type="moment"><integrator type="moment"/></integrator>', "is not supported"),
        ('<integrator type="path"><integer name="max_depth" value="-2"/></integrator>', "max_depth: is -2"),
        ('<integrator type="path"><integer name="rr_depth" value="0"/></integrator>', "rr_depth: is 0"),
        ('<integrator type="path"><float name="max_depth" value="2"/></integrator>', "write it as <integer>"),
        ("<scene/>", "has no type"),
        ('<scene type="scene"/>', "stands inside a scene"),
        ('<lookat origin="0 0 0" target="1 0 0"/>', "stands outside a <transform>"),
        ('<float name="x"/>', "has no value"),
        ('<float value="1"/>', "has no name"),
        ('<float name="x" value="1"><float name="y" value="1"/></float>', "cannot stand in <float>"),
        ('<ref id="a"><float name="y" value="1"/></ref>', "cannot stand in <ref>"),
    ],
)
def test_what_is_refused_by_name(refused, body, problem):
    assert problem in refused(body)


@pytest.mark.parametrize(
    "element, problem",
    [
        ('<float name="radius" value="big"/>', "not a number"),
        ('<float name="radius" value="1 2"/>', "not a number"),
        ('<float name="radius" value="nan"/>', "not a number"),
        ('<float name="radius" value="1e400"/>', "not a finite number"),
        ('<float name="radius" value="-1"/>', "shape_0.radius: is -1"),
        ('<float name="radius" value="0"/>', "give a positive one"),
        ('<integer name="radius" value="1.5"/>', "is not an integer"),
        ('<integer name="radius" value="99999999999999999999"/>', "is not an integer"),
        ('<boolean name="flip_normals" value="yes"/>', "write true or false"),
        ('<float name="flip_normals" value="1"/>', "write it as <boolean>"),
        ('<point name="center" x="1" y="2"/>', "has no z"),
        ('<point name="center" value="1 2"/>', "has 2 numbers"),
        ('<point name="center" value="1" x="1"/>', "only one kind"),
        ('<rgb name="center" value="1 2 3"/>', "write it as <point>"),
        ('<float name="radius" value="1"/><float name="radius" value="1"/>', "given twice"),
        ('<transform name="to_world"><scale x="2"/></transform>', "scales unevenly"),
        ('<transform name="to_world"><scale x="0"/></transform>', "is singular"),
        ('<transform name="to_world"><scale value="1e200"/><scale value="1e200"/></transform>', "too large"),
    ],
)
def test_bad_values(refused, element, problem):
    message = refused(f'<shape type="sphere">\n{element}</shape>')
    assert problem in message and re.match(r"scene\.xml:[23]: <", message)


def test_messages_do_not_quote_the_file(load, tmp_path):
    write(tmp_path, "secret.xml", scene('<shape type="sphere"><float name="radius" value="hunter2"/></shape>'))
    write(tmp_path, "secret.txt", "hunter2")
    for name in ("secret.xml", "secret.txt"):
        with pytest.raises(SceneError) as problem:
            load(f'<include filename="{name}"/>')
        assert "hunter2" not in str(problem.value)


def test_unknown_parameters_are_noted(load):
    notes = load('<shape type="sphere" id="a"><float name="size" value="1"/>text</shape>').notes
    assert len(notes) == 2 and "holds text" in notes[0]
    assert notes[1].endswith('scene.xml:2: <float name="size">: is not a parameter of sphere, and is ignored')


def test_nothing_to_note(load):
    body = (
        '<bsdf type="diffuse" id="a"/><shape type="sphere"><ref id="a"/></shape><bsdf type="diffuse" id="spare"/>'
        '<film type="hdrfilm" id="f"/><sensor type="perspective"><ref id="f"/></sensor>'
        "<emitter type='area' id='lamp'/><shape type='disk'><ref id='lamp'/></shape>"
    )
    assert load(body).notes == []


def test_what_nothing_refers_to_is_noted(load):
    body = '<bsdf type="hair" id="glass"/><emitter type="area"/><medium type="homogeneous" id="fog"/>'
    notes = load(body).notes
    assert len(notes) == 3 and all("nothing refers to it" in note for note in notes)
    assert any("hair" in note and "is not supported" in note for note in notes)


def test_unsupported_material_in_use_is_refused(refused):
    message = refused('<bsdf type="hair" id="glass"/>\n<shape type="sphere"><ref id="glass"/></shape>')
    assert message.startswith('scene.xml:2: <bsdf type="hair" id="glass">: is not supported; use diffuse')


# ---------------------------------------------------------------------------------------- transforms

TRANSFORMS = [
    '<translate x="1"/><scale x="2"/>',
    '<scale x="2"/><translate x="1"/>',
    '<translate value="1"/>',
    '<translate value="1 2 3"/>',
    '<translate value=" 1,2 , 3"/>',
    '<translate y="1e1" z="-.5"/>',
    "<translate/>",
    '<scale value="3"/>',
    '<scale value="1,2,3"/>',
    '<scale y="-2"/>',
    '<rotate x="1" angle="90"/>',
    '<rotate value="0,0,1" angle="-30"/>',
    '<rotate y="0.6" z="0.8" angle="77"/>',
    '<rotate x="1" y="2" angle="30"/>',
    '<rotate value="1" angle="40"/>',
    '<lookat origin="1,2,3" target="2 5 -3" up="0,1,0"/>',
    '<lookat origin="0,0,0" target="1,2,3"/>',
    '<lookat origin="0,0,0" target="1,2,-3" up="0 0 0"/>',
    '<lookat origin="0,0,0" target="0,0,-1"/>',
    '<lookat origin="0,0,0" target="0,-1,0"/>',
    '<matrix value="1 2 3 4 5 6 7 8 10"/>',
    '<matrix value="1 2 3 4, 5 6 7 8, 10 11 12 14, 0 0 0 1"/><rotate z="1" angle="10"/><translate x="3"/>',
]


def test_later_transforms_are_applied_after_earlier_ones(load):
    assert to_world(load, TRANSFORMS[0])[0].tolist() == [2, 0, 0, 2]
    assert to_world(load, TRANSFORMS[1])[0].tolist() == [2, 0, 0, 1]


def test_rotation_and_look_at(load):
    np.testing.assert_allclose(to_world(load, '<rotate z="1" angle="90"/>') @ [1, 0, 0, 1], [0, 1, 0, 1], atol=1e-15)
    m = to_world(load, '<lookat origin="1,2,3" target="1,2,8" up="0,2,0"/>')
    np.testing.assert_allclose(m, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-15)


def test_look_at_without_up_is_a_rotation(load):
    m = to_world(load, '<lookat origin="0,0,0" target="1,2,3"/>')[:3, :3]
    np.testing.assert_allclose(m.T @ m, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(m[:, 2], np.array([1, 2, 3]) / 14**0.5)
    assert np.linalg.det(m) > 0


def test_matrix_of_nine_is_the_linear_part(load):
    m = to_world(load, '<matrix value="1 2 3 4 5 6 7 8 10"/>')
    assert m[:3, :3].tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 10]] and m[:, 3].tolist() == [0, 0, 0, 1]


def test_rotation_axis_is_not_normalised_and_this_is_noted(load):
    body = '<shape type="rectangle"><transform name="to_world"><rotate x="2" angle="90"/></transform></shape>'
    scene = load(body)
    np.testing.assert_allclose(np.diag(scene.shapes[0].to_world), [4, 0, 0, 1], atol=1e-15)
    assert len(scene.notes) == 1 and "axis of length 2" in scene.notes[0]


@pytest.mark.parametrize(
    "body, problem",
    [
        ('<rotate angle="90"/>', "axis is zero"),
        ('<rotate x="1"/>', "has no angle"),
        ('<lookat origin="0,0,0" target="0,1,0" up="0,2,0"/>', "up is along the view"),
        ('<lookat origin="1,2,3" target="1,2,3"/>', "coincide"),
        ('<lookat origin="1,2" target="1,2,3"/>', "three numbers each"),
        ('<lookat target="1,2,3"/>', "has no origin"),
        ('<look_at origin="0,0,0" target="1,2,3"/>', "write <lookat>"),
        ('<lookAt origin="0,0,0" target="1,2,3"/>', "write <lookat>"),
        ('<matrix value="1 2 3"/>', "9 or 16 numbers, not 3"),
        ('<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1"/>', "perspective"),
        ('<translate value="1 2"/>', "2 numbers"),
        ('<translate value="1;2;3"/>', "not a number"),
        ('<translate value="1" x="1"/>', "only one kind"),
        ('<translate w="1"/>', "has no attribute 'w'"),
        ('<scale x="one"/>', "not a number"),
        ('<float name="x" value="1"/>', "cannot stand in <transform>"),
        ('<translate x="1"><scale x="1"/></translate>', "cannot stand in <translate>"),
    ],
)
def test_transforms_that_do_not_work(refused, body, problem):
    assert problem in refused(f'<shape type="disk"><transform name="to_world">{body}</transform></shape>')


# ---------------------------------------------------------------------------------------------- bsdfs


@pytest.mark.parametrize(
    "given, expected",
    [
        ("", [0.5]),
        ('<float name="reflectance" value=".25"/>', [0.25]),
        ('<integer name="reflectance" value="1"/>', [1]),
        ('<rgb name="reflectance" value="0.3"/>', [0.3, 0.3, 0.3]),
        ('<rgb name="reflectance" value="0.1 0.2 0.3"/>', [0.1, 0.2, 0.3]),
        ('<rgb name="reflectance" value="0.1, 0.2 ,0.3"/>', [0.1, 0.2, 0.3]),
        ('<spectrum name="reflectance" value="0.7"/>', [0.7]),
        ('<spectrum name="reflectance" value="400:.1,700:.8"/>', [0.662438, 0.433495, 0.19472]),
        ('<spectrum name="reflectance" type="uniform"><float name="value" value=".3"/></spectrum>', [0.3]),
        ('<spectrum name="reflectance" type="srgb"><rgb name="color" value=".3,.1,.2"/></spectrum>', [0.3, 0.1, 0.2]),
        ('<spectrum name="reflectance" type="rawconstant"><float name="value" value=".3"/></spectrum>', [0.3]),
    ],
)
def test_reflectance_in_all_forms(load, given, expected):
    made = material(load, f'<bsdf type="diffuse">{given}</bsdf>')
    assert isinstance(made, parts.Diffuse)
    np.testing.assert_allclose(made.reflectance, expected, rtol=1e-5)


@pytest.mark.parametrize(
    "given, problem",
    [
        ('<rgb name="reflectance" value="#ff8000"/>', "hexadecimal"),
        ('<rgb name="reflectance" value=".1 .2"/>', "has 2 numbers"),
        ('<rgb name="reflectance" value="2"/>', "shape_0.bsdf.reflectance: is 2"),
        ('<rgb name="reflectance" value="-1"/>', "is -1"),
        ('<rgb name="reflectance" value="nan"/>', "not a number"),
        ('<spectrum name="reflectance" value="2"/>', "is 2"),
        ('<spectrum name="reflectance" value="500:1"/>', "at least two wavelengths"),
        ('<spectrum name="reflectance" value="500:1,400:1"/>', "do not increase"),
        ('<spectrum name="reflectance" value="400: 1, 500: 1"/>', "no space after a colon"),
        ('<spectrum name="reflectance" value="400:1,500:x"/>', "not a number"),
        ('<spectrum name="reflectance" value="400:1,500"/>', "is not a list of"),
        ('<spectrum name="reflectance"/>', "neither value nor filename"),
        ('<spectrum name="reflectance" filename="none.spd"/>', "no such file"),
        ('<spectrum name="reflectance" type="blackbody"/>', "is not supported as a colour"),
        ('<texture name="reflectance" type="bitmap"/>', "no such file"),
        ('<string name="reflectance" value="red"/>', "write it as <rgb>"),
        ('<vector name="reflectance" value="1 1 1"/>', "write it as <rgb>"),
        ('<bsdf type="diffuse"/>', "is not supported in <bsdf"),
    ],
)
def test_reflectance_that_does_not_work(refused, given, problem):
    assert problem in refused(f'<shape type="sphere"><bsdf type="diffuse">{given}</bsdf></shape>')


def test_clipped_spectrum_is_noted(load):
    body = '<shape type="sphere"><bsdf type="diffuse"><spectrum name="reflectance" value="400:0,500:8"/></bsdf></shape>'
    assert "outside the sRGB gamut" in load(body).notes[0]


def test_spectrum_from_a_file(load, tmp_path):
    write(tmp_path, "data/s.spd", "400 0.1\n700 0.8\n")
    made = material(load, '<bsdf type="diffuse"><spectrum name="reflectance" filename="data/s.spd"/></bsdf>')
    np.testing.assert_allclose(made.reflectance, [0.662438, 0.433495, 0.19472], rtol=1e-5)


def test_mistake_in_a_spectrum_file_names_both(refused, tmp_path):
    write(tmp_path, "s.spd", "400 0.1\n700 high\n")
    message = refused(
        '<shape type="sphere"><bsdf type="diffuse"><spectrum name="reflectance" filename="s.spd"/></bsdf></shape>'
    )
    assert message.startswith('scene.xml:2: <spectrum name="reflectance">: s.spd:2: not two numbers')


@pytest.mark.parametrize(
    "plugin, given, alpha, eta, k",
    [
        ("conductor", "", [0, 0], [0], [1]),
        ("conductor", '<string name="material" value="none"/>', [0, 0], [0], [1]),
        ("conductor", '<float name="eta" value=".2"/>', [0, 0], [0.2], [1]),
        ("conductor", '<rgb name="eta" value="1 2 3"/><float name="k" value="3"/>', [0, 0], [1, 2, 3], [3]),
        (
            "conductor",
            '<string name="material" value="Au"/>',
            [0, 0],
            [0.143036, 0.375307, 1.44205],
            [3.983, 2.38556, 1.60336],
        ),
        ("conductor", '<spectrum name="eta" value="400:1.5,700:2"/>', [0, 0], [1.89509, 1.73786, 1.56038], [1]),
        ("roughconductor", "", [0.1, 0.1], [0], [1]),
        ("roughconductor", '<float name="alpha" value=".3"/>', [0.3, 0.3], [0], [1]),
        ("roughconductor", '<float name="alpha" value="0"/>', [1e-4, 1e-4], [0], [1]),
        (
            "roughconductor",
            '<float name="alpha_u" value=".2"/><float name="alpha_v" value=".4"/>',
            [0.2, 0.4],
            [0],
            [1],
        ),
    ],
)
def test_conductors(load, plugin, given, alpha, eta, k):
    ggx = '<string name="distribution" value="ggx"/>' if plugin == "roughconductor" else ""
    made = material(load, f'<bsdf type="{plugin}">{ggx}{given}</bsdf>')
    assert isinstance(made, parts.Conductor)
    np.testing.assert_allclose(made.alpha, alpha)
    np.testing.assert_allclose(made.eta, eta, rtol=1e-5)
    np.testing.assert_allclose(made.k, k, rtol=1e-5)
    assert made.specular_reflectance.tolist() == [1]


def test_distributions(load):
    made = [material(load, f'<bsdf type="roughconductor">{d}</bsdf>').distribution for d in ("", GGX)]
    assert made == ["beckmann", "ggx_separable"]


def test_glass_and_plastic(load):
    glass = material(load, '<bsdf type="dielectric"/>')
    assert (glass.int_ior, glass.ext_ior, glass.thin) == (1.5046, 1.000277, False)
    assert glass.specular_reflectance.tolist() == glass.specular_transmittance.tolist() == [1]
    thin = material(load, '<bsdf type="thindielectric"><float name="int_ior" value="2"/></bsdf>')
    assert (thin.int_ior, thin.thin) == (2.0, True)
    rough = material(load, '<bsdf type="roughdielectric"/>')
    assert (rough.int_ior, rough.distribution, rough.alpha) == (1.5046, "beckmann", [0.1, 0.1])
    rough = material(load, f'<bsdf type="roughplastic">{GGX}<float name="alpha" value=".3"/></bsdf>')
    assert (rough.int_ior, rough.distribution, rough.alpha) == (1.49, "ggx", [0.3, 0.3])
    paint = material(load, '<bsdf type="plastic"><string name="ext_ior" value="Water"/></bsdf>')
    assert (paint.int_ior, paint.ext_ior, paint.nonlinear) == (1.49, 1.333, False)
    assert (paint.diffuse_reflectance, paint.specular_reflectance) == (0.5, 1.0)
    assert isinstance(material(load, '<bsdf type="null"/>'), parts.Null)


GGX = '<string name="distribution" value="ggx"/>'


def test_specular_reflectance(load):
    made = material(load, '<bsdf type="conductor"><rgb name="specular_reflectance" value=".1 .2 .3"/></bsdf>')
    assert made.specular_reflectance.tolist() == [0.1, 0.2, 0.3]


def test_principled_surfaces(load):
    shape = '<shape type="sphere"><bsdf type="principled{}">{}</bsdf></shape>'
    number = '<float name="{}" value="{}"/>'
    numbers = {"metallic": 0.2, "specular": 0.3, "clearcoat_gloss": 0.4, "main_specular_sampling_rate": 3}
    body = '<rgb name="base_color" value=".1,.2,.3"/>' + "".join(number.format(*pair) for pair in numbers.items())
    read = load(shape.format("", body) + shape.format("thin", number.format("diff_trans", 1.5)))
    solid, thin = (s.bsdf for s in read.shapes)
    assert read.notes == []
    want = parts.Principled([0.1, 0.2, 0.3], metallic=0.2, specular=0.3, clearcoat_gloss=0.4, id=solid.id)
    assert str(solid) == str(want)
    assert str(thin) == str(parts.PrincipledThin(diff_trans=1.5, id=thin.id))


@pytest.mark.parametrize(
    "body, problem",
    [
        ('<bsdf type="conductor"><string name="material" value="au"/></bsdf>', "did you mean Au"),
        (
            '<bsdf type="conductor"><string name="material" value="Au"/><float name="k" value="1"/></bsdf>',
            "only one kind",
        ),
        ('<bsdf type="conductor"><float name="eta" value="-1"/></bsdf>', "eta: is -1"),
        ('<bsdf type="roughconductor"><string name="distribution" value="phong"/></bsdf>', "'phong' is not known"),
        ('<bsdf type="dielectric"><string name="int_ior" value="bk-7"/></bsdf>', "did you mean bk7"),
        ('<bsdf type="plastic"><float name="int_ior" value="0"/></bsdf>', "int_ior: is 0"),
        ('<bsdf type="twosided"/>', "has 0 BSDFs inside"),
        ('<bsdf type="twosided"><bsdf type="roughdielectric"/></bsdf>', "holds what transmits"),
        (
            '<bsdf type="roughplastic"><float name="alpha_u" value=".1"/><float name="alpha_v" value=".2"/></bsdf>',
            "is one",
        ),
        (
            '<bsdf type="twosided"><bsdf type="diffuse"/><bsdf type="diffuse"/><bsdf type="diffuse"/></bsdf>',
            "has 3 BSDFs inside",
        ),
        ('<bsdf type="twosided"><bsdf type="null"/></bsdf>', "holds what transmits"),
        ('<bsdf type="hair"/>', "is not supported"),
        (
            '<bsdf type="principled"><float name="eta" value="1.5"/><float name="specular" value="0"/></bsdf>',
            "give one",
        ),
        ('<bsdf type="principled"><float name="metallic" value="2"/></bsdf>', "metallic: is 2"),
        ('<bsdf type="principledthin"><rgb name="roughness" value="0,0,1"/></bsdf>', "roughness is a colour"),
        ('<bsdf type="twosided"><bsdf type="principledthin"/></bsdf>', "holds what transmits"),
        (
            '<bsdf type="twosided"><bsdf type="principled"><float name="spec_trans" value=".1"/></bsdf></bsdf>',
            "holds what transmits",
        ),
    ],
)
def test_bsdfs_that_do_not_work(refused, body, problem):
    assert problem in refused(f'<shape type="sphere">{body}</shape>')


@pytest.mark.parametrize(
    "given", ['<float name="alpha_u" value=".1"/>', '<float name="alpha" value="1"/><float name="alpha_v" value="1"/>']
)
def test_half_a_roughness(refused, given):
    body = f'<bsdf type="roughconductor"><string name="distribution" value="ggx"/>{given}</bsdf>'
    assert "only part of its roughness" in refused(f'<shape type="sphere">{body}</shape>')


def test_twosided_shares_what_is_inside(load):
    body = '<bsdf type="conductor" id="m"/><shape type="sphere"><ref id="m"/></shape>'
    a, b = load(body + '<shape type="disk"><bsdf type="twosided" id="t"><ref id="m"/></bsdf></shape>').shapes
    assert isinstance(b.bsdf, parts.TwoSided) and b.bsdf.id == "t" and b.bsdf.bsdf is a.bsdf


# --------------------------------------------------------------------------------- shapes and emitters


def test_shapes_of_closed_form(load):
    shapes = load(
        "".join(f'<shape type="{kind}"/>' for kind in ("rectangle", "cube", "disk", "sphere", "cylinder"))
    ).shapes
    assert [type(s) for s in shapes] == [parts.Rectangle, parts.Cube, parts.Disk, parts.Sphere, parts.Cylinder]
    assert all((s.to_world == np.eye(4)).all() and not s.flip_normals and s.emission is None for s in shapes)
    sphere, cylinder = shapes[3:]
    assert sphere.center.tolist() == [0, 0, 0] and sphere.radius == 1
    assert (cylinder.p0.tolist(), cylinder.p1.tolist(), cylinder.radius) == ([0, 0, 0], [0, 0, 1], 1)


def test_parameters_of_shapes(load):
    sphere, cylinder = load(
        '<shape type="sphere"><point name="center" value="1 2 3"/><float name="radius" value="2"/>'
        '<boolean name="flip_normals" value="TRUE"/></shape><shape type="cylinder"><point name="p0" x="1" y="0" z="0"/>'
        '<vector name="p1" value="4"/><integer name="radius" value="2"/></shape>'
    ).shapes
    assert sphere.center.tolist() == [1, 2, 3] and sphere.radius == 2 and sphere.flip_normals
    assert (cylinder.p0.tolist(), cylinder.p1.tolist(), cylinder.radius) == ([1, 0, 0], [4, 4, 4], 2)


def test_mirrored_sphere_faces_inwards(load):
    mirrored = '<transform name="to_world"><scale x="-1"/></transform>'
    assert only(load, f'<shape type="sphere">{mirrored}</shape>').flip_normals
    assert not only(load, f'<shape type="rectangle">{mirrored}</shape>').flip_normals


def test_stretched_cylinder_is_a_longer_one(load):
    made = only(
        load,
        '<shape type="cylinder"><point name="p0" value="1 0 1"/><point name="p1" value="1 0 3"/>'
        '<transform name="to_world"><scale x="2" y="2" z="5"/><rotate x="1" angle="90"/><translate x="7"/></transform>'
        "</shape>",
    )
    ends = [(made.to_world @ [*p, 1])[:3] for p in (made.p0, made.p1)]
    np.testing.assert_allclose(ends, [[9, -5, 0], [9, -15, 0]], atol=1e-12)
    np.testing.assert_allclose(made.to_world[:3, :3].T @ made.to_world[:3, :3], np.eye(3), atol=1e-12)
    assert made.radius == pytest.approx(2)


def test_elliptic_cylinder_is_refused(refused):
    body = '<shape type="cylinder"><transform name="to_world"><scale x="2"/></transform></shape>'
    assert "scales unevenly" in refused(body)


def test_emitter_makes_the_default_bsdf_black(load):
    assert only(load, '<shape type="disk"><emitter type="area"/></shape>').bsdf.reflectance == 0
    assert only(load, '<shape type="disk"><emitter type="area"/><bsdf type="diffuse"/></shape>').bsdf.reflectance == 0.5


@pytest.mark.parametrize(
    "given, expected",
    [
        ("", [1]),
        ('<float name="radiance" value="2"/>', [2]),
        ('<rgb name="radiance" value="2"/>', [2, 2, 2]),
        ('<spectrum name="radiance" value="2"/>', [2.40959, 1.89658, 1.81783]),
        ('<spectrum name="radiance" value="400:.1,700:.8"/>', [0.778184, 0.413256, 0.169932]),
        ('<spectrum name="radiance" type="d65"/>', [1]),
        ('<spectrum name="radiance" type="d65"><float name="scale" value="3"/></spectrum>', [3]),
        ('<spectrum name="radiance" type="d65"><rgb name="color" value=".5 .2 .3"/></spectrum>', [0.5, 0.2, 0.3]),
    ],
)
def test_radiance_in_all_forms(load, given, expected):
    area = only(load, f'<shape type="disk"><emitter type="area">{given}</emitter></shape>').emission
    np.testing.assert_allclose(area, expected, rtol=1e-5)
    np.testing.assert_allclose(
        load(f'<emitter type="constant">{given}</emitter>').enclosure.radiance, expected, rtol=1e-5
    )


def test_no_emitter_is_no_enclosure(load):
    assert load("").enclosure is None


def test_negative_radiance_is_refused(refused):
    body = '<emitter type="area" id="lamp"><rgb name="radiance" value="-1"/></emitter>'
    assert "lamp.radiance: is -1" in refused(f'<shape type="disk">{body}</shape>')


# --------------------------------------------------------------------------------------------- meshes


def mesh(load, tmp_path, faces, given="", name="t.obj"):
    write(tmp_path, name, TENT + faces)
    return only(load, f'<shape type="{name[-3:]}"><string name="filename" value="{name}"/>{given}</shape>')


def test_smooth_normals_by_angle(load, tmp_path):
    made = mesh(load, tmp_path, "f 1 2 3 4\nf 2 5 3\n")
    expected = [-0.31581, -0.42433, 0.84865]  # from Mitsuba 3.9.1
    np.testing.assert_allclose(made.normals[1], expected, atol=1e-5)


def test_normals_are_computed_in_the_world(load, tmp_path):
    squash = '<transform name="to_world"><scale x="-3" y="2"/></transform>'
    made = mesh(load, tmp_path, "f 1 2 3 4\nf 2 5 3\n", squash)
    world = made.normals @ np.linalg.inv(made.to_world[:3, :3])
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    np.testing.assert_allclose(world[1], [-0.15184, 0.23972, -0.95889], atol=1e-5)  # from Mitsuba 3.9.1
    np.testing.assert_allclose(np.linalg.norm(made.normals, axis=1), 1)


def test_face_normals_and_flat_meshes_have_none(load, tmp_path):
    assert mesh(load, tmp_path, "f 1 2 3 4\n", '<boolean name="face_normals" value="true"/>').normals is None
    assert mesh(load, tmp_path, "f 1 2 3\n").normals is None
    assert mesh(load, tmp_path, "f 1 2 3 4\n").normals is not None


def test_own_normals_decide_the_front(load, tmp_path):
    own = "vn 0 0 1\nvn 0 0 -1\nvn 0 1 1\n"
    mirror = '<transform name="to_world"><scale x="-1"/></transform>'
    assert mesh(load, tmp_path, own + "f 1//3 2//1 3//1\n").faces.tolist() == [[0, 1, 2]]
    assert mesh(load, tmp_path, own + "f 1//2 2//2 3//2\n").faces.tolist() == [[2, 1, 0]]
    mirrored = mesh(load, tmp_path, own + "f 1//3 2//1 3//1\n", mirror)
    assert mirrored.faces.tolist() == [[2, 1, 0]] and (mirrored.normals[:, 2] > 0).all()


def test_texture_coordinates_are_flipped_for_obj_only(load, tmp_path):
    assert mesh(load, tmp_path, "vt .1 .3\nf 1/1 2/1 3/1\n").uvs[0].tolist() == [0.1, 0.7]
    flip = '<boolean name="flip_tex_coords" value="{}"/>'
    assert mesh(load, tmp_path, "vt .1 .3\nf 1/1 2/1 3/1\n", flip.format("false")).uvs[0].tolist() == [0.1, 0.3]
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {k}\n" for k in "xyzst")
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    write(tmp_path, "t.ply", header + "0 0 0 .1 .25\n1 0 0 .1 .25\n0 1 0 .1 .25\n3 0 1 2\n")
    shape = '<shape type="ply"><string name="filename" value="t.ply"/>{}</shape>'
    np.testing.assert_allclose(only(load, shape.format("")).uvs[0], [0.1, 0.25], rtol=1e-6)
    np.testing.assert_allclose(only(load, shape.format(flip.format("true"))).uvs[0], [0.1, 0.75], rtol=1e-6)


def test_missing_and_broken_meshes(refused, tmp_path):
    body = '<shape type="obj"><string name="filename" value="t.obj"/></shape>'
    assert refused(body).startswith("scene.xml:2: <shape type=\"obj\">: no such file: 't.obj'")
    assert "no such file" in refused('<shape type="obj"/>')
    write(tmp_path, "t.obj", "v 0 0 0\nf 1 2 3\n")
    assert refused(body).startswith('scene.xml:2: <shape type="obj">: ') and "t.obj" in refused(body)


# -------------------------------------------------------------------------- sensors, films, integrators


def sensor(load, given="", kind="perspective"):
    (made,) = load(f'<sensor type="{kind}">{given}</sensor>').sensors
    return made


def test_sensor_with_mitsubas_defaults(load):
    scene = load('<sensor type="perspective"/>')
    made = scene.sensors[0]
    assert (made.kind, made.near, made.far, made.fov_axis) == ("perspective", 0.01, 1e4, "diagonal")
    assert made.fov == pytest.approx(46.793, abs=1e-4)  # 50 mm on film of 36 mm x 24 mm
    assert (made.film.width, made.film.height, made.film.filter, made.film.radius) == (768, 576, "gaussian", 2)
    assert scene.integrator == parts.Integrator(max_depth=-1, rr_depth=5, hide_emitters=False, spp=4)


PIXEL = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'
BATCH = '<sensor type="batch">{}</sensor>'
AHEAD = '<vector name="direction" x="2" y="0" z="0"/>'


def test_meters(load):
    at = '<point name="origin" x="1" y="2" z="3"/>'
    target = '<point name="target" x="4" y="5" z="6"/>'
    plain, away, over, side = load(
        f'<sensor type="radiancemeter">{at}{AHEAD}{PIXEL}</sensor><sensor type="distant">{AHEAD}{target}{PIXEL}</sensor>'
        f'<sensor type="distant"><shape type="disk" name="target"/>{PIXEL}</sensor>'
        '<shape type="sphere"><sensor type="irradiancemeter"/></shape>'
    ).sensors
    np.testing.assert_allclose(plain.to_world[:3, 2:].T, [[1, 0, 0], [1, 2, 3]], atol=1e-12)
    assert (plain.kind, away.kind, away.target.tolist()) == ("radiancemeter", "distant", [4, 5, 6])
    assert isinstance(over.target, parts.Disk) and isinstance(side.target, parts.Sphere)


def test_the_shape_of_a_meter_is_that_of_the_scene(load):
    scene = load('<shape type="cube" id="c"/><shape type="sphere"><sensor type="irradiancemeter"/></shape>')
    assert scene.sensors[0].target is scene.shapes[1]
    inner = '<sensor type="irradiancemeter"/>'
    batch = f'<sensor type="batch"><shape type="disk">{inner}</shape><sensor type="thinlens">{{}}</sensor></sensor>'
    lens = '<float name="aperture_radius" value=".1"/>'
    (made,) = load(batch.format(lens) + SPHERE).sensors
    assert [part.kind for part in made.sensors] == ["irradiancemeter", "thinlens"]


def test_scene_without_sensor(load):
    assert load("").sensors == []


@pytest.mark.parametrize("axis", ["x", "y", "smaller", "larger", "diagonal"])
def test_field_of_view(load, axis):
    made = sensor(load, f'<float name="fov" value="40"/><string name="fov_axis" value="{axis}"/>')
    assert (made.fov, made.fov_axis) == (40, axis)


def test_field_of_view_is_along_x(load):
    assert sensor(load, '<integer name="fov" value="40"/>').fov_axis == "x"


@pytest.mark.parametrize("text", ["35mm", "35", " 35.0 mm "])
def test_focal_length(load, text):
    made = sensor(load, f'<string name="focal_length" value="{text}"/>')
    assert made.fov == pytest.approx(np.degrees(2 * np.arctan(np.hypot(36, 24) / 70))) and made.fov_axis == "diagonal"


def test_thin_lens(load):
    made = sensor(load, '<float name="aperture_radius" value=".1"/><float name="far_clip" value="50"/>', "thinlens")
    assert (made.kind, made.aperture_radius, made.focus_distance) == ("thinlens", 0.1, 50)  # focus: far_clip


def test_orthographic_sensor_may_scale(load):
    made = sensor(load, '<transform name="to_world"><scale x="2" y="3"/></transform>', "orthographic")
    assert made.kind == "orthographic" and np.diag(made.to_world).tolist() == [2, 3, 1, 1]


def test_several_sensors_and_their_samples(load):
    one = '<sensor type="perspective"><sampler type="{}"><integer name="sample_count" value="{}"/></sampler></sensor>'
    scene = load(one.format("multijitter", 10) + one.format("ldsampler", 20))
    assert scene.integrator.spp == 10 and "sample_count is taken for all sensors" in scene.notes[0]


@pytest.mark.parametrize(
    "given, expected",
    [
        ('<rfilter type="box"/>', ("box", 0.5)),
        ('<rfilter type="tent"/>', ("tent", 1)),
        ('<rfilter type="tent"><float name="radius" value="2"/></rfilter>', ("tent", 2)),
        ('<rfilter type="gaussian"/>', ("gaussian", 2)),
        ('<rfilter type="gaussian"><float name="stddev" value="1"/></rfilter>', ("gaussian", 4)),
        ('<rfilter type="mitchell"/>', ("mitchell", 2)),
        ('<rfilter type="catmullrom"/>', ("catmullrom", 2)),
        ('<rfilter type="lanczos"><integer name="lobes" value="2"/></rfilter>', ("lanczos", 2)),
    ],
)
def test_film_filters(load, given, expected):
    size = '<integer name="width" value="64"/><integer name="height" value="32"/>'
    formats = '<string name="pixel_format" value="rgba"/><string name="component_format" value="float32"/>'
    scene = load(f'<sensor type="perspective"><film type="hdrfilm">{size}{formats}{given}</film></sensor>')
    made = scene.sensors[0].film
    assert (made.filter, made.radius) == expected and (made.width, made.height) == (64, 32) and scene.notes == []


@pytest.mark.parametrize(
    "body, problem",
    [
        ('<sensor type="fisheye"/>', "use perspective, thinlens, orthographic"),
        ('<sensor type="thinlens"/>', "has no aperture_radius; add <float"),
        ('<sensor type="perspective"><float name="fov" value="0"/></sensor>', "fov: is 0"),
        ('<sensor type="perspective"><float name="fov" value="180"/></sensor>', "fov: is 180"),
        ('<sensor type="perspective"><string name="focal_length" value="long"/></sensor>', "write it as 50mm"),
        ('<sensor type="perspective"><string name="focal_length" value="0mm"/></sensor>', "write it as 50mm"),
        ('<sensor type="perspective"><float name="focal_length" value="50"/></sensor>', "write it as <string>"),
        (
            '<sensor type="perspective"><transform name="to_world"><scale value="2"/></transform></sensor>',
            "to_world scales",
        ),
        ('<sensor type="perspective"><float name="near_clip" value="0"/></sensor>', "near_clip"),
        ('<sensor type="perspective"><film type="specfilm"/></sensor>', "use hdrfilm"),
        ('<sensor type="perspective"><film type="hdrfilm"/><film type="hdrfilm"/></sensor>', "has 2 <film>"),
        ('<sensor type="perspective"><sampler type="halton"/></sensor>', "use independent"),
        ('<sensor type="perspective"><medium type="homogeneous"/></sensor>', "is not supported in <sensor"),
        ('<sensor type="perspective"><spectrum name="srf" value="1"/></sensor>', "srf is not supported"),
        ('<sensor type="irradiancemeter"/>', "is out of place"),
        ('<shape type="sphere"><sensor type="perspective"/></shape>', "is out of place"),
        ('<sensor type="radiancemeter"/>', "film: has 768 x 576 pixels of one value"),
        (f'<sensor type="radiancemeter">{AHEAD}{PIXEL}</sensor>', "has direction alone"),
        (
            f'<sensor type="distant">{AHEAD}<transform name="to_world"/>{PIXEL}</sensor>',
            "has direction and also to_world",
        ),
        (f'<sensor type="distant"><bsdf type="diffuse" name="target"/>{PIXEL}</sensor>', "neither a point nor a shape"),
        ('<sensor type="batch"/>', "sensors: are none"),
        ('<sensor type="batch"><shape type="sphere"/></sensor><shape type="sphere"/>', "has no sensor inside"),
        (BATCH.format(5 * '<sensor type="perspective"/>'), "is 768 pixels wide, which 5 views"),
        (
            '<shape type="shapegroup"><shape type="cube"><sensor type="irradiancemeter"/></shape></shape>',
            "holds a sensor",
        ),
    ],
)
def test_sensors_that_do_not_work(refused, body, problem):
    assert problem in refused(body)


@pytest.mark.parametrize(
    "given, problem",
    [
        ('<integer name="crop_width" value="1000"/>', "goes beyond the film of 768 x 576 pixels"),
        ('<integer name="crop_offset_y" value="-1"/>', "goes beyond the film"),
        ('<integer name="width" value="0"/>', "film.width: is 0"),
        ('<float name="width" value="10"/>', "write it as <integer>"),
        ('<string name="pixel_format" value="cmyk"/>', "'cmyk' is not known; give one of luminance"),
        ('<rfilter type="sinc"/>', "use box, tent, gaussian, mitchell"),
        ('<rfilter type="lanczos"><integer name="lobes" value="0"/></rfilter>', "give a positive"),
        ('<rfilter type="mitchell"><float name="B" value="7"/></rfilter>', "two numbers from -1 to 1"),
        ('<rfilter type="tent"><float name="radius" value="0"/></rfilter>', "give a positive"),
        ('<rfilter type="gaussian"><float name="stddev" value="0"/></rfilter>', "give a positive"),
    ],
)
def test_films_that_do_not_work(refused, given, problem):
    assert problem in refused(f'<sensor type="perspective"><film type="hdrfilm">{given}</film></sensor>')


def test_lamps_without_extent(load):
    at = '<transform name="to_world"><lookat origin="1,2,3" target="1,2,0" up="0,1,0"/></transform>'
    point, spot, sun = load(
        '<shape type="sphere"/><emitter type="point"><point name="position" x="1" y="2" z="3"/></emitter>'
        f'<emitter type="spot" id="beam">{at}<rgb name="intensity" value="1,2,3"/></emitter>'
        f'<emitter type="directional">{at}</emitter>'
    ).lamps
    assert (point.id, spot.id, sun.id) == ("point", "beam", "directional_2")
    assert point.position.tolist() == spot.position.tolist() == [1, 2, 3]
    np.testing.assert_allclose([spot.direction, sun.direction], [[0, 0, -1]] * 2, atol=1e-12)
    assert (spot.cutoff_angle, spot.beam_width) == (20, 15) and spot.intensity.tolist() == [1, 2, 3]


def test_a_place_given_twice(refused):
    both = '<point name="position" x="1" y="0" z="0"/><transform name="to_world"><translate x="1"/></transform>'
    assert "has position and also to_world" in refused(f'<shape type="sphere"/><emitter type="point">{both}</emitter>')


def test_crop_windows_and_principal_points(load):
    crop = "".join(
        f'<integer name="crop_{k}" value="{v}"/>' for k, v in zip(("width", "offset_x"), (100, 20), strict=True)
    )
    given = '<float name="principal_point_offset_y" value=".1"/>'
    made = load(f'<shape type="sphere"/><sensor type="perspective">{given}<film type="hdrfilm">{crop}</film></sensor>')
    film = made.sensors[0].film
    assert (film.width, film.height, film.crop) == (100, 576, (20, 0, 768, 576))
    assert made.sensors[0].principal_point == (0.0, 0.1)


def test_fov_and_focal_length_together(refused):
    given = '<float name="fov" value="40"/><string name="focal_length" value="50mm"/>'
    assert "give only one" in refused(f'<sensor type="perspective">{given}</sensor>')


AOV = '<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="prb"/></integrator>'


@pytest.mark.parametrize(
    "body, expected",
    [
        ('<integrator type="path"/>', (-1, 5, False)),
        ('<integrator type="prb"/>', (6, 5, False)),
        ('<integrator type="ptracer"/>', (-1, 5, False)),
        ('<integrator type="direct"/>', (2, 5, False)),
        ('<integrator type="direct"><boolean name="hide_emitters" value="true"/></integrator>', (2, 5, True)),
        ('<integrator type="moment"><integrator type="prb"/></integrator>', (6, 5, False)),
        (f'<integrator type="moment">{AOV}</integrator>', (6, 5, False)),
        ('<integrator type="volpathmis"/>', (-1, 5, False)),
        ('<integrator type="path"><integer name="max_depth" value="3"/></integrator>', (3, 5, False)),
        ('<integrator type="ptracer"><integer name="rr_depth" value="9"/></integrator>', (-1, 9, False)),
    ],
)
def test_integrators(load, body, expected):
    made = load(body).integrator
    assert (made.max_depth, made.rr_depth, made.hide_emitters) == expected


def test_aovs_of_an_integrator(load):
    aovs = '<string name="aovs" value="d.y:depth, n:sh_normal,s:dp_du"/>'
    scene = load(f'<integrator type="aov">{aovs}<integrator type="path"/></integrator>')
    assert scene.integrator.aovs == ("d.y:depth", "n:normal")
    assert len(scene.notes) == 1 and "s:dp_du is left out" in scene.notes[0]


def test_luminance_alone_is_asked_by_the_film(load):
    film = '<sensor type="perspective"><film type="hdrfilm"><string name="pixel_format" value="{}"/></film></sensor>'
    assert load(film.format("luminance")).sensors[0].film.grey and not load(film.format("rgba")).sensors[0].film.grey
    assert "xyz is written as rgb" in load(film.format("xyz")).notes[0]


def test_samples_of_direct_light_are_noted(load):
    notes = load('<integrator type="direct"><integer name="emitter_samples" value="4"/></integrator>').notes
    assert len(notes) == 1 and "each sample combines" in notes[0]
    notes = load('<integrator type="direct"><integer name="bsdf_samples" value="0"/></integrator>').notes
    assert len(notes) == 1 and "what only such samples find is in the picture" in notes[0]


# ---------------------------------------------------------------------------------------- damaged files

WHOLE = scene(
    '<default name="r" value="2"/><path value="."/><bsdf type="roughconductor" id="gold">'
    '<string name="material" value="Au"/><string name="distribution" value="ggx"/>'
    '<float name="alpha" value=".2"/></bsdf><alias id="gold" as="or"/>'
    '<shape type="sphere"><float name="radius" value="$r"/><point name="center" value="1 2 3"/><ref id="or"/>'
    '<emitter type="area"><spectrum name="radiance" value="400:1,700:2"/></emitter></shape><shape type="cylinder">'
    '<transform name="to_world"><scale z="3"/><rotate x="1" angle="30"/><translate x="1"/></transform></shape>'
    '<sensor type="perspective"><transform name="to_world"><lookat origin="0 0 5" target="0 0 0" up="0 1 0"/>'
    '</transform><film type="hdrfilm"><rfilter type="tent"/></film></sensor><integrator type="path"/>'
    '<emitter type="constant"/>'
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_loads_or_is_a_scene_error_of_one_line(tmp_path, data):
    text = WHOLE
    words = ["", "0", "-1", "1e308", "nan", "$r", "$", "&", "<", ">", '"', "/>", "\n", "é", "ref", "shape", ":", ","]
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text) - 1))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.sampled_from(words)) + text[end:]
    path = tmp_path / "scene.xml"
    path.write_text(text)
    try:
        mitsuba.load(path, {})
    except SceneError as problem:
        assert "scene.xml" in str(problem) and str(problem).isprintable()


# -------------------------------------------------------------------------------------- against Mitsuba


@pytest.fixture(scope="module")
def mi():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    return mi


@pytest.mark.peer
@pytest.mark.parametrize("body", TRANSFORMS)
def test_mitsuba_transforms_alike(load, mi, body):
    text = f'<shape version="3.0.0" type="disk"><transform name="to_world">{body}</transform></shape>'
    theirs = np.array(mi.traverse(mi.load_string(text))["to_world"].matrix)
    np.testing.assert_allclose(to_world(load, body), theirs, rtol=1e-6, atol=1e-6)


@pytest.mark.peer
@pytest.mark.parametrize("value", ["0.5", "400:.1,500:.2,700:.8", "380:1,780:.5", "400:.3,555.5:.25,700:.37"])
def test_mitsuba_has_the_same_colours(load, mi, value):
    def theirs(tag, plugin, name):
        made = mi.load_string(
            f'<{tag} version="3.0.0" type="{plugin}"><spectrum name="{name}" value="{value}"/></{tag}>'
        )
        return np.atleast_1d(np.array(mi.traverse(made)[f"{name}.value"]))

    ours = material(load, f'<bsdf type="diffuse"><spectrum name="reflectance" value="{value}"/></bsdf>').reflectance
    np.testing.assert_allclose(ours, theirs("bsdf", "diffuse", "reflectance"), atol=2e-4)
    ours = material(load, f'<bsdf type="conductor"><spectrum name="eta" value="{value}"/></bsdf>').eta
    np.testing.assert_allclose(ours, theirs("bsdf", "conductor", "eta"), atol=2e-4)
    ours = load(f'<emitter type="constant"><spectrum name="radiance" value="{value}"/></emitter>').enclosure.radiance
    np.testing.assert_allclose(ours, theirs("emitter", "constant", "radiance"), atol=2e-4)


FILM = '<film type="hdrfilm"><integer name="width" value="{}"/><integer name="height" value="{}"/>{}</film>'


def x_fov(made):
    """The field of view along x of a sensor of ours."""
    w, h = made.film.width, made.film.height
    along = {"x": w, "y": h, "smaller": min(w, h), "larger": max(w, h), "diagonal": np.hypot(w, h)}[made.fov_axis]
    return np.degrees(2 * np.arctan(np.tan(np.radians(made.fov) / 2) * w / along))


@pytest.mark.peer
@pytest.mark.parametrize("size", [(200, 100), (64, 96)])
@pytest.mark.parametrize("kind", ["perspective", "thinlens"])
@pytest.mark.parametrize(
    "given",
    ["", '<string name="focal_length" value="35mm"/>', '<float name="fov" value="40"/>']
    + [
        f'<float name="fov" value="40"/><string name="fov_axis" value="{a}"/>'
        for a in ("y", "smaller", "larger", "diagonal")
    ],
)
def test_mitsuba_has_the_same_sensors(load, mi, size, kind, given):
    given += '<float name="aperture_radius" value=".2"/>' if kind == "thinlens" else ""
    given += FILM.format(*size, '<rfilter type="tent"/>')
    ours = sensor(load, given, kind)
    theirs = mi.load_string(f'<sensor version="3.0.0" type="{kind}">{given}</sensor>')
    values = mi.traverse(theirs)
    assert x_fov(ours) == pytest.approx(values["x_fov"], rel=1e-5)
    assert (ours.near, ours.far) == pytest.approx((values["near_clip"], values["far_clip"]))
    assert [ours.film.width, ours.film.height] == list(theirs.film().size())
    assert ours.film.radius == pytest.approx(theirs.film().rfilter().radius())
    if kind == "thinlens":
        assert ours.focus_distance == pytest.approx(values["focus_distance"])


@pytest.mark.peer
@pytest.mark.parametrize("given", ["", '<boolean name="face_normals" value="true"/>'])
@pytest.mark.parametrize(
    "move", ["", '<scale x="-3" y="2"/>', '<rotate x="1" angle="40"/><scale z=".3"/><translate x="5"/>']
)
@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3 4\nf 2 5 3\n",
        "vt 0 0\nvt 1 .25\nf 1/1 2/1 3/1\nf 2/2 5/2 3/2\n",
        "vn 0 0 2\nvn 1 0 1\nf 1//1 2//1 3//1 4//1\nf 2//2 5//2 3//2\n",
    ],
)
def test_mitsuba_has_the_same_meshes(load, mi, tmp_path, faces, move, given):
    given += f'<transform name="to_world">{move}</transform>'
    ours = mesh(load, tmp_path, faces, given)
    name = f'<string name="filename" value="{tmp_path / "t.obj"}"/>'
    theirs = mi.load_string(f'<shape version="3.0.0" type="obj">{name}{given}</shape>')
    values = mi.traverse(theirs)
    m = ours.to_world
    world = ours.vertices @ m[:3, :3].T + m[:3, 3]
    np.testing.assert_allclose(world, np.array(values["vertex_positions"]).reshape(-1, 3), atol=1e-5)
    if theirs.has_vertex_normals():
        if ours.normals is None:  # flat anyway
            a, b, c = (world[ours.faces[:, k]] for k in range(3))
            normals = np.empty_like(world)
            normals[ours.faces] = np.cross(b - a, c - a)[:, None]
        else:
            normals = ours.normals @ np.linalg.inv(m[:3, :3])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        np.testing.assert_allclose(normals, np.array(values["vertex_normals"]).reshape(-1, 3), atol=1e-5)
    else:
        assert ours.normals is None
    if ours.uvs is not None:
        np.testing.assert_allclose(ours.uvs, np.array(values["vertex_texcoords"]).reshape(-1, 2), atol=1e-6)


@pytest.mark.peer
@pytest.mark.parametrize("flip", ["true", "false"])
@pytest.mark.parametrize("scale", ['<scale value="2"/>', '<scale x="-1"/>'])
def test_mitsuba_has_the_same_side_of_spheres(load, mi, flip, scale):
    given = f'<boolean name="flip_normals" value="{flip}"/><transform name="to_world">{scale}</transform>'
    ours = only(load, f'<shape type="sphere">{given}</shape>')
    theirs = mi.load_string(scene(f'<shape type="sphere">{given}</shape>'))
    hit = theirs.ray_intersect(mi.Ray3f([0.1, 0.2, 9.0], [0.0, 0.0, -1.0]))
    assert (hit.sh_frame.n.z < 0) == ours.flip_normals


@pytest.mark.peer
def test_mitsuba_has_the_same_plain_values(load, mi):
    text = '<bsdf version="3.0.0" type="{}"/>'
    assert mi.traverse(mi.load_string(text.format("diffuse")))["reflectance.value"] == 0.5
    rough = mi.traverse(mi.load_string(text.format("roughconductor")))
    assert rough["alpha.value"] == pytest.approx(0.1) and (rough["eta.value"], rough["k.value"]) == (0, 1)
    black = mi.traverse(mi.load_string('<shape version="3.0.0" type="disk"><emitter type="area"/></shape>'))
    assert (black["bsdf.reflectance.value"], black["emitter.radiance.value"]) == (0, 1)
    made = mi.load_string('<sensor version="3.0.0" type="perspective"/>')
    assert made.sampler().sample_count() == load('<sensor type="perspective"/>').integrator.spp


def test_instances_share_a_group(load):
    made = load(
        '<shape type="shapegroup" id="toy"><shape type="cube" id="box"/><shape type="rectangle"/></shape>'
        '<shape type="instance"><ref id="toy"/></shape>'
        '<shape type="instance" id="far"><ref id="toy"/><transform name="to_world"><translate x="3"/></transform></shape>'
    )
    one, far = made.shapes
    assert one.group is far.group and [s.id for s in one.group.shapes] == ["box", "toy.shape_1"]
    assert (one.id, far.id) == ("shape_1", "far")
    np.testing.assert_allclose(far.to_world[:3, 3], [3, 0, 0])
    with pytest.raises(SceneError, match="has no shapes"):
        load(GROUP)  # a group alone is not in the scene


def test_merged_shapes_stand_where_the_merge_does(load):
    made = load(
        '<shape type="disk"/><shape type="merge"><shape type="cube" id="box"/><shape type="merge"><shape type="sphere"/>'
        '</shape></shape><shape type="disk"/>'
    ).shapes
    assert [s.id for s in made] == ["shape_0", "box", "shape_2", "shape_3"]
    assert [type(s) for s in made] == [parts.Disk, parts.Cube, parts.Sphere, parts.Disk]


def test_textures_in_a_checkerboard(load):
    inner = '<texture type="checkerboard" name="color1" id="inner"><rgb name="color0" value=".1,.2,.3"/></texture>'
    made = material(
        load, f'<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">{inner}</texture></bsdf>'
    )
    assert isinstance(made.reflectance.color1, parts.Checkerboard) and made.reflectance.color0 == 0.4
    np.testing.assert_allclose(made.reflectance.color1.color0, [0.1, 0.2, 0.3])


GROUP = '<shape type="shapegroup"><shape type="cube"/></shape>'
INSTANCES = """<shape type="shapegroup" id="toy"><shape type="cube"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
</shape></shape><shape type="instance"><ref id="toy"/><transform name="to_world"><scale x=".5" y=".3" z=".4"/>
<rotate x="1" angle="35"/><translate x="-.6"/></transform></shape><shape type="instance"><ref id="toy"/>
<transform name="to_world"><scale x="-.4" y=".4" z=".4"/><rotate z="1" angle="70"/><translate x=".7"/></transform>
</shape><emitter type="constant"/><shape type="sphere"><point name="center" x="0" y="0" z="3"/>
<emitter type="area"><rgb name="radiance" value="9,8,7"/></emitter></shape><sensor type="perspective">
<transform name="to_world"><lookat origin="0,-4,1" target="0,0,0" up="0,0,1"/></transform>
<sampler type="independent"><integer name="sample_count" value="256"/></sampler><film type="hdrfilm">
<integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
<integrator type="path"><integer name="max_depth" value="4"/></integrator>"""


@pytest.mark.peer
def test_mitsuba_has_the_same_instances(mi, tmp_path):
    import jaxrt

    path = tmp_path / "scene.xml"
    path.write_text(scene(INSTANCES))
    ours, theirs = jaxrt.render(jaxrt.load(path), 256, 1), np.array(mi.render(mi.load_file(str(path))))[..., :3]
    blocks = lambda image: image.reshape(4, 4, 6, 4, 3).mean((1, 3))
    np.testing.assert_allclose(blocks(ours.image), blocks(theirs), rtol=0.03)
    assert abs(ours.image.mean() / theirs.mean() - 1) < 3e-3
