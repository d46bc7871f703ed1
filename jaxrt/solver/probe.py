"""What elements see before they are linked: whether something stands on them, and how evenly lights shine on them.

It tells where a partition has to be finer, and which elements are followed further.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ..vector import dot, normalise, safe_sqrt, where
from ..world import World
from . import path
from .elements import Elements, in_piece
from .links import ENDLESS, begin, stream_of

PROBES = 4
"""Light samples in each quarter of an element."""


def stood_on(world: World, rectangle: Any, face: Any, size: Any) -> Any:
    """Whether another surface stands on pieces: the middle of each, a little above, does not see all of its corners."""

    def one(row: Any, face: Any, size: Any) -> Any:
        point = lambda a, b: in_piece(world, face, row, a, b)
        (whole, n), (half, _) = point(0.5, 0.5), point(1 / 3, 1 / 3)
        middle = where(row[4] > 0, half, whole)
        o = middle + n * (4.0 * world.epsilon + 0.01 * jnp.where(size < jnp.inf, size, 0.0))

        def hidden(corner: Any) -> Any:
            a, b = (corner % 2).astype(row.dtype), (corner // 2).astype(row.dtype)
            to = point(a, b)[0] - middle
            far = safe_sqrt(dot(to, to)) * jnp.where((row[4] > 0) & (corner == 3), 0.0, 1.0 - 1e-3)
            return world.search.occluded(o, normalise(to), far)

        return jax.vmap(hidden)(jnp.arange(4)).any() & (face < world.first("disk")) & (size > 0)

    return jax.vmap(one)(rectangle, face, size)


def lit(world: World, elements: Elements, numbers: Any) -> tuple[Any, Any]:
    """The mean of direct light that each element reflects, over channels, and how far the means of its quarters are
    from that, on average."""

    def one(e: Any) -> tuple[Any, Any]:
        quarters = jax.vmap(lambda q: _direct(world, elements, jnp.uint32(0), e, q))(jnp.arange(4))
        return quarters.mean(), jnp.abs(quarters - quarters.mean()).mean()

    return jax.vmap(one)(numbers)


def _direct(world: World, elements: Elements, seed: Any, e: Any, quarter: Any) -> Any:
    """Mean over a quarter of an element, and channels, of direct light that it reflects."""

    def sample(k: Any) -> Any:
        u, v = stream_of(seed, e, k).pair_at(0)
        u, v = 0.5 * (u + (quarter % 2)), 0.5 * (v + (quarter // 2))
        k = PROBES * quarter + k
        link = begin(world, elements, seed, e, k, (u, v))
        landing = path.land(
            world, ENDLESS, link.path, path.bounce_stream(stream_of(seed, e, k), jnp.int32(0)), link.face
        )
        if landing.lit is None:
            return jnp.zeros_like(u)
        return jnp.where(landing.asked & ~landing.blocked, sum(landing.lit.channels), 0.0)

    return jax.vmap(sample)(jnp.arange(PROBES)).mean() / world.plan.channels
