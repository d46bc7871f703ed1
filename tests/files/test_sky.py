"""The sun and the sky of Mitsuba's `sunsky`: the model, where the sun stands, files, and pictures against Mitsuba."""

import datetime

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import UP, assert_same_picture, moved, rotation, world_of

import jaxrt
from jaxrt.files import sky
from jaxrt.files.solar_position import sun_direction
from jaxrt.sampling.sobol import Stream
from jaxrt.sky import radiance
from jaxrt.vector import Vec3

KEY = jax.random.key(0)
ORIGIN = np.array([0.0, 0.0, 0.01])


def unit(elevation, azimuth=0.0):
    e, a = np.radians(elevation), np.radians(azimuth)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def evenly(n):
    """cosθ and φ of directions above the horizon, evenly spread."""
    k = np.arange(n) + 0.5
    return k / n, np.pi * (1 + 5**0.5) * k


def dome(turbidity, elevation, albedo, n=1024):
    """Radiance from evenly spread directions above the horizon, (n, 3)."""
    cos, phi = evenly(n)
    s = np.sqrt(1 - cos**2)
    gamma = np.arccos(np.clip(np.stack([s * np.cos(phi), s * np.sin(phi), cos], -1) @ unit(elevation), -1, 1))
    c = sky.coefficients(turbidity, np.full(3, albedo), np.radians(elevation))
    return np.stack([radiance(k, cos, gamma, np) for k in c], -1)


def loaded(tmp_path, given, text="", shapes='<shape type="rectangle"/>'):
    file = tmp_path / "sky.xml"
    file.write_text(f'<scene version="3.0.0">{text}{shapes}<emitter type="sunsky">{given}</emitter></scene>')
    return jaxrt.load(file)


def test_the_sky_is_finite_and_nowhere_all_black():
    for turbidity in np.linspace(1, 10, 19):
        for elevation in (0.0, 1e-3, 0.1, 1.0, 5.0, 20.0, 50.0, 89.9, 90.0):
            for albedo in (0.0, 0.4, 1.0):
                light = dome(turbidity, elevation, albedo, 64)
                assert np.isfinite(light).all() and light.mean() > 0
            sun = sky.sun_radiance(turbidity, np.radians(elevation))
            assert np.isfinite(sun).all() and sun.mean() > 0


@pytest.mark.parametrize("turbidity", range(2, 10))
def test_nothing_jumps_at_whole_turbidities(turbidity):
    around = [turbidity - 1e-6, turbidity, turbidity + 1e-6]
    for f in (lambda t: dome(t, 30.0, 0.3), lambda t: sky.sun_radiance(t, 0.5)):
        low, at, high = map(f, around)
        np.testing.assert_allclose(low, at, rtol=1e-4, atol=1e-5 * at.max())
        np.testing.assert_allclose(high, at, rtol=1e-4, atol=1e-5 * at.max())


def test_noon_of_a_solstice():
    """The sun's elevation there is 90° − |latitude − 23.44°|; noon by the clock is 1.8 minutes early in June."""
    for latitude in (-35.0, 0.0, 23.44, 50.0):
        days = [sun_direction(datetime.date(2010, 6, 21), h, latitude, 0.0) for h in np.linspace(11.9, 12.2, 181)]
        highest = max(days, key=lambda d: d[2])
        assert np.degrees(np.arcsin(highest[2])) == pytest.approx(90 - abs(latitude - 23.44), abs=0.05)
        assert abs(highest[1]) < 2e-3 and (highest[0] > -1e-2) == (latitude > 20)
    assert sun_direction(datetime.date(2010, 6, 21), 15.0, 50.0, 0.0)[1] > 0.5  # west, in the afternoon


def test_the_sun_lights_by_its_irradiance_whatever_its_size(tmp_path):
    """Alone, over a floor. The last one is the upper half of a disc whose middle is on the horizon."""
    floor = lambda given: jaxrt.irradiance(
        loaded(tmp_path, given + '<float name="sky_scale" value="0"/>'), ORIGIN, UP, KEY, spp=1 << 15, max_depth=2
    )
    given = '<vector name="sun_direction" x="3" y="0" z="4"/><float name="sun_aperture" value="{}"/>'
    across = sky.sun_radiance(3.0, np.arcsin(0.8)) * 2 * np.pi * (1 - np.cos(np.radians(0.2679)))
    np.testing.assert_allclose(floor(given.format(0.5358)), 0.8 * across, rtol=1e-4)
    half = np.radians(5.0)
    np.testing.assert_allclose(  # the cosine's mean over a cap is that at its middle times (1 + cos) / 2
        floor(given.format(10)), 0.8 * across * (1 + np.cos(half)) / 2, rtol=1e-3
    )
    low = '<vector name="sun_direction" x="1" y="0" z="0"/><float name="sun_aperture" value="10"/>'
    expected = sky.sun_radiance(3.0, 0.0, 10.0).clip(0) * 2 / 3 * np.sin(half) ** 3
    np.testing.assert_allclose(floor(low), expected, rtol=0.02)


def test_light_samples_are_even_over_the_disc():
    scene = jaxrt.Scene.build([jaxrt.Rectangle()], lamps=[jaxrt.Sun(-unit(40.0), angle=0.6)])
    sun = jaxrt.world.world_of(scene).sun
    u = np.random.default_rng(0).random((2, 4096))
    w = np.stack([np.asarray(a, float) for a in jax.vmap(lambda *u: sun.sample(u))(*u)], -1)
    off = np.linalg.norm(w - unit(40.0), axis=1) / (2 * np.sin(np.radians(0.15)))
    assert np.abs(np.sort(off**2) - np.arange(4096) / 4096).max() < 0.025  # Kolmogorov and Smirnov, 1 in 100
    inside, beside = (jaxrt.Vec3.of(unit(40.0 + d).astype(np.float32)) for d in (0.29, 0.31))
    assert float(sun.density(inside)) == pytest.approx(1 / (2 * np.pi * (1 - np.cos(np.radians(0.3)))), rel=1e-3)
    assert float(sun.density(beside)) == 0 and float(sun.radiance(beside).array()[0]) == 0


def test_a_floor_under_the_sky_has_the_integral_of_it(tmp_path):
    given = '<vector name="sun_direction" x="0" y="1" z="1"/><float name="sun_scale" value="0"/>'
    seen = jaxrt.irradiance(loaded(tmp_path, given), ORIGIN, UP, KEY, spp=1 << 14, max_depth=2)
    cos, _ = evenly(1 << 14)
    expected = 2 * np.pi * (dome(3.0, 45.0, 0.3, 1 << 14) * cos[:, None]).mean(0)
    np.testing.assert_allclose(seen, expected, rtol=2e-3)


@pytest.mark.parametrize("around", [1.0, pytest.param(jaxrt.Bitmap(np.ones((8, 16))), marks=pytest.mark.slow)])
def test_a_floor_under_a_wide_sun_in_a_bright_sky(around):
    """1 + sin²30°, by a meter, by paths and by the operator D: within the disc one samples both."""
    floor = jaxrt.Rectangle(to_world=moved(5.0), bsdf=jaxrt.Diffuse(1.0))
    sun = jaxrt.Sun((0, 0, -1), radiance=1.0, angle=60.0)
    scene = jaxrt.Scene.build([floor], lamps=[sun], enclosure=jaxrt.Enclosure(around))
    many, down = np.tile([[0, 0, 0.5]], (64, 1)), np.array([[0, 0, -1.0]])

    @jax.jit
    def direct(world):
        x, up = jaxrt.psi(world)(jnp.asarray(many[0]), jnp.asarray(down[0])), Vec3(0.0, 0.0, 1.0)
        one = lambda i: jaxrt.D(world)(x, up, Stream(i, jnp.uint32(3))).array()
        return jax.vmap(one)(jnp.arange(1 << 15, dtype=jnp.uint32)).mean()

    found = [
        jaxrt.irradiance(scene, many, -down, KEY, spp=512, max_depth=1).mean() / np.pi,
        jaxrt.radiance(scene, many, down, KEY, spp=512, max_depth=2).mean(),
        direct(world_of(scene)),
    ]
    np.testing.assert_allclose(np.array(found), 1.25, rtol=5e-3)


def test_a_sun_below_the_horizon_leaves_all_dark(tmp_path):
    scene = loaded(tmp_path, '<float name="hour" value="2"/>')
    assert not np.asarray(jaxrt.irradiance(scene, ORIGIN, UP, KEY, spp=1)).any()


def test_a_plain_scene_has_no_part_of_it():
    plan = jaxrt.plan(jaxrt.Scene.build([jaxrt.Rectangle(emission=1.0)]))
    assert "sun" not in plan.effects and "texture:sky" not in plan.effects


@pytest.mark.parametrize(
    "given, problem",
    [
        ('<float name="turbidity" value="11"/>', "turbidity: is 11; give a value of at most 10"),
        ('<float name="turbidity" value=".5"/>', "turbidity: is 0.5; give a value of at least 1"),
        ('<rgb name="albedo" value=".2,.3,1.2"/>', "albedo: is 1.2; give a value of at most 1"),
        ('<texture type="checkerboard" name="albedo"/>', "albedo: takes no texture"),
        ('<vector name="sun_direction" x="0" y="0" z="0"/>', "sun_direction: is no direction"),
        (
            '<vector name="sun_direction" x="0" y="0" z="1"/><float name="hour" value="9"/>',
            "has a sun_direction and also hour",
        ),
        ('<integer name="month" value="13"/>', "has no such date: month must be in 1..12"),
        ('<float name="sun_scale" value="-1"/>', "sun_scale: is -1"),
        ('<float name="sun_aperture" value="0"/>', "sun_aperture: is 0; give an angle between"),
        ('<boolean name="complex_sun" value="true"/>', "has a complex_sun, which is not supported; leave it out"),
        (
            '<transform name="to_world"><scale x="2"/></transform>',
            "is stretched or shrunk to nothing by its to_world; only turn it",
        ),
    ],
)
def test_mistakes_are_named(tmp_path, given, problem):
    with pytest.raises(jaxrt.SceneError, match=problem) as caught:
        loaded(tmp_path, given)
    assert '<emitter type="sunsky">' in str(caught.value) and "\n" not in str(caught.value)


def test_parts_that_do_not_work():
    with pytest.raises(jaxrt.SceneError, match="b: is a second sun; keep one"):
        jaxrt.Scene.build([jaxrt.Rectangle()], lamps=[jaxrt.Sun(id="a"), jaxrt.Sun(id="b")])
    with pytest.raises(jaxrt.SceneError, match=r"a\.angle: is 200; give an angle between 0 and 180 degrees"):
        jaxrt.Sun(angle=200.0, id="a")


# ---------------------------------------------------------------------------------------- against Mitsuba


@pytest.mark.slow
@pytest.mark.peer
def test_radiance_is_that_of_mitsuba(tmp_path):
    """At random turbidities, albedos, turns, and directions of the sun and of rays; also into a large sun, but for low
    ones, in which Mitsuba has negative blue."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rng, off = np.random.default_rng(2), []
    at = mi.SurfaceInteraction3f()
    for case in range(24):
        m = np.eye(4)
        m[:3, :3] = rotation(case)
        sun, albedo = unit(90 * rng.random() ** 2, rng.uniform(0, 360)), ",".join(map(str, rng.random(3)))
        way = m[:3, :3] @ sun
        given = f'<vector name="sun_direction" x="{way[0]}" y="{way[1]}" z="{way[2]}"/>'
        given += f'<float name="turbidity" value="{rng.uniform(1, 10)}"/><rgb name="albedo" value="{albedo}"/>'
        given += f'<float name="sun_scale" value="{rng.uniform(0, 0.01) * (sun[2] > 0.07)}"/><float name="sun_aperture" value="20"/>'
        given += f'<transform name="to_world"><matrix value="{" ".join(map(str, m.ravel()))}"/></transform>'
        scene = loaded(tmp_path, given)
        peer = mi.load_file(str(tmp_path / "sky.xml")).environment()
        w = rng.normal(size=(64, 3))
        w[:, 2] = np.abs(w[:, 2]) * np.repeat([1, 0.1], 32)
        w[:8] = sun + 0.2 * rng.normal(size=(8, 3))
        w = (w / np.linalg.norm(w, axis=1, keepdims=True)) @ m[:3, :3].T
        theirs = np.zeros((64, 3))
        for k in range(64):
            at.wi = -w[k]
            theirs[k] = np.maximum(peer.eval(at), 0)
        edge = np.abs(np.degrees(np.arccos(np.clip(w @ way, -1, 1))) - 10) < 0.01
        ours = np.asarray(jaxrt.radiance(scene, 100 * w, w, KEY, spp=1))[~edge]
        off.append(np.abs(ours - theirs[~edge]) / np.maximum(theirs[~edge], 0.05 * theirs.mean()))
    off = np.concatenate(off)
    assert off.max() < 5e-3 and off.mean() < 1e-4


@pytest.mark.peer
def test_the_sun_stands_where_mitsuba_has_it():
    """Which counts days in float32, to a quarter."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rng = np.random.default_rng(0)
    for _ in range(20):
        year, month, day = (int(rng.integers(*span)) for span in ((1999, 2016), (1, 13), (1, 29)))
        place = {k: rng.uniform(*v) for k, v in {"latitude": (-60, 60), "longitude": (-180, 180)}.items()}
        zone = place["longitude"] / 15
        time = {"hour": 12.0, "minute": rng.uniform(-200, 200), "timezone": zone}
        peer = mi.load_dict({"type": "sunsky", "year": year, "month": month, "day": day, **place, **time})
        hours = 12 + time["minute"] / 60 - zone
        ours = sun_direction(datetime.date(year, month, day), hours, **place)
        theirs = np.array(mi.traverse(peer)["sun_direction"]).ravel()
        assert np.degrees(np.linalg.norm(ours - theirs)) < 0.06


SCENE = """<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="{fov}"/>
<transform name="to_world"><lookat origin="0,-5,{height}" target="0,0,{aim}" up="0,0,1"/>{turn}</transform>
<sampler type="independent"/><film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="24"/>
<rfilter type="box"/></film></sensor>"""
SHAPES = """<shape type="rectangle"><transform name="to_world"><scale value="3"/>{turn}</transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".8,.5,.2"/></bsdf></shape>
<shape type="sphere"><transform name="to_world"><scale value=".6"/><translate x="-.7" z=".6"/>{turn}</transform>
<bsdf type="diffuse"/></shape>
<shape type="sphere"><transform name="to_world"><scale value=".6"/><translate x=".7" z="{mirror}"/>{turn}</transform>
<bsdf type="conductor"><string name="material" value="none"/></bsdf></shape>"""
UPWARDS = '<rotate x="1" angle="-90"/>'
VIEWS = {
    "from above": (
        {
            "fov": 40,
            "height": 2,
            "aim": 0.5,
            "turn": "",
            "mirror": -9,
        },  # no glints of a small sun, which few samples see
        '<float name="turbidity" value="2.5"/><rgb name="albedo" value=".1,.5,.9"/>'
        '<vector name="sun_direction" x=".5" y="-.3" z=".6"/>',
    ),
    "into a large and low sun, +y up": (
        {"fov": 25, "height": 1, "aim": 1.2, "turn": UPWARDS, "mirror": 0.6},
        f'<transform name="to_world"><rotate z="1" angle="80"/>{UPWARDS}</transform>'
        '<float name="turbidity" value="6.7"/><vector name="sun_direction" x=".1" y=".07" z="-1"/>'
        '<float name="sun_aperture" value="4"/><float name="sun_scale" value=".5"/><float name="sky_scale" value="2"/>',
    ),
}


@pytest.mark.slow
@pytest.mark.peer
@pytest.mark.usefixtures("short_loops")
@pytest.mark.parametrize("view", VIEWS)
def test_mitsuba_renders_the_same_picture(tmp_path, view):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    places, given = VIEWS[view]
    scene = loaded(tmp_path, given, SCENE.format(**places), SHAPES.format(**places))
    peer = mi.load_file(str(tmp_path / "sky.xml"))
    runs = np.stack([np.array(mi.render(peer, spp=128, seed=k), np.float64)[..., :3] for k in range(16)])
    assert_same_picture(runs, [jaxrt.render(scene, 128, seed=k, method="path") for k in range(4)], most=0.01)
