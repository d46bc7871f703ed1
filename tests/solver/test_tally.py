"""Sums of very many samples do not drift, and tell of the few that hold most."""

import jax
import numpy as np
import pytest

import jaxrt
from jaxrt.solver import path
from jaxrt.solver.solution import share_of_most
from jaxrt.solver.tally import Tally

pytestmark = pytest.mark.usefixtures("short_loops")


@pytest.mark.parametrize("value", [0.5, 0.1])
def test_a_billion_samples(value):
    """Few large steps, then many small ones, which a plain sum in float32 would round."""
    tally, n = Tally(1, 1, 0), 0
    for step in [10**6] * 996 + [256] * 15625:
        sums = np.full((1, path.SETS, 1), np.float32(value) * np.float32(step / path.SETS), np.float32)
        tally.add(np.zeros(1, int), np.array([n]), np.array([n + step]), sums)
        n += step
    assert n == tally.samples == 10**9
    mean, variance = tally.found()
    np.testing.assert_allclose(mean, value, rtol=1e-6)
    assert variance[0, 0] < 1e-12


def test_many_samples_of_one_call():
    """What `measure` adds up inside one program; a plain sum in float32 is 1e-3 off."""
    mesh = jaxrt.Mesh(vertices=[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=np.array([[0, 1, 2]]), id="away")
    view = jaxrt.Sensor(film=jaxrt.Film(1, 1, "box"))
    scene = jaxrt.Scene.build([mesh], sensors=[view], enclosure=jaxrt.Enclosure(0.1))
    image = jax.jit(lambda s: jaxrt.measure(s, 0, spp=1 << 20, max_depth=1))(scene)
    np.testing.assert_allclose(np.asarray(image), 0.1, rtol=2e-6)


def test_outliers_are_told():
    values = np.ones(5000, np.float32)
    assert share_of_most(values) == pytest.approx(1e-3)
    values[[7, 70, 700]] = 5000.0
    assert share_of_most(values) == pytest.approx(15002 / 19997)
    values[9] = np.nan
    assert share_of_most(values) == pytest.approx(15002 / 19996)
    assert share_of_most(np.zeros(10)) == 0.0
