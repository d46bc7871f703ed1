"""Second derivatives: by values they hold, where something moves they are refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera, moved

import jaxrt

pytestmark = pytest.mark.usefixtures("short_loops")

PAINT, POSE, EYE, SKY, GLOSS = (
    "paint.reflectance",
    "floor.to_world",
    "eye.to_world",
    "enclosure.radiance",
    "metal.alpha",
)


def one_bounce(sheet=None):
    """A floor under an even sky that fills the picture, and a view of it: L = ρ Le where it is diffuse."""
    floor = jaxrt.Rectangle(id="floor", to_world=moved(9.0), bsdf=sheet or jaxrt.Diffuse(0.5, id="paint"))
    sensors = [camera((0.1, 0.2, 3.0), (0.0, 0.1, 0.0), 4, 4, 30.0, (0, 1, 0), id="eye")]
    return jaxrt.Scene.build([floor], sensors=sensors, enclosure=jaxrt.Enclosure(2.0))


def mean_of(scene, **more):
    """The picture's mean as a function of parameters."""
    measured = lambda v: jaxrt.measure(jaxrt.with_params(scene, v), 0, spp=4, max_depth=2, **more)
    return lambda v: jnp.mean(measured(v))


def twice(f, scene, first, second):
    """The derivative by `first` of f, along even tangents, and its own by `second`; and the values of both."""
    values = {k: v for k, v in jaxrt.params(scene).items() if k in (first, second)}
    ones = lambda name: jnp.ones_like(values[name])
    inner = lambda v: jax.jvp(lambda a: f(v | {first: a}), (v[first],), (ones(first),))[1]
    return (lambda v: jax.jvp(lambda b: inner(v | {second: b}), (v[second],), (ones(second),))[1]), values


def test_by_reflectance_and_radiance():
    """L = ρ Le: the mixed derivative is 1, and those by one alone are 0, in both orders of forward and reverse."""
    scene = one_bounce()
    values = {k: jaxrt.params(scene)[k] for k in (PAINT, SKY)}
    bend = jax.jit(jax.hessian(mean_of(scene)))(values)
    for a in values:
        for b in values:
            np.testing.assert_allclose(bend[a][b], [[float(a != b)]], atol=1e-5)


def test_by_roughness():
    scene = one_bounce(jaxrt.Conductor(0.4, 0.9, 2.5, 0.9, id="metal"))
    bend, values = twice(mean_of(scene), scene, GLOSS, SKY)
    assert np.isfinite(jax.jit(bend)(values))


@pytest.mark.parametrize("first, second", [(POSE, POSE), (POSE, PAINT), (PAINT, POSE), (EYE, SKY), (SKY, EYE)])
def test_where_something_moves_they_are_refused(first, second):
    """Also with interior terms alone, and no matter which derivative is by what moves."""
    scene = one_bounce()
    bend, values = twice(mean_of(scene, boundary=False), scene, first, second)
    with pytest.raises(jaxrt.SceneError, match="second derivatives do not hold where something moves"):
        jax.eval_shape(bend, values)


def test_a_hessian_by_all_at_once_is_refused():
    scene = one_bounce()
    values = {k: jaxrt.params(scene)[k] for k in (PAINT, POSE)}
    with pytest.raises(jaxrt.SceneError, match="second derivatives"):
        jax.eval_shape(jax.hessian(mean_of(scene)), values)
