"""The bounding volume hierarchy in pure JAX: triangles in a tree, the few other faces by the dense tests.

Rays go one after the other, and the vector is a node's 16 children or a leaf's triangles: a loop within a loop, as
one function without queued kernels, so that each ray branches as it needs. `custom_vmap` turns any batch into that
loop. The order of the triangles is made once on the host; bounds and tables follow from positions, purely.

ns a ray on one core, incoherent rays in icospheres of 320 / 5k / 82k / 1.3M triangles: closest 460 / 510 / 780 / 2100
(dense at 320: 210), occluded 350 / 310 / 400 / 570. Tried at 82k: the same search over lanes by `vmap`, 4500 to 8500
(256 to 8192 lanes); nodes of 4, 8 and 32 with leaves of 4, 8 and 16: 1.5, 1.2 and 1.2 times; leaves of 12: 1.3 times,
of 40: equal; kernels left in a queue: 16 times. Cuts by cost, with room left on either side, made worse trees than
halves by area where the scene is uneven.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import bitcast_convert_type, dynamic_slice, dynamic_update_slice
from jaxtyping import Array, Float, Int32

from ..compiler import one_function
from ..vector import Vec3
from .batch import in_a_row
from .dense import Dense, allowed, flat_columns, flat_crossing, several
from .faces import Faces

WIDTH = 16  # children of a node: one vector of 512 bits
LEAF = 32  # most triangles of a leaf, or twice as many where that saves a level
MISS = np.int32(0x7F800000)  # a key after those of all distances: the bits of ∞ in float32


def shape_of_order(triangles: int) -> tuple[int, int]:
    """Leaves, and places in each, for so many triangles."""
    leaves = 1 << max(-(-triangles // LEAF) - 1, 0).bit_length()
    if leaves > 2 and leaves.bit_length() % 4 == 2:  # 2 · 16ᵏ leaves need a level for a root of two children
        leaves //= 2
    return leaves, max(-(-triangles // (4 * leaves)), 1) * 4


def _order(geometry: Any, count: Any) -> Any:
    return order(np.asarray(geometry), int(count))


def order(geometry: Any, count: int) -> Any:
    """Numbers of the first `count` triangles (origin, e₁, e₂) by leaf, −1 in free places. Once, on the host.

    From the top down, a set is halved across the axis on which the areas of its halves' bounds are least. So the
    tree is complete: its topology is this table, and the table's shape follows from the padded number of rows.
    """
    leaves, places = shape_of_order(len(geometry))
    o, a, b = np.asarray(geometry[:count], np.float32).T.reshape(3, 3, -1)
    none = np.full((3, 1), np.inf, np.float32)  # the bounds of a free place, which sorts last
    low = np.concatenate([o + np.minimum(0, np.minimum(a, b)), none], 1)
    high = np.concatenate([o + np.maximum(0, np.maximum(a, b)), -none], 1)
    middle = np.concatenate([low[:, :-1] + high[:, :-1], none], 1)
    bounds = list(zip(low, high, strict=True))
    full = -(-count // leaves)  # triangles of each leaf but the last
    faces = np.minimum(np.arange(leaves * full), count)[None]
    while len(faces) < leaves and count:
        halves, areas = [], []
        for axis in range(3):
            keys = np.argpartition(middle[axis].take(faces), faces.shape[1] // 2 - 1, 1)
            half = np.take_along_axis(faces, keys, 1).reshape(len(faces), 2, -1)
            x, y, z = (np.maximum(q.take(half).max(2) - p.take(half).min(2), 0) for p, q in bounds)
            halves.append(half)
            areas.append((x * y + y * z + z * x).sum(1))
        faces = np.choose(np.argmin(areas, 0)[:, None, None], halves).reshape(2 * len(faces), -1)
    table = np.full((leaves, places), -1, np.int32)
    table[:, :full] = np.where(faces < count, faces, -1)
    return table


class Tree(eqx.Module):
    """Levels from the root on; node k of a level has the children 16 k to 16 k + 15 of the next."""

    boxes: Float[Array, "nodes 2 3 16"]  # low and high corners of the children; ∞ and −∞ where there is none
    rows: Float[Array, "leaves 13 places"]  # the triangles' columns, as of the dense tables
    faces: Int32[Array, "leaves places"]
    least: Float[Array, ""]

    @property
    def starts(self) -> list[int]:
        """First row of each level in `boxes`."""
        sizes = [-(-len(self.rows) // WIDTH)]
        while sizes[0] > 1:
            sizes.insert(0, -(-sizes[0] // WIDTH))
        return [sum(sizes[:k]) for k in range(len(sizes))]


class Bvh(eqx.Module):
    tree: Tree
    rest: Dense  # all faces but the triangles

    @classmethod
    def build(cls, faces: Faces, order: Any = None) -> Bvh:
        """Bounds and tables of faces, the triangles arranged by their `order`. Pure; instances are not among them.

        Without an `order` one is made in a callback; with that of a scene before its vertices moved, this is a refit.
        """
        epsilon, blocks, counts = faces.epsilon, faces.blocks, faces.counts
        geometry, maps = (table[: blocks[0]] for table in (faces.geometry, faces.maps))
        if order is None:
            triangles = jax.lax.stop_gradient(geometry)
            shape = jax.ShapeDtypeStruct(shape_of_order(blocks[0]), jnp.int32)
            order = jax.pure_callback(_order, shape, triangles, counts[0], vmap_method="sequential")
        dense = Dense.build(faces, first_kind=1)
        numbers = jnp.where(order < counts[0], order, -1)
        pad = lambda table: jnp.concatenate([table, jnp.zeros_like(table[:1], shape=(1, table.shape[1]))])
        rows, edges = pad(flat_columns(maps, epsilon))[numbers], pad(geometry)[numbers]
        # Where an inside test may reach out to, and the rounding of all that is computed from the box.
        o, a, b = edges[..., :3], edges[..., 3:6], edges[..., 6:9]
        out = jnp.minimum(2 * rows[..., 12:], 100.0)
        corners = jnp.stack([o - (a + b) * out, o + a + (2 * a - b) * out, o + b + (2 * b - a) * out])
        low, high = corners.min(0) - epsilon, corners.max(0) + epsilon
        empty = ~((numbers >= 0)[..., None] & (low <= high))
        low, high = jnp.where(empty, jnp.inf, low).min(1), jnp.where(empty, -jnp.inf, high).max(1)
        levels = []
        while not levels or len(low) > 1:
            more = -len(low) % WIDTH
            low = jnp.concatenate([low, jnp.full_like(low, jnp.inf, shape=(more, 3))]).reshape(-1, WIDTH, 3)
            high = jnp.concatenate([high, jnp.full_like(high, -jnp.inf, shape=(more, 3))]).reshape(-1, WIDTH, 3)
            levels.insert(0, jnp.stack([low, high], 1).swapaxes(2, 3))
            low, high = low.min(1), high.max(1)
        tree = Tree(jnp.concatenate(levels), rows.swapaxes(1, 2), numbers, dense.least)
        return cls(tree, dense)

    def closest(self, o: Vec3, d: Vec3, exclude: Any = None) -> Any:
        """Number of the first face along the ray, −1 if none. `exclude`: faces to skip, one or several numbers."""
        best = self.rest.nearest(o, d, exclude)
        face = self._search(False, o, d, jnp.real(best), exclude)
        return jnp.where(face >= 0, face, jnp.imag(best).astype(jnp.int32))

    def occluded(self, o: Vec3, d: Vec3, distance: Any, exclude: Any = None) -> Any:
        """Whether any face but the excluded ones lies before `distance` (m)."""
        return self.rest.occluded(o, d, distance, exclude) | (self._search(True, o, d, distance, exclude) >= 0)

    def _search(self, first: bool, o: Vec3, d: Vec3, bound: Any, exclude: Any) -> Any:
        row = lambda c, dtype: jnp.asarray(c, dtype).reshape(1)
        ray = tuple(row(c, self.tree.boxes.dtype) for c in (*(o - Vec3(*self.rest.center)), *d, bound))
        rays = ray, tuple(row(e, jnp.int32) for e in several(exclude))
        return _rays(first)(*jax.lax.stop_gradient((self.tree, rays)))[0]


@functools.cache
def _rays(first: bool) -> Any:
    """`_ray` over n rays, one after the other."""

    def each(tree: Tree, rays: Any) -> Any:
        n = len(rays[0][0])

        def step(i: Any, found: Any) -> Any:
            face = _ray(tree, first, *jax.tree.map(lambda c: c[i], rays))
            return dynamic_update_slice(found, face[None], (i,))

        return jax.lax.fori_loop(0, n, step, jnp.full(n, -1, jnp.int32))

    return in_a_row(one_function(each))


def _least(x: Any) -> Any:
    """The least of floating-point numbers, as integers: minima that heed NaN are reduced slowly."""
    bits = bitcast_convert_type(x, jnp.int32 if x.dtype == jnp.float32 else jnp.int64)
    fold = lambda k: k ^ (k >> (8 * x.itemsize - 1) & jnp.iinfo(k.dtype).max)
    return bitcast_convert_type(fold(jnp.min(fold(bits))), x.dtype)


def _ray(tree: Tree, first: bool, ray: Any, exclude: Any) -> Any:
    """The triangle nearest along one ray before a bound, or with `first` any; −1 if none.

    A stack holds a row of keys for each level: distances to a node's children, as bits of float32 that end in
    the child's number. The least key is taken until all lie behind the best triangle. Level 0 holds the root.
    """
    *ray, bound = ray
    starts = tree.starts
    depth = len(starts)
    sizes = [b - a for a, b in zip(starts, [*starts[1:], len(tree.boxes)], strict=True)]
    i32 = lambda *k: [np.int32(i) for i in k]
    tiny = 1e-20
    d = jnp.stack(ray[3:])
    inverse = 1.0 / jnp.where(jnp.abs(d) < tiny, jnp.where(d < 0, -tiny, tiny), d)
    ray = jnp.concatenate([jnp.stack(ray), inverse, tree.least[None]])

    unused = jnp.full(WIDTH, MISS)

    def leave(state: Any) -> Any:
        level, node, best, face = state
        return level - 1, node // WIDTH, best, face, unused

    def test(state: Any) -> Any:
        level, node, best, face = state
        r = dynamic_slice(tree.rows, (node, *i32(0, 0)), (1, *tree.rows.shape[1:]))[0]
        faces = dynamic_slice(tree.faces, (node, *i32(0)), (1, tree.faces.shape[1]))[0]
        inside, t = flat_crossing("triangle", r, Vec3(*ray[:3]), Vec3(*ray[3:6]))
        inside = inside & (t > ray[9]) & (t < best) & allowed(faces, exclude)
        t = jnp.where(inside, t, jnp.inf)
        nearest = _least(t)
        hit = nearest < best
        face = jnp.where(hit, jnp.min(jnp.where(inside & (t == nearest), faces, np.iinfo(np.int32).max)), face)
        return jnp.where(hit & first, -1, level), node // WIDTH, jnp.where(hit, nearest, best), face, unused

    def enter(state: Any) -> Any:
        level, node, best, face = state
        row = node + sum(jnp.where(level > k, np.int32(size), 0) for k, size in enumerate(sizes[:-1]))
        box = lambda side, axis: dynamic_slice(tree.boxes, (row, side, *i32(axis, 0)), (1, 1, 1, WIDTH)).reshape(WIDTH)
        near, far = ray[9], jnp.inf
        for axis in range(3):
            start, k = ray[axis], ray[6 + axis]
            sign = (k < 0).astype(jnp.int32)
            near = jnp.maximum(near, (box(sign, axis) - start) * k)
            far = jnp.minimum(far, (box(1 - sign, axis) - start) * k)
        key = ((near - ray[9]) * (1 - 2.0**-20)).astype(jnp.float32)
        key = bitcast_convert_type(key, jnp.int32) & -WIDTH | jnp.arange(WIDTH, dtype=jnp.int32)
        return level + 1, node, best, face, jnp.where(near <= far * (1 + 2.0**-20), key, MISS)

    def step(state: Any) -> Any:
        level, node, best, face, stack = state
        key = jnp.min(dynamic_slice(stack, (level * WIDTH,), (WIDTH,)))
        child = key & (WIDTH - 1)
        near = bitcast_convert_type(key & -WIDTH, jnp.float32) + ray[9]
        case = jnp.where(near < best, jnp.where(level == depth, 1, 2), 0)
        node = jnp.where(case == 0, node, node * WIDTH + child)
        stack = dynamic_update_slice(stack, jnp.full(1, MISS), (level * WIDTH + child,))
        level, node, best, face, row = jax.lax.switch(case, [leave, test, enter], (level, node, best, face))
        stack = dynamic_update_slice(stack, row, (jnp.where(case == 2, level, depth + 1) * WIDTH,))
        return level, node, best, face, stack

    stack = jnp.full((depth + 2) * WIDTH, MISS).at[0].set(0)
    state = jnp.int32(0), jnp.int32(0), bound, jnp.int32(-1), stack
    return jax.lax.while_loop(lambda s: s[0] >= 0, step, state)[3]
