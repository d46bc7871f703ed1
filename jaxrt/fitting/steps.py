"""One step of a fit, jitted: gradient descent by optax, least squares by optimistix."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..scene import Scene
from .parameters import Free
from .views import Measuring, Views

FORWARD = 4
"""Numbers up to which gradients go forward."""


class State(eqx.Module):
    """The free parameters' numbers, and what the optimiser keeps of its steps."""

    z: Any
    kept: Any


def finite(*trees: Any) -> Any:
    leaves = [jnp.isfinite(a).all() for a in jax.tree.leaves(trees) if eqx.is_inexact_array(a)]
    return jnp.stack(leaves).all()


@dataclasses.dataclass(frozen=True)
class Descent:
    """Steps along gradients of the loss.

    `twice`: the loss is the mean product of residuals of two independent pictures, of half the samples each. Its mean
    is the loss of the picture without noise, and so is its gradient's: E[r₁ ∂r₂ + r₂ ∂r₁] = ∂(E r)², where that of
    one picture is also drawn to where pictures have little noise.
    """

    optimiser: Any
    measuring: Measuring
    twice: bool
    forward: bool

    def init(self, scene: Scene, free: Free, views: Any, key: Any) -> State:
        return State(free.start, self.optimiser.init(free.start))

    def enter(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> State:
        """The state with which a stage of other sizes goes on."""
        return state

    def loss(self, z: Any, scene: Scene, free: Free, views: tuple[Views, ...], key: Any) -> Any:
        moved, total = free(scene, z), 0.0
        for k, group in enumerate(views):
            r = self.measuring.residuals(moved, group, jax.random.fold_in(key, k), 2 if self.twice else 1)
            if r.ndim == 2:  # the caller's loss itself
                total = total + r.sum()
                continue
            total = total + (r[:, 0] * r[:, -1]).mean(tuple(range(1, r.ndim - 1))).sum()
        return total / sum(len(group.rows) for group in views)

    def gradient(self, *args: Any) -> tuple[Any, Any]:
        """The loss and its gradient in z."""
        z, *rest = args
        if not self.forward:
            return jax.value_and_grad(self.loss)(z, *rest)
        flat, back = ravel_pytree(z)
        along = lambda t: jax.jvp(lambda flat: self.loss(back(flat), *rest), (flat,), (t,))
        value, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(flat.size, dtype=flat.dtype))
        return value, back(slopes)

    @eqx.filter_jit
    def step(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> tuple[State, Any, Any, Any]:
        """The next state, the loss of this one, whether it is at its end, and whether all is finite."""
        value, slope = self.gradient(state.z, scene, free, views, key)
        move, kept = self.optimiser.update(slope, state.kept, state.z)
        z = jax.tree.map(lambda a, b: a + b, state.z, move)
        return State(z, kept), value, jnp.array(False), finite(value, z)


@dataclasses.dataclass(frozen=True)
class LeastSquares:
    """Steps of a solver of optimistix, with one set of samples: it compares residuals of one step and the next."""

    optimiser: Any
    measuring: Measuring

    def _call(self, scene: Scene, free: Free, views: Any, key: Any) -> tuple[Any, ...]:
        return (scene, free, views, key), {}

    def residuals(self, z: Any, args: Any) -> tuple[Any, None]:
        scene, free, views, key = args
        moved = free(scene, z)
        every = [self.measuring.residuals(moved, v, jax.random.fold_in(key, k)).ravel() for k, v in enumerate(views)]
        return jnp.concatenate(every), None

    def init(self, scene: Scene, free: Free, views: Any, key: Any) -> State:
        return self.enter(State(free.start, None), scene, free, views, key)

    def enter(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> State:
        args = scene, free, views, key
        out = jax.eval_shape(self.residuals, state.z, args)
        return State(state.z, self.optimiser.init(self.residuals, state.z, args, {}, *out, frozenset()))

    @eqx.filter_jit
    def step(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> tuple[State, Any, Any, Any]:
        args = scene, free, views, key
        z, kept, _ = self.optimiser.step(self.residuals, state.z, args, {}, state.kept, frozenset())
        done, result = self.optimiser.terminate(self.residuals, z, args, {}, kept, frozenset())
        loss = (kept.f_info.residual**2).mean()
        import optimistix

        return State(z, kept), loss, done, finite(loss, z) & (result == optimistix.RESULTS.successful)

    def covariance(self, state: State, free: Free) -> np.ndarray | None:
        """σ² D (JᵀJ)⁻¹ Dᵀ of the parameters: σ² = |r|² / (n − p), J = ∂r/∂z at the last accepted step, D = ∂(values)/∂z."""
        residual = np.asarray(state.kept.f_info.residual, np.float64)
        flat, back = ravel_pytree(state.z)
        if flat.size > LARGEST or residual.size <= flat.size:
            return None
        J = np.asarray(state.kept.f_info.jac.as_matrix(), np.float64)
        D = np.asarray(jax.jacfwd(lambda flat: ravel_pytree(free.values(back(flat)))[0])(flat), np.float64)
        variance = (residual**2).sum() / (residual.size - flat.size)
        return variance * D @ np.linalg.pinv(J.T @ J, hermitian=True) @ D.T


LARGEST = 1000
"""Free numbers up to which there is a covariance."""
