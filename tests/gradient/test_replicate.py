"""Standard errors of estimates, of gradients among them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrt


def test_errors_are_those_of_the_mean():
    """Of means of 16 normal numbers, in 4 batches: z is of Student's distribution with 3 degrees of freedom."""

    def estimate(key):
        x = jax.random.normal(key, (16,))
        return {"slope": jax.grad(lambda t: (t * x).mean())(2.0), "value": (x * 3.0).mean()}

    mean, stderr = jax.jit(jax.vmap(lambda key: jaxrt.replicate(estimate, key, 4)))(
        jax.random.split(jax.random.key(3), 4000)
    )
    for name, size in (("slope", 0.25), ("value", 0.75)):
        np.testing.assert_allclose(np.mean(np.square(stderr[name])), size**2 / 4, rtol=0.05)
        within = np.abs(mean[name] / stderr[name]) < 3.182  # 95 %
        assert np.mean(within) == pytest.approx(0.95, abs=0.015)


def test_a_gradient_and_its_error():
    """d/dρ of what a floor reflects of a ball of light above it: E/π = (R/d)² = 1/4."""
    floor = jaxrt.Rectangle(to_world=np.diag([5.0, 5.0, 1.0, 1.0]), bsdf=jaxrt.Diffuse([0.5], id="paint"), id="floor")
    ball = jaxrt.Sphere(center=(0.0, 0.0, 2.0), radius=1.0, emission=1.0, bsdf=jaxrt.Diffuse(0.0), id="ball")
    scene = jaxrt.Scene.build([floor, ball])

    def gradient(key):
        seen = lambda rho: jaxrt.radiance(
            jaxrt.with_params(scene, {"paint.reflectance": rho}),
            jnp.array([1.5, 0.0, 1.5]), jnp.array([-1.0, 0.0, -1.0]), key, plan=scene.plan, spp=4, max_depth=2,
        ).sum()  # fmt: skip
        return jax.grad(seen)(jnp.array([0.5]))

    mean, stderr = jaxrt.replicate(gradient, 7, batches=64)
    assert mean.shape == stderr.shape == (1,)
    assert 0 < float(stderr[0]) < 0.01
    assert abs(float(mean[0]) - 0.25) < 4 * float(stderr[0])


def test_one_batch_has_no_error():
    with pytest.raises(ValueError, match="batches is 1; give at least 2"):
        jaxrt.replicate(lambda key: jnp.zeros(()), 0, 1)
