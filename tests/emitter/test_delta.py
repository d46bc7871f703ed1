"""Lamps without extent: irradiance in closed form, its derivative, selection beside others, and the field method."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mean_and_error, moved

import jaxrt

FLOOR = jaxrt.Rectangle(to_world=moved(5.0), bsdf=jaxrt.Diffuse(0.5))
X, UP = np.array([1.0, 2.0, 0.01]), np.array([0.0, 0.0, 1.0])


def irradiance(lamps):
    scene = jaxrt.Scene.build([FLOOR], lamps=lamps)
    return float(jaxrt.irradiance(scene, X, UP, jax.random.key(0), spp=64, max_depth=2)[0])


def test_irradiance():
    """I cosθ/r²; E cosθ; within a spot's beam, between beam and cutoff, and beyond."""
    to = np.array([0.0, 0.0, 3.0]) - X
    r = np.linalg.norm(to)
    full = 7.0 * to[2] / r**3
    assert irradiance([jaxrt.Point((0, 0, 3), 7.0)]) == pytest.approx(full, rel=1e-5)
    assert irradiance([jaxrt.Directional((0, 3, -4), 2.0)]) == pytest.approx(1.6, rel=1e-5)
    assert irradiance([jaxrt.Directional((0, 3, 4), 2.0)]) == 0
    angle = np.degrees(np.arccos(to[2] / r))
    spot = lambda cutoff, beam: irradiance([jaxrt.Spot((0, 0, 3), 7.0, "", (0, 0, -1), cutoff, beam)])
    assert spot(angle + 2, angle + 1) == pytest.approx(full, rel=1e-5)
    assert spot(angle + 1, angle - 3) == pytest.approx(full / 4, rel=1e-3)
    assert spot(angle - 1, 1.0) == 0
    assert spot(angle + 0.5, angle + 0.5) == pytest.approx(full, rel=1e-5)


def test_many_are_chosen_among():
    lamps = [jaxrt.Point((k - 2, 0, 3), 1.0 + k) for k in range(5)] + [jaxrt.Directional((0, 0, -1), 0.5)]
    alone = [irradiance([lamp]) for lamp in lamps]
    ball = jaxrt.Sphere(center=(0, 0, 4), radius=0.5, emission=3.0)
    scene = jaxrt.Scene.build([FLOOR, ball], lamps=lamps)
    alone.append(3.0 * np.pi * 0.25 * 3.99 / (1 + 4 + 3.99**2) ** 1.5)  # a ball wholly above the horizon
    meters = jax.jit(lambda k: jaxrt.irradiance(scene, X, UP, k, spp=256, max_depth=2)[0])
    mean, error = mean_and_error(np.array([meters(jax.random.key(k)) for k in range(32)]))
    assert error < 0.01 * sum(alone) and abs(mean - sum(alone)) < 4.5 * error + 1e-4 * sum(alone)
    assert jaxrt.plan(scene).lamp_kinds == ("point", "directional")
    without = jaxrt.plan(scene, point=False)
    out = jaxrt.irradiance(scene, X, UP, jax.random.key(0), plan=without, spp=4096, max_depth=2)
    assert float(out[0]) == pytest.approx(sum(alone[5:]), rel=0.01)


def test_a_lamp_that_moves():
    """dE/dz of I z/(z² + a²)^(3/2), where nothing hides it; how borders of its shadows move is not known."""
    scene = jaxrt.Scene.build([FLOOR], lamps=[jaxrt.Point((0, 0, 3), 7.0, "lamp")])

    def seen(z, boundary=False):
        lamp = jaxrt.with_params(scene, {"lamp.position": jnp.array([0.0, 0.0, 1.0]) * z})
        return jaxrt.irradiance(lamp, X, UP, jax.random.key(0), spp=4, max_depth=2, boundary=boundary)[0]

    value, slope = jax.jit(jax.value_and_grad(seen))(3.0)
    a2, z = 5.0, 3.0 - 0.01
    assert float(value) == pytest.approx(7 * z / (z * z + a2) ** 1.5, rel=1e-4)
    assert float(slope) == pytest.approx(7 * (a2 - 2 * z * z) / (z * z + a2) ** 2.5, rel=1e-3)
    with pytest.raises(jaxrt.SceneError, match=r"shadows of lamps without extent .point."):
        jax.grad(lambda z: seen(z, True))(3.0)


def test_directions_may_have_any_length():
    scene = jaxrt.Scene.build([FLOOR], lamps=[jaxrt.Directional((0, 0, -1), 2.0, "sun")])
    turned = jaxrt.with_params(scene, {"sun.direction": [0.0, 3.0, -4.0]})
    seen = jaxrt.irradiance(turned, X, UP, jax.random.key(0), spp=4, max_depth=2)
    assert float(seen[0]) == pytest.approx(1.6, rel=1e-5)


def test_the_field_method_sees_them(short_loops):
    box = [jaxrt.Cube(to_world=moved(1.0), bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.6)))]
    sensor = jaxrt.Sensor(to_world=moved(1.0, (0, 0, -0.9)), fov=80.0, film=jaxrt.Film(16, 16, "box"))
    scene = jaxrt.Scene.build(box, sensors=[sensor], lamps=[jaxrt.Point((0.3, 0.2, 0.1), 1.0)])
    path, field = (jaxrt.render(scene, 256, 0, max_depth=8, method=m).image.mean() for m in ("path", "field"))
    assert field == pytest.approx(path, rel=0.01)


@pytest.mark.parametrize(
    "make, problem",
    [
        (lambda: jaxrt.Point((0, 0)), "point.position: is no point"),
        (lambda: jaxrt.Point(intensity=-1), "point.intensity: is -1"),
        (lambda: jaxrt.Spot(cutoff_angle=10, beam_width=11), "spot.beam_width: is 11"),
        (lambda: jaxrt.Directional((0, 0, 0)), "directional.direction: is no direction"),
    ],
)
def test_lamps_that_do_not_work(make, problem):
    with pytest.raises(jaxrt.SceneError, match=problem):
        make()
