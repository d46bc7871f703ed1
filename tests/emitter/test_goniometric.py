"""Lamps with a photometric web: intensity by direction, flux, irradiance, derivatives, and Mitsuba's spots."""

import jax
import numpy as np
import pytest
from helpers import assert_same_picture, look_at, mean_and_error, moved, rotation, sphere_directions, world_of
from scipy.interpolate import RegularGridInterpolator
from test_catalogue import SCENE, two

import jaxrt
from jaxrt.emitter import goniometric
from jaxrt.files import load_description
from jaxrt.vector import Vec3

FLOOR = jaxrt.Rectangle(to_world=moved(50.0), bsdf=jaxrt.Diffuse(0.5))
VERTICAL = np.array([0, 5, 15, 40, 90, 100, 180.0])  # uneven
PLANES = {  # one set of horizontal angles for each symmetry
    "axial": [0],
    "quadrants": [0, 22.5, 70, 90],
    "halves": [0, 10, 90, 180],
    "halves across": [90, 130, 200, 270],
    "none": [0, 45, 100, 200, 300, 360],
}


def web_of(name, channels=1, vertical=VERTICAL, **more):
    data = np.random.default_rng(len(name)).random((len(PLANES[name]), len(vertical), channels)) * 5
    data[:, [0, -1]] = data[:1, [0, -1]]  # at a pole planes agree
    return jaxrt.PhotometricWeb(data, vertical, PLANES[name], **more)


def unfolded(web):
    """Intensity (N, C) over angles (N, 2) in degrees, horizontal ones first, with the mirrored planes written out."""
    at, data = list(web.horizontal), list(web.data)
    span = at[-1] - at[0]
    while at[-1] - at[0] < 360:
        data += data[-2::-1] if span else data
        at += [2 * at[-1] - a for a in at[-2::-1]] if span else [at[0] + 360]
    take = RegularGridInterpolator((at, web.vertical), np.stack(data), bounds_error=False, fill_value=0.0)
    return lambda phi, theta: take(np.stack([(phi - at[0]) % 360 + at[0], theta], -1))


def angles_of(m, d):
    """Horizontal and vertical angle (degrees) of directions in the space of a lamp's pose: +y is 0°, +x is 90°."""
    x, y, z = (d @ m[:3, :3] / np.linalg.norm(m[:3, :3], axis=0)).T
    return np.degrees(np.arctan2(x, y)), np.degrees(np.arctan2(np.hypot(x, y), z))


def test_intensity_by_direction():
    m = moved(0.3, (1, 2, 3), rotation(4))  # whose scale does not count
    webs = [web_of(name, 3) for name in PLANES] + [web_of("halves", 3, np.array([20, 50, 95.0]))]
    scene = jaxrt.Scene.build([FLOOR], lamps=[jaxrt.Goniometric(web, m) for web in webs])
    plan = jaxrt.plan(scene)
    assert (plan.lamp_kinds, plan.web, plan.textures, plan.textured_lights) == (("goniometric",), 7, (), False)
    world, d = world_of(scene), sphere_directions(2000)
    d = np.concatenate([d, np.eye(3)[[0, 1, 2]], -np.eye(3)]) @ m[:3, :3].T  # poles, and where planes meet
    axis, up = (Vec3.of(m[:3, k] / np.linalg.norm(m[:3, k])) for k in (2, 1))
    at = jax.jit(lambda d, k: goniometric.intensity(world, k, axis, up, Vec3.of(d)).array())
    for k, web in enumerate(webs):
        found = np.asarray(jax.vmap(at, (0, None))(d, np.float32(k + 1)))
        phi, theta = angles_of(m, d)
        want = unfolded(web)(phi, theta)
        inside = (theta > web.vertical[0] + 1e-3) & (theta < web.vertical[-1] - 1e-3) | (len(web.vertical) > 3)
        np.testing.assert_allclose(found[inside], want[inside], rtol=2e-4, atol=2e-4)
        assert (want > 0).any() and (len(web.vertical) > 3 or (want == 0).any())


def test_flux_and_choice_by_it():
    """∫ I dω by quadrature; a point of the same flux is as likely to be chosen."""
    phi, theta = np.meshgrid((np.arange(360) + 0.5), (np.arange(720) + 0.5) / 4)  # kinks and ends lie between
    weight = np.sin(np.radians(theta)).ravel()
    for name, vertical in (*((name, VERTICAL) for name in PLANES), ("halves", np.array([20, 50, 95.0]))):
        web = web_of(name, 3, vertical)
        mean = np.average(unfolded(web)(phi.ravel(), theta.ravel()), 0, weight)
        np.testing.assert_allclose(web.mean(), mean, rtol=1e-4)
    point = jaxrt.Point(intensity=web.mean())
    scene = jaxrt.Scene.build([FLOOR], lamps=[jaxrt.Goniometric(web), point, jaxrt.Point(intensity=2 * web.mean())])
    world = world_of(scene)
    np.testing.assert_allclose(
        np.diff(np.asarray(world.light_cdf), prepend=0)[:3], [0.254167, 0.254167, 0.491667], rtol=1e-4
    )


X, UP = np.array([1.0, 2.0, 0.01]), np.array([0.0, 0.0, 1.0])


def test_irradiance_and_derivatives(short_loops):
    """I cosθ/d² under a turned lamp; linear in the web's values; dE/dp against finite differences; and beside others."""
    pose, web = look_at((0, 0, 3), (0.3, 0.4, 0), (0, 1, 0)), web_of("none")
    lamps = [jaxrt.Goniometric(web, pose, id="lamp"), jaxrt.Point((1, 0, 2), 2.0)]
    scene = jaxrt.Scene.build([FLOOR], lamps=lamps)
    parameters = jaxrt.params(scene)
    data, place = parameters["lamp.intensity.data"], parameters["lamp.position"]
    np.testing.assert_allclose(data, web.data, rtol=1e-6)

    def measured(data, place, key, **more):
        lit = jaxrt.with_params(scene, {"lamp.intensity.data": data, "lamp.position": place})
        return jaxrt.irradiance(lit, X, UP, key, max_depth=2, boundary=False, **more)[0]

    to = X - pose[:3, 3]
    want = float(unfolded(web)(*angles_of(pose, to[None]))[0, 0] * -to[2] / np.linalg.norm(to) ** 3)
    alone = {"plan": jaxrt.plan(scene, point=False), "key": jax.random.key(0), "spp": 2}
    valued = jax.jit(lambda d, p: jax.value_and_grad(measured, (0, 1))(d, p, **alone))
    value, (weights, slope) = valued(data, place)
    assert value == pytest.approx(want, rel=1e-4)
    assert (weights != 0).sum() == 4
    assert (weights * data).sum() == pytest.approx(want, rel=1e-4)
    steps = 0.02 * np.eye(3, dtype=np.float32)
    difference = [(valued(data, place + s)[0] - valued(data, place - s)[0]) / 0.04 for s in steps]
    np.testing.assert_allclose(slope, difference, rtol=5e-3, atol=1e-4)

    meters, to = jax.jit(lambda d, k: measured(d, place, k, spp=64)), X - (1, 0, 2)
    other = 2.0 * -to[2] / np.linalg.norm(to) ** 3
    for d, share in ((data, 1.0), (0.0 * data, 0.0)):  # chances are those of the web that the scene was made with
        mean, error = mean_and_error(np.array([meters(d, jax.random.key(k)) for k in range(16)]))
        assert abs(mean - other - share * want) < 4.5 * error + 1e-4 * want
        assert error < 0.1 * want


def test_plans():
    web = jaxrt.PhotometricWeb(np.zeros((1, 2)), [0, 90])
    scene = jaxrt.Scene.build([FLOOR], lamps=[jaxrt.Goniometric(web, id="lamp"), jaxrt.Point()])
    assert jaxrt.plan(scene).web == 2
    assert jaxrt.plan(scene, free=None).lamp_kinds == ("point", "goniometric")  # texels are not looked at
    assert jaxrt.plan(scene, free="lamp.intensity.data").lamp_kinds == ("point", "goniometric")
    out = jaxrt.plan(scene, goniometric=False)
    assert (out.web, out.lamp_kinds) == (0, ("point",))
    assert jaxrt.plan(jaxrt.Scene.build([FLOOR], lamps=[jaxrt.Point()]), goniometric=True).web == 0


@pytest.mark.peer
def test_a_web_is_what_spots_on_one_axis_make_together(tmp_path, short_loops):
    """Each of Mitsuba's spots is linear in the angle from its beam to its cutoff, so their sum is linear between those."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    look, colour = '<lookat origin="-1,-2,4" target=".5,0,0" up="0,0,1"/>', np.array([9.0, 6.0, 3.0])
    spots = [(60, 5, 4), (32, 5, 4), (12, 5, 3)]
    text = "".join(
        f'<emitter type="spot"><float name="cutoff_angle" value="{cutoff}"/><float name="beam_width" value="{beam}"/>'
        f'<rgb name="intensity" value="{",".join(map(str, k * colour))}"/><transform name="to_world">{look}</transform></emitter>'
        for cutoff, beam, k in spots
    )
    text = SCENE.format(depth=3, emitter=text, shape=two('<bsdf type="diffuse"/>', '<bsdf type="plastic"/>'))
    path = tmp_path / "scene.xml"
    path.write_text(text)
    peer = mi.load_file(str(path))
    runs = np.stack([np.array(mi.render(peer, spp=64, seed=k), np.float64)[..., :3] for k in range(12)])
    angles = np.array([0, 5, 12, 32, 60.0])
    value = lambda a: sum(k * np.clip((c - a) / (c - b), 0, 1) for c, b, k in spots)
    web = jaxrt.PhotometricWeb(value(angles)[None, :, None] * colour, angles)
    parts = load_description(path)
    lamp = jaxrt.Goniometric(web, look_at((-1, -2, 4), (0.5, 0, 0)))
    more = {"sensors": parts.sensors, "integrator": parts.integrator, "lamps": [lamp]}
    scene = jaxrt.Scene.build(parts.shapes, channels=3, **more)
    sols = [jaxrt.render(scene, 256, seed=k, method="path") for k in range(3)]
    assert_same_picture(runs, sols, most=0.01)


@pytest.mark.parametrize(
    "make, problem",
    [
        (lambda: jaxrt.Goniometric(3.0), r"goniometric\.intensity: is no PhotometricWeb"),
        (lambda: jaxrt.PhotometricWeb(np.ones((1, 2)), [0, 200]), r"web\.vertical: go from 0 to 200"),
        (lambda: jaxrt.PhotometricWeb(np.ones((1, 2)), [90, 0]), r"web\.vertical: are no angles that ascend"),
        (lambda: jaxrt.PhotometricWeb(np.ones((2, 2)), [0, 90], [0, 45]), r"web\.horizontal: go from 0 to 45"),
        (lambda: jaxrt.PhotometricWeb(np.ones((2, 2)), [0, 90]), r"web\.data: has shape \(2, 2, 1\); give \(1, 2\)"),
        (lambda: jaxrt.PhotometricWeb(-np.ones((1, 2)), [0, 90]), r"web\.data: has a value that is not between 0"),
        (lambda: jaxrt.Diffuse(web_of("axial")), r"diffuse\.reflectance: takes no PhotometricWeb"),
        (lambda: jaxrt.Point(intensity=web_of("axial")), r"point\.intensity: takes no texture"),
    ],
)
def test_webs_that_do_not_work(make, problem):
    with pytest.raises(jaxrt.SceneError, match=problem):
        make()
