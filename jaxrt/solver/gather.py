"""Radiance stored on elements, and the step of a path that ends in it: `estimate(field, 0)`."""

from __future__ import annotations

import functools
import operator
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..rules import Node, met_share, reflection_node
from ..sampling.sobol import Stream
from ..surface import SurfacePoint, _row, is_diffuse, leave, radiance_of, surface_point
from ..vector import Spectrum, Vec3, where
from ..world import World
from . import path
from .elements import Elements, around, element_of

EVEN = 1.5
"""By so much, relative to its own, elements around that of a point may differ from it to be looked at there."""


class Stored(eqx.Module):
    """Exitant reflected radiance of each element, (H, J, E, C), of H fields found apart.

    Set h of a pixel's samples looks into field h mod H, so that what differs between them shows in the picture's error;
    `block`: samples that follow one another in a set. J is 1
    for a fixed point; where the depth of paths is finite, row j holds the series up to as many edges as are left after
    a landing with j + 1 edges before it. From a distance below `near` times its size an element is too coarse to be
    looked at, and one gathers further. `gathers`: directions that a path looks into where it is reflected; 0 where
    `values` are of light reflected before, which is what a path looks at where it lands, with one more edge.
    """

    elements: Elements
    values: Float[Array, "H J E C"]
    near: Any = 1.0
    block: Any = 1
    gathers: int = eqx.field(static=True, default=1)

    def at(self, element: Any, depth: Any, half: Any) -> Spectrum:
        """What an element stores for a path of `depth` edges before the landing there."""
        fields, levels, count, channels = self.values.shape
        index = jnp.maximum(element, 0)
        if levels > 1:
            index = index + count * jnp.clip(depth - 1, 0, levels - 1)
        if fields > 1:
            index = index + count * levels * (half % fields)
        row = _row(self.values.reshape(-1, channels), index)
        return Spectrum(tuple(row[c] for c in range(channels)))

    def found(self, world: World, x: SurfacePoint, w: Vec3) -> tuple[Any, Any]:
        """The element at x seen along ω, and whether what it stores holds from so near."""
        element = element_of(world, self.elements, x, w)
        size = _row(self.elements.size, jnp.maximum(element, 0))
        return element, (element >= 0) & (size < jnp.inf) & (
            x.distance > self.near * jnp.where(size < jnp.inf, size, 0.0)
        )

    def bounce(
        self, world: World, depths: path.Depths, state: path.PathState, s: Stream, half: Any, face: Any = None
    ) -> tuple[path.PathState, Any]:
        """One step of a path, split into `gathers`: those that land on a stored element or on nothing end there, and
        one of the others goes on for all of them, to land again. Also the number of rays cast."""
        landing = path.land(world, depths, state, s, face)
        at, x, n = landing.at, landing.x, self.gathers
        if at is None:
            return path.reflect(world, depths, state, landing), 1
        cast = 1 + jnp.where(landing.alive, n + (landing.light is not None), 0)
        if n == 0:
            return self._ended(world, depths, state, landing, half), cast
        asked = landing.alive & (state.scattered | is_diffuse(world, at))

        def look(m: Any, carry: Any) -> Any:
            total, chosen, count = carry
            sub = s.node(m, n) if n > 1 else s
            node = world.settle(reflection_node(world, at, sub))
            o = world.settle(leave(world, x, node.w))
            face = world.settle(world.search.closest(o, node.w))
            y = surface_point(world, face, o, node.w)
            used = ("position", "normal", "uv", "distance", "finish", "light_density")
            y = replace(y, **world.settle({name: getattr(y, name) for name in used}))
            element, holds = world.settle(self.found(world, y, -node.w))
            lost = ~(node.weight.max() > 0) & (state.before is None)  # black surfaces have derivatives
            ends = asked & (holds | (face < 0) | lost)
            share = met_share(world, y, o, node.w, node.pdf, node.delta)
            stored = self.at(element, state.depth + 1, half).map(lambda c: jnp.where(holds, c, 0.0))
            seen = node.weight * (radiance_of(world, y, -node.w) * share + stored)
            total = total + seen.map(lambda c: jnp.where(ends & ~lost, c, 0.0))
            count = count + jnp.where(ends, 0.0, 1.0)
            take = ~ends & ((sub.pair_at(1)[0] * count < 1.0) | (n == 1))
            return total, where(take, (node.w, node.weight, node.pdf, node.delta), chosen), count

        zero = state.beta * 0.0
        none = zero.channels[0]
        carry = zero, (state.d, zero, none, landing.alive & False), none
        total, chosen, count = look(0, carry) if n == 1 else jax.lax.fori_loop(0, n, look, carry)
        w, weight, pdf, delta = chosen
        node = Node(w, weight * (count / n), pdf, delta, None)
        light = (state.beta * total * (1.0 / n)).map(lambda c: jnp.where(landing.alive, c, 0.0))
        landing = replace(landing, radiance=landing.radiance + light)
        return path.reflect(world, depths, state, landing, node), cast

    def _ended(self, world: World, depths: path.Depths, state: path.PathState, landing: Any, half: Any) -> Any:
        """A path that ends where it landed on an element: light of lights is sampled alone, the rest is looked at.

        It goes on where elements around differ so much that what lies between them is not known.
        """
        x, w = landing.x, -state.d
        element, holds = self.found(world, x, w)
        found = around(world, self.elements, x, w, element)
        held = [self.at(e, state.depth + 1, half) for e, _ in found]
        seen = functools.reduce(operator.add, [value * weight for value, (_, weight) in zip(held, found, strict=True)])
        # What lies beyond the element's border must not outshine it: there may be a wall between.
        own = self.at(element, state.depth + 1, half)
        apart = [
            jnp.where(weight > 0, jnp.abs(sum(v.channels) - sum(own.channels)), 0.0)
            for v, (_, weight) in zip(held, found, strict=True)
        ]
        even = functools.reduce(jnp.maximum, apart) <= EVEN * sum(own.channels)
        even = even & (_row(self.elements.span, jnp.maximum(element, 0)) > 0)
        ends = landing.alive & holds & (even | state.scattered)
        light = (state.beta * where(even, seen, own)).map(lambda c: jnp.where(ends, c, 0.0))
        landing = replace(landing, radiance=landing.radiance + light)
        if landing.share is not None:
            landing = replace(landing, share=jnp.where(ends, 1.0, landing.share))
        state = path.reflect(world, depths, state, landing)
        return replace(state, alive=state.alive & ~ends)
