"""Materials of glTF: which parts they become, and that pictures are those of Mitsuba 3."""

import jax
import numpy as np
import pytest
from gltf_files import DATA, added, document, glb, load, picture
from helpers import assert_same_picture, look_at, sphere_directions

import jaxrt
from jaxrt import brdf
from jaxrt.files.gltf import load_gltf
from jaxrt.parts import (
    Bitmap,
    Dielectric,
    Diffuse,
    Mask,
    MeshAttribute,
    NormalMap,
    Principled,
    PrincipledThin,
    Product,
    SceneError,
    TwoSided,
)

GREY = ((128 / 255 + 0.055) / 1.055) ** 2.4


def material(folder, pbr=(), **more):
    """The reflectance of a material, by its metallic-roughness part, extensions (KHR_materials_...) and other keys, and
    the notes."""
    extensions = {f"KHR_materials_{k}": v for k, v in more.pop("extensions", {}).items()}
    textures = {k: more.pop(k) for k in ("images", "textures", "samplers") if k in more}
    entry = {"name": "m", "pbrMetallicRoughness": dict(pbr), "extensions": extensions, **more}
    scene = load(folder, materials=[entry], extensionsRequired=[*extensions], **textures)
    return scene.shapes[0].bsdf, "\n".join(scene.notes)


def test_factors_of_the_metallic_roughness_model(tmp_path):
    pbr = {"metallicFactor": 0.5, "roughnessFactor": 0.25, "baseColorFactor": [1, 0.5, 0.25, 0.5]}
    sides, _ = material(tmp_path, pbr, doubleSided=True)
    assert isinstance(sides, TwoSided)
    surface = sides.bsdf
    assert isinstance(surface, Principled)
    np.testing.assert_array_equal(surface.base_color, [1, 0.5, 0.25])
    assert (surface.metallic, surface.roughness, surface.eta, surface.id) == (0.5, 0.25, 1.5, "m")
    plain, _ = material(tmp_path)
    assert (plain.metallic, plain.roughness) == (1, 1)
    np.testing.assert_array_equal(plain.base_color, [1, 1, 1])


def test_metals_are_those_of_appendix_b():
    """D, separable G and Schlick's F of glTF 2.0, B.3, for α = roughness², in their own words."""
    base, rough = 0.7, 0.6
    v, w = np.abs(sphere_directions(40, 1)), sphere_directions(40, 2)
    w[:, 2] = np.abs(w[:, 2])
    h = (v + w) / np.linalg.norm(v + w, axis=1, keepdims=True)
    a2, vh = rough**4, (v * h).sum(1)
    d = a2 / (np.pi * (h[:, 2] ** 2 * (a2 - 1) + 1) ** 2)
    g = np.prod([1 / (x[:, 2] + np.sqrt(a2 + (1 - a2) * x[:, 2] ** 2)) for x in (v, w)], 0)  # over 4 NL NV
    want = (base + (1 - base) * (1 - vh) ** 5) * g * d
    fields = dict.fromkeys(brdf.LOBES["principled"].fields, 0.0)
    fields |= {"ior": 1.5, "roughness": rough, "metallic": 1.0, "reflectance": jaxrt.Spectrum((base,))}
    eval = jax.jit(brdf.LOBES["principled"].eval)
    got = eval(brdf.Material(**fields), *(jaxrt.Vec3(*x.astype(np.float32).T) for x in (w, v)))
    np.testing.assert_allclose(got.channels[0], want, rtol=1e-4)


def test_reflectance_at_normal_incidence(tmp_path):
    """KHR_materials_ior and _specular: F₀ = ((n − 1)/(n + 1))² times factors; with none of it paint is Lambertian."""
    f0 = lambda bsdf: ((bsdf.eta - 1) / (bsdf.eta + 1)) ** 2
    rough, _ = material(tmp_path, {"metallicFactor": 0}, extensions={"ior": {"ior": 2.0}})
    assert f0(rough) == pytest.approx(1 / 9)
    weak = {"ior": {"ior": 2.0}, "specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 0]}}
    weak, notes = material(tmp_path, {"metallicFactor": 0}, extensions=weak)
    assert f0(weak) == pytest.approx(0.5 * 0.5 / 9)
    assert "of specularColor the mean is taken" in notes
    none, notes = material(tmp_path, {"metallicFactor": 0}, extensions={"specular": {"specularFactor": 0}})
    assert isinstance(none, Diffuse)
    assert not notes
    with pytest.raises(SceneError, match=r"'m'\.ior is 0\.5; give 1 or more"):
        material(tmp_path, extensions={"ior": {"ior": 0.5}})


def test_clear_coats(tmp_path):
    coat = {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.2}
    coated, notes = material(tmp_path, extensions={"clearcoat": coat})
    assert (coated.clearcoat, 0.1 - 0.099 * coated.clearcoat_gloss) == (0.5, pytest.approx(0.04))  # α = roughness²
    assert not notes
    coated, notes = material(tmp_path, extensions={"clearcoat": coat | {"clearcoatRoughnessFactor": 0.9}})
    assert coated.clearcoat_gloss == 0
    assert "clear coat is made smoother" in notes


def test_what_transmits(tmp_path):
    """KHR_materials_transmission is a thin sheet, with KHR_materials_volume the surface of a solid."""
    pbr = {"metallicFactor": 0, "roughnessFactor": 0, "baseColorFactor": [0.9, 0.8, 0.7, 1]}
    through, solid = {"transmission": {"transmissionFactor": 1}}, {"volume": {"thicknessFactor": 2}}
    thin, _ = material(tmp_path, pbr, extensions=through, doubleSided=True)
    assert isinstance(thin, Dielectric)
    assert (thin.thin, thin.int_ior, thin.ext_ior) == (True, 1.5, 1)
    np.testing.assert_array_equal(thin.specular_transmittance, [0.9, 0.8, 0.7])
    rough, _ = material(tmp_path, pbr | {"roughnessFactor": 0.5}, extensions=through | {"ior": {"ior": 1.3}})
    assert isinstance(rough, PrincipledThin)
    assert (rough.roughness, rough.eta, rough.spec_trans) == (0.5, 1.3, 1)
    glass, notes = material(tmp_path, pbr | {"roughnessFactor": 0.5}, extensions=through | solid)
    assert (glass.thin, glass.alpha, notes) == (False, [0.25, 0.25], "")
    solid["volume"] |= {"attenuationDistance": 1, "attenuationColor": [1, 0.5, 0.5]}
    glass, notes = material(tmp_path, pbr, extensions=through | solid)
    assert glass.alpha == [0, 0]
    assert "light is not absorbed" in notes
    through["transmission"]["transmissionFactor"] = 0.25
    mixed, _ = material(tmp_path, pbr | {"metallicFactor": 0.5}, extensions=through, doubleSided=True)
    assert (mixed.weight, mixed.second.bsdf.metallic) == (0.5, 1)
    assert (mixed.first.weight, mixed.first.first.bsdf.metallic, mixed.first.second.thin) == (0.25, 0, True)
    metal, _ = material(tmp_path, extensions=through)  # nothing passes a metal
    assert isinstance(metal, Principled)


def test_unlit_surfaces_are_as_bright_as_they_are(tmp_path):
    entry = {"name": "m", "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.5, 1, 1]}, "emissiveFactor": [9, 9, 9]}
    entry["extensions"] = {"KHR_materials_unlit": {}}
    (shape,) = load(tmp_path, materials=[entry]).shapes
    np.testing.assert_array_equal(shape.emission, [0.2, 0.5, 1])
    np.testing.assert_array_equal(shape.bsdf.reflectance, [0])


def test_meshes_of_one_emitting_material_and_other_colours(tmp_path):
    """Each has an emitter of its own."""
    doc = document()
    doc["materials"][0]["extensions"] = {"KHR_materials_unlit": {}}
    (one,) = doc["meshes"][0]["primitives"]
    red, data = added(doc, DATA, np.tile(np.array([255, 0, 0], np.uint8), (5, 1)), "VEC3", normalized=True)
    blue, data = added(doc, data, np.tile(np.array([0, 0, 255], np.uint8), (5, 1)), "VEC3", normalized=True)
    primitives = [one | {"attributes": one["attributes"] | {"COLOR_0": k}} for k in (red, blue)]
    doc["meshes"][0]["primitives"] = primitives
    params = jaxrt.params(jaxrt.load(glb(tmp_path / "a.glb", doc, data)))
    np.testing.assert_allclose(params["paint.emitter.radiance"], [0.1, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(params["paint_1.emitter.radiance"], [0, 0, 0.3], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("short_loops")
def test_coverage_of_what_emits(tmp_path):
    """α L and (1 − α) of what is behind: an unlit sheet with colours of vertices, before one with a texture for α."""
    doc = document(images=[{"uri": picture([[[255, 255, 255, 102]] * 2], "RGBA")}], textures=[{"source": 0}])
    unlit = {"extensions": {"KHR_materials_unlit": {}}, "alphaMode": "BLEND"}
    doc["materials"] = [
        unlit | {"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.25, 0.25]}},
        unlit | {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
        {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}, "emissiveFactor": [0.5, 0.5, 0.5]},
    ]
    (one,) = doc["meshes"][0]["primitives"]
    doc["meshes"] = [{"primitives": [one | {"material": k}]} for k in range(3)]
    doc["nodes"] = [{"mesh": k, "translation": [0, 0, -k], "scale": [9, 9, 1]} for k in range(3)]
    doc["nodes"] += [{"camera": 0, "translation": [12, 3, 9]}]
    doc["scenes"] = [{"nodes": [0, 1, 2, 3]}]
    doc["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.1, "aspectRatio": 1, "znear": 0.1}}]
    scene = jaxrt.resized(jaxrt.load(glb(tmp_path / "a.glb", doc)), 0, 4, 4)
    sol = jaxrt.render(scene, 1024, seed=0, method="path", max_depth=4)
    want = 0.25 * np.array([1, 0.5, 0.25]) + 0.75 * (0.4 + 0.6 * 0.5)
    error = np.sqrt((sol.stderr**2).mean((0, 1)) / 16)
    assert (error < 0.01).all()
    np.testing.assert_array_less(np.abs(sol.image.mean((0, 1)) - want), 4 * error)


def test_emission(tmp_path):
    lamp = {"name": "lamp", "emissiveFactor": [1, 0.5, 0], "pbrMetallicRoughness": {"metallicFactor": 0}}
    lamp["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 12.5}}
    (shape,) = load(tmp_path, materials=[lamp], extensionsRequired=["KHR_materials_emissive_strength"]).shapes
    np.testing.assert_array_equal(shape.emission, [12.5, 6.25, 0])
    assert shape.emission_id == "lamp.emitter"


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
    scene = load_gltf(glb(tmp_path / "a.glb", doc))
    (shape,) = scene.shapes
    mask, turned, colour = shape.bsdf, shape.bsdf.bsdf, shape.bsdf.bsdf.bsdf.base_color
    assert isinstance(mask, Mask)
    assert isinstance(turned, NormalMap)
    assert (colour.filter, colour.wrap) == ("nearest", "clamp")
    assert "wrapS (clamp) is taken for wrapT (repeat)" in "".join(scene.notes)
    np.testing.assert_allclose(colour.data, [[[0.5, 0, 0], [0.5 * GREY, GREY, GREY]]], rtol=1e-5)
    np.testing.assert_array_equal(mask.opacity.data[..., 0], [[1, 0]])
    np.testing.assert_allclose(turned.normalmap.data[0, 0] * 2 - 1, np.array([-1, 1, -1]) / np.sqrt(3), atol=1e-6)
    assert not turned.shadowed
    emission = shape.emission.first
    assert shape.emission.second is mask.opacity  # holes do not emit
    np.testing.assert_allclose(emission.data, [[[0, 2, 0]], [[1, 2, 3]]], atol=1e-6)
    assert (emission.filter, emission.wrap) == ("bilinear", "repeat")
    np.testing.assert_allclose(emission.to_uv @ [1, 0, 1], [0.1, 0.2 - 2], atol=1e-12)
    tangents, data = added(doc, DATA, np.tile(np.array([1, 0, 0, -1], np.float32), (5, 1)), "VEC4")
    doc["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = tangents
    assert "are mirrored, slopes" in "".join(load_gltf(glb(tmp_path / "c.glb", doc, data)).notes)
    del doc["meshes"][0]["primitives"][0]["attributes"]["TANGENT"]
    del doc["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]
    scene = load_gltf(glb(tmp_path / "b.glb", doc, data))
    mean = [0.25 + 0.25 * GREY, GREY / 2, GREY / 2]
    np.testing.assert_allclose(scene.shapes[0].bsdf.base_color, mean, rtol=1e-5)
    np.testing.assert_allclose(scene.shapes[0].emission, [0.5, 2, 1.5], rtol=1e-5)
    assert "normalTexture" in scene.notes[0]


def test_textures_of_metallic_and_roughness(tmp_path):
    """Green is roughness, blue is metallic, both as they are stored, times factors; what does not vary is a number."""
    images = [{"uri": picture([[[9, 51, 0], [9, 255, 255]]], "RGB")}, {"uri": picture([[[0, 51, 255]] * 2], "RGB")}]
    pbr = {"metallicRoughnessTexture": {"index": 0}, "roughnessFactor": 0.5, "metallicFactor": 0.25}
    more = {"images": images, "textures": [{"source": 0}, {"source": 1}]}
    surface, _ = material(tmp_path, pbr, **more)
    np.testing.assert_allclose(surface.roughness.data, [[[0.1], [0.5]]], rtol=1e-6)
    np.testing.assert_allclose(surface.metallic.data, [[[0], [0.25]]], rtol=1e-6)
    surface, _ = material(tmp_path, pbr | {"metallicRoughnessTexture": {"index": 1}}, **more)
    assert (surface.roughness, surface.metallic) == (pytest.approx(0.1), 0.25)
    through = {"transmission": {"transmissionFactor": 0.5, "transmissionTexture": {"index": 0}}}
    mixed, _ = material(
        tmp_path, pbr | {"metallicFactor": 0}, extensions=through | {"volume": {"thicknessFactor": 1}}, **more
    )
    np.testing.assert_allclose(mixed.weight, 0.5 * 9 / 255, rtol=1e-6)
    assert isinstance(mixed.second, Dielectric)
    np.testing.assert_allclose(mixed.second.alpha[0].data, [[[0.01], [0.25]]], rtol=1e-6)  # α = roughness²


def test_a_second_set_of_texture_coordinates(tmp_path):
    """Textures are laid by the set that the base colour asks for; others are named."""
    doc = document(images=[{"uri": picture([[0, 255]], "L")}], textures=[{"source": 0}])
    second, data = added(doc, DATA, np.arange(10, dtype=np.float32).reshape(5, 2), "VEC2")
    doc["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = second
    paint = doc["materials"][0]
    paint["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0, "texCoord": 1}
    paint |= {"emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}
    scene = load_gltf(glb(tmp_path / "a.glb", doc, data))
    (shape,) = scene.shapes
    np.testing.assert_array_equal(shape.uvs[:2], [[0, 1], [2, 3]])
    assert isinstance(shape.bsdf.base_color, Bitmap)
    np.testing.assert_allclose(shape.emission, 0.5)  # the mean of a texture of the other set
    assert "textures are not mapped (emissiveTexture embedded)" in scene.notes[0].replace("'", "")


def test_colours_of_vertices(tmp_path):
    """COLOR_0 times texture times factor: folded into them where it does not vary, else a product at each point."""
    doc = document(images=[{"uri": picture([[0, 255]], "L")}], textures=[{"source": 0}])
    even, data = added(doc, DATA, np.full((5, 4), 51, np.uint8), "VEC4", normalized=True)
    varies, data = added(doc, data, np.linspace(0, 1, 20, dtype=np.float32).reshape(5, 4), "VEC4")
    attributes, paint = doc["meshes"][0]["primitives"][0]["attributes"], doc["materials"][0]
    paint |= {"alphaMode": "BLEND"}

    def bsdf(number):
        attributes["COLOR_0"] = number
        (shape,) = load_gltf(glb(tmp_path / "a.glb", doc, data)).shapes
        return shape.bsdf, shape

    found, _ = bsdf(even)
    np.testing.assert_allclose(found.bsdf.base_color, [0.02, 0.04, 0.06])
    assert found.opacity == pytest.approx(0.2)
    found, shape = bsdf(varies)
    tint = found.bsdf.base_color
    assert isinstance(tint, Product)
    np.testing.assert_allclose(tint.first.data, [[[0.1, 0.2, 0.3]]])
    assert (tint.second.name, found.opacity.name) == ("vertex_color", "vertex_alpha")
    np.testing.assert_allclose(shape.attributes["vertex_color"][1], np.arange(4, 7) / 19, rtol=1e-6)
    np.testing.assert_allclose(shape.attributes["vertex_alpha"][1], [7 / 19], rtol=1e-6)
    paint["pbrMetallicRoughness"] |= {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, 1]}
    found, _ = bsdf(varies)
    assert isinstance(found.bsdf.base_color.first, Bitmap)
    assert isinstance(found.opacity, MeshAttribute)
    assert jaxrt.plan(jaxrt.load(tmp_path / "a.glb")).textures == ("bitmap", "attribute", "product")


# --------------------------------------------------------------------------------------- pictures

TEXELS = np.random.default_rng(1).integers(60, 255, (2, 2, 3, 3))
WIDTH, HEIGHT, FOV = 32, 24, 0.6
DIFFUSE = {"specular": {"specularFactor": 0}}
LAMP = look_at((1, 4, 4), (0, 0, 0), (0, 1, 0)) @ np.diag([1.5, 1.5, 1, 1])


def tilted(x, y):
    return look_at((x, y, 0.9), (0.5 * x, 0.5 * y, 5), (0, 1, 0)) @ np.diag([0.6, 0.6, 0.6, 1])


def entry(base, metallic=0.0, roughness=1.0, extensions=(), texture=None, **more):
    """A material; `texture`: of its base colour."""
    pbr = {"baseColorFactor": [*base, 1], "metallicFactor": metallic, "roughnessFactor": roughness}
    pbr |= {} if texture is None else {"baseColorTexture": {"index": texture}}
    pbr |= {"metallicRoughnessTexture": more.pop("rough")} if "rough" in more else {}
    return {
        "pbrMetallicRoughness": pbr,
        "extensions": {f"KHR_materials_{k}": v for k, v in dict(extensions).items()},
        **more,
    }


def write(path, items):
    """Squares and cubes [-1, 1]ⁿ of materials at places, seen from a camera 9 above."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    doc = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "materials": [], "meshes": [], "nodes": []}
    position, data = added(doc, b"", square, "VEC3")
    uv, data = added(doc, data, (square[:, :2] + 1) / 2, "VEC2")
    corners, data = added(doc, data, cube, "VEC3")
    quads = lambda q: np.array(q, np.uint8)[:, [0, 1, 2, 0, 2, 3]].ravel()
    one, data = added(doc, data, quads([[0, 1, 2, 3]]), "SCALAR")
    six, data = added(doc, data, quads(sides), "SCALAR")
    shapes = {
        "rectangle": {"attributes": {"POSITION": position, "TEXCOORD_0": uv}, "indices": one},
        "cube": {"attributes": {"POSITION": corners}, "indices": six},
    }
    for k, (kind, place, material, _) in enumerate(items):
        doc["meshes"] += [{"primitives": [shapes[kind] | {"material": k}]}]
        doc["materials"] += [material]
        doc["nodes"] += [{"mesh": k, "matrix": np.asarray(place).T.ravel().tolist()}]
    doc["nodes"] += [{"camera": 0, "translation": [0, 0, 9]}]
    lens = {"yfov": FOV, "aspectRatio": WIDTH / HEIGHT, "znear": 0.1}
    doc["cameras"] = [{"type": "perspective", "perspective": lens}]
    doc["images"] = [{"uri": picture(a, "RGB")} for a in TEXELS]
    doc["textures"] = [{"source": 0}, {"source": 1}]
    return glb(path, doc, data)


def peer(items, depth):
    """The same in Mitsuba 3, of the reflectances that stand last; the first item is the lamp."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")

    def made(value):
        if isinstance(value, dict):
            return {k: made(v) for k, v in value.items()}
        if isinstance(value, list):
            return {"type": "rgb", "value": value}
        if isinstance(value, np.ndarray):  # a texture of linear values
            return {"type": "bitmap", "bitmap": mi.Bitmap(value.astype(np.float32)), "raw": True}
        return value

    pose = mi.ScalarTransform4f().translate([0, 0, 9]).rotate([0, 1, 0], 180)
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "gaussian"}}
    sensor = {"type": "perspective", "fov": np.degrees(FOV), "fov_axis": "y", "to_world": pose, "film": film}
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": depth}, "sensor": sensor}
    for k, (kind, place, _, bsdf) in enumerate(items):
        shape = {"type": kind, "to_world": mi.ScalarTransform4f(np.asarray(place))}
        last = {"emitter": {"type": "area", "radiance": made(bsdf)}} if k == 0 else {"bsdf": made(bsdf)}
        scene[f"shape_{k}"] = shape | last
    loaded = mi.load_dict(scene)
    return np.stack([np.array(mi.render(loaded, spp=64, seed=k), np.float64)[..., :3] for k in range(16)])


def compare(path, items, depth):
    scene = jaxrt.resized(jaxrt.load(write(path / "a.glb", items)), 0, WIDTH, HEIGHT)
    sols = [jaxrt.render(scene, 256, seed=k, method="path", max_depth=depth) for k in range(4)]
    assert_same_picture(peer(items, depth), sols, most=0.01)


def linear(a):
    a = np.asarray(a) / 255
    return np.where(a <= 0.04045, a / 12.92, ((a + 0.055) / 1.055) ** 2.4)


ROOM = [
    ("rectangle", LAMP, entry([0, 0, 0], extensions=DIFFUSE, emissiveFactor=[9, 8, 7]), [9.0, 8, 7]),
    (
        "rectangle",
        np.diag([4.0, 4, 1, 1]),
        entry([0.8, 0.5, 0.2], extensions=DIFFUSE),
        {"type": "diffuse", "reflectance": [0.8, 0.5, 0.2]},
    ),
]


@pytest.mark.peer
@pytest.mark.slow
@pytest.mark.usefixtures("short_loops")
def test_opaque_materials_look_as_principled_ones_of_mitsuba(tmp_path):
    """Dielectric, mixed, metal, textured and coated, the last two from behind, one of which has two sides."""
    turned = np.diag([1, -1, -1, 1])
    coat = {"clearcoat": {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.2}, "ior": {"ior": 2.0}}
    principled = lambda base, **more: {"type": "principled", "base_color": base, **more}
    blue, plastic = entry([0.2, 0.4, 0.9], 0, 0.3), principled([0.2, 0.4, 0.9], roughness=0.3, eta=1.5)
    metal = principled([0.9, 0.6, 0.3], metallic=1.0, roughness=0.4)
    rough, metallic = TEXELS[0][..., 1:2] / 255, 0.5 * TEXELS[0][..., 2:] / 255
    textured = principled(linear(TEXELS[1]) * [1, 0.5, 1], roughness=rough, metallic=metallic)
    coated = principled([0.7] * 3, metallic=0.3, roughness=0.6, eta=2.0, clearcoat=1.0, clearcoat_gloss=0.06 / 0.099)
    items = [
        *ROOM,
        ("cube", tilted(-1.7, 1), blue, plastic),
        ("rectangle", tilted(0, 1), entry([0.9, 0.6, 0.3], 1, 0.4), metal),
        ("rectangle", tilted(1.7, 1), entry([1, 0.5, 1], 0.5, 1, texture=1, rough={"index": 0}), textured),
        ("rectangle", tilted(-1.7, -1), entry([0.7] * 3, 0.3, 0.6, coat), coated),
        ("rectangle", tilted(0, -1) @ turned, blue | {"doubleSided": True}, {"type": "twosided", "bsdf": plastic}),
        ("rectangle", tilted(1.7, -1) @ turned, blue, plastic),
    ]
    compare(tmp_path, items, 4)


@pytest.mark.peer
@pytest.mark.slow
@pytest.mark.usefixtures("short_loops")
def test_glass_looks_as_that_of_mitsuba(tmp_path):
    """Solid and thin, smooth and rough, and half of one with paint; base colour tints at each surface."""
    full, half = ({"transmission": {"transmissionFactor": t}} for t in (1, 0.5))
    solid, tint, white = {"volume": {"thicknessFactor": 1}}, [0.6, 0.8, 0.9], [0.9, 0.9, 0.9]
    boundary = {"int_ior": 1.5, "ext_ior": 1.0, "specular_transmittance": tint}
    thin = {"type": "thindielectric", **boundary}
    paint = {"type": "twosided", "bsdf": {"type": "principled", "base_color": tint, "roughness": 0.0, "eta": 1.5}}
    frosted = {"type": "principledthin", "base_color": white, "roughness": 0.4, "eta": 1.4, "spec_trans": 1.0}
    items = [
        *ROOM,
        ("cube", tilted(-1.7, 0.9), entry(tint, 0, 0, full | solid), {"type": "dielectric", **boundary}),
        ("cube", tilted(1.7, 0.9), entry(tint, 0, 0.6, full | solid), {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.36, **boundary}),
        ("rectangle", tilted(0, 1), entry(tint, 0, 0, full), thin),
        ("rectangle", tilted(-0.8, -0.9), entry(white, 0, 0.4, full | {"ior": {"ior": 1.4}}), frosted),
        ("rectangle", tilted(0.8, -0.9), entry(tint, 0, 0, half, doubleSided=True), {"type": "blendbsdf", "weight": 0.5, "a": paint, "b": thin}),
    ]  # fmt: skip
    compare(tmp_path, items, 5)
