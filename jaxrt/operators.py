"""The algebra of light transport: G, K, T, D and the series, as operators between radiance functions.

A radiance function is a callable pytree (x: SurfacePoint, ω: Vec3, s: Stream) -> Spectrum, with ω facing away
from the surface. Emission is split off, L = L⁰ + R with R = D + T R and D = T L⁰, so nothing counts twice.
Everything here is for one point and one direction; batch it with `jax.vmap`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .casting import Psi
from .chart import even_point, off_surface
from .rules import BrdfRule, MisRule
from .sampling.sobol import Stream, seed_of
from .sampling.warp import cosine_hemisphere
from .scene import Scene
from .surface import SurfacePoint, radiance_of, surface_point
from .vector import Frame, Spectrum, Vec3
from .world import World, face_areas, world_of

Radiance = Callable[[SurfacePoint, Vec3, Stream], Spectrum]
Operator = Callable[[Any], Any]


class Emission(eqx.Module):
    """L⁰(x, ω): radiance that x emits towards ω (W·m⁻²·sr⁻¹)."""

    world: World

    def __call__(self, x: SurfacePoint, w: Vec3, s: Any = None) -> Spectrum:
        return radiance_of(self.world, x, w)


class Transported(eqx.Module):
    """G L: incident radiance, (G L)(x, ω) = L(ψ(x, ω), −ω)."""

    psi: Any
    L: Any

    def __call__(self, x: SurfacePoint, w: Vec3, s: Any = None) -> Spectrum:
        return self.L(self.psi(x, w), -w, s)


class TransportOperator(eqx.Module):
    """G. Its adjoint is itself."""

    psi: Any

    def __call__(self, L: Any) -> Transported:
        return Transported(self.psi, L)

    @property
    def adjoint(self) -> TransportOperator:
        return self


class Reflected(eqx.Module):
    """K L_i: reflected radiance, (K L_i)(x, ω_e) = ∫ f_r(x, ω_i, ω_e) L_i(x, ω_i) dμ(ω_i), by the nodes of a rule."""

    rule: Any
    Li: Any

    def __call__(self, x: SurfacePoint, w: Vec3, s: Any = None) -> Spectrum:
        nodes = self.rule(x, w, s)
        values = jax.vmap(lambda node: node.weight * self.Li(x, node.w, node.s))(nodes)
        return values.map(lambda c: jnp.sum(c, 0))


class ReflectionOperator(eqx.Module):
    """K. Its adjoint is itself by reciprocity, but where surfaces transmit: there radiance over η² is reciprocal."""

    rule: Any

    def __call__(self, Li: Any) -> Reflected:
        return Reflected(self.rule, Li)

    @property
    def adjoint(self) -> ReflectionOperator:
        return self


class Composed(eqx.Module):
    """A product of operators; the last is applied first."""

    operators: tuple[Any, ...]

    def __call__(self, L: Any) -> Any:
        for operator in reversed(self.operators):
            L = operator(L)
        return L

    @property
    def adjoint(self) -> Composed:
        return Composed(tuple(o.adjoint for o in reversed(self.operators)))


class Sum(eqx.Module):
    a: Any
    b: Any
    sign: float = eqx.field(static=True, default=1.0)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Any = None) -> Spectrum:
        apart = [None, None] if s is None else [s.child(1), s.child(2)]
        return self.a(x, w, apart[0]) + self.b(x, w, apart[1]) * self.sign


class Zero(eqx.Module):
    channels: int = eqx.field(static=True)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Any = None) -> Spectrum:
        return Spectrum.full(self.channels, jnp.zeros_like(w.x))


def emission(scene: Scene | World) -> Emission:
    """L⁰ of a scene."""
    return Emission(world_of(scene))


def psi(scene: Scene | World) -> Psi:
    """ψ of a scene: (SurfacePoint | Vec3, Vec3, exclude=faces) -> SurfacePoint."""
    return Psi(world_of(scene))


def G(scene: Scene | World | Psi) -> TransportOperator:
    """The transport operator of a scene (or of a ψ)."""
    return TransportOperator(scene if isinstance(scene, Psi) else psi(scene))


def K(scene: Scene | World, rule: Any = None) -> ReflectionOperator:
    """The reflection operator by a rule for its integral; one direction drawn from the BRDF by default."""
    return ReflectionOperator(BrdfRule(world_of(scene)) if rule is None else rule)


def compose(*operators: Any) -> Composed:
    return Composed(operators)


def add(a: Any, b: Any) -> Sum:
    return Sum(a, b)


def sub(a: Any, b: Any) -> Sum:
    return Sum(a, b, -1.0)


def T(scene: Scene | World, rule: Any = None) -> Composed:
    """One bounce, T = K G."""
    world = world_of(scene)
    return compose(K(world, rule), G(world))


def D(scene: Scene | World, n: int = 1) -> Reflected:
    """Direct light, D = T L⁰, by light and BRDF sampling combined: the only place where L⁰ is sampled."""
    world = world_of(scene)
    return compose(K(world, MisRule(world, n)), G(world))(emission(world))


def neumann(S: Any, T: Operator, n: int) -> Any:
    """S + T S + ... + Tⁿ S, as the notes nest it: S + T (S + T (S + ...))."""
    return S if n == 0 else add(S, T(neumann(S, T, n - 1)))


def estimate(scene: Scene | World, n: int, Rt: Any = None, rule: Any = None) -> Sum:
    """L⁰ + R̃ + Σ Tᵏ (D + T R̃ − R̃), k ≤ n: unbiased up to depth n for any approximation R̃ of R = L − L⁰."""
    world = world_of(scene)
    t, d = T(world, rule), D(world)
    if Rt is None:
        return add(emission(world), neumann(d, t, n))
    return add(emission(world), add(Rt, neumann(sub(add(d, t(Rt)), Rt), t, n)))


def surface_sample(world: World, s: Stream) -> tuple[SurfacePoint, Vec3, Any]:
    """A point of M and a direction with density cosθ/π per area, and the weight that makes a mean ∬ · dμ dA.

    Both sides of every face count; the enclosure does not. Faces are chosen by area.
    """
    cdf = jnp.cumsum(face_areas(world.geometry, world.blocks))
    choice, side = s.pair_at(0)
    face = jnp.minimum(jnp.searchsorted(cdf, choice * cdf[-1], side="right"), cdf.shape[0] - 1).astype(jnp.int32)
    y, n = even_point(world, face, s.pair_at(1))
    x = surface_point(world, face, off_surface(world, y, n), -n)
    local = cosine_hemisphere(s.pair_at(2))
    up = jnp.where(side < 0.5, 1.0, -1.0)
    w = Frame.around(n).to_world(Vec3(local.x, local.y, local.z * up))
    return x, w, 2.0 * jnp.pi * cdf[-1]


def inner(scene: Scene | World, a: Any, b: Any, key: Any = 0, n: int = 4096) -> Any:
    """⟨a, b⟩ = ∬ a b dμ dA over both sides of all faces, for each channel, (C,), by n samples.

    With G* = G, K* = K and T* = G K in closed scenes.
    """
    world = world_of(scene)
    if world.instances is not None:
        raise ValueError("inner: surfaces of instances are not supported; write them out as meshes")
    if world.grids is not None:
        raise ValueError("inner: surfaces of grids of distances are not supported; make meshes of them")
    seed = seed_of(key)

    def one(i: Any) -> Any:
        s = Stream(i, seed)
        x, w, weight = surface_sample(world, s)
        later = s.advance(3)
        return (a(x, w, later.child(1)) * b(x, w, later.child(2)) * weight).array()

    return jnp.mean(jax.vmap(one)(jnp.arange(n, dtype=jnp.uint32)), 0)


def norm(scene: Scene | World, a: Any, key: Any = 0, n: int = 4096) -> Any:
    """‖a‖ = √⟨a, a⟩ for each channel, (C,); a must be deterministic."""
    return jnp.sqrt(inner(scene, a, a, key, n))


def adjoint(operator: Any) -> Any:
    """The adjoint in ⟨·, ·⟩: G* = G, K* = K, (A B)* = B* A*, so T* = G K."""
    return operator.adjoint
