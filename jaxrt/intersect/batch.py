"""Batches of rays as a search wants them: in a row, with one structure for all."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


def in_a_row(search: Callable[..., Any]) -> Callable[..., Any]:
    """search(structure, rays), of arrays (n,), under any `vmap`: it adds to n, unless it is over structures.

    Structures of a batch are searched one after another.
    """

    @custom_vmap
    def run(structure: Any, rays: Any) -> Any:
        return search(structure, rays)

    @run.def_vmap
    def rule(size: int, batched: Any, structure: Any, rays: Any) -> Any:
        spread = lambda c, b: c if b else jnp.broadcast_to(c, (size, *c.shape))
        rays = jax.tree.map(spread, rays, batched[1])
        if any(jax.tree.leaves(batched[0])):
            found = jax.lax.map(lambda x: run(*x), (jax.tree.map(spread, structure, batched[0]), rays))
        else:
            found = run(structure, jax.tree.map(jnp.ravel, rays))
            found = jax.tree.map(lambda a: a.reshape(size, -1), found)
        return found, jax.tree.map(lambda _: True, found)

    return run
