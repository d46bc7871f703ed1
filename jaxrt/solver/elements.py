"""Elements: a partition of the diffuse sides of M, made on the host and passed to programs as an argument.

Each side of a face has a grid of cells, each cell belongs to an element; so one gather of the grid's row and one
of the cell lead from a point to its element, whatever was subdivided or clustered.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32

from ..chart import coordinates, place
from ..surface import SurfacePoint, _row
from ..vector import Vec3, dot, safe_sqrt
from ..world import World

BLACK = 0
"""The element of all sides that reflect nothing; the first real one is 1."""


class Elements(eqx.Module):
    """A partition. Sides are numbered face + faces · (1 for the back); a last row stands for all that has no elements.

    `grid`, for each side: first cell, cells along both coordinates, and the corner from which those count. `cells`: the
    element of each cell. An element consists of pieces `first[e]` to `first[e + 1]` − 1; a piece is a rectangle in
    the coordinates of a face: rows of `rectangle` are where it starts, its extents, whether only its lower triangle
    counts, the side (±1) and the corner. `span`: cells of the grid along each side of an element, 0 where it has
    another shape. `ends`: cumulative areas of pieces, m². `size`: the longer extent of each
    element (m), infinite where another surface stands on it, 0 for padding and black. `everywhere`: whether so much
    of M emits that light is rather met than sampled.
    """

    grid: Int32[Array, "sides 4"]
    cells: Int32[Array, " N"]
    first: Int32[Array, " E1"]
    face: Int32[Array, " P"]
    rectangle: Float[Array, "P 7"]
    ends: Float[Array, " P"]
    span: Int32[Array, " E"]
    size: Float[Array, " E"]
    area: Float[Array, " E"]
    clustered: bool = eqx.field(static=True)
    everywhere: bool = eqx.field(static=True, default=False)

    @property
    def count(self) -> int:
        return self.size.shape[0]


def element_of(world: World, elements: Elements, x: SurfacePoint, w: Vec3) -> Any:
    """The element in which x lies, seen along ω; −1 where there is none: mirrors, gloss, instances, the enclosure."""
    (first, nu, nv), at = _in_grid(world, elements, x, w)
    i, j = (jnp.clip(jnp.floor(c).astype(jnp.int32), 0, n - 1) for c, n in zip(at, (nu, nv), strict=True))
    return jnp.where(nu > 0, _row(elements.cells, first + i * nv + j), -1)


def _in_grid(world: World, elements: Elements, x: SurfacePoint, w: Vec3) -> tuple[tuple[Any, ...], tuple[Any, Any]]:
    """The grid of the side on which x is seen (first cell, cells along both coordinates), and where x lies in it."""
    faces = sum(world.blocks)
    known = (x.face >= 0) & (x.face < faces)
    side = jnp.where(known, x.face + jnp.where(dot(x.normal, w) < 0, faces, 0), 2 * faces)
    row = _row(elements.grid, side)
    a, b = (graded(c) for c in cornered(*coordinates(world, x), row[3]))
    return (row[0], row[1], row[2]), (a * row[1], b * row[2])


def around(world: World, elements: Elements, x: SurfacePoint, w: Vec3, own: Any) -> tuple[tuple[Any, Any], ...]:
    """The four elements whose middles lie around x, which lies in `own`, with bilinear weights; those that cannot be
    looked at have none."""
    (first, nu, nv), at = _in_grid(world, elements, x, w)
    span = jnp.maximum(_row(elements.span, jnp.maximum(own, 0)), 1)

    def two(c: Any, n: Any) -> tuple[tuple[Any, Any], ...]:
        c = c / span - 0.5
        low = jnp.floor(c)
        cell = lambda k: jnp.clip(jnp.clip(k.astype(jnp.int32), 0, n // span - 1) * span + span // 2, 0, n - 1)
        return (cell(low), 1.0 - (c - low)), (cell(low + 1.0), c - low)

    found = []
    for i, f in two(at[0], nu):
        for j, g in two(at[1], nv):
            element = _row(elements.cells, first + i * nv + j)
            size = _row(elements.size, element)
            found.append((element, f * g * jnp.where((size > 0) & (size < jnp.inf), 1.0, 0.0)))
    total = sum(weight for _, weight in found)
    return tuple((element, weight / jnp.where(total > 0, total, 1.0)) for element, weight in found)


def graded(s: Any) -> Any:
    """[0, 1] to itself, steep at both ends: cells are small at the borders of a face, where light changes fast."""
    t = safe_sqrt(0.5 * jnp.minimum(s, 1.0 - s))
    return jnp.where(s < 0.5, t, 1.0 - t)


def cornered(a: Any, b: Any, corner: Any) -> tuple[Any, Any]:
    """Coordinates of a triangle as they count from another of its corners, 0, 1 or 2."""
    c = 1.0 - a - b
    return jnp.select([corner == 1, corner == 2], [b, c], a), jnp.select([corner == 1, corner == 2], [c, a], b)


def in_piece(world: World, face: Any, row: Any, a: Any, b: Any) -> tuple[Vec3, Vec3]:
    """Position and normal, on its side, at coordinates in [0, 1]² of a piece: a row of `Elements.rectangle`."""
    back = (3.0 - row[6]) % 3.0  # the corner from which the face itself counts
    y, n = place(world, face, *cornered(row[0] + a * row[2], row[1] + b * row[3], back))
    return y, n * row[5]


def sampled(world: World, elements: Elements, e: Any, u: tuple[Any, Any], choice: Any) -> tuple[Any, Vec3, Vec3]:
    """A point of element e with even density: its face, position, and normal on the element's side."""
    piece = _row(elements.first, e)
    if elements.clustered:
        last = _row(elements.first, e + 1) - 1
        low = jnp.where(piece > 0, _row(elements.ends, jnp.maximum(piece - 1, 0)), 0.0)
        at = low + choice * (_row(elements.ends, last) - low)
        piece = jnp.clip(jnp.searchsorted(elements.ends, at, side="right", method="scan"), piece, last)
    row, face = _row(elements.rectangle, piece), _row(elements.face, piece)
    fold = (row[4] > 0) & (u[0] + u[1] > 1.0)
    a, b = (jnp.where(fold, 1.0 - c, c) for c in u)
    return face, *in_piece(world, face, row, a, b)


def corners_of_pieces(world: World, elements: Elements) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of each piece, (P, 4, 3), in the order of its coordinates; its element; whether it is cut in half."""
    first = np.asarray(elements.first)
    real = int(first[1:].max())
    element = np.searchsorted(first, np.arange(1, real), side="right") - 1
    rows, faces = jnp.asarray(elements.rectangle)[1:real], jnp.asarray(elements.face)[1:real]
    corner = lambda a, b: np.asarray(jax.vmap(lambda r, f: in_piece(world, f, r, a, b)[0].array())(rows, faces))
    corners = np.stack([corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0)], 1)
    return corners, element, np.asarray(elements.rectangle)[1:real, 4] > 0
