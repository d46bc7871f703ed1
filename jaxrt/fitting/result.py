"""What a fit returns."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..scene import Scene


class Fit(eqx.Module):
    """A fitted scene, and how it came about.

    scene: with the fitted values. parameters: these by name, as `jaxrt.params` has them. history: by step, arrays of
    `step`, `loss` and `seconds` (since the start, compiling included), and of parameters of few numbers, by name.
    covariance (P, P): of least squares, of all parameters' numbers one after another, in their own units; else None.
    seconds: all of it. result: `optimistix.RESULTS.successful`, or what kept the fit from it.
    """

    scene: Scene
    parameters: dict[str, Array]
    history: dict[str, np.ndarray]
    covariance: Float[np.ndarray, "P P"] | None
    seconds: float
    result: Any

    @property
    def stderr(self) -> dict[str, Array]:
        """Standard errors of the parameters by name, from the covariance; NaN where there is none."""
        flat, back = ravel_pytree(self.parameters)
        if self.covariance is None:
            return back(jnp.full_like(flat, jnp.nan))
        return back(jnp.sqrt(jnp.diag(self.covariance)).astype(flat.dtype))
