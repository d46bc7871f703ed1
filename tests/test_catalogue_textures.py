"""Textures, environment maps and materials made of others against Mitsuba 3, each on a scene of its own."""

import numpy as np
import pytest
from test_catalogue import CONSTANT, GLASS, GOLD, LAMPS, METAL, SCENE, check, principled, rough, several, two

from jaxrt.files import image
from jaxrt.files.textures import read_picture
from jaxrt.parts import SceneError

pytestmark = [pytest.mark.peer, pytest.mark.usefixtures("short_loops")]


@pytest.fixture
def pictures(tmp_path):
    """Files that scenes below refer to: colours, an uneven grey, and a mesh with coordinates and attributes."""
    import trimesh
    from PIL import Image

    random = np.random.default_rng(3)
    Image.fromarray(random.integers(30, 250, (3, 5, 3), np.uint8)).save(tmp_path / "colours.png")
    Image.fromarray(random.integers(40, 250, (4, 3), np.uint8)).save(tmp_path / "grey.png")
    normals = random.normal(size=(4, 5, 3)) * (0.4, 0.4, 0.1) + (0, 0, 1)
    normals = 0.5 + 0.5 * normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    Image.fromarray((255 * normals).astype(np.uint8)).save(tmp_path / "normals.png")
    image.write_exr(tmp_path / "bright.exr", random.random((4, 6, 3)).astype(np.float32) ** 3 * 6)
    corners = [(-1, -1, 0), (1, -1, 0.3), (1, 1, 0), (-1, 1, 0.4)]
    uvs, colours = (
        [(0, 0), (1.5, 0), (1.4, 1), (0, 1.2)],
        [(0.9, 0.1, 0.1), (0.1, 0.9, 0.2), (0.2, 0.1, 0.9), (1, 1, 1)],
    )
    head = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {c}" for c in ("x", "y", "z", "u", "v"))]
    head += [
        *(f"property float {c}" for c in ("r", "g", "b")),
        "element face 2",
        "property list uchar int vertex_indices",
    ]
    head += [*(f"property float {c}" for c in ("r", "g", "b")), "end_header"]
    body = [" ".join(map(str, p + t + c)) for p, t, c in zip(corners, uvs, colours, strict=True)]
    body += ["3 0 1 2 .1 .8 .3", "3 0 2 3 .7 .2 .9"]
    (tmp_path / "sheet.ply").write_text("\n".join(head + body) + "\n")
    trimesh.creation.icosahedron().export(tmp_path / "smooth.ply")
    bare = [*(f"{x} {y} {z}" for x, y, z in corners), "3 0 1 2", "3 0 2 3"]
    kept = [line for line in head if line[-2:] not in (" u", " v", " r", " g", " b")]
    (tmp_path / "bare.ply").write_text("\n".join(kept + bare) + "\n")


def bitmap(name, file, more=""):
    return f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>{more}</texture>'


NEAREST = '<string name="filter_type" value="nearest"/><string name="wrap_mode" value="{}"/>'
TURNED = '<transform name="to_uv"><scale x="2" y="3"/><rotate z="1" angle="20"/><translate x=".3" y=".1"/></transform>'
RAW = '<boolean name="raw" value="true"/>'
SHEET = """<shape type="ply"><string name="filename" value="sheet.ply"/><boolean name="face_normals" value="true"/>
<transform name="to_world"><rotate x="1" angle="60"/></transform>{}</shape>"""
CHECKERS = '<texture type="checkerboard" name="reflectance"><rgb name="color0" value=".9,.2,.1"/>{}</texture>'


def diffuse(texture):
    return f'<bsdf type="diffuse">{texture}</bsdf>'


def attribute(name):
    return SHEET.format(diffuse(f'<texture type="mesh_attribute" name="reflectance"><string name="name" value="{name}"/></texture>'))  # fmt: skip


def turned(plugin, texture, inner):
    return f'<bsdf type="{plugin}">{texture}{inner}</bsdf>'


RAW = '<boolean name="raw" value="true"/>'
TEXTURED = {
    "bitmap": two(diffuse(bitmap("reflectance", "colours.png")), diffuse(bitmap("reflectance", "grey.png")))
    + SHEET.format(diffuse(bitmap("reflectance", "colours.png", RAW))),
    "bitmap nearest": two(
        diffuse(bitmap("reflectance", "colours.png", TURNED + NEAREST.format("mirror"))),
        diffuse(bitmap("reflectance", "grey.png", TURNED + NEAREST.format("clamp"))),
    )
    + SHEET.format(diffuse(bitmap("reflectance", "colours.png", RAW + NEAREST.format("repeat")))),
    "checkerboard and attributes": two(diffuse(CHECKERS.format("")), diffuse(CHECKERS.format(TURNED)))
    + attribute("vertex_color").replace("<rotate", '<translate x="-1" y="-.5"/><rotate')
    + attribute("face_color").replace("<rotate", '<translate x=".5" y="1.5"/><rotate'),
    "roughness": two(
        rough("ggx", bitmap("alpha_u", "grey.png", RAW) + bitmap("alpha_v", "colours.png", RAW) + GOLD),
        f'<bsdf type="plastic">{bitmap("diffuse_reflectance", "colours.png")}</bsdf>',
    )
    + SHEET.replace("sheet", "bare")  # no coordinates
    .format(rough("ggx", '<float name="alpha_u" value=".05"/><float name="alpha_v" value=".4"/>'))
    .replace("<rotate", '<translate x="-1.2" y=".5"/><rotate'),
    "principled": several(
        principled(
            "",
            METAL.replace('roughness=".4" ', ""),
            bitmap("base_color", "colours.png") + bitmap("roughness", "grey.png", RAW),
        ),
        principled("", GLASS),
        principled("thin", 'spec_trans=".3" sheen="1"', bitmap("diff_trans", "grey.png", RAW)),
        principled("thin", GLASS),
    ),
    "blendbsdf and mask": several(
        f'<bsdf type="blendbsdf"><float name="weight" value=".3"/>{rough("ggx", GOLD)}<bsdf type="diffuse"/></bsdf>',
        f"""<bsdf type="blendbsdf">{bitmap("weight", "grey.png")}<bsdf type="plastic"/><bsdf type="blendbsdf">
        <float name="weight" value=".6"/><bsdf type="dielectric"/><bsdf type="diffuse"/></bsdf></bsdf>""",
        f'<bsdf type="mask">{bitmap("opacity", "grey.png")}<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
        '<bsdf type="mask"><float name="opacity" value=".4"/><bsdf type="conductor"/></bsdf>',
    ),
    "twosided": f"""<shape type="cylinder"><bsdf type="twosided">{diffuse(CHECKERS.format(""))}{rough("ggx", GOLD)}</bsdf>
    </shape><shape type="disk"><transform name="to_world"><rotate y="1" angle="110"/><translate x="-1.2"/></transform>
    <bsdf type="twosided">{rough("beckmann", "")}<bsdf type="diffuse"/></bsdf></shape>""",
    "normalmap and bumpmap": several(
        turned("normalmap", bitmap("normalmap", "normals.png", RAW), '<bsdf type="diffuse"/>'),
        f"""<bsdf type="twosided">{turned("normalmap", bitmap("normalmap", "normals.png", RAW), rough("ggx", GOLD))}
        </bsdf>""",
        turned("bumpmap", bitmap("bump", "grey.png", RAW) + '<float name="scale" value=".4"/>', rough("ggx", GOLD)),
        turned(
            "bumpmap", bitmap("bump", "grey.png", RAW) + '<float name="scale" value=".2"/>', '<bsdf type="diffuse"/>'
        ),
    ),
    "emission": two('<bsdf type="diffuse"/>', f'<emitter type="area">{bitmap("radiance", "bright.exr")}</emitter>')
    + f"""<shape type="rectangle"><transform name="to_world"><lookat origin="-2,-1,2" target="0,0,0" up="0,0,1"/>
    </transform><emitter type="area">{bitmap("radiance", "colours.png")}</emitter></shape>
    <shape type="ply"><string name="filename" value="smooth.ply"/>
    <transform name="to_world"><scale value=".5"/><translate x="-.3" y="-1.5" z=".8"/></transform>
    <emitter type="area"><rgb name="radiance" value="6,9,3"/></emitter></shape>""",  # dark where vertex normals turn away
}

CHECKERS_IN = '<texture type="checkerboard" name="{}">{}</texture>'
INNER = bitmap("color0", "colours.png", NEAREST.format("mirror")) + '<rgb name="color1" value=".1,.9,.2"/>' + TURNED
ATTRIBUTE = '<texture type="mesh_attribute" name="color1"><string name="name" value="vertex_color"/></texture>'
TEXTURED["nested"] = (
    two(
        diffuse(
            CHECKERS_IN.format(
                "reflectance", bitmap("color0", "colours.png", TURNED) + CHECKERS_IN.format("color1", INNER)
            )
        ),
        rough("ggx", CHECKERS_IN.format("alpha", bitmap("color1", "grey.png", RAW)) + GOLD),
    )
    + SHEET.format(diffuse(CHECKERS_IN.format("reflectance", ATTRIBUTE))).replace(
        "<rotate", '<translate y="2"/><rotate'
    )
    + f"""<shape type="rectangle"><transform name="to_world"><lookat origin="-2,-1,2" target="0,0,0" up="0,0,1"/>
    </transform><emitter type="area">{CHECKERS_IN.format("radiance", bitmap("color1", "bright.exr"))}</emitter></shape>"""
)


@pytest.mark.parametrize("name", TEXTURED)
def test_textures(name, tmp_path, pictures):
    check(tmp_path, SCENE.format(depth=5, emitter=CONSTANT, shape=TEXTURED[name]))


ENVMAP = """<emitter type="envmap"><string name="filename" value="{}"/><float name="scale" value=".5"/>
<transform name="to_world"><rotate x=".6" y=".8" angle="50"/></transform></emitter>"""


@pytest.mark.parametrize("lamps", ["alone", "beside"])
def test_environment_maps(lamps, tmp_path, pictures):
    around = np.full((16, 32, 3), 0.2, np.float32)
    around[3:5, 7:9] = 40, 30, 10
    image.write_exr(tmp_path / "around.exr", around)
    shape = two(rough("ggx", GOLD), '<bsdf type="diffuse"/>')
    text = SCENE.format(depth=3, emitter=ENVMAP.format("around.exr" if lamps == "alone" else "bright.exr"), shape=shape)
    if lamps == "alone":
        text = text.replace('<emitter type="area"><rgb name="radiance" value="9,8,7"/></emitter>', "")
    check(tmp_path, text)


def test_projectors(tmp_path, pictures):
    emitter = f"""<emitter type="projector"><float name="scale" value="3"/><float name="fov" value="35"/>
    {bitmap("irradiance", "colours.png")}<transform name="to_world"><lookat origin="-1,-2,4" target=".5,0,0" up="0,0,1"/>
    </transform></emitter>"""
    shape = two('<bsdf type="diffuse"/>', '<bsdf type="diffuse"/>')
    check(tmp_path, SCENE.format(depth=2, emitter=emitter + LAMPS["spot"], shape=shape))


def test_pictures_of_floats_are_read_alike(tmp_path):
    """Radiance's RGBE without and with run lengths, and PFM of one and three channels."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    random = np.random.default_rng(4)
    for name, shape in (("a.hdr", (3, 5, 3)), ("b.hdr", (3, 40, 3)), ("c.pfm", (4, 3, 3)), ("d.pfm", (4, 3, 1))):
        values = np.repeat(random.random(shape).astype(np.float32) ** 4 * 9, 2, 1)
        mi.Bitmap(values).write(str(tmp_path / name))
        want = np.array(mi.Bitmap(str(tmp_path / name))).reshape(values.shape)
        np.testing.assert_array_equal(read_picture(tmp_path / name), want, name)
    (tmp_path / "d.pfm").write_bytes((tmp_path / "d.pfm").read_bytes()[:-1])
    with pytest.raises(SceneError, match="which it does not hold"):
        read_picture(tmp_path / "d.pfm")
