"""Adam with one step size for all numbers of a parameter."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp


def uniform_adam(rate: Any, b1: float = 0.9, b2: float = 0.99) -> Any:
    """Adam whose steps are the mean gradient over one root mean square a parameter: of its largest number at each step.

    By number, as Adam does it, a smooth gradient becomes a rough step, and `Smooth` displacements do not stay so
    (B. Nicolet, A. Jacobson, W. Jakob, Large Steps in Inverse Rendering of Geometry, 2021, section 4.3). `rate`: a
    number or a schedule of optax, (step) -> a number. Returns an `optax.GradientTransformation`.
    """
    import optax

    def init(params: Any) -> Any:
        zero = jax.tree.map(lambda a: jnp.zeros((), a.dtype), params)
        return jnp.zeros((), jnp.int32), jax.tree.map(jnp.zeros_like, params), zero

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]:
        step, mean, square = state
        step, now = step + 1, rate(step) if callable(rate) else rate
        mean = jax.tree.map(lambda m, g: b1 * m + (1 - b1) * g, mean, updates)
        square = jax.tree.map(lambda v, g: b2 * v + (1 - b2) * jnp.max(g * g), square, updates)
        size = lambda v: now / (1 - b1**step) / jnp.sqrt(jnp.maximum(v / (1 - b2**step), 1e-30))
        return jax.tree.map(lambda m, v: -size(v) * m, mean, square), (step, mean, square)

    return optax.GradientTransformation(init, update)
