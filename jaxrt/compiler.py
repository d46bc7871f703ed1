"""What XLA has to be told about loops over lanes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax

CPU_OPTIONS: dict[str, str | bool] = {"xla_cpu_prefer_vector_width": "512"}
"""XLA keeps to vectors of 256 bits, which leaves a fifth of the speed of wide cores unused."""


def options() -> dict[str, str | bool]:
    """Compiler options for the programs that `render` compiles itself."""
    return CPU_OPTIONS if jax.default_backend() == "cpu" else {}


def one_function(f: Callable[..., Any]) -> Callable[..., Any]:
    """f compiled for the CPU into one function on one thread, where XLA would queue each of its kernels.

    A bounce is some hundred short kernels over 8k lanes; queueing them doubles the time on jax 0.10. XLA does
    this by itself for small loops (its `small_call`); we ask for it, and use cores by running several programs.
    """
    inner = jax.jit(f)

    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(inner(*args))
        try:
            from jax.experimental.xla_metadata import set_xla_metadata

            leaves[0] = set_xla_metadata(leaves[0], inlineable="false", xla_cpu_small_call="true")
        except (ImportError, TypeError):  # a hint only: other versions of jax run without it
            pass
        return jax.tree.unflatten(tree, leaves)

    return call
