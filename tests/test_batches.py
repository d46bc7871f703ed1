"""Batches of scenes that share a plan in one call: `vmap` over values gives what scene by scene does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera

import jaxrt

pytestmark = pytest.mark.usefixtures("short_loops")

TENT = np.array([[-0.5, -0.5, 0.6], [0.5, -0.5, 0.6], [0.0, 0.6, 0.8]])


def triangle(name, vertices, reflectance, **more):
    """All that is in this scene is of one kind, for a short program."""
    return jaxrt.Mesh(
        id=name, vertices=vertices, faces=[[0, 1, 2]], bsdf=jaxrt.Diffuse(reflectance, id=f"{name}_paint"), **more
    )


SCENE = jaxrt.Scene.build(
    [
        triangle("floor", [[-3, -2, 0], [3, -2, 0], [0, 4, 0]], 0.5),
        triangle("tent", TENT, 0.7),
        triangle("lamp", [[-0.5, -0.5, 2], [0, 0.5, 2], [0.5, -0.5, 2]], 0.0, emission=5.0),
    ],
    sensors=[camera((0.3, -3.0, 2.0), (0, 0, 0.2), 6, 6, 50.0)],
)
PLAN = jaxrt.plan(SCENE)


def picture(values):
    return jaxrt.measure(jaxrt.with_params(SCENE, values), 0, plan=PLAN, spp=2, max_depth=2)


def slope(values):
    return jax.grad(lambda v: jnp.mean(picture(v)))(values)


def three():
    """Values of three scenes, stacked: another paint, another tent, another lamp."""
    given, k = jaxrt.params(SCENE), jnp.arange(3.0)
    shift = jnp.zeros((1, 4, 4)).at[0, 0, 3].set(0.2)
    return {
        "floor_paint.reflectance": 0.3 + 0.2 * k[:, None],
        "tent.vertices": given["tent.vertices"][None] + 0.1 * k[:, None, None],
        "lamp.to_world": given["lamp.to_world"][None] + k[:, None, None] * shift,
    }


@pytest.mark.parametrize("f", [picture, pytest.param(slope, marks=pytest.mark.slow)])
def test_a_batch_is_its_scenes(f):
    """To rounding, for reflectance, vertices and a transform at once, and every scene differs."""
    stacked, one = three(), jax.jit(f)
    together = jax.jit(jax.vmap(f))(stacked)
    apart = [one(jax.tree.map(lambda a, i=i: a[i], stacked)) for i in range(3)]
    for got, *want in zip(*map(jax.tree.leaves, (together, *apart)), strict=True):
        want = np.stack(want)
        assert np.isfinite(want).all() and np.ptp(want, axis=0).max() > 1e-3 * np.abs(want).max()
        np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-5 * np.abs(want).max())
