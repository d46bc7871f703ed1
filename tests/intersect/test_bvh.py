"""The tree in pure JAX: the same face as the dense search, on soups, slivers, edges, and under every transformation."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import edges_of, icosphere, sphere_directions

from jaxrt.intersect import affine
from jaxrt.intersect.bvh import LEAF, Bvh, order
from jaxrt.intersect.dense import Dense
from jaxrt.intersect.faces import Faces
from jaxrt.vector import Vec3

RAYS = 4096
SPARE = 7  # rows of padding in each block that is used


def faces_of(corners):
    """(origin, e₁, e₂) of triangles (n, 3, 3)."""
    return np.concatenate([corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], 1)


@functools.partial(jax.jit, static_argnums=(0, 2, 3))
def build(backend, geometry, counts, blocks, order=None):
    """A search about the corner of the first face. Pure."""
    center = geometry[:1, :3].sum(0)
    epsilon = 8 * 2.0**-23 * jnp.abs(geometry[:, :3]).max(initial=1.0)
    geometry = jnp.concatenate([geometry[:, :3] - center[None], geometry[:, 3:]], -1)
    maps = affine(geometry[:, :3], geometry[:, 3:6], geometry[:, 6:9])
    more = () if backend is Dense else (order,)
    return backend.build(Faces(geometry, maps, jnp.array(counts), center, epsilon, blocks), *more)


def table(*kinds):
    """Geometry in padded blocks, with its counts and blocks."""
    kinds = [np.asarray(k, np.float64).reshape(-1, 9) for k in (*kinds, *[np.zeros((0, 9))] * (5 - len(kinds)))]
    blocks = tuple(len(k) + SPARE if len(k) else 0 for k in kinds)
    rows = [np.concatenate([k, np.zeros((b - len(k), 9))]) for k, b in zip(kinds, blocks, strict=True)]
    return np.concatenate(rows), tuple(len(k) for k in kinds), blocks


def both(*kinds, dtype=np.float32):
    geometry, counts, blocks = table(*kinds)
    tree = jnp.asarray(order(geometry[: blocks[0]], counts[0]))
    g = jnp.asarray(geometry.astype(dtype))
    return build(Bvh, g, counts, blocks, tree), build(Dense, g, counts, blocks)


@jax.jit
def closest(search, o, d, *exclude):
    f = lambda o, d, *e: search.closest(Vec3(*o), Vec3(*d), e)
    return jax.vmap(f)(o, d, *exclude)


@jax.jit
def occluded(search, o, d, distance, *exclude):
    f = lambda o, d, t, *e: search.occluded(Vec3(*o), Vec3(*d), t, e)
    return jax.vmap(f)(o, d, distance, *exclude)


def rays(n, seed=0, size=1.5, dtype=np.float32):
    o = np.random.default_rng(seed).uniform(-size, size, (n, 3))
    return o.astype(dtype), sphere_directions(n, seed + 1).astype(dtype)


@functools.cache
def soup(n=1500, seed=1, size=0.15):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (n, 1, 3)) + rng.normal(0, size, (n, 3, 3))


def agree(bvh, dense, o, d, *exclude, ties=0):
    """Both searches find the same faces, but for so many ties."""
    a, b = np.asarray(closest(bvh, o, d, *exclude)), np.asarray(closest(dense, o, d, *exclude))
    assert (a != b).sum() <= ties
    return b


# ---------------------------------------------------------------------------------------------- order


@pytest.mark.parametrize("n", [0, 1, LEAF, LEAF + 1, 100, 513, 3000])
def test_each_face_has_one_place(n):
    t = order(faces_of(soup(3000)[:n]), n)
    assert t.dtype == np.int32
    np.testing.assert_array_equal(np.sort(t[t >= 0]), np.arange(n))
    assert t.size <= max(2 * n, 4) and (len(t) & len(t) - 1) == 0
    padded = order(np.concatenate([faces_of(soup(3000)[:n]), np.zeros((5, 9))]), n)
    np.testing.assert_array_equal(np.sort(padded[padded >= 0]), np.arange(n))


def test_faces_at_one_place_are_ordered_too():
    t = order(np.zeros((1000, 9)), 1000)
    np.testing.assert_array_equal(np.sort(t[t >= 0]), np.arange(1000))


# ------------------------------------------------------------------------------------- equal to dense


@pytest.mark.parametrize("n", [1, 40, 1500])
def test_soup(n):
    found = agree(*both(faces_of(soup(n))), *rays(RAYS))
    assert (found >= 0).any() and (found < 0).any()


def test_rays_along_the_axes():
    o, d = rays(RAYS)
    d = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), RAYS // 6 + 1, 0)[:RAYS].astype(np.float32)
    d[::2] *= np.where(d[::2] == 0, -1, 1)  # −0 too
    agree(*both(faces_of(soup())), o, d)


def test_slivers():
    rng = np.random.default_rng(3)
    p = rng.uniform(-1, 1, (1500, 3))
    a = rng.normal(0, 0.5, (1500, 3))
    b = a * rng.uniform(0, 1, (1500, 1)) + rng.normal(0, 10 ** rng.uniform(-7, -2, (1500, 1)), (1500, 3))
    b[:5] = 0  # without area
    bvh, dense = both(np.concatenate([p, a, b], 1))
    o, d = rays(RAYS)
    # Half of the rays go at points of the slivers.
    k = rng.integers(0, 1500, RAYS // 2)
    u, v = rng.dirichlet([1, 1, 1], RAYS // 2)[:, :2].T
    at = p[k] + u[:, None] * a[k] + v[:, None] * b[k] - o[: RAYS // 2]
    d[: RAYS // 2] = at / np.linalg.norm(at, axis=1)[:, None]
    assert (agree(bvh, dense, o, d, ties=2) >= 0).mean() > 0.1


def test_rays_in_the_plane_of_faces():
    """A floor of many triangles, rays within it and along its edges; a wall beyond is met either way."""
    n = 12
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    corner = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    e = np.eye(3)
    floor = [np.concatenate([corner, corner * 0 + e[0], corner * 0 + e[1]], 1)]
    floor += [np.concatenate([corner + e[0] + e[1], corner * 0 - e[0], corner * 0 - e[1]], 1)]
    wall = np.concatenate([[n + 1, -99, -99], [0, 300, 0], [0, 0, 300]])[None]
    bvh, dense = both(np.concatenate([*floor, wall]))
    rng = np.random.default_rng(4)
    o = np.stack([rng.integers(0, n, RAYS), rng.integers(0, n, RAYS), np.zeros(RAYS)], 1).astype(np.float32)
    o[::2, :2] += rng.uniform(0, 1, (RAYS // 2, 2))
    angle = rng.uniform(-1, 1, RAYS) * np.where(np.arange(RAYS) % 3, 1, 0)
    d = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1).astype(np.float32)
    agree(bvh, dense, o, d)


def test_closed_mesh_has_no_gaps():
    """Rays at points of edges and at vertices of an icosphere, from inside."""
    v, f = icosphere(4)
    bvh, dense = both(faces_of(v[f]))
    rng = np.random.default_rng(5)
    n = 100_000
    edges = edges_of(f)
    i, j = edges[rng.integers(0, len(edges), n)].T
    s = rng.uniform(0, 1, (n, 1))
    s[: n // 4] = 0
    o = rng.uniform(-0.5, 0.5, (n, 3)).astype(np.float32)
    d = v[i] * (1 - s) + v[j] * s - o
    d = (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)
    assert (np.asarray(closest(bvh, o, d)) >= 0).all()
    assert np.asarray(occluded(bvh, o, d, np.full(n, 3, np.float32))).all()
    # Neighbours tie at an edge; both are the same distance away, but for rounding.
    few = slice(0, 2000)
    a, b = (np.asarray(closest(s, o[few], d[few])) for s in (bvh, dense))
    shared = (f[a][:, :, None] == f[b][:, None, :]).any((1, 2))
    assert shared.all()


def test_from_surface_points_and_far_away():
    """Origins on faces, where the distance is about 0; and origins far from the scene."""
    corners = soup()
    bvh, dense = both(faces_of(corners))
    o, d = rays(RAYS)
    k = np.arange(RAYS) % len(corners)
    o = corners[k].mean(1).astype(np.float32)
    agree(bvh, dense, o, d, ties=1)
    agree(bvh, dense, o, d, k.astype(np.int32))
    agree(bvh, dense, o - 300 * d, d, ties=1)


def test_mixed_kinds():
    rng = np.random.default_rng(6)
    frames = lambda n, s: np.concatenate(
        [rng.uniform(-1, 1, (n, 3)), s * np.linalg.qr(rng.normal(size=(n, 3, 3)))[0][:, :2].reshape(n, 6)], 1
    )
    bvh, dense = both(faces_of(soup(300)), frames(9, 0.4), frames(8, 0.3), frames(7, 0.2), frames(6, 0.2))
    o, d = rays(RAYS)
    found = agree(bvh, dense, o, d)
    starts = np.cumsum([0, *bvh.rest.blocks])
    kinds = np.searchsorted(starts, found[found >= 0], side="right") - 1
    assert set(kinds) == set(range(5))
    np.testing.assert_array_equal(occluded(bvh, o, d, np.full(RAYS, np.inf, np.float32)), found >= 0)


def test_no_triangles():
    bvh, dense = both([], [[-1, -1, 0, 2, 0, 0, 0, 2, 0]])
    found = agree(bvh, dense, *rays(256))
    assert (found >= 0).any()
    bvh, _ = both([])
    assert (np.asarray(closest(bvh, *rays(256))) == -1).all()


# ------------------------------------------------------------------------------ exclude and occluded


def test_excluded_faces_are_passed():
    bvh, dense = both(faces_of(soup()))
    o, d = rays(RAYS)
    first = agree(bvh, dense, o, d)
    second = agree(bvh, dense, o, d, first)
    third = agree(bvh, dense, o, d, first, second)
    hit = third >= 0
    assert hit.any()
    assert (second[hit] != first[hit]).all() and (third[hit] != second[hit]).all() and (third[hit] != first[hit]).all()
    one = bvh.closest(Vec3(*o[0]), Vec3(*d[0]), int(first[0]))
    assert int(one) == second[0]


def test_occluded_is_a_face_before_the_distance():
    bvh, dense = both(faces_of(soup()))
    o, d = rays(RAYS)
    far = np.random.default_rng(8).uniform(0, 2, RAYS).astype(np.float32)
    seen = np.asarray(occluded(bvh, o, d, far))
    np.testing.assert_array_equal(seen, occluded(dense, o, d, far))
    first = np.asarray(closest(bvh, o, d))
    np.testing.assert_array_equal(occluded(bvh, o, d, np.full(RAYS, np.inf, np.float32)), first >= 0)
    np.testing.assert_array_equal(occluded(bvh, o, d, far, first), occluded(dense, o, d, far, first))


# ---------------------------------------------------------------------------------- transformations


def test_moved_vertices_keep_the_order():
    """One order serves all positions, under jit: bounds are made anew."""
    geometry, counts, blocks = table(faces_of(soup()))
    tree = order(geometry[: blocks[0]], counts[0])
    o, d = rays(RAYS)

    @functools.partial(jax.jit, static_argnums=0)
    def find(backend, g):
        return closest(build(backend, g, counts, blocks, jnp.asarray(tree)), o, d)

    for k in range(3):
        stretch = np.random.default_rng(k).normal(size=(3, 3))
        g = jnp.asarray((geometry.reshape(-1, 3, 3) @ stretch).reshape(-1, 9), jnp.float32)
        np.testing.assert_array_equal(find(Bvh, g), find(Dense, g))


def test_vmap_over_geometries_and_over_rays_twice():
    geometry, counts, blocks = table(faces_of(soup(200)))
    tree = jnp.asarray(order(geometry[: blocks[0]], counts[0]))
    o, d = rays(256)
    shift = jnp.linspace(-0.2, 0.2, 3)

    def find(s, o, d):
        g = jnp.asarray(geometry, jnp.float32).at[:, 0].add(s)
        return build(Bvh, g, counts, blocks, tree).closest(Vec3(*o), Vec3(*d))

    over_rays = jax.vmap(find, (None, 0, 0))
    a = jax.jit(jax.vmap(over_rays, (0, None, None)))(shift, o, d)
    b = jnp.stack([jax.jit(over_rays)(s, o, d) for s in shift])
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(find, (0, None, None)), (None, 0, 0)))(shift, o, d), b.T)
    square = jax.vmap(over_rays, (None, 0, 0))(shift[1], o.reshape(16, 16, 3), d.reshape(16, 16, 3))
    np.testing.assert_array_equal(square.ravel(), b[1])


def test_derivatives_pass_by_the_search():
    """The distance to the face that was found has a derivative by the vertices, the search none."""
    geometry, counts, blocks = table(faces_of(soup(300)))
    tree = jnp.asarray(order(geometry[: blocks[0]], counts[0]))
    o, d = rays(64)

    def total(shift, o, d):
        g = jnp.asarray(geometry, jnp.float32).at[:, :3].add(shift[None])
        bvh = build(Bvh, g, counts, blocks, tree)

        def distance(o, d):
            found = bvh.closest(Vec3(*o), Vec3(*d))
            face = jnp.maximum(found, 0)
            n = jnp.cross(g[face, 3:6], g[face, 6:9])
            return jnp.where(found >= 0, n @ (g[face, :3] - o) / (n @ d), 0.0)

        return jax.vmap(distance)(o, d)

    shift = jnp.zeros(3)
    t = jax.jit(total)(shift, o, d)
    assert (t > 0).any()
    back = jax.jit(jax.grad(lambda s: (total(s, o, d) ** 2).sum()))(shift)
    _, along = jax.jit(lambda s: jax.jvp(lambda s: total(s, o, d), (s,), (jnp.ones(3),)))(shift)
    np.testing.assert_allclose(back.sum(), (2 * t * along).sum(), rtol=1e-4)
    # Moving the origin against the scene is the same as moving the scene.
    by_o = jax.jit(jax.grad(lambda x: (total(shift, o + x[None], d) ** 2).sum()))(shift)
    np.testing.assert_allclose(by_o, -back, rtol=1e-3, atol=1e-4)


def test_scene_that_a_program_closes_over():
    bvh, _ = both(faces_of(soup()))
    o, d = rays(RAYS)
    f = jax.vmap(lambda o, d: bvh.closest(Vec3(*o), Vec3(*d)))
    np.testing.assert_array_equal(jax.jit(f)(o, d), closest(bvh, o, d))
    np.testing.assert_array_equal(jax.jit(lambda: f(o, d))(), closest(bvh, o, d))


def test_within_a_loop():
    """A path of rays, each from where the last one ended, in a `while_loop`, by a batch and ray by ray."""
    bvh, dense = both(faces_of(icosphere(2)[0][icosphere(2)[1]]))
    o, d = rays(256, size=0.4)

    def path(search, o, d):
        def step(s):
            k, o, d, face = s
            face = search.closest(o, d, face)
            return k + 1, o + d * 0.1, Vec3(d.y, d.z, d.x), face

        stop = jnp.where(o.x > 0, 3, 6)
        return jax.lax.while_loop(lambda s: s[0] < stop, step, (0, o, d, jnp.int32(-2)))[3]

    run = jax.jit(jax.vmap(lambda s, o, d: path(s, Vec3(*o), Vec3(*d)), (None, 0, 0)))
    a, b = np.asarray(run(bvh, o, d)), np.asarray(run(dense, o, d))
    np.testing.assert_array_equal(a, b)
    assert int(jax.jit(path)(bvh, Vec3(*o[3]), Vec3(*d[3]))) == a[3]


def test_float64():
    with jax.enable_x64(True):
        bvh, dense = both(faces_of(soup()), dtype=np.float64)
        o, d = rays(RAYS, dtype=np.float64)
        found = agree(bvh, dense, o, d)
        agree(bvh, dense, o, d, found)
        assert bvh.tree.boxes.dtype == np.float64
        far = np.full(RAYS, 0.3)
        np.testing.assert_array_equal(occluded(bvh, o, d, far), occluded(dense, o, d, far))
