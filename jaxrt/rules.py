"""Rules for the reflection integral: nodes ω with weights, so that K L is Σ weight · L(ω).

A rule is a callable pytree (x, ω_o, s) -> Nodes with a leading axis of nodes. `reflection_node` and
`light_node` are the two ways to draw one node; rules, `D` and the fused path all use these. Directions and
densities are held fixed under differentiation; f_r cosθ is not.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from . import brdf, emitter
from .casting import cast
from .gradient import material
from .sampling.sobol import Drawn, Stream
from .surface import Shading, SurfacePoint, choice, shading_at
from .vector import Spectrum, Vec3, where
from .world import World, world_of


class Node(eqx.Module):
    """A direction ω_i in the world, its weight f_r cosθ over the density that it was drawn with, that density (sr⁻¹) as
    weights against other ways to draw it take it, whether it is a delta's."""

    w: Vec3
    weight: Spectrum
    pdf: Any
    delta: Any
    s: Any


def balance(a: Any, b: Any) -> Any:
    """Balance heuristic of two densities (Veach 1997, section 9.2.2)."""
    total = a + b
    return jnp.where(total > 0, a / jnp.where(total > 0, total, 1.0), 0.0)


def met_share(world: World, x: SurfacePoint, o: Vec3, d: Vec3, pdf: Any, delta: Any) -> Any:
    """Weight of emission met at x along a ray drawn by reflection, against the chance of having drawn it as a light."""
    if not world.plan.lights:
        return 1.0
    return sg(jnp.where(delta, 1.0, balance(pdf, emitter.density(world, o, x, d))))


def reflected(world: World, at: Shading, w: Vec3) -> Spectrum:
    """f_r cosθ for a direction of the world."""
    wi = at.to_local(w)
    return brdf.eval(world.plan.lobes, at.material, wi, at.wo) * brdf.cosine(world.plan.lobes, wi) * at.factor(w)


def reflection_density(world: World, at: Shading, w: Vec3) -> Any:
    return sg(brdf.pdf(world.plan.lobes, at.material, at.to_local(w), at.wo))


def reflection_node(world: World, at: Shading, s: Stream | Drawn, pair: int = 0) -> Node:
    """A direction drawn from the BRDF, by pair `pair` and one number of `pair + 2`.

    Delta directions move with the surface, others stay fixed in space.
    """
    lobes, m = world.plan.lobes, at.material
    u = (*s.pair_at(pair), s.pair_at(pair + 2)[0]) if brdf.chooses(lobes) else s.pair_at(pair)
    local, delta = world.settle(brdf.sample(lobes, m, at.wo, u))
    attached = at.to_world(local)
    w = sg(attached)
    wi = at.to_local(w)
    p = sg(brdf.pdf(lobes, m, wi, at.wo))
    ok = p > 0
    weight = brdf.eval(lobes, m, wi, at.wo) * jnp.where(ok, brdf.cosine(lobes, wi) / jnp.where(ok, p, 1.0), 0.0)
    if brdf.has_delta(lobes):
        weight = where(delta, brdf.delta_weight(lobes, m, local, at.wo), weight)
        w = where(delta, attached, w)
    if at.found is not None:
        weight = weight * at.factor(w)
    return Node(w, weight, p, delta, s)


def light_node(world: World, x: SurfacePoint, at: Shading, s: Stream | Drawn, pair: int = 1) -> tuple[Node, Any]:
    """A direction drawn towards a light, and the light sample behind it. Uses pairs `pair` and `pair + 1`."""
    light = emitter.sample(world, x.position, s, pair, at.frame.n * at.side)
    ok = light.pdf > 0
    weight = reflected(world, at, light.w) * jnp.where(ok, light.jacobian / jnp.where(ok, light.pdf, 1.0), 0.0)
    return Node(light.w, weight, light.known, ok & False, s), light


def _nodes(n: int, one: Any, s: Stream) -> Any:
    return jax.vmap(lambda j: one(s.node(j, n)))(jnp.arange(n))


def _averaged(nodes: Node, n: int) -> Node:
    return eqx.tree_at(lambda a: (a.weight, a.s), nodes, (nodes.weight * (1.0 / n), nodes.s.advance(4)))


class BrdfRule(eqx.Module):
    """n directions drawn from f_r cosθ; delta lobes are nodes with finite weight."""

    world: World = eqx.field(converter=world_of)
    n: int = eqx.field(static=True, default=1)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Stream) -> Node:
        at = shading_at(self.world, x, w, choice(self.world, s))
        return _averaged(_nodes(self.n, lambda t: reflection_node(self.world, at, t), s), self.n)


class LightRule(eqx.Module):
    """n directions drawn towards area lights; others are no part of L⁰, which G could see."""

    world: World = eqx.field(converter=world_of)
    n: int = eqx.field(static=True, default=1)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Stream) -> Node:
        world, at = self.world, shading_at(self.world, x, w, choice(self.world, s))

        def one(t: Stream) -> Node:
            node, light = light_node(world, x, at, t)
            # A light behind another one: G would give the radiance of the one in front.
            behind = cast(world, x, node.w).face != light.face  # lamps without extent always, for G cannot see them
            return eqx.tree_at(lambda a: a.weight, node, node.weight * jnp.where(behind, 0.0, 1.0))

        return _averaged(_nodes(self.n, one, s), self.n)


class MisRule(eqx.Module):
    """n nodes of each kind, weighted by the balance heuristic: the rule of D."""

    world: World = eqx.field(converter=world_of)
    n: int = eqx.field(static=True, default=1)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Stream) -> Node:
        world, at = self.world, shading_at(self.world, x, w, choice(self.world, s))
        by_brdf = BrdfRule(world, self.n)(x, w, s)
        if not world.plan.lights:
            return by_brdf
        by_light = LightRule(world, self.n)(x, w, s)

        def other(node: Node) -> Node:
            y = cast(world, x, node.w)
            share = balance(node.pdf, emitter.density(world, x.position, y, node.w))
            # Emission that it meets is differentiated like that of light samples, see gradient.material.
            slopes = material.slope(functools.partial(reflected, world), at, node.w)
            form = material.met(world, x.position, y, slopes, ~node.delta & (y.light_density > 0) & (y.face >= 0))
            weight = node.weight * form * sg(jnp.where(node.delta, 1.0, share))
            return eqx.tree_at(lambda a: a.weight, node, weight)

        def light(node: Node) -> Node:
            share = balance(node.pdf, reflection_density(world, at, node.w))
            return eqx.tree_at(lambda a: a.weight, node, node.weight * sg(share))

        return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), jax.vmap(other)(by_brdf), jax.vmap(light)(by_light))


class QuadratureRule(eqx.Module):
    """A product rule over the hemisphere of projected solid angle: Gauss-Legendre in cos²θ, even in φ. No randomness.

    `turn` shifts φ by a part of a step. Delta lobes have no place here.
    """

    world: World = eqx.field(converter=world_of)
    n_theta: int = eqx.field(static=True, default=8)
    n_phi: int = eqx.field(static=True, default=16)
    turn: float = eqx.field(static=True, default=0.5)

    def __call__(self, x: SurfacePoint, w: Vec3, s: Stream) -> Node:
        at = shading_at(self.world, x, w, choice(self.world, s))
        u, du = np.polynomial.legendre.leggauss(self.n_theta)
        u, du = 0.5 * (u + 1.0), 0.5 * du
        phi = 2 * np.pi * (np.arange(self.n_phi) + self.turn) / self.n_phi
        r, z = np.sqrt(u)[:, None], np.broadcast_to(np.sqrt(1.0 - u)[:, None], (self.n_theta, self.n_phi))
        dmu = np.broadcast_to((np.pi / self.n_phi * du)[:, None], z.shape)
        local = Vec3(*(jnp.asarray(a.ravel(), x.position.x.dtype) for a in (r * np.cos(phi), r * np.sin(phi), z)))
        weights = jnp.asarray(dmu.ravel(), x.position.x.dtype)

        def node(v: Vec3, d: Any) -> Node:
            f = brdf.eval(self.world.plan.lobes, at.material, v, at.wo)
            return Node(at.to_world(v), f * (d * at.factor(at.to_world(v))), 1.0 / d, jnp.asarray(False), s)

        return jax.vmap(node)(local, weights)
