"""glTF: what is read, where it stands in the world, and that damaged files are refused by name."""

import base64
import copy
import json

import numpy as np
import pytest
from gltf_files import DATA, INDICES, NORMALS, POSITIONS, added, document, glb, load, picture
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrt.files import load_description
from jaxrt.files.gltf import load_gltf
from jaxrt.parts import Diffuse, Instance, Mesh, Principled, SceneError

QUICK = settings(max_examples=80, deadline=None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gltf")


def test_a_mesh_and_its_material(tmp_path):
    scene = load(tmp_path)
    (shape,) = scene.shapes
    assert shape.id == "quad"
    np.testing.assert_array_equal(shape.vertices, POSITIONS[:4])  # what no face uses is left out
    np.testing.assert_array_equal(shape.normals, NORMALS[:4])
    np.testing.assert_array_equal(shape.uvs, [[0, 0], [1, 0], [1, 1], [0, 1]])
    assert shape.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert isinstance(shape.bsdf, Principled)
    np.testing.assert_array_equal(shape.bsdf.base_color, [0.1, 0.2, 0.3])  # not rounded to 8 bits
    assert (shape.emission, scene.sensors, scene.notes) == (None, [], [])


@pytest.mark.parametrize("where", ["data", "file"])
def test_buffers_elsewhere(tmp_path, where):
    doc = document()
    doc["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(DATA).decode()
    if where == "file":
        doc["buffers"][0]["uri"] = "my%20data.bin"
        (tmp_path / "my data.bin").write_bytes(DATA)
    (tmp_path / "a.gltf").write_text(json.dumps(doc))
    np.testing.assert_array_equal(load_gltf(tmp_path / "a.gltf").shapes[0].vertices, POSITIONS[:4])


def test_interleaved_accessors(tmp_path):
    rows = np.concatenate([POSITIONS, NORMALS], 1).tobytes()
    doc = document(buffers=[{"byteLength": len(rows) + 6}])
    doc["bufferViews"][0] = {"buffer": 0, "byteLength": len(rows), "byteStride": 24}
    doc["bufferViews"][3]["byteOffset"] = len(rows)
    doc["accessors"][1] |= {"bufferView": 0, "byteOffset": 12}
    del doc["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]
    (shape,) = load_gltf(glb(tmp_path / "a.glb", doc, rows + INDICES.tobytes())).shapes
    np.testing.assert_array_equal(shape.vertices, POSITIONS[:4])
    np.testing.assert_array_equal(shape.normals, NORMALS[:4])
    assert shape.uvs is None


def test_sparse_accessors_and_quantised_positions(tmp_path):
    """Rows replaced in data, in nothing at all, and in normalised 16-bit positions (KHR_mesh_quantization)."""
    doc = document(extensionsRequired=["KHR_mesh_quantization"])
    at, data = added(doc, DATA, np.array([1, 3], np.uint16), "SCALAR")
    rows, data = added(doc, data, np.array([[5, 0, 0], [0, 7, 0]], np.float32), "VEC3")
    views = [doc["accessors"][k]["bufferView"] for k in (at, rows)]
    indices, values = {"bufferView": views[0], "componentType": 5123}, {"bufferView": views[1]}
    doc["accessors"][0]["sparse"] = {"count": 2, "indices": indices, "values": values}
    (shape,) = load_gltf(glb(tmp_path / "a.glb", doc, data)).shapes
    np.testing.assert_array_equal(shape.vertices, [[0, 0, 0], [5, 0, 0], [2, 1, 0], [0, 7, 0]])
    del doc["accessors"][0]["bufferView"]
    (shape,) = load_gltf(glb(tmp_path / "a.glb", doc, data)).shapes
    np.testing.assert_array_equal(shape.vertices, [[0, 0, 0], [5, 0, 0], [0, 0, 0], [0, 7, 0]])
    indices["componentType"] = 5126
    with pytest.raises(SceneError, match=r"accessors\[0\].sparse has no indices"):
        load_gltf(glb(tmp_path / "a.glb", doc, data))
    doc["accessors"][0] = {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 2, "values": values}}
    doc["accessors"][0]["sparse"]["indices"] = indices | {"componentType": 5123}
    with pytest.raises(SceneError, match="replaces row 3 of 3"):
        load_gltf(glb(tmp_path / "a.glb", doc, data))
    places = np.array([[32767, 0, 0, 0], [0, -32768, 16384, 0]] * 3, np.int16)[:5]
    doc["accessors"][0], data = None, data
    number, data = added(doc, data, places, "VEC4")
    doc["accessors"][0] = doc["accessors"][number] | {"type": "VEC3", "normalized": True}
    doc["bufferViews"][-1]["byteStride"] = 8
    (shape,) = load_gltf(glb(tmp_path / "a.glb", doc, data)).shapes
    np.testing.assert_allclose(shape.vertices[:2], [[1, 0, 0], [0, -1, 16384 / 32767]])
    del doc["accessors"][0]["normalized"]
    (shape,) = load_gltf(glb(tmp_path / "a.glb", doc, data)).shapes
    np.testing.assert_array_equal(shape.vertices[:2], [[32767, 0, 0], [0, -32768, 16384]])


def test_instances_of_a_node(tmp_path):
    """EXT_mesh_gpu_instancing: each stands in the space of the node."""
    doc = document(nodes=[{"mesh": 0, "translation": [0, 0, 5]}], extensionsRequired=["EXT_mesh_gpu_instancing"])
    moves, data = added(doc, DATA, np.array([[1, 0, 0], [0, 2, 0]], np.float32), "VEC3")
    turns, data = added(doc, data, np.array([[0, 0, 127, 127], [0, 0, 0, 127]], np.int8), "VEC4", normalized=True)
    attributes = {"TRANSLATION": moves, "ROTATION": turns}
    doc["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    turned, moved = load_gltf(glb(tmp_path / "a.glb", doc, data)).shapes
    np.testing.assert_allclose(turned.to_world @ [1, 0, 0, 1], [1, 1, 5, 1], atol=1e-12)
    np.testing.assert_allclose(moved.to_world @ [1, 0, 0, 1], [1, 2, 5, 1], atol=1e-12)
    doc["accessors"][turns]["count"] = 1
    with pytest.raises(SceneError, match="1 and 2 values of its instances"):
        load_gltf(glb(tmp_path / "a.glb", doc, data))


def test_compressed_data_without_a_fallback_is_refused(tmp_path):
    doc = document()
    doc["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    assert load_gltf(glb(tmp_path / "a.glb", doc)).shapes  # it has the data uncompressed as well
    del doc["accessors"][0]["bufferView"]
    with pytest.raises(SceneError, match=r"KHR_draco_mesh_compression.*export it without"):
        load_gltf(glb(tmp_path / "a.glb", doc))
    doc = document()
    doc["buffers"] += [{"byteLength": 60, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}]
    doc["bufferViews"][0]["buffer"] = 1
    with pytest.raises(SceneError, match=r"buffers\[1\] is compressed \(EXT_meshopt_compression"):
        load_gltf(glb(tmp_path / "a.glb", doc))


@pytest.mark.parametrize(
    ("mode", "faces"),
    [
        (4, [[0, 1, 2], [0, 2, 3]]),
        (5, [[0, 1, 2], [1, 0, 2], [2, 0, 2], [0, 3, 2]]),
        (6, [[1, 2, 0], [2, 0, 0], [0, 2, 0], [2, 3, 0]]),
    ],
)
def test_lists_strips_and_fans(tmp_path, mode, faces):
    doc = document()
    doc["meshes"][0]["primitives"][0]["mode"] = mode
    assert load_gltf(glb(tmp_path / "a.glb", doc)).shapes[0].faces.tolist() == faces


def test_without_indices_and_without_material(tmp_path):
    doc = document()
    doc["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 0}, "mode": 1}]
    doc["accessors"][0]["count"] = 3
    scene = load_gltf(glb(tmp_path / "a.glb", doc))
    (shape,) = scene.shapes
    assert shape.id == "quad_0"
    assert shape.faces.tolist() == [[0, 1, 2]]
    assert isinstance(shape.bsdf, Diffuse)
    assert len(scene.notes) == 2
    assert "lines, which have no surface; left out" in scene.notes[1]


def test_hierarchy_and_instances(tmp_path):
    nodes = [
        {"children": [1, 2], "translation": [1, 2, 3]},
        {"mesh": 0, "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [1, 2, 3], "name": "turned"},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 5, 6, 7, 1]},
        {"mesh": 0, "name": "not in the scene"},
    ]
    turned, moved = load(tmp_path, nodes=nodes).shapes
    assert (turned.id, moved.id) == ("turned", "shape")
    expected = [[0, -2, 0, 1], [1, 0, 0, 2], [0, 0, 3, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(turned.to_world, expected, atol=1e-15)
    np.testing.assert_allclose(moved.to_world @ [0, 1, 0, 1], [6, 8, 11, 1])
    assert turned.vertices is moved.vertices
    assert turned.bsdf is moved.bsdf


@QUICK
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(x * x for x in q) > 1e-3))
def test_rotations_are_those_of_the_quaternion(folder, q):
    m = load(folder, nodes=[{"mesh": 0, "rotation": q}]).shapes[0].to_world[:3, :3]
    np.testing.assert_allclose(m @ m.T, np.eye(3), atol=1e-12)
    v, w, p = np.array(q[:3]), q[3], np.array([0.3, -0.7, 0.2])
    turned = p + 2 / np.dot(q, q) * (w * np.cross(v, p) + np.cross(v, np.cross(v, p)))  # q p q*
    np.testing.assert_allclose(m @ p, turned, atol=1e-12)


def world(shape):
    p = shape.vertices @ shape.to_world[:3, :3].T + shape.to_world[:3, 3]
    return p[shape.faces]


def test_mirrored_nodes_keep_their_front(tmp_path):
    """glTF 2.0, 3.7.4: a negative determinant turns the winding of front faces."""
    nodes = [{"mesh": 0}, {"mesh": 0, "scale": [-1, 2, 1], "translation": [0, 0, 4]}]
    plain, mirrored = load(tmp_path, nodes=nodes, scenes=[{"nodes": [0, 1]}]).shapes
    for shape in (plain, mirrored):
        a, b, c = world(shape)[0]
        assert np.cross(b - a, c - a)[2] > 0
        assert np.linalg.det(shape.to_world[:3, :3]) > 0
    np.testing.assert_array_equal(np.sort(world(mirrored)[0, :, 0]), [-2, -2, 0])
    np.testing.assert_array_equal(mirrored.normals, NORMALS[:4])


def test_cameras(tmp_path):
    cameras = [
        {"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1}},
        {"type": "orthographic", "orthographic": {"xmag": 4, "ymag": 2, "znear": 0, "zfar": 50}},
    ]
    nodes = [
        {"children": [1, 2, 3], "scale": [2, 2, 2]},
        {"mesh": 0},
        {"camera": 0, "translation": [1, 2, 3], "name": "eye"},
        {"camera": 1, "rotation": [0, np.sqrt(0.5), 0, np.sqrt(0.5)]},  # a quarter turn about y: looks along −x
    ]
    eye, ortho = load(tmp_path, cameras=cameras, nodes=nodes).sensors
    assert eye.kind == "perspective"
    assert eye.fov == pytest.approx(np.degrees(0.8))
    assert (eye.fov_axis, eye.film.width, eye.film.height, eye.id) == ("y", 768, 512, "eye")
    assert eye.near == pytest.approx(0.2)
    assert eye.far > 1e9  # without zfar
    # ours looks along its +z with +x to the left; theirs along −z with +x to the right
    np.testing.assert_allclose(eye.to_world, [[-1, 0, 0, 2], [0, 1, 0, 4], [0, 0, -1, 6], [0, 0, 0, 1]], atol=1e-15)
    assert ortho.kind == "orthographic"
    assert (ortho.film.width, ortho.film.height) == (1024, 512)
    np.testing.assert_allclose(ortho.to_world @ [0, 0, 1, 0], [-1, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(ortho.to_world[:3, :3], axis=0), [8, 8, 1])
    assert ortho.far == 100


def test_lights(tmp_path):
    lights = [
        {"type": "directional", "color": [1, 0.5, 0], "intensity": 4},
        {"type": "point", "intensity": 2},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
    ]
    turn = [0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)]  # −z becomes −x
    node = lambda k: {"translation": [1, 2, 3], "rotation": turn, "extensions": {"KHR_lights_punctual": {"light": k}}}
    nodes = [{"mesh": 0, "children": [1, 2, 3]}, *map(node, range(3))]
    scene = load(tmp_path, nodes=nodes, extensions={"KHR_lights_punctual": {"lights": lights}})
    sun, point, spot = scene.lamps
    np.testing.assert_allclose(sun.direction, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(sun.irradiance, [4, 2, 0])
    np.testing.assert_allclose(point.position, [1, 2, 3])
    np.testing.assert_allclose(point.intensity, [2, 2, 2])
    np.testing.assert_allclose((spot.cutoff_angle, spot.beam_width), np.degrees([0.5, 0.1]))
    for wrong, says in (({"light": 3}, "no light 3"), ({"light": 0}, "is of type 'sky'")):
        lights[0]["type"] = "sky"
        nodes[1]["extensions"]["KHR_lights_punctual"] = wrong
        with pytest.raises(SceneError, match=says):
            load(tmp_path, nodes=nodes, extensions={"KHR_lights_punctual": {"lights": lights}})


def test_measured_lights(tmp_path):
    """EXT_lights_ies: vertical angle 0 is −z of the node, horizontal angle 0 is +x and 90 is +y."""
    numbers = "1 -1 1 3 2 1 2 0 0 0 1 1 0  0 90 180  0 90  7 8 1 7 9 1"
    (tmp_path / "a lamp.ies").write_text(f"IESNA:LM-63-2002\nTILT=NONE\n{numbers}")
    data = base64.b64encode((tmp_path / "a lamp.ies").read_bytes()).decode()
    lights = [{"uri": "a%20lamp.ies"}, {"uri": f"data:application/x-ies-lm-63;base64,{data}"}, {"bufferView": 4}]
    turn = [0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)]  # −z becomes −x, and +x −z
    more = [{"multiplier": 2, "color": [1, 0.5, 3]}, {}, {}]
    nodes = [{"mesh": 0, "children": [1, 2, 3]}]
    nodes += [
        {"translation": [1, 2, 3], "rotation": turn, "extensions": {"EXT_lights_ies": {"light": k, **more[k]}}}
        for k in range(3)
    ]
    views = [*document()["bufferViews"], {"buffer": 1, "byteOffset": 0, "byteLength": len(base64.b64decode(data))}]
    buffers = [*document()["buffers"], {"uri": f"data:,{data}", "byteLength": len(base64.b64decode(data))}]
    extras = {"bufferViews": views, "buffers": buffers, "extensionsRequired": ["EXT_lights_ies"]}
    profiles = lambda lights: {"extensions": {"EXT_lights_ies": {"lights": lights}}}
    lamps = load(tmp_path, nodes=nodes, **extras, **profiles(lights)).lamps
    for lamp, scale in zip(lamps, [[2, 1, 2], [1, 1, 1], [1, 1, 1]], strict=True):
        np.testing.assert_allclose(lamp.intensity.data[:, :, None] / scale, np.array([[7, 8, 1], [7, 9, 1]])[..., None, None] * [1, 1, 1])  # fmt: skip
        place = np.array([[0, 0, -1, 1], [1, 0, 0, 2], [0, -1, 0, 3]])  # +x, +y, +z of the lamp's own space
        np.testing.assert_allclose(
            lamp.to_world[:3] - [[0, 0, -1, 1], [1, 0, 0, 2], [0, -1, 0, 3]], 0 * place, atol=1e-12
        )
    for wrong, says in (
        ({"uri": "b.ies"}, "no such file"),
        ({}, "light 2 has no data"),
        ({"bufferView": 9}, "no bufferViews"),
    ):
        with pytest.raises(SceneError, match=says):
            load(tmp_path, nodes=nodes, **extras, **profiles([*lights[:2], wrong]))


def test_what_is_left_out_is_named(tmp_path):
    doc = document(
        textures=[{"source": 0}],
        images=[{"uri": "wood.png"}],
        extensionsUsed=["KHR_lights_punctual", "KHR_materials_sheen", "KHR_materials_sheen"],
        extensionsRequired=["KHR_lights_punctual"],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "directional"}]}},
        nodes=[
            {"mesh": 0, "children": [1, 2]},
            {"name": "sun", "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"mesh": 0, "name": "gone", "scale": [0, 1, 1]},
        ],
        animations=[{}],
        skins=[{}],
        scenes=[{"nodes": [0], "name": "first"}, {}],
    )
    doc["materials"][0] |= {"alphaMode": "BLEND", "normalTexture": {"index": 0}, "occlusionTexture": {"index": 7}}
    doc["meshes"][0]["primitives"][0]["targets"] = [{}]
    scene = load_gltf(glb(tmp_path / "a.glb", doc))
    assert len(scene.shapes) == 1
    notes = "\n".join(scene.notes)
    for words in (
        "normalTexture 'wood.png'", "occlusionTexture", "of 2 scenes, 'first' is taken",
        "extensions are not used: KHR_materials_sheen", "gone", "animations", "skins", "morph targets",
    ):  # fmt: skip
        assert words in notes
    assert all(note.startswith(str(tmp_path)) and "\n" not in note for note in scene.notes)


def change(doc, path, value):
    """The document with the value at `path` (keys and indices) replaced."""
    doc = copy.deepcopy(doc)
    at = doc
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return doc


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (["asset"], {"version": "1.0"}, "glTF 2"),
        (["extensionsRequired"], ["KHR_draco_mesh_compression"], "requires KHR_draco_mesh_compression.* compression"),
        (["extensionsRequired"], ["EXT_meshopt_compression"], "requires EXT_meshopt_compression.* compression"),
        (["extensionsRequired"], ["KHR_unknown"], "requires KHR_unknown.* export it without"),
        (["scenes"], [{"nodes": [7]}], r"nodes\[7\]"),
        (["scene"], 3, r"scenes\[3\]"),
        (["nodes"], [{"children": [0], "mesh": 0}], "contains itself"),
        (["nodes"], [{}], "no triangle meshes"),
        (["nodes", 0, "mesh"], 1, r"meshes\[1\]"),
        (["nodes", 0, "mesh"], "0", "mesh is 0"),
        (["nodes", 0, "rotation"], [0, 0, 0, 0], "quaternion"),
        (["nodes", 0, "scale"], [1, 1], "scale"),
        (["nodes", 0, "matrix"], [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], r"nodes\[0\]: has a perspective"),
        (["nodes", 0], {"mesh": 0, "children": [1], "scale": [1e300, 1e300, 1e300]}, r"nodes\[0\]"),
        (["nodes", 0, "translation"], [1, float("nan"), 0], "translation"),
        (["meshes", 0, "primitives", 0, "material"], 5, r"materials\[5\]"),
        (["meshes", 0, "primitives", 0, "attributes", "POSITION"], 3, r"accessors\[3\]"),
        (["meshes", 0, "primitives", 0, "attributes", "NORMAL"], 9, r"accessors\[9\]"),
        (["materials", 0, "pbrMetallicRoughness", "baseColorFactor"], [2, 0, 0, 1], "paint.base_color"),
        (["materials", 0, "pbrMetallicRoughness"], [], "pbrMetallicRoughness"),
        (["materials", 0, "emissiveFactor"], [-1, 0, 0], "paint"),
        (["accessors", 0, "count"], 6, r"accessors\[0\] lies outside"),
        (["accessors", 0, "count"], 10**12, r"accessors\[0\] lies outside"),
        (["accessors", 0, "count"], -1, "count"),
        (["accessors", 0, "count"], 0, "lies outside"),
        (["accessors", 0, "componentType"], [], r"accessors\[0\].type"),
        (["accessors", 0, "sparse"], {}, "sparse"),
        (["accessors", 1, "count"], 4, "4 normals"),
        (["accessors", 3, "count"], 5, "not triangles"),
        (["accessors", 3, "componentType"], 5120, "0..4|outside"),
        (["bufferViews", 0, "byteOffset"], 10**9, "lies outside"),
        (["bufferViews", 0, "byteStride"], 0, "lies outside"),
        (["buffers", 0, "byteLength"], 10**9, "truncated"),
        (["buffers", 0, "uri"], "data:;base64,!", "base64|truncated"),
        (["buffers", 0, "uri"], "gone.bin", "gone.bin: no such file"),
        (["buffers", 0, "uri"], "https://example.org/a.bin", "download"),
        (["buffers", 0, "uri"], "/dev/zero", "no such file"),
        (["buffers"], {}, "buffers"),
    ],
)
def test_mistakes_are_refused_by_name(tmp_path, path, value, says):
    with pytest.raises(SceneError, match=rf"a\.glb: .*{says}") as error:
        load_gltf(glb(tmp_path / "a.glb", change(document(), path, value)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "value"), [("yfov", 0), ("yfov", 4), ("yfov", None), ("aspectRatio", 0), ("znear", -1)]
)
def test_cameras_that_cannot_be(tmp_path, key, value):
    camera = {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1, key: value}}
    if key == "znear":  # taken as left out
        assert load(tmp_path, cameras=[camera], nodes=[{"mesh": 0, "camera": 0}]).sensors[0].near > 0
        return
    with pytest.raises(SceneError, match=r"a\.glb: "):
        load(tmp_path, cameras=[camera], nodes=[{"mesh": 0, "camera": 0}])


def test_indices_out_of_range(tmp_path):
    with pytest.raises(SceneError, match=r"outside 0\.\.4"):
        load_gltf(glb(tmp_path / "a.glb", document(), DATA[:140] + b"\5" * 6))
    with pytest.raises(SceneError, match="not finite"):
        load_gltf(glb(tmp_path / "a.glb", document(), b"\xff" * 140 + DATA[140:]))


def test_repetition_beyond_all_measure_is_refused(tmp_path):
    doc = document()
    doc["bufferViews"] += [{"buffer": 0, "byteLength": 600_000}]
    doc["accessors"] += [{"bufferView": 4, "componentType": 5121, "count": 600_000, "type": "SCALAR"}]
    doc["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 0}, "indices": 4}] * 1000
    doc["buffers"] = [{"byteLength": 600_000}]
    with pytest.raises(SceneError, match="fewer copies"):
        load_description(glb(tmp_path / "a.glb", doc, b"\0" * 600_000))


def test_a_truncated_file(tmp_path):
    whole = glb(tmp_path / "a.glb", document()).read_bytes()
    for n in range(0, len(whole) - 4, 37):
        (tmp_path / "b.glb").write_bytes(whole[:n])
        with pytest.raises(SceneError, match=r"b\.glb"):
            load_gltf(tmp_path / "b.glb")


@QUICK
@given(st.binary(max_size=200))
def test_random_bytes_are_refused(folder, content):
    for data in (content, b"glTF\2\0\0\0" + content):
        (folder / "a.glb").write_bytes(data)
        with pytest.raises(SceneError):
            load_gltf(folder / "a.glb")


def leaves(value, path=()):
    """Every path into a JSON value."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, below in items:
        yield from leaves(below, (*path, key))


FULL = document(
    cameras=[{"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1, "zfar": 9}}],
    nodes=[{"mesh": 0, "camera": 0, "scale": [-1, 1, 1], "rotation": [0, 0, 0, 1], "children": []}],
    extensionsUsed=[],
    samplers=[{"wrapS": 33071, "wrapT": 33071, "magFilter": 9728}],
    textures=[{"source": 0, "sampler": 0, "extensions": {"EXT_texture_webp": {"source": 0}}}],
    images=[{"uri": picture([[[0, 255, 0, 9]], [[255, 255, 255, 99]]], "RGBA")}],
)
TEXTURE = {"index": 0, "texCoord": 0}
FULL["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}
FULL["materials"][0] |= {"normalTexture": TEXTURE, "emissiveFactor": [1, 1, 1], "alphaMode": "BLEND"}
FULL["materials"][0]["pbrMetallicRoughness"] |= {"baseColorTexture": TEXTURE, "metallicRoughnessTexture": TEXTURE}
FULL["materials"][0]["extensions"] = {
    "KHR_materials_transmission": {"transmissionFactor": 0.5, "transmissionTexture": TEXTURE},
    "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 1, "attenuationColor": [1, 0, 1]},
    "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessTexture": TEXTURE},
    "KHR_materials_specular": {"specularTexture": TEXTURE, "specularColorFactor": [1, 1, 1]},
    "KHR_materials_ior": {"ior": 1.4},
}
FULL["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = 0
FULL["accessors"][0]["sparse"] = {
    "count": 1,
    "indices": {"bufferView": 3, "componentType": 5121},
    "values": {"bufferView": 0, "byteOffset": 0},
}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([p for p in leaves(FULL) if p]), JSON)
def test_any_json_in_any_place_is_read_or_refused(folder, path, value):
    try:
        scene = load_gltf(glb(folder / "a.glb", change(FULL, path, value)))
    except SceneError as error:
        assert "a.glb" in str(error)
        assert len(str(error).splitlines()) == 1
    else:
        assert all(isinstance(s, Mesh) for s in scene.shapes)


def test_a_heavy_mesh_at_several_nodes_is_stored_once(tmp_path, monkeypatch):
    nodes = [{"children": [1, 2, 3]}, {"mesh": 0, "name": "one"}, {"mesh": 0, "scale": [-1, 1, 1]}]
    nodes += [{"mesh": 0, "translation": [1, 0, 0]}]
    assert all(isinstance(s, Mesh) for s in load(tmp_path, nodes=nodes).shapes)
    monkeypatch.setattr("jaxrt.files.gltf.SHARED", 2)
    shapes = load(tmp_path, nodes=nodes).shapes
    assert [s.id for s in shapes] == ["one", "shape", "shape"]
    assert all(isinstance(s, Instance) and s.group is shapes[0].group for s in shapes)
    np.testing.assert_allclose(shapes[2].to_world[:3, 3], [1, 0, 0])
