"""`measure` and `solve` on several devices of one process give what they give on one."""

import os
import subprocess
import sys

import jax
import numpy as np

import jaxrt
from jaxrt.intersect import dense
from jaxrt.solver import measure

SIZE = 24  # two rows of lanes, the second one filled up


def picture_and_gradient():
    lamp = np.diag([0.5, 0.5, -1.0, 1.0])
    lamp[2, 3] = 2.0
    floor = jaxrt.Rectangle(bsdf=jaxrt.Diffuse(0.5, id="floor"))
    pose = np.diag([1.0, 1.0, -1.0, 1.0])  # down onto the floor
    pose[2, 3] = 1.5
    sensor = jaxrt.Sensor(to_world=pose, film=jaxrt.Film(SIZE, SIZE, "box"))
    scene = jaxrt.Scene.build([floor, jaxrt.Rectangle(to_world=lamp, emission=1.0)], sensors=[sensor])
    plan = jaxrt.plan(scene, light_sampling=False)

    def image(r):
        return jaxrt.measure(jaxrt.with_params(scene, {"floor.reflectance": r}), 1, plan=plan, spp=4, max_depth=3)

    measure.STILL, dense.UNROLL = measure.LANES, 1
    weights = np.linspace(0.0, 1.0, SIZE * SIZE).reshape(SIZE, SIZE, 1)
    r = jaxrt.params(scene)["floor.reflectance"]
    field = jaxrt.solve(scene, 1, plan=plan, resolution=600, directions=16)  # three rows of elements
    return jax.jit(image)(r), jax.jit(jax.grad(lambda r: (weights * image(r)).mean()))(r), field.values


def test_two_devices_give_what_one_gives(tmp_path, monkeypatch, short_loops):
    monkeypatch.setattr(measure, "STILL", measure.STILL)
    one = picture_and_gradient()
    script = f"""
import sys, jax, numpy
sys.path.insert(0, {os.path.dirname(__file__)!r})
from test_devices import picture_and_gradient
assert len(jax.devices()) == 2
numpy.savez({str(tmp_path / "two.npz")!r}, *picture_and_gradient())
"""
    env = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    subprocess.run([sys.executable, "-c", script], env=env, check=True)
    two = np.load(tmp_path / "two.npz")
    assert np.asarray(one[0]).std() > 0
    np.testing.assert_allclose(two["arr_0"], one[0], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(two["arr_1"], one[1], rtol=1e-5)
    assert np.asarray(one[2]).std() > 0
    np.testing.assert_allclose(two["arr_2"], one[2], rtol=1e-5, atol=1e-7)
