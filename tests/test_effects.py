"""The plan: what is in, what is left out of the program, and what values it relies on."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrt
from jaxrt.solver import measure, path
from jaxrt.world import prepare


def room(*more, radiance=1.0, reflectance=0.5, **parts):
    lamp = np.diag([0.5, 0.5, -1.0, 1.0])
    lamp[2, 3] = 2.0
    shapes = [
        jaxrt.Rectangle(id="floor", bsdf=jaxrt.Diffuse(reflectance, id="paint")),
        jaxrt.Rectangle(id="lamp", to_world=lamp, emission=radiance, emission_id="light", bsdf=jaxrt.Diffuse(0.0)),
        *more,
    ]
    film = jaxrt.Film(8, 8, "box")
    return jaxrt.Scene.build(shapes, sensors=[jaxrt.Sensor(film=film)], channels=3, **parts)


def lowered(scene, plan):
    """The program of the path method for a plan, as text."""
    world = jax.eval_shape(functools.partial(prepare, plan=plan), scene)
    view, depths = measure.view_of(scene, 0), measure.depths_of(scene, 4)
    pixels = jnp.arange(64, dtype=jnp.int32)[:, None]
    return jax.jit(path.trace).lower(world, view, depths, jnp.uint32(0), pixels, 0, 4).as_text()


SPHERE = dict(center=(0.0, 0.0, 0.5), radius=0.2)


def test_what_is_left_out_leaves_no_trace():
    plain = room()
    short = lowered(plain, jaxrt.plan(plain))
    for more in (
        jaxrt.Sphere(**SPHERE),
        jaxrt.Rectangle(bsdf=jaxrt.Conductor(alpha=0.2)),
        jaxrt.Rectangle(bsdf=jaxrt.Conductor()),
    ):
        rich = room(more)
        assert len(lowered(rich, jaxrt.plan(rich)).splitlines()) > len(short.splitlines()) + 50
    dark = room(radiance=0.0)
    without_lamp = lowered(dark, jaxrt.plan(dark, free=None))
    assert len(without_lamp.splitlines()) < len(short.splitlines()) - 1050
    grey = lowered(plain, jaxrt.plan(plain, free=None))
    assert len(grey.splitlines()) < len(short.splitlines())


def test_a_plan_is_static_and_values_do_not_change_it():
    a, b = room(reflectance=0.3), room(reflectance=0.7, radiance=5.0)
    assert jaxrt.plan(a) == jaxrt.plan(b)
    assert hash(jaxrt.plan(a)) == hash(jaxrt.plan(b))
    assert jaxrt.plan(a) != jaxrt.plan(room(jaxrt.Sphere(**SPHERE)))
    assert {"area_light", "lobe:diffuse", "parallelogram", "bounces"} <= jaxrt.plan(a).effects
    assert not {"sphere", "lobe:ggx", "twosided", "smooth_normals"} & jaxrt.plan(a).effects


def test_a_grey_scene_runs_on_one_channel_and_looks_the_same():
    scene = room()
    one, three = jaxrt.plan(scene, free=None), jaxrt.plan(scene)
    assert (one.channels, three.channels) == (1, 3)
    got = [jaxrt.render(scene, spp=4, plan=p, max_depth=3).image for p in (one, three)]
    assert got[0].shape == got[1].shape == (8, 8, 3)
    np.testing.assert_allclose(got[0], got[1], rtol=1e-5, atol=1e-6)


def test_free_parameters_are_not_specialised_on():
    dark = room(radiance=0.0)
    assert "area_light" not in jaxrt.plan(dark, free=None).effects
    assert jaxrt.plan(dark, free=None).assumes
    assert "area_light" in jaxrt.plan(dark, free="light.*").effects
    assert "area_light" in jaxrt.plan(dark).effects
    assert jaxrt.plan(room(), free="paint.reflectance").channels == 3
    black = room(reflectance=0.0)
    assert "bounces" not in jaxrt.plan(black, free=None).effects
    assert "bounces" in jaxrt.plan(black, free="paint.reflectance").effects


def test_names_that_do_not_exist_are_refused_with_the_closest():
    with pytest.raises(jaxrt.SceneError, match=r"paint\.reflectance"):
        jaxrt.plan(room(), free="paint.reflectanse")
    with pytest.raises(jaxrt.SceneError, match="enclosure"):
        jaxrt.plan(room(), enclosures=False)


def test_an_effect_can_be_forced_out():
    scene = room(enclosure=jaxrt.Enclosure(1.0))
    at = lambda **out: jaxrt.radiance(scene, (0.0, 0.0, 1.5), (0.3, 0.2, -1.0), plan=jaxrt.plan(scene, **out), spp=64)
    both, lamp, sky = (np.asarray(at(**out)) for out in ({}, {"enclosure": False}, {"area_light": False}))
    assert "enclosure" not in jaxrt.plan(scene, enclosure=False).effects
    assert (lamp > 0.01).all() and (sky > 0.01).all()
    np.testing.assert_allclose(lamp + sky, both, rtol=0.05)
    np.testing.assert_allclose(at(light_sampling=False), both, rtol=0.2)
    assert (at(enclosure=False, area_light=False) == 0).all()
