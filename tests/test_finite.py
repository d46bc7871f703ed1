"""No derivative is infinite or not a number, by any parameter of the scenes in scenes/."""

import jax
import numpy as np
import pytest
from test_scenes import FOLDER, SCENES

import jaxrt

pytestmark = pytest.mark.usefixtures("short_loops")


def gradients(name, boundary, max_depth):
    """The gradient of a small picture's mean by every parameter of a scene, with boundary terms where there are some."""
    scene = jaxrt.load(FOLDER / name, res=6)
    plan, values = jaxrt.plan(scene), jaxrt.params(scene)

    def mean(values, boundary):
        moved = jaxrt.with_params(scene, values)
        return jaxrt.measure(moved, 0, plan=plan, spp=4, max_depth=max_depth, boundary=boundary).mean()

    slope = jax.grad(mean)
    try:
        run = jax.jit(slope, static_argnums=1).lower(values, boundary)
    except jaxrt.SceneError as e:
        assert "do not know" in str(e)
        run = jax.jit(slope, static_argnums=1).lower(values, False)
    return run.compile({"xla_backend_optimization_level": 0})(values)  # which saves more than it costs here


def assert_finite(found):
    wrong = [name for name, a in found.items() if not np.isfinite(a).all()]
    assert not wrong
    assert any(np.abs(a).max(initial=0.0) > 0 for a in found.values())


def test_the_cornell_box():
    assert_finite(gradients("cornell_box.xml", False, 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_every_scene(name):
    assert_finite(gradients(name, True, 3))
