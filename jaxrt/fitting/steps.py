"""One step of a fit, jitted: gradient descent by optax, least squares by optimistix."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient as sg

from ..parts import SceneError
from ..scene import Scene
from .parameters import Free
from .views import Measuring, Views

FORWARD = 10
"""Numbers up to which gradients go forward: for more a step takes longer than in reverse, which compiles longer."""


class State(eqx.Module):
    """The free parameters' numbers, and what the optimiser keeps of its steps."""

    z: Any
    kept: Any


def finite(*trees: Any) -> Any:
    leaves = [jnp.isfinite(a).all() for a in jax.tree.leaves(trees) if eqx.is_inexact_array(a)]
    return jnp.stack(leaves).all()


ABREAST = 16
"""Derivatives along so many directions that are taken at once."""


def along(f: Any, flat: Any) -> tuple[Any, Any]:
    """f, and its derivatives along all axes (P, ...), forward."""
    eye = jnp.eye(flat.size, dtype=flat.dtype)
    if flat.size <= ABREAST:
        return jax.vmap(lambda t: jax.jvp(f, (flat,), (t,)), out_axes=(None, 0))(eye)
    values, slopes = jax.lax.map(lambda t: jax.jvp(f, (flat,), (t,)), eye, batch_size=ABREAST)
    return values[0], slopes


class Descent(eqx.Module):
    """Steps along gradients of the loss.

    `twice`: the loss is the mean product of residuals of two independent pictures, of half the samples each. Its mean
    is the loss of the picture without noise, and so is its gradient's: E[r₁ ∂r₂ + r₂ ∂r₁] = ∂(E r)², where that of
    one picture is also drawn to where pictures have little noise.
    """

    optimiser: Any
    measuring: Measuring = eqx.field(static=True)
    twice: bool = eqx.field(static=True)
    forward: bool = eqx.field(static=True)

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
        value, slopes = along(lambda flat: self.loss(back(flat), *rest), flat)
        return value, back(slopes)

    @eqx.filter_jit
    def step(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> tuple[State, Any, Any, Any]:
        """The next state, the loss of this one, whether it is at its end, and whether all is finite."""
        value, slope = self.gradient(state.z, scene, free, views, key)
        move, kept = self.optimiser.update(slope, state.kept, state.z)
        z = jax.tree.map(lambda a, b: a + b, state.z, move)
        return State(z, kept), value, jnp.array(False), finite(value, z)


class LeastSquares(eqx.Module):
    """Steps of a solver of optimistix, with one set of samples: it compares residuals of one step and the next.

    `twice`: residuals of two independent pictures, of half the samples each, each with the other's derivative: then
    JᵀR = J₂ᵀr₁ + J₁ᵀr₂, the gradient of the picture without noise in the mean.
    """

    optimiser: Any
    measuring: Measuring = eqx.field(static=True)
    twice: bool = eqx.field(static=True)

    def residuals(self, z: Any, args: Any) -> tuple[Any, None]:
        """(takes, n), with a Jacobian that is known with them: solvers ask for its product with every axis."""
        scene, free, views, key = args
        flat, back = ravel_pytree(z)

        def every(flat: Any) -> Any:
            moved, found = free(scene, back(flat)), []
            for k, group in enumerate(views):
                r = self.measuring.residuals(moved, group, jax.random.fold_in(key, k), 2 if self.twice else 1)
                if r.ndim == 2:
                    raise SceneError("loss: gives one number; least squares needs residuals, an array")
                found.append(jnp.moveaxis(r, 1, 0).reshape(r.shape[1], -1))
            return jnp.concatenate(found, 1)

        r, J = along(every, sg(flat))
        return r + jnp.tensordot(flat - sg(flat), J[:, ::-1] if self.twice else J, 1), None

    def fresh(self, z: Any, args: Any) -> Any:
        """What the solver starts with. Not all of it is arrays: the rest is made again inside each program, so that
        programs serve every fit of their shapes."""
        out = jax.eval_shape(self.residuals, z, args)
        return self.optimiser.init(self.residuals, z, args, {}, *out, frozenset())

    @eqx.filter_jit
    def init(self, scene: Scene, free: Free, views: Any, key: Any) -> State:
        return State(free.start, eqx.filter(self.fresh(free.start, (scene, free, views, key)), eqx.is_array))

    @eqx.filter_jit
    def enter(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> State:
        return State(state.z, eqx.filter(self.fresh(state.z, (scene, free, views, key)), eqx.is_array))

    @eqx.filter_jit
    def step(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> tuple[State, Any, Any, Any]:
        import optimistix

        args, none = (scene, free, views, key), frozenset()
        kept = eqx.combine(state.kept, self.fresh(state.z, args))
        z, kept, _ = self.optimiser.step(self.residuals, state.z, args, {}, kept, none)
        done, result = self.optimiser.terminate(self.residuals, z, args, {}, kept, none)
        loss = (kept.f_info.residual**2).mean()
        good = finite(loss, z) & (result == optimistix.RESULTS.successful)
        return State(z, eqx.filter(kept, eqx.is_array)), loss, done, good

    @eqx.filter_jit
    def _normal(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> tuple[Any, ...]:
        """JᵀJ, |r|², how many residuals, and ∂(values)/∂z at the last accepted step."""
        kept = eqx.combine(state.kept, self.fresh(state.z, (scene, free, views, key)))
        r, (flat, back) = kept.f_info.residual, ravel_pytree(state.z)
        J = kept.f_info.jac.as_matrix().reshape(*r.shape, -1)
        slopes = jax.jacfwd(lambda flat: ravel_pytree(free.values(back(flat)))[0])(flat)
        return J[0].T @ J[-1], (r.mean(0) ** 2).sum(), jnp.array(r.shape[1]), slopes

    def covariance(self, state: State, scene: Scene, free: Free, views: Any, key: Any) -> np.ndarray | None:
        """σ² D (JᵀJ)⁻¹ Dᵀ of the parameters: σ² = |r|² / (n − p), J = ∂r/∂z, D = ∂(values)/∂z.

        At the last accepted step. Of two pictures r is the mean of both, and JᵀJ is J₁ᵀJ₂.
        """
        numbers = free.numbers
        if numbers > LARGEST:
            return None
        square, total, n, D = (np.asarray(a, np.float64) for a in self._normal(state, scene, free, views, key))
        if n <= numbers:
            return None
        return total / (n - numbers) * D @ np.linalg.pinv((square + square.T) / 2, hermitian=True) @ D.T


LARGEST = 1000
"""Free numbers up to which there is a covariance."""
