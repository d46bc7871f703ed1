"""How well an estimate is known: a gradient, or anything else that a key decides."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def replicate(estimate: Callable[[Any], Any], key: Any, batches: int = 8) -> tuple[Any, Any]:
    """The mean of independent estimates, and its standard error.

    `estimate`: a key -> numbers in any pytree, as `lambda key: jax.grad(loss)(values, key)`; pure, traced once. `key`:
    a JAX key or an integer. `batches`: how many, at least 2, one after another, so that memory is that of one. The
    error is of Student's distribution with batches − 1 degrees of freedom. Returns two pytrees of the estimate's
    structure and units. Raises `ValueError` for fewer batches.
    """
    if batches < 2:
        raise ValueError(f"replicate: batches is {batches}; give at least 2, for an error is that of their differences")
    if jnp.issubdtype(jnp.result_type(key), jnp.integer) and jnp.ndim(key) == 0:
        key = jax.random.key(key)
    found = jax.lax.map(estimate, jax.random.split(key, batches))
    mean = jax.tree.map(lambda a: a.mean(0), found)
    return mean, jax.tree.map(lambda a: a.std(0, ddof=1) / batches**0.5, found)
