"""Cameras: fields of view in closed form, orientation, focus, near planes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera, look_at, moved, picture, rotation

import jaxrt
from jaxrt.scene import SensorStructure
from jaxrt.sensor import camera as cameras

SIZES = [(16, 9), (9, 16), (8, 8)]


@functools.partial(jax.jit, static_argnums=(0, 1))
def _rays(kind, fov_axis, to_world, lens, window, at, u):
    sensor = SensorStructure(kind, fov_axis, (0, 0, "box", 0.5, 0.5), (0.0, 0.0, 0.0, 0.0))

    def one(p, v):
        o, d = cameras.ray(sensor, to_world, lens, window, (p[0], p[1]), (v[0], v[1]))
        return o.array(), d.array()

    return jax.vmap(one)(at, u)


def rays(
    at, size, kind="perspective", fov_axis="x", to_world=None, fov=50.0, near=0.01, aperture=0.0, focus=1.0, u=None,
    corner=(0, 0),
):  # fmt: skip
    at = np.atleast_2d(np.asarray(at, np.float32))
    u = np.zeros_like(at) if u is None else np.asarray(u, np.float32)
    m = np.asarray(np.eye(4) if to_world is None else to_world, np.float32)
    lens = np.array([fov, near, 1e4, aperture, focus], np.float32)
    o, d = _rays(kind, fov_axis, m, lens, np.array([*corner, *size], np.float32), at, u)
    return np.asarray(o, np.float64), np.asarray(d, np.float64)


def angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))


def test_a_part_of_a_film_sees_what_the_film_sees_there():
    at = np.array([[0.0, 0.0], [3.5, 2.25]])
    for a, b in zip(rays(at + [5, 3], (16, 9)), rays(at, (16, 9), corner=(5, 3)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_windows_keep_their_place_at_other_sizes():
    film = jaxrt.Film(4, 3, "box", crop=(2, 6, 8, 12))
    sensor = jaxrt.Sensor(film=film, principal_point=(0.25, -0.5))
    structure = jaxrt.Scene.build([jaxrt.Sphere()], sensors=[sensor]).structure.sensors[0]
    assert structure.window == (4.0, 0.0, 8.0, 12.0)
    assert structure.sized(8, 3).window == (8.0, 0.0, 16.0, 12.0)
    with pytest.raises(jaxrt.SceneError, match="goes beyond the film of 8 x 12"):
        jaxrt.Film(4, 3, crop=(5, 0, 8, 12))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("axis", ["x", "y", "smaller", "larger", "diagonal"])
@pytest.mark.parametrize("fov", [10.0, 50.0, 120.0])
def test_the_field_of_view_spans_its_axis(axis, size, fov):
    w, h = size
    pairs = {"x": ((0, h / 2), (w, h / 2)), "y": ((w / 2, 0), (w / 2, h)), "diagonal": ((0, 0), (w, h))}
    pairs["smaller"], pairs["larger"] = (pairs["x"], pairs["y"]) if w < h else (pairs["y"], pairs["x"])
    _, d = rays(pairs[axis], size, fov_axis=axis, fov=fov)
    assert angle(d[0], d[1]) == pytest.approx(fov, abs=1e-4)  # 50° in float32 is good to 6e-6, tan to a few of it


def test_pixels_are_square():
    for size in SIZES:
        c = np.array(size) / 2
        _, d = rays([c, c + [1, 0], c + [0, 1]], size)
        step = d[:, :2] / d[:, 2:]
        np.testing.assert_allclose(abs(step[1, 0] - step[0, 0]), abs(step[2, 1] - step[0, 1]), rtol=1e-5)


@pytest.mark.parametrize("kind", ["perspective", "thinlens", "orthographic"])
def test_orientation(kind):
    """The centre looks at the target; up is up; +x of the camera's own space is left in the picture."""
    origin, target, up = np.array([1.0, 2, 3]), np.array([-2.0, 0.5, 1]), np.array([0.1, 0.2, 1])
    m, (w, h) = look_at(origin, target, up), (16, 9)
    forward = (target - origin) / np.linalg.norm(target - origin)
    o, d = rays([(w / 2, h / 2), (w / 2, 0), (0, h / 2)], (w, h), kind, to_world=m)
    np.testing.assert_allclose(d[0], forward, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1.0, atol=1e-6)
    at = o + 3 * d  # some way along the rays
    left = np.cross(up, forward)
    above, beside = at[1] - at[0], at[2] - at[0]
    assert np.dot(above, up) > 0.1 and abs(np.dot(above, left)) < 1e-5
    assert np.dot(beside, left) > 0.1 and abs(np.dot(beside, np.cross(forward, left))) < 1e-5


def test_a_perspective_ray_starts_on_the_near_plane():
    m = moved(1.0, (1, 2, 3), rotation(3))
    at = np.random.default_rng(0).random((20, 2)) * [16, 9]
    o, d = rays(at, (16, 9), to_world=m, near=0.25)
    depth = (o - m[:3, 3]) @ m[:3, 2]
    np.testing.assert_allclose(depth, 0.25, atol=1e-6)
    np.testing.assert_allclose(np.cross(o - m[:3, 3], d), 0.0, atol=2e-6)  # on the line through the pinhole


@pytest.mark.parametrize("focus", [0.5, 4.0])
def test_a_thin_lens_gathers_at_the_plane_of_focus(focus):
    u = np.random.default_rng(1).random((64, 2))
    o, d = rays(np.full((64, 2), (3.0, 7.0)), (16, 9), "thinlens", aperture=0.2, focus=focus, near=0.1, u=u)
    lens = o - d * (0.1 / d[:, 2:])
    np.testing.assert_allclose(lens[:, 2], 0.0, atol=1e-6)
    radius = np.hypot(lens[:, 0], lens[:, 1])
    assert 0.17 < radius.max() <= 0.2 + 1e-6  # the largest of 64 uniform points: over .17 but for a chance of 2e-8
    meeting = lens + d * (focus / d[:, 2:])
    _, sharp = rays((3.0, 7.0), (16, 9))
    np.testing.assert_allclose(meeting, np.broadcast_to(sharp * (focus / sharp[:, 2]), (64, 3)), atol=focus * 1e-6)


def test_a_thin_lens_without_aperture_is_a_pinhole():
    at = np.random.default_rng(2).random((20, 2)) * [16, 9]
    got = rays(at, (16, 9), "thinlens", aperture=0.0, focus=3.0, u=at / 20)
    for a, b in zip(got, rays(at, (16, 9)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_an_orthographic_camera_sees_from_minus_one_to_one_in_parallel():
    o, d = rays([(0, 4.5), (16, 4.5), (8, 0), (8, 9)], (16, 9), "orthographic", near=0.5)
    np.testing.assert_allclose(d, np.broadcast_to([0, 0, 1], d.shape), atol=1e-7)
    np.testing.assert_allclose(o, [[1, 0, 0.5], [-1, 0, 0.5], [0, 9 / 16, 0.5], [0, -9 / 16, 0.5]], atol=1e-6)
    o, d = rays([(0, 4.5)], (16, 9), "orthographic", to_world=moved(5.0, (0, 0, 2)), near=0.5)
    np.testing.assert_allclose(o, [[5, 0, 4.5]], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(d), 1.0, atol=1e-6)


def test_a_picture_is_the_right_way_round():
    """A lamp up and to the left of the axis is in the upper left of the picture, and where its direction says."""
    at = np.array([-0.8, 4.0, 0.6])  # seen from the origin along +y, left is −x
    lamp = jaxrt.Rectangle(to_world=moved(0.2, at, look_at((0, 0, 0), -at)[:3, :3]), emission=1.0)
    scene = jaxrt.Scene.build([lamp], sensors=[camera((0, 0, 0), (0, 1, 0), 24, 16, 40.0)])
    image = np.asarray(picture(scene, 0, jaxrt.plan(scene, light_sampling=False), spp=4, max_depth=1))[..., 0]
    rows, columns = np.nonzero(image > 0.5)
    half = np.tan(np.radians(20)) * at[1]
    assert columns.mean() + 0.5 == pytest.approx(12 * (1 + at[0] / half), abs=0.6)  # to half a pixel
    assert rows.mean() + 0.5 == pytest.approx(8 - 12 * at[2] / half, abs=0.6)


def test_near_cuts_what_is_nearer():
    """A lamp before the near plane is not seen, one behind it is."""
    lamp = jaxrt.Rectangle(to_world=moved(5.0, (0, 1, 0), look_at((0, 1, 0), (0, 0, 0))[:3, :3]), emission=1.0)
    seen = []
    for near in (0.9, 1.1):
        sensor = camera((0, 0, 0), (0, 1, 0), 24, 16, 40.0, near=near)
        scene = jaxrt.Scene.build([lamp], sensors=[sensor])
        plan = jaxrt.plan(scene, light_sampling=False)
        seen.append(float(jnp.mean(picture(scene, 0, plan, spp=4, max_depth=1))))
    assert seen == [1.0, 0.0]
