"""Every item of the catalogue against Mitsuba 3 on a scene of its own, by a z-test of each value."""

import numpy as np
import pytest
from helpers import assert_same_picture, ball_of_distances
from serialized import volume

import jaxrt

pytestmark = [pytest.mark.peer, pytest.mark.usefixtures("short_loops")]

SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0,-5,2" target="0,0,0" up="0,0,1"/></transform>
<sampler type="independent"><integer name="sample_count" value="256"/></sampler><film type="hdrfilm">
<integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".8,.5,.2"/></bsdf></shape>
<shape type="sphere"><point name="center" x="2" y="-1" z="4"/><float name="radius" value=".7"/>
<emitter type="area"><rgb name="radiance" value="9,8,7"/></emitter></shape>{emitter}{shape}</scene>"""
BALL = '<shape type="sphere">{}</shape>'
BOX = """<shape type="cube"><transform name="to_world"><scale value=".6"/><rotate z="1" angle="30"/></transform>{}</shape>
<shape type="sphere"><point name="center" x="1.4" y="0" z="-.5"/><float name="radius" value=".5"/>{}</shape>"""
CONSTANT = '<emitter type="constant"><rgb name="radiance" value=".3,.4,.5"/></emitter>'


def rough(distribution, more):
    return f'<bsdf type="roughconductor"><string name="distribution" value="{distribution}"/>{more}</bsdf>'


def two(a, b):
    return BOX.format(a, b)


def several(*bsdfs):
    """Up to six materials, on cubes and spheres by turns."""
    cube = '<shape type="cube"><transform name="to_world"><scale value=".4"/><rotate z="1" angle="30"/><translate x="{}" y="{}" z="-.55"/></transform>{}</shape>'
    ball = (
        '<shape type="sphere"><point name="center" x="{}" y="{}" z="-.5"/><float name="radius" value=".45"/>{}</shape>'
    )
    places = [(-0.7, -1.2), (0.7, -1.2), (0.2, 0.2), (1.5, 0.2), (-1.2, 0.2), (-0.1, 1.7)]
    return "".join((ball if k % 2 else cube).format(*places[k], bsdf) for k, bsdf in enumerate(bsdfs))


def principled(thin, given, more='<rgb name="base_color" value=".8,.6,.2"/>'):
    numbers = "".join(f'<float name="{k}" value={v}/>' for k, v in (pair.split("=") for pair in given.split()))
    return f'<bsdf type="principled{thin}">{more}{numbers}</bsdf>'


METAL = 'metallic=".6" anisotropic=".7" roughness=".4" clearcoat="1" clearcoat_gloss=".3" sheen=".5" specular=".7"'
GLASS = 'spec_trans=".8" roughness=".4" eta="1.4" spec_tint=".3" flatness=".5"'
GOLD = '<string name="material" value="Au"/>'
GLASSES = '<rgb name="specular_reflectance" value=".9,.8,.7"/><rgb name="specular_transmittance" value=".6,.7,.8"/>'
ITEMS = {
    "metals": several(
        rough("beckmann", GOLD),
        rough("beckmann", '<float name="alpha" value=".4"/>'),
        rough("ggx", '<float name="alpha_u" value=".5"/><float name="alpha_v" value=".1"/>'),
        rough("ggx", '<float name="alpha" value=".8"/>'),
    ),
    "smooth boundaries": several(
        '<bsdf type="dielectric"/>',
        '<bsdf type="dielectric"><string name="int_ior" value="diamond"/><float name="ext_ior" value="1.1"/>'
        f"{GLASSES}</bsdf>",
        '<bsdf type="thindielectric"><float name="int_ior" value="2"/></bsdf>',
        '<bsdf type="thindielectric"><rgb name="specular_transmittance" value=".6,.7,.8"/></bsdf>',
        '<bsdf type="plastic"><rgb name="diffuse_reflectance" value=".1,.27,.36"/></bsdf>',
        '<bsdf type="twosided"><bsdf type="plastic"><rgb name="diffuse_reflectance" value=".9,.5,.1"/>'
        '<boolean name="nonlinear" value="true"/><string name="int_ior" value="pet"/></bsdf></bsdf>',
    ),
    "rough boundaries": several(
        '<bsdf type="roughdielectric"><float name="alpha" value=".2"/></bsdf>',
        '<bsdf type="roughdielectric"><string name="distribution" value="ggx"/><float name="alpha_u" value=".6"/>'
        f'<float name="alpha_v" value=".3"/><string name="int_ior" value="diamond"/>{GLASSES}</bsdf>',
        '<bsdf type="roughplastic"><rgb name="diffuse_reflectance" value=".1,.27,.36"/></bsdf>',
        '<bsdf type="twosided"><bsdf type="roughplastic"><rgb name="diffuse_reflectance" value=".9,.5,.1"/>'
        '<boolean name="nonlinear" value="true"/><string name="distribution" value="ggx"/>'
        '<float name="alpha" value=".4"/></bsdf></bsdf>',
    ),
}
"""Several in a scene, for one compilation; principled surfaces are with the textures."""


LAMPS = {
    "point": """<emitter type="point"><point name="position" x="-1" y="-2" z="3"/>
<rgb name="intensity" value="9,2,5"/></emitter>""",
    "spot": """<emitter type="spot"><float name="cutoff_angle" value="25"/><rgb name="intensity" value="90,60,30"/>
<transform name="to_world"><lookat origin="-1,-2,4" target=".5,0,0" up="0,0,1"/></transform></emitter>""",
    "directional": '<emitter type="directional"><vector name="direction" x=".3" y=".5" z="-1"/></emitter>',
}


def check(tmp_path, text):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path = tmp_path / "scene.xml"
    path.write_text(text)
    peer = mi.load_file(str(path))
    runs = np.stack([np.array(mi.render(peer, spp=64, seed=k), np.float64)[..., :3] for k in range(16)])
    sols = [jaxrt.render(jaxrt.load(path), 256, seed=k, method="path") for k in range(4)]
    assert_same_picture(runs, sols, most=0.01)


@pytest.mark.parametrize("name", ITEMS)
def test_mitsuba_renders_the_same_picture(name, tmp_path):
    check(tmp_path, SCENE.format(depth=7, emitter=CONSTANT, shape=ITEMS[name]))


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("spot", "directional")]  # "all" has them


@pytest.mark.parametrize("name", ["point", *SLOW, "all"])
def test_lamps_without_extent(name, tmp_path):
    """With emitters beside them that only light tracing sees: black surfaces, and others that are as without."""
    beam = '<emitter type="directionalarea"><rgb name="radiance" value="90,80,70"/></emitter>'
    emitters = "".join(LAMPS.values()) if name == "all" else LAMPS[name] + '<emitter type="constant"/>'
    shape = several('<bsdf type="diffuse"/>', '<bsdf type="diffuse"/>', beam, f'<bsdf type="diffuse"/>{beam}')
    text = SCENE.format(depth=4, emitter=emitters, shape=shape)
    if name != "all":  # no lamp with extent beside it
        text = text.replace('<emitter type="area"><rgb name="radiance" value="9,8,7"/></emitter>', "")
    check(tmp_path, text)


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_crop_windows_principal_points_and_filters(kind, tmp_path):
    text = SCENE.format(depth=3, emitter=CONSTANT, shape=BALL.format('<bsdf type="diffuse"/>'))
    crop = zip(("width", "height", "offset_x", "offset_y"), (10, 12, 9, 3), strict=True)
    window = "".join(f'<integer name="crop_{k}" value="{v}"/>' for k, v in crop)
    text = text.replace('<integer name="height"', window + '<integer name="height"')
    if kind == "orthographic":
        text = text.replace('"perspective"><float name="fov" value="40"/>', '"orthographic">')
        text = text.replace('<rfilter type="box"/>', '<rfilter type="mitchell"/>')
    else:
        shift = "".join(f'<float name="principal_point_offset_{k}" value="{v}"/>' for k, v in (("x", 0.1), ("y", -0.2)))
        text = text.replace('<float name="fov"', shift + '<float name="fov"')
        border = '<boolean name="sample_border" value="true"/><rfilter type="lanczos"/>'
        text = text.replace('<rfilter type="box"/>', border)
    check(tmp_path, text)


def test_hidden_emitters(tmp_path):
    """A lamp, a dark one and the enclosure, alone, behind each other, and behind what lets light straight through."""
    plate = """<shape type="rectangle"><transform name="to_world"><scale value=".4"/><rotate x="1" angle="60"/>
    <translate x="{}" y="{}" z=".4"/></transform>{}</shape>"""
    lamp, dark = (f'<emitter type="area"><rgb name="radiance" value="{v}"/></emitter>' for v in (2, 0))
    sheets = '<bsdf type="null"/>', '<bsdf type="thindielectric"/>'
    shapes = [(-1.2, -1, lamp), (-1, -0.6, dark), (-0.3, -1, sheets[0]), (-0.1, -0.6, lamp)]
    shapes += [(0.6, -1, sheets[1]), (0.8, -0.6, lamp), (1.5, -1, sheets[0]), (1.7, -0.6, sheets[1])]
    text = SCENE.format(depth=5, emitter=CONSTANT, shape="".join(plate.format(*shape) for shape in shapes))
    check(tmp_path, text.replace("</integrator>", '<boolean name="hide_emitters" value="true"/></integrator>'))


@pytest.mark.slow
def test_grids_of_distances(tmp_path):
    """One turned and scaled unevenly, which Mitsuba draws as an instance only, and one of glass."""
    (tmp_path / "ball.vol").write_bytes(volume(ball_of_distances(8, 0.02, 0.3)))
    grid = """<shape type="sdfgrid"><string name="filename" value="ball.vol"/><transform name="to_world">
    <translate x="-.5" y="-.5" z="-.5"/>{}</transform>{}</shape>"""
    glass = '<bsdf type="dielectric"/><string name="normals" value="analytic"/>'
    shape = f"""<shape type="shapegroup" id="ball">{grid.format("", '<bsdf type="diffuse"/>')}</shape>
    <shape type="instance"><ref id="ball"/><transform name="to_world"><scale x="3.5" y="1.5" z="2"/>
    <rotate x=".6" y=".8" angle="40"/><translate x="-.8"/></transform></shape>
    {grid.format('<scale x="1.5" y="2" z="1.8"/><translate x="1.2" y="-.2" z="-.2"/>', glass)}"""
    check(tmp_path, SCENE.format(depth=7, emitter=CONSTANT, shape=shape))


def test_indices_of_refraction():
    from jaxrt.files.indices import INDICES

    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    for name, index in INDICES.items():
        made = mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": 1.0})
        assert mi.traverse(made)["eta"] == pytest.approx(index, rel=1e-6), name
