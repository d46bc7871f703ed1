"""Scenes: parameters by name, and tables that scenes of different sizes share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrt
from jaxrt import compiler
from jaxrt.build import bucket

pytestmark = pytest.mark.usefixtures("short_loops")


def scene(n=1, **more):
    mesh = jaxrt.Mesh(id="tri", vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=[[0, 1, 2]] * n)
    ball = jaxrt.Sphere(id="ball", radius=0.5, bsdf=jaxrt.Conductor(alpha=0.3, id="metal"))
    red = jaxrt.Rectangle(id="wall", bsdf=jaxrt.TwoSided(jaxrt.Diffuse([0.5, 0.1, 0.1]), id="red"), emission=2.0)
    film = jaxrt.Film(4, 4, "box")
    return jaxrt.Scene.build([mesh, ball, red], sensors=[jaxrt.Sensor(film=film)], channels=3, **more)


def test_names_and_shapes_of_parameters():
    p = jaxrt.params(scene())
    shapes = {name: value.shape for name, value in p.items()}
    assert shapes["red.reflectance"] == (3,)
    assert shapes["wall.emitter.radiance"] == (3,)
    assert shapes["tri.vertices"] == (3, 3)
    assert shapes["tri.to_world"] == (4, 4)
    assert shapes["ball.center"] == (3,)
    assert shapes["ball.radius"] == ()
    assert shapes["metal.alpha"] == ()
    assert shapes["sensor.to_world"] == (4, 4)
    assert shapes["sensor.fov"] == ()
    np.testing.assert_allclose(p["red.reflectance"], [0.5, 0.1, 0.1], rtol=1e-6)


def test_setting_each_parameter_changes_it_and_nothing_else():
    s = scene()
    before = jaxrt.params(s)
    for name, value in before.items():
        after = jaxrt.params(jaxrt.with_params(s, {name: value + 1}))
        for other in before:
            np.testing.assert_array_equal(after[other], before[other] + (1 if other == name else 0), err_msg=other)


def test_setting_is_pure_and_differentiable():
    s = scene()
    f = lambda r: (jaxrt.params(jaxrt.with_params(s, {"ball.radius": r}))["ball.radius"]) ** 2
    assert float(jax.grad(f)(3.0)) == 6.0
    np.testing.assert_array_equal(jaxrt.params(s)["ball.radius"], 0.5)


def test_unknown_names_and_wrong_shapes():
    with pytest.raises(jaxrt.SceneError, match=r"red\.reflectance"):
        jaxrt.with_params(scene(), {"red.reflectence": 1.0})
    with pytest.raises(jaxrt.SceneError, match=r"\(3, 3\)"):
        jaxrt.with_params(scene(), {"tri.vertices": jnp.zeros((2, 3))})
    with pytest.raises(jaxrt.SceneError, match="one number"):
        jaxrt.with_params(scene(), {"ball.radius": jnp.zeros(2)})


def test_buckets_grow_by_half_at_most_and_hold():
    sizes = [bucket(n) for n in range(1, 500)]
    assert all(size >= n for n, size in enumerate(sizes, 1))
    assert all(size <= max(2 * n, 4) for n, size in enumerate(sizes, 1))
    assert len(set(sizes)) < 20


def test_scenes_of_one_bucket_share_a_program():
    jaxrt.render(scene(5), spp=1, max_depth=2)
    count = compiler.programs()
    other = jaxrt.with_params(scene(7), {"red.reflectance": [0.2, 0.6, 0.1]})
    jaxrt.render(jaxrt.resized(other, 0, 5, 3), spp=9, seed=4, max_depth=5)
    assert compiler.programs() == count
    jaxrt.render(scene(9), spp=1, max_depth=2)
    assert compiler.programs() == count + 4  # its world, two for lamps' borders, its picture


def test_a_scene_needs_shapes():
    with pytest.raises(jaxrt.SceneError, match="no shapes"):
        jaxrt.Scene.build([])
