"""Pixels through which the border of a lamp goes. A few of them hold most of a picture's variance, for a lamp outshines
what it lights a hundred times; so they are taken several times."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import emitter
from ..compiler import program, remembered
from ..sampling.sobol import Drawn
from ..surface import radiance_of, surface_point
from ..world import World
from .begin import Picture

TAKES = 8
"""How often a pixel with a lamp's border in it is taken."""

PIXELS, CORNERS = 1 << 16, 1 << 12
"""Pixels of one program that looks for lamps, and of one that casts rays through their corners."""


@remembered
def borders(world: World, view: Picture) -> np.ndarray:
    """Numbers of the pixels whose corners do not all see the same emission."""
    count = int(view.width) * int(view.height)
    if not world.plan.light_kinds or view.searches or count * (TAKES + 1) >= 1 << 31:
        return np.zeros(0, np.int32)
    near = _asked(_near, world, view, np.arange(count, dtype=np.int32), PIXELS)
    found = _asked(_differ, world, view, near, CORNERS)
    return found if TAKES * len(found) <= count else found[:0]  # where lamps end everywhere, no pixel stands out


def _asked(f: Any, world: World, view: Picture, numbers: np.ndarray, size: int) -> np.ndarray:
    """Those numbers of which f says yes, asked `size` at a time."""
    if not len(numbers):
        return numbers
    rows = np.resize(numbers, (-(-len(numbers) // size), size))
    run = program(f, world, view, rows[0], keep=world.plan.storable)
    return numbers[np.concatenate([np.asarray(run(world, view, row)) for row in rows])[: len(numbers)]]


def _through_corners(world: World, view: Picture, number: Any) -> Any:
    """The paths that begin at the corners of a pixel's filter, with a leading axis of 4."""
    corners = jnp.asarray([(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)], world.faces.dtype)
    return jax.vmap(lambda u: view(world, number, Drawn(((u[0], u[1]), (0.5, 0.5)))))(corners)


def _near(world: World, view: Picture, numbers: Any) -> Any:
    """Whether rays through the corners of pixels may meet a lamp."""

    def one(number: Any) -> Any:
        paths = _through_corners(world, view, number)
        return jax.vmap(lambda o, d: emitter.may_meet(world, o, d))(paths.o, paths.d).any()

    return jax.vmap(one)(numbers)


def _differ(world: World, view: Picture, numbers: Any) -> Any:
    """Whether rays through the corners of pixels see different emission."""

    def emission(o: Any, d: Any) -> Any:
        x = surface_point(world, world.settle(world.search.closest(o, d)), o, d)
        return radiance_of(world, x, -d).array()

    def one(number: Any) -> Any:
        paths = _through_corners(world, view, number)
        seen = jax.vmap(emission)(paths.o, paths.d)
        return (seen != seen[:1]).any()

    return jax.vmap(one)(numbers)
