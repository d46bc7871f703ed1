"""Solvers for b = e + T b, the field equation on elements; all behind one function.

T is never a matrix: it is applied by its links. Derivatives are those of the solution, by the implicit function theorem
and a Krylov solver, whatever found it; memory does not depend on the number of steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx

MAX_STEPS = 4096
RESTART = 32
"""Directions that GMRES keeps."""

SOLVERS = ("plain", "ambient", "anderson", "gmres")


class Anderson(optx.AbstractFixedPointSolver):
    """Anderson acceleration (Walker and Ni 2011) of a fixed point of one array, from the last `depth` differences."""

    rtol: Any
    atol: Any
    norm: Callable[[Any], Any] = optx.max_norm
    depth: int = 5

    def init(self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> Any:
        none = jnp.zeros((self.depth, y.size), y.dtype)
        return none, none, y, y, jnp.int32(0), jnp.asarray(jnp.inf, y.dtype)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        steps_of_f, steps_of_y, last_r, last_f, n, _ = state
        f, aux = fn(y, args)
        r = f - y
        k = (n - 1) % self.depth
        put = lambda table, d: jnp.where(n > 0, table.at[k].set(d.ravel()), table)
        steps_of_f, steps_of_y = put(steps_of_f, r - last_r), put(steps_of_y, f - last_f)
        gram = steps_of_f @ steps_of_f.T
        size = jnp.trace(gram)
        ridge = jnp.where(size > 0, 1e-6 * size, 1.0) * jnp.eye(self.depth, dtype=y.dtype)
        mix = jnp.linalg.solve(gram + ridge, steps_of_f @ r.ravel())
        new = f - (mix @ steps_of_y).reshape(y.shape)
        error = self.norm(r / (self.atol + self.rtol * jnp.abs(f)))
        return new, (steps_of_f, steps_of_y, r, f, n + 1, error), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        return state[-1] < 1, optx.RESULTS.successful

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: Any, tags: Any, result: Any
    ) -> Any:
        return y, aux, {}


def ambient(after: Any, residual: Any, area: Any, spread: tuple[Any, Any]) -> Any:
    """`after` = e + T b, as it would be had the light still on its way been spread over all surfaces alike.

    `spread` = (T 1, T² 1): b + c T 1 has the residual r − c (T 1 − T² 1), smallest in the norm of areas for this c.
    Exact in an enclosure of one albedo, and nowhere worse than a step without.
    """
    rest = spread[0] - spread[1]
    c = (area[:, None] * rest * residual).sum(0) / jnp.maximum((area[:, None] * rest**2).sum(0), 1e-30)
    return after + c[None] * spread[1]


def solve_links(links: Any, rtol: Any, solver: Any, max_steps: int = MAX_STEPS) -> tuple[Any, Any, Any]:
    """b = e + T b to a relative tolerance, the number of applications of T, and an `optimistix.RESULTS`.

    `solver`: a name of `SOLVERS`, or a fixed point solver of optimistix or a linear solver of lineax. Steps are
    compared with rtol · (1 − ‖T‖∞), for a small step is not a small error.
    """
    e = links.emitted
    row = jax.lax.stop_gradient(links.apply(jnp.ones_like(e)))
    short = jnp.clip(1.0 - row.max(), 1e-5, 1.0)
    scale = jax.lax.stop_gradient(jnp.maximum(e.max(), 1e-30))
    adjoint = lx.GMRES(rtol=1e-5, atol=1e-7, restart=RESTART, stagnation_iters=RESTART)
    if solver == "gmres" or isinstance(solver, lx.AbstractLinearSolver):
        krylov = lx.GMRES(1e-2 * rtol, 0.0, max_steps=max_steps, restart=RESTART, stagnation_iters=RESTART)
        krylov = krylov if solver == "gmres" else solver
        operator = lx.FunctionLinearOperator(lambda b: b - links.apply(b), jax.eval_shape(lambda: e))
        found = lx.linear_solve(operator, e, krylov, throw=False)
        ok = found.result == lx.RESULTS.successful
        steps = found.stats.get("num_steps", jnp.int32(-1))
        left = jnp.abs(e + links.apply(found.value) - found.value).max()
        small = left <= 10.0 * rtol * scale + 16.0 * jnp.finfo(e.dtype).eps * jnp.abs(found.value).max()
        return found.value, steps, _result(ok & small & _bounded(found.value, scale))
    step_tolerance = jnp.maximum(rtol * short, 2.0 * jnp.finfo(e.dtype).eps)
    tolerance = {"rtol": step_tolerance, "atol": 1e-3 * rtol * short * scale}
    chosen = {"plain": optx.FixedPointIteration, "ambient": optx.FixedPointIteration, "anderson": Anderson}
    method = chosen[solver](**tolerance) if isinstance(solver, str) else solver

    spread = jax.lax.stop_gradient((row, links.apply(row)))

    def step(b: Any, args: Any) -> Any:
        links, e, spread = args
        after = e + links.apply(b)
        return ambient(after, after - b, links.area, spread) if solver == "ambient" else after

    found = optx.fixed_point(
        step,
        method,
        e,
        (links, e, spread),
        adjoint=optx.ImplicitAdjoint(adjoint),
        max_steps=max_steps,
        throw=False,
    )
    good = (found.result == optx.RESULTS.successful) & _bounded(found.value, scale)
    return found.value, found.stats["num_steps"], _result(good)


def _bounded(b: Any, scale: Any) -> Any:
    """Whether b is a solution: ‖b‖ ≤ ‖e‖ / (1 − ‖T‖), and weights tell 1 − ‖T‖ from 0 only down to their rounding."""
    return jnp.abs(b).max() < scale * (0.01 / jnp.finfo(b.dtype).eps)


def _result(good: Any) -> Any:
    results = optx.RESULTS
    return results.where(good, results.successful, results.nonlinear_max_steps_reached)


def series(links: Any, edges: int) -> Any:
    """Partial sums of the series by their number of edges beyond an element, 1 ... `edges`: (edges, E, C)."""
    direct = links.direct.mean(1)
    lengths = direct.shape[1]
    levels = [direct[:, 0]]
    for n in range(1, edges):
        e = direct[:, : min(n + 1, lengths)].sum(1)
        if links.edges is None:
            levels.append(e + links.apply(levels[-1]))
            continue
        at = n - links.edges
        stacked = jnp.concatenate(levels)  # flat, for XLA gathers by two indices at a third of the speed
        landed = stacked.at[jnp.maximum(at, 0) * len(levels[0]) + links.target].get(mode="promise_in_bounds")
        landed = jnp.where((at >= 0)[..., None], landed, 0.0)
        levels.append(e + (links.weight * landed).mean(1))
    return jnp.stack(levels)


def spectral_radius(links: Any, steps: int = 24) -> Any:
    """The largest |eigenvalue| of T, by power iteration from a positive start."""
    start = jnp.ones_like(links.emitted)

    def one(b: Any, _: Any) -> Any:
        after = links.apply(b)
        size = jnp.abs(after).max()
        return after / jnp.where(size > 0, size, 1.0), size

    sizes = jax.lax.scan(one, start, None, length=steps)[1]
    return jnp.exp(jnp.log(jnp.maximum(sizes[-4:], 1e-30)).mean())


def residual_bound(links: Any, b: Any) -> tuple[Any, Any, Any]:
    """‖e + T b − b‖∞ / (1 − ‖T‖∞), an upper bound of ‖b − b*‖∞ (Banach), infinite where ‖T‖∞ is 1; the residual's norm;
    and ‖T‖∞."""
    norm = links.apply(jnp.ones_like(b)).max()
    rounding = 4.0 * jnp.finfo(b.dtype).eps * jnp.abs(b).max()
    residual = jnp.abs(links.emitted + links.apply(b) - b).max()
    least = jnp.where(norm < 1.0, 1.0 - norm, 1.0)
    return jnp.where(norm < 1.0, (residual + rounding) / least, jnp.inf), residual, norm


__all__ = ["MAX_STEPS", "SOLVERS", "Anderson", "ambient", "residual_bound", "series", "solve_links", "spectral_radius"]
