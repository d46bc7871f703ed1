"""Adam with one step size for all numbers of a parameter."""

import jax.numpy as jnp
import numpy as np
import optax

import jaxrt


def steps(optimiser, slopes):
    """Its steps along gradients, one after another."""
    kept, found = optimiser.init(slopes[0]), []
    for slope in slopes:
        step, kept = optimiser.update(slope, kept)
        found.append(step)
    return found


def test_of_one_number_it_is_adam():
    rate = optax.cosine_decay_schedule(0.1, 5)
    slopes = [{"a": jnp.array([g])} for g in (0.3, -2.0, 0.01, 5.0, 0.4)]
    uniform, adam = (steps(f(rate, b2=0.99), slopes) for f in (jaxrt.uniform_adam, optax.adam))
    for a, b in zip(uniform, adam, strict=True):
        np.testing.assert_allclose(a["a"], b["a"], rtol=1e-5)


def test_steps_keep_the_shape_of_the_gradient():
    """The largest number of each parameter moves as far as Adam would move it, others in proportion."""
    slope = {"a": jnp.array([[1.0, -4.0], [0.5, 0.0]]), "b": jnp.array([1e-6])}
    (step,) = steps(jaxrt.uniform_adam(0.2), [slope])
    np.testing.assert_allclose(step["a"], -0.2 * slope["a"] / 4.0, rtol=1e-5)
    np.testing.assert_allclose(step["b"], [-0.2], rtol=1e-5)
    assert (steps(jaxrt.uniform_adam(0.2), [{"a": jnp.zeros(2)}])[0]["a"] == 0).all()
