"""Meters and batches: closed forms, derivatives, names of parameters, and Mitsuba's values."""

import jax
import numpy as np
import pytest
from helpers import assert_same_picture, camera, icosphere, look_at, mean_and_error, moved

import jaxrt

pytestmark = pytest.mark.usefixtures("short_loops")

ONE = jaxrt.Film(1, 1, "box")
BLACK = jaxrt.Diffuse(0.0)
DOWN = look_at((0, 0, 0), (0, 0, -1), (0, 1, 0))


def meter(kind, **more):
    return jaxrt.Sensor(kind, film=more.pop("film", ONE), id="meter", **more)


def build(shapes, sensor, sky=1.0, **parts):
    return jaxrt.Scene.build(shapes, sensors=[sensor], enclosure=jaxrt.Enclosure(sky), **parts)


def value(scene, spp=1024, seeds=12):
    """Mean of the first pixel over seeds and its standard error."""
    return mean_and_error([jaxrt.render(scene, spp, seed).image[0, 0, 0] for seed in range(seeds)])


def close(found, want):
    """Within 5 standard errors, and what a floor that ends somewhere leaves open."""
    mean, error = found
    return abs(mean - want) < 5 * error + 2e-3 * abs(want)


def test_radiance_along_one_ray():
    """A meter that stands on a surface does not see it, and all its pixels see the same."""
    lamp = jaxrt.Rectangle(to_world=moved(1.0, (0, 0, 3), np.diag([1.0, -1, -1])), emission=2.5, bsdf=BLACK)
    floor = jaxrt.Rectangle(bsdf=BLACK)
    up = meter("radiancemeter", to_world=moved(1.0, (0.5, 0.25, 0)), film=jaxrt.Film(3, 1))
    scene = build([floor, lamp], up, 0.0)
    np.testing.assert_allclose(jaxrt.render(scene, 4).image, 2.5, rtol=1e-6)
    aside = moved(1.0, (1.5, 0, 0))
    image = jaxrt.measure(jaxrt.with_params(scene, {"meter.to_world": aside}), 0, spp=4, max_depth=2)
    assert np.asarray(image).max() == 0.0


SHAPES = {
    "rectangle": (jaxrt.Rectangle, 1.0),
    "disk": (jaxrt.Disk, 1.0),
    "sphere": (jaxrt.Sphere, 0.5),
    "cylinder": (jaxrt.Cylinder, 0.5),
    "cube": (jaxrt.Cube, 0.5),
}


@pytest.mark.parametrize("name", SHAPES)
def test_irradiance_of_shapes_under_half_a_sky(name):
    """Above a black floor without end the sky of radiance 1 gives π times the share of it that the shape sees."""
    make, share = SHAPES[name]
    shape = make(bsdf=BLACK, to_world=moved(0.1, (0, 0, 0.11)))
    floor = jaxrt.Rectangle(to_world=moved(100.0), bsdf=BLACK)
    assert close(value(build([shape, floor], meter("irradiancemeter", target=shape))), np.pi * share)
    # The same where the shape itself is not in the scene.
    assert close(value(build([floor], meter("irradiancemeter", target=shape))), np.pi * share)


def test_a_turned_front_measures_the_other_side():
    shape = jaxrt.Rectangle(bsdf=BLACK, flip_normals=True)
    floor = jaxrt.Rectangle(to_world=moved(1e3, (0, 0, -0.5)), bsdf=BLACK)
    assert value(build([shape, floor], meter("irradiancemeter", target=shape)))[0] < 0.01


def test_triangles_count_by_their_area():
    """Two triangles in one mesh, of areas 1/2 and 9/2, of which only the smaller sees the sky."""
    small, large = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[5.0, 0, 0], [8, 0, 0], [5, 3, 0]])
    mesh = jaxrt.Mesh(vertices=np.concatenate([small, large]), faces=[[0, 1, 2], [3, 4, 5]], bsdf=BLACK)
    lid = jaxrt.Rectangle(to_world=moved(2.0, (6.5, 1.5, 1e-3)), bsdf=BLACK)
    assert close(value(build([mesh, lid], meter("irradiancemeter", target=mesh))), 0.1 * np.pi)


def under_a_ball(kind="irradiancemeter"):
    plate = jaxrt.Disk(id="plate", to_world=moved(1e-3), bsdf=BLACK)
    ball = jaxrt.Sphere(id="ball", center=(0, 0, 4.0), radius=0.5, emission=3.0, bsdf=BLACK)
    return build([plate, ball], meter(kind, target=plate), 0.0)


@pytest.mark.slow
def test_light_is_sampled_and_differentiated():
    """A ball of radius r at height h over the meter: E = π L r²/h², whatever the integrator hides."""
    scene = under_a_ball()
    want = np.pi * 3.0 * (0.5 / 4.0) ** 2
    assert close(value(scene, 64), want)

    def measured(center):
        return jaxrt.measure(jaxrt.with_params(scene, {"ball.center": center}), 0, spp=1024, max_depth=2)[0, 0, 0]

    slope = jax.grad(measured)(np.array([0.0, 0.0, 4.0], np.float32))
    np.testing.assert_allclose(slope, [0, 0, -2 * want / 4.0], atol=0.02 * want)


def test_pixels_lie_over_a_rectangle():
    """Half of it lies beneath a lid; rows and columns run as its own x and y."""
    plate = jaxrt.Rectangle(bsdf=BLACK)
    lid = jaxrt.Rectangle(to_world=moved(1.0, (-1.0, 0, 1e-3)), bsdf=BLACK)
    scene = build([plate, lid], meter("irradiancemeter", target=plate, film=jaxrt.Film(4, 2, "box")))
    want = np.broadcast_to(np.array([0, 0, np.pi, np.pi])[None, :, None], (2, 4, 1))
    np.testing.assert_allclose(jaxrt.render(scene, 64).image, want, atol=0.03)
    mesh = jaxrt.Mesh(vertices=np.eye(3), faces=[[0, 1, 2]])
    with pytest.raises(jaxrt.SceneError, match="has 4 x 2 pixels, which only go over a rectangle, disk or sphere"):
        meter("irradiancemeter", target=mesh, film=jaxrt.Film(4, 2, "box"))


def test_hidden_emitters_are_measured_all_the_same():
    plate = jaxrt.Disk(bsdf=BLACK)
    hide = jaxrt.Integrator(hide_emitters=True)
    scene = build([plate], meter("irradiancemeter", target=plate), integrator=hide)
    assert float(jaxrt.render(scene, 16).image[0, 0, 0]) == pytest.approx(np.pi, rel=1e-4)


def test_what_leaves_the_scene():
    """A black square of area 4 before a sky of 1: its box's sphere has a cross section of 2π."""
    square = jaxrt.Rectangle(bsdf=BLACK)
    assert close(value(build([square], meter("distant", to_world=DOWN))), 1 - 2 / np.pi)
    # A disk's box is tight: the sphere around it has √2 of its radius.
    turned = jaxrt.Disk(bsdf=BLACK, to_world=moved(2.0, (3, 4, 5), frame_of(DOWN)))
    assert close(value(build([turned], meter("distant", to_world=DOWN))), 0.5)


def frame_of(m):
    """A turn about the axis of view: the same disk, from corners of its own that lie elsewhere."""
    c, s = np.cos(0.7), np.sin(0.7)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.abs(np.diag(np.diag(m[:3, :3])))


def test_distant_targets():
    square = jaxrt.Rectangle(bsdf=BLACK)
    wide = jaxrt.Rectangle(to_world=moved(2.0))
    assert close(value(build([square], meter("distant", to_world=DOWN, target=wide))), 0.75)
    points = {(0.2, 0.3, 0.0): 0.0, (1.2, 0.3, 0.0): 1.0}
    for point, want in points.items():
        scene = build([square], meter("distant", to_world=DOWN, target=point))
        assert value(scene, 4, 2)[0] == want
        other = jaxrt.with_params(scene, {"meter.target": (1.4, 0.6, 0.0) - np.array(point)})
        assert jaxrt.measure(other, 0, spp=4, max_depth=1)[0, 0, 0] == 1 - want
    vertices, faces = icosphere(2)
    ball = jaxrt.Mesh(vertices=vertices, faces=faces)
    cross_section = jaxrt.Sphere(radius=0.5, bsdf=BLACK)  # of points of a larger ball, seen from above
    share = 1 - np.sqrt(0.75)  # of each half of the unit sphere, within .5 of its axis
    assert close(value(build([cross_section], meter("distant", to_world=DOWN, target=ball)), 4096), 1 - share)


def colours():
    """Three lamps side by side, and views that each see one of them."""
    lamps, views = [], []
    for k in range(3):
        at = moved(1.0, (10.0 * k, 0, 5), np.diag([1.0, -1, -1]))
        lamps.append(jaxrt.Rectangle(to_world=at, emission=k + 1.0, bsdf=BLACK))
        views.append(camera((10.0 * k, 0, 0), (10.0 * k, 0, 5), fov=15.0, up=(0, 1, 0), id=f"view{k}"))
    return lamps, views


def test_a_batch_stands_side_by_side():
    lamps, views = colours()
    views[1] = jaxrt.Sensor("radiancemeter", to_world=views[1].to_world, film=ONE, id="view1")
    batch = jaxrt.Sensor("batch", sensors=views, film=jaxrt.Film(6, 2, "box"), id="all")
    scene = build(lamps, batch, 0.0)
    want = np.broadcast_to(np.repeat([1.0, 2.0, 3.0], 2)[None, :, None], (2, 6, 1))
    np.testing.assert_allclose(jaxrt.render(scene, 4).image, want, rtol=1e-6)
    names = jaxrt.params(scene)
    assert {"view0.fov", "view1.to_world", "view2.to_world"} <= set(names) and "view1.fov" not in names
    swapped = jaxrt.with_params(scene, {"view0.to_world": names["view2.to_world"]})
    np.testing.assert_allclose(jaxrt.measure(swapped, 0, spp=4, max_depth=1)[:, :2], 3.0, rtol=1e-6)
    assert jaxrt.render(jaxrt.resized(scene, 0, 9, 3), 4).image[2, 5] == pytest.approx(2.0)
    with pytest.raises(jaxrt.SceneError, match="8 pixels across are not 3 views"):
        jaxrt.resized(scene, 0, 8, 3)
    assert {"sensor:batch", "sensor:perspective", "sensor:radiancemeter"} <= jaxrt.plan(scene).effects


@pytest.mark.slow
def test_derivatives_through_a_batch_are_those_of_its_views():
    scene = under_a_ball()
    alone = scene.structure.sensors[0]
    assert alone.area == ("faces", "disk", 0, 1)
    plate = jaxrt.Disk(id="plate", to_world=moved(1e-3), bsdf=BLACK)
    ball = jaxrt.Sphere(id="ball", center=(0, 0, 4.0), radius=0.5, emission=3.0, bsdf=BLACK)
    views = [meter("irradiancemeter", target=plate), jaxrt.Sensor(fov=10.0)]
    both = build([plate, ball], jaxrt.Sensor("batch", sensors=views, film=jaxrt.Film(2, 1, "box")), 0.0)

    def measured(radius):
        moved_scene = jaxrt.with_params(both, {"ball.radius": radius})
        return jaxrt.measure(moved_scene, 0, spp=64, max_depth=2, boundary=False)[0, :, 0]

    slope = jax.jacfwd(measured)(np.float32(0.5))
    assert float(slope[0]) == pytest.approx(2 * np.pi * 3.0 * 0.5 / 16.0, rel=0.05)
    assert float(slope[1]) == 0.0  # radiance of the ball, which fills the view


@pytest.mark.parametrize(
    "fields, problem",
    [
        ({"kind": "radiancemeter", "film": jaxrt.Film(2, 2)}, "meter.film: has 2 x 2 pixels of one value"),
        ({"kind": "irradiancemeter"}, "meter.target: is not a shape"),
        ({"kind": "distant", "target": (1, 2)}, "meter.target: is no target"),
        ({"kind": "perspective", "target": (1, 2, 3)}, "meter.target: has no use in a perspective"),
        ({"kind": "batch"}, "meter.sensors: are none"),
        ({"kind": "batch", "sensors": [jaxrt.Sensor()] * 2}, "is 1 pixels wide, which 2 views"),
        ({"kind": "perspective", "sensors": [jaxrt.Sensor()]}, "meter.sensors: have no use"),
    ],
)
def test_meters_that_do_not_work(fields, problem):
    with pytest.raises(jaxrt.SceneError, match=problem):
        meter(**fields)


# ------------------------------------------------------------------------------------ against Mitsuba

SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="3"/></integrator>
<emitter type="constant"><rgb name="radiance" value=".3,.4,.5"/></emitter>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".8,.5,.2"/></bsdf></shape>
<shape type="sphere"><point name="center" x="2" y="-1" z="4"/><float name="radius" value=".7"/>
<emitter type="area"><rgb name="radiance" value="9,8,7"/></emitter></shape>{}</scene>"""
FILM = """<film type="hdrfilm"><integer name="width" value="{}"/><integer name="height" value="{}"/>
<rfilter type="{}"/></film>"""
PIXEL = FILM.format(1, 1, "box")
TURNED = '<transform name="to_world"><rotate x="1" angle="40"/><translate y=".5"/></transform>'
LEFT = '<transform name="to_world"><translate x="-1"/></transform>'  # unturned: Mitsuba 3.9.1 does not turn its normals
METER = f'<sensor type="irradiancemeter">{PIXEL}</sensor>'
AIM = '<vector name="direction" x=".3" y=".5" z="-1"/>'
LOOK = '<transform name="to_world"><lookat origin="{},-5,2" target="0,0,0" up="0,0,1"/></transform>'
VIEWS = "".join(f'<sensor type="perspective"><float name="fov" value="40"/>{LOOK.format(x)}</sensor>' for x in (-2, 3))
BALL = '<shape type="cylinder"><float name="radius" value=".6"/>{}</shape>'
ITEMS = {
    "radiancemeter": f"""<sensor type="radiancemeter"><point name="origin" x="0" y="-2" z="1"/>
<vector name="direction" x="0" y="2" z="-1.5"/>{PIXEL}</sensor>""",
    "cylinder": f'<shape type="cylinder">{TURNED}{METER}</shape>',
    "cube": f'<shape type="cube">{TURNED}{METER}</shape>',
    "sphere": f'<shape type="sphere"><float name="radius" value=".6"/>{METER}</shape>',
    "ball": f"""<shape type="sphere">{LEFT}<sensor type="irradiancemeter">{FILM.format(6, 4, "box")}</sensor></shape>""",
    "distant": BALL.format("") + f'<sensor type="distant">{AIM}{PIXEL}</sensor>',
    "point": f'<sensor type="distant">{AIM}<point name="target" x=".5" y="0" z="-1"/>{PIXEL}</sensor>',
    "shape": f"""<sensor type="distant">{AIM}<shape type="sphere" name="target"/>{PIXEL}</sensor>""",
    "batch": f"""<sensor type="batch">{VIEWS}<shape type="disk">{TURNED}<sensor type="irradiancemeter"/></shape>
{FILM.format(24, 6, "gaussian")}</sensor>""" + BALL.format(""),
}  # fmt: skip


@pytest.mark.peer
@pytest.mark.parametrize("name", ITEMS)
def test_mitsuba_measures_the_same(name, tmp_path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(ITEMS[name]))
    peer, scene = mi.load_file(str(path)), jaxrt.load(path)
    spp = 64 if name in ("batch", "ball") else 4096
    runs = np.stack([np.array(mi.render(peer, spp=spp, seed=k), np.float64)[..., :3] for k in range(16)])
    sols = [jaxrt.render(scene, 256 if spp == 64 else 4096, seed=k, method="path") for k in range(8)]
    if name in ("batch", "ball"):
        return assert_same_picture(runs, sols, most=0.01)
    (theirs, a), (ours, b) = mean_and_error(runs), mean_and_error([s.image for s in sols])
    assert (np.hypot(a, b) < 0.02 * theirs).all()
    assert (abs(ours - theirs) < 5 * np.hypot(a, b) + 1e-4 * theirs).all(), (ours, theirs)
