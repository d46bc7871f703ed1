"""glTF: what is read, where it stands in the world, and that damaged files are refused by name."""

import base64
import copy
import io
import json
import struct

import numpy as np
import PIL.Image
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrt.files.gltf import load_gltf
from jaxrt.parts import Conductor, Diffuse, Instance, Mesh, SceneError, TwoSided

QUICK = settings(max_examples=80, deadline=None)
POSITIONS = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.5], [9, 9, 9]], np.float32)
NORMALS = np.tile(np.array([0, 0, 1], np.float32), (5, 1))
UVS = np.array([[0, 0], [65535, 0], [65535, 65535], [0, 65535], [0, 0]], np.uint16)  # normalised
INDICES = np.array([0, 1, 2, 0, 2, 3], np.uint8)
DATA = POSITIONS.tobytes() + NORMALS.tobytes() + UVS.tobytes() + INDICES.tobytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gltf")


def document(**more):
    """One mesh of two triangles, in one node."""
    views = [(0, 60), (60, 60), (120, 20), (140, 6)]
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "quad"}],
        "meshes": [
            {
                "name": "shape",
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}
                ],
            }
        ],
        "materials": [
            {"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0}}
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 5, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5123, "count": 5, "type": "VEC2", "normalized": True},
            {"bufferView": 3, "componentType": 5121, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in views],
        "buffers": [{"byteLength": len(DATA)}],
        **more,
    }


def glb(path, doc, data=DATA):
    text = json.dumps(doc).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    return path


def load(folder, **more):
    return load_gltf(glb(folder / "a.glb", document(**more)))


def test_a_mesh_and_its_material(tmp_path):
    scene = load(tmp_path)
    (shape,) = scene.shapes
    assert shape.id == "quad"
    np.testing.assert_array_equal(shape.vertices, POSITIONS[:4])  # what no face uses is left out
    np.testing.assert_array_equal(shape.normals, NORMALS[:4])
    np.testing.assert_array_equal(shape.uvs, [[0, 0], [1, 0], [1, 1], [0, 1]])
    assert shape.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert isinstance(shape.bsdf, Diffuse)
    np.testing.assert_array_equal(shape.bsdf.reflectance, [0.1, 0.2, 0.3])  # not rounded to 8 bits
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


@pytest.mark.parametrize(("metallic", "rough", "alpha"), [(0.5, 0.5, 0.25), (1.0, 0.0, 0.0), (None, None, 1.0)])
def test_metals(tmp_path, metallic, rough, alpha):
    pbr = {"metallicFactor": metallic, "roughnessFactor": rough, "baseColorFactor": [1, 0.5, 0.25, 0.5]}
    pbr = {k: v for k, v in pbr.items() if v is not None}
    (shape,) = load(tmp_path, materials=[{"pbrMetallicRoughness": pbr, "doubleSided": True}]).shapes
    assert isinstance(shape.bsdf, TwoSided)
    metal = shape.bsdf.bsdf
    assert isinstance(metal, Conductor)
    np.testing.assert_array_equal(metal.alpha, [alpha, alpha])
    np.testing.assert_array_equal(metal.specular_reflectance, [1, 0.5, 0.25])
    assert (metal.eta, metal.k, metal.id) == (0, 1, "material_0")


def test_emission(tmp_path):
    lamp = {"name": "lamp", "emissiveFactor": [1, 0.5, 0], "pbrMetallicRoughness": {"metallicFactor": 0}}
    lamp["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 12.5}}
    (shape,) = load(tmp_path, materials=[lamp], extensionsRequired=["KHR_materials_emissive_strength"]).shapes
    np.testing.assert_array_equal(shape.emission, [12.5, 6.25, 0])
    assert shape.emission_id == "lamp.emitter"


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
    # ours looks along its +z with +x to the left; theirs along −z with +x to the right
    np.testing.assert_allclose(eye.to_world, [[-1, 0, 0, 2], [0, 1, 0, 4], [0, 0, -1, 6], [0, 0, 0, 1]], atol=1e-15)
    assert ortho.kind == "orthographic"
    assert (ortho.film.width, ortho.film.height) == (1024, 512)
    np.testing.assert_allclose(ortho.to_world @ [0, 0, 1, 0], [-1, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(ortho.to_world[:3, :3], axis=0), [8, 8, 1])
    assert ortho.far == 100


def picture(values, mode):
    """A picture as the data of a URI."""
    file = io.BytesIO()
    PIL.Image.fromarray(np.asarray(values, np.uint8), mode).save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


def test_textures(tmp_path):
    """Base colour and its alpha, emission and normals, as the sampler and a transform lay them; by their mean without
    coordinates."""
    red = [[[255, 0, 0, 255], [128, 128, 128, 10]]]
    doc = document(
        images=[{"uri": picture(red, "RGBA")}, {"uri": picture([[[0, 255, 0]], [[255, 255, 255]]], "RGB")}],
        samplers=[{"wrapS": 33071, "magFilter": 9728}],
        textures=[{"source": 0, "sampler": 0}, {"source": 1}],
    )
    paint = doc["materials"][0]
    paint["pbrMetallicRoughness"] |= {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 1, 1, 1]}
    moved = {"offset": [0.1, 0.2], "scale": [2, 3], "rotation": np.pi / 2}
    paint |= {
        "alphaMode": "MASK", "emissiveTexture": {"index": 1, "extensions": {"KHR_texture_transform": moved}},
        "emissiveFactor": [1, 2, 3], "normalTexture": {"index": 1},
    }  # fmt: skip
    (shape,) = load_gltf(glb(tmp_path / "a.glb", doc)).shapes
    mask, turned, colour = shape.bsdf, shape.bsdf.bsdf, shape.bsdf.bsdf.bsdf.reflectance
    assert (colour.filter, colour.wrap) == ("nearest", "clamp")
    grey = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(colour.data, [[[0.5, 0, 0], [0.5 * grey, grey, grey]]], rtol=1e-5)
    np.testing.assert_array_equal(mask.opacity.data[..., 0], [[1, 0]])
    np.testing.assert_allclose(turned.normalmap.data[0, 0] * 2 - 1, np.array([-1, 1, -1]) / np.sqrt(3), atol=1e-6)
    assert not turned.shadowed
    np.testing.assert_allclose(shape.emission.data, [[[0, 2, 0]], [[1, 2, 3]]], atol=1e-6)
    assert (shape.emission.filter, shape.emission.wrap) == ("bilinear", "repeat")
    np.testing.assert_allclose(shape.emission.to_uv @ [1, 0, 1], [0.1, 0.2 - 2], atol=1e-12)
    del doc["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]
    scene = load_gltf(glb(tmp_path / "b.glb", doc))
    mean = [0.25 + 0.25 * grey, grey / 2, grey / 2]
    np.testing.assert_allclose(scene.shapes[0].bsdf.reflectance, mean, rtol=1e-5)
    np.testing.assert_allclose(scene.shapes[0].emission, [0.5, 2, 1.5], rtol=1e-5)
    assert "normalTexture" in scene.notes[0]


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
        extensionsUsed=["KHR_lights_punctual", "KHR_materials_clearcoat"],
        extensionsRequired=["KHR_lights_punctual"],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "directional"}]}},
        nodes=[
            {"mesh": 0, "children": [1, 2]},
            {"name": "sun", "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"mesh": 0, "name": "gone", "scale": [0, 1, 1]},
        ],
        animations=[{}],
        skins=[{}],
    )
    doc["materials"][0] |= {"alphaMode": "BLEND", "normalTexture": {"index": 0}, "occlusionTexture": {"index": 7}}
    doc["meshes"][0]["primitives"][0]["targets"] = [{}]
    scene = load_gltf(glb(tmp_path / "a.glb", doc))
    assert len(scene.shapes) == 1
    notes = "\n".join(scene.notes)
    for words in (
        "normalTexture 'wood.png'", "occlusionTexture without a name",
        "KHR_materials_clearcoat", "gone", "animations", "skins", "morph targets",
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
        (["extensionsRequired"], ["KHR_draco_mesh_compression"], "requires KHR_draco_mesh_compression"),
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
        (["materials", 0, "pbrMetallicRoughness", "baseColorFactor"], [2, 0, 0, 1], "paint.reflectance"),
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
        load_gltf(glb(tmp_path / "a.glb", doc, b"\0" * 600_000))


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
    nodes=[{"mesh": 0, "camera": 0, "scale": [-1, 1, 1], "rotation": [0, 0, 0, 1], "extensions": {}, "children": []}],
    extensionsUsed=[],
    textures=[{"source": 0}],
    images=[{"uri": "a.png"}],
)
FULL["materials"][0] |= {"normalTexture": {"index": 0}, "emissiveFactor": [1, 1, 1], "alphaMode": "BLEND"}
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
