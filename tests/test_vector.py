"""Vec3, Spectrum and Frame: orthonormal for every normal, and finite derivatives where a formula has none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jaxrt import vector as v
from jaxrt.vector import Frame, Spectrum, Vec3

EPS = np.finfo(np.float32).eps
COMPONENT = st.floats(-1.0, 1.0, width=32)
ROWS = 32  # normals a program call: one compiled shape for every example

_around = jax.jit(jax.vmap(lambda n: _axes(Frame.around(Vec3.of(n)))))
_along = jax.jit(jax.vmap(lambda n, t: _axes(Frame.along(Vec3.of(n), Vec3.of(t)))))
_there_and_back = jax.jit(
    jax.vmap(lambda n, w: Frame.around(Vec3.of(n)).to_world(Frame.around(Vec3.of(n)).to_local(Vec3.of(w))).array())
)
_normalise = jax.jit(jax.vmap(lambda a: v.normalise(Vec3.of(a)).array()))


def _axes(f: Frame):
    return jnp.stack([f.s.array(), f.t.array(), f.n.array()])


def units(rows):
    a = np.asarray(rows, np.float64)
    return (a / np.linalg.norm(a, axis=-1, keepdims=True)).astype(np.float32)


def near_the_pole(z):
    """Unit normals with exactly this z, all around."""
    phi = np.linspace(0, 2 * np.pi, ROWS)
    r = np.sqrt((1 - np.float64(z)) * (1 + np.float64(z)))
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.full(ROWS, z)], -1).astype(np.float32)


def assert_orthonormal(axes, tolerance):
    axes = np.asarray(axes, np.float64)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=tolerance)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=tolerance)  # right-handed


@pytest.mark.parametrize("z", [1.0, -1.0, -1 + 1e-7, 1 - 1e-7, -1 + 1e-4, 1e-8, -1e-8, 0.0, -0.0])
def test_frame_is_orthonormal_at_the_poles_and_the_equator(z):
    axes = _around(near_the_pole(z))
    np.testing.assert_array_equal(axes[:, 2], near_the_pole(z))
    assert_orthonormal(axes, 1e-6)  # oracles, hard case 4


@given(st.lists(st.tuples(COMPONENT, COMPONENT, COMPONENT), min_size=ROWS, max_size=ROWS))
@settings(max_examples=50)
def test_frame_is_orthonormal_for_any_normal(rows):
    rows = [r if np.hypot(np.hypot(*r[:2]), r[2]) > 1e-3 else (0.0, 0.6, -0.8) for r in rows]
    # A normal rounded to float32 is off unit length by EPS, and every product of axes by a few of it.
    assert_orthonormal(_around(units(rows)), 8 * EPS)


@given(st.lists(st.tuples(*[COMPONENT] * 6), min_size=ROWS, max_size=ROWS))
@settings(max_examples=50)
def test_frame_along_keeps_the_tangent_in_its_first_half_plane(rows):
    rows = np.array(rows, np.float64) + np.array([0, 0, 2.0, 0, 0, 0])  # normals away from 0
    n, tangent = units(rows[:, :3]), rows[:, 3:].astype(np.float32)
    across = np.linalg.norm(np.cross(n.astype(np.float64), tangent), axis=-1)
    tangent[across < 0.1] = np.cross(n[across < 0.1], [1.0, 0.3, 0.0])
    axes = np.asarray(_along(n, tangent), np.float64)
    # The tangent's part along n, rounded, is left in s: EPS over the sine of their angle.
    assert_orthonormal(axes, 40 * EPS)
    np.testing.assert_allclose(np.einsum("ni,ni->n", axes[:, 1], tangent), 0.0, atol=20 * EPS)
    assert (np.einsum("ni,ni->n", axes[:, 0], tangent) > 0).all()


@given(
    st.lists(st.tuples(COMPONENT, COMPONENT, COMPONENT), min_size=ROWS, max_size=ROWS),
    st.lists(st.tuples(COMPONENT, COMPONENT, COMPONENT), min_size=ROWS, max_size=ROWS),
)
@example([(0.0, 0.0, -1.0)] * ROWS, [(0.3, -0.2, 0.9)] * ROWS)
@settings(max_examples=50)
def test_to_world_undoes_to_local(normals, vectors):
    n = units([r if max(map(abs, r)) > 1e-3 else (0.0, 0.6, -0.8) for r in normals])
    w = np.array(vectors, np.float32)
    np.testing.assert_allclose(_there_and_back(n, w), w, atol=16 * EPS)


def test_local_coordinates_are_along_s_t_n():
    f = Frame(Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0))
    assert tuple(f.to_local(Vec3(1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)
    g = Frame(Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0), Vec3(1.0, 0.0, 0.0))
    assert tuple(g.to_local(Vec3(1.0, 2.0, 3.0))) == (2.0, 3.0, 1.0)
    assert tuple(g.to_world(Vec3(2.0, 3.0, 1.0))) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("scale", [1e-15, 1e-6, 1.0, 1e6, 1e15])
def test_normalise_at_any_scale(scale):
    a = np.random.default_rng(0).normal(size=(ROWS, 3))
    np.testing.assert_allclose(_normalise((a * scale).astype(np.float32)), units(a), atol=4 * EPS)


def test_normalise_of_zero_is_up_with_derivative_zero():
    zero = Vec3(0.0, 0.0, 0.0)
    jacobian = jax.jacrev(lambda a: v.normalise(a).array())(zero)
    assert tuple(map(float, v.normalise(zero))) == (0.0, 0.0, 1.0)
    for column in jacobian:
        np.testing.assert_array_equal(column, 0.0)


def test_normalise_has_the_derivative_of_a_projection():
    a = np.array([1.0, -2.0, 2.0], np.float32)
    n = a / 3
    got = jax.jacfwd(lambda q: v.normalise(Vec3.of(q)).array())(jnp.asarray(a))
    np.testing.assert_allclose(got, (np.eye(3) - np.outer(n, n)) / 3, atol=4 * EPS)


@pytest.mark.parametrize("x, value, slope", [(4.0, 2.0, 0.25), (0.0, 0.0, 0.0), (-1e-9, 0.0, 0.0), (-5.0, 0.0, 0.0)])
def test_safe_sqrt(x, value, slope):
    assert float(v.safe_sqrt(x)) == value
    assert float(jax.grad(v.safe_sqrt)(x)) == slope
    assert float(jax.jvp(v.safe_sqrt, (x,), (1.0,))[1]) == slope


def test_length_of_zero_has_a_finite_derivative():
    g = jax.grad(v.length)(Vec3(0.0, 0.0, 0.0))
    assert tuple(map(float, g)) == (0.0, 0.0, 0.0)


def test_vec3_is_a_pytree_of_three_scalars():
    a = Vec3.of(np.arange(12.0).reshape(4, 3).astype(np.float32))
    assert [leaf.shape for leaf in jax.tree.leaves(a)] == [(4,)] * 3
    np.testing.assert_array_equal(a.array(), np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(np.asarray(a), np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(jnp.asarray(a), np.arange(12.0).reshape(4, 3))
    assert Vec3.of(a) is a
    doubled = jax.vmap(lambda p: p * 2.0)(a)
    np.testing.assert_array_equal(doubled.array(), 2 * np.arange(12.0).reshape(4, 3))


def test_vec3_arithmetic_is_that_of_vectors():
    rng = np.random.default_rng(1)
    p, q = rng.normal(size=(2, 3)).astype(np.float32)
    a, b = Vec3.of(p), Vec3.of(q)
    for got, want in (
        (a + b, p + q),
        (a - b, p - q),
        (a * 3.0, 3 * p),
        (3.0 * a, 3 * p),
        (-a, -p),
        (v.cross(a, b), np.cross(p, q)),
    ):
        np.testing.assert_allclose(got.array(), want, rtol=4 * EPS, atol=4 * EPS)
    np.testing.assert_allclose(v.dot(a, b), p @ q, rtol=8 * EPS)
    np.testing.assert_allclose(v.length(a), np.linalg.norm(p), rtol=4 * EPS)


@pytest.mark.parametrize("shape", [(2,), (4,), (3, 1), ()])
def test_vec3_refuses_other_than_three_components(shape):
    with pytest.raises(ValueError, match="three components"):
        Vec3.of(np.zeros(shape))


def test_spectrum_is_a_pytree_of_channels():
    a = Spectrum.of(np.arange(8.0).reshape(2, 4).astype(np.float32))
    assert len(jax.tree.leaves(a)) == 4
    np.testing.assert_array_equal(np.asarray(a), np.arange(8.0).reshape(2, 4))
    assert Spectrum.of(a) is a
    np.testing.assert_array_equal(a.max(), [3.0, 7.0])
    np.testing.assert_array_equal(Spectrum.full(2, 1.5).array(), [1.5, 1.5])


def test_spectrum_arithmetic_is_by_channel_and_by_scalar():
    a, b = Spectrum((1.0, 2.0)), Spectrum((4.0, 8.0))
    assert (a + b).channels == (5.0, 10.0)
    assert (b - a).channels == (3.0, 6.0)
    assert (a * b).channels == (4.0, 16.0)
    assert (b / a).channels == (4.0, 4.0)
    assert (a * 2.0).channels == (2.0 * a).channels == (2.0, 4.0)
    assert sum([a, b], 0.0).channels == (5.0, 10.0)
    with pytest.raises(ValueError):
        a + Spectrum((1.0, 2.0, 3.0))


def test_where_selects_between_equal_pytrees():
    picked = v.where(jnp.array([True, False]), Vec3.of(jnp.ones((2, 3))), Vec3.of(jnp.zeros((2, 3))))
    np.testing.assert_array_equal(picked.array(), [[1, 1, 1], [0, 0, 0]])


def test_affine_transforms_move_points_and_turn_vectors():
    rng = np.random.default_rng(2)
    m = np.eye(4)
    m[:3] = rng.normal(size=(3, 4))
    p = rng.normal(size=3).astype(np.float32)
    m32 = jnp.asarray(m, jnp.float32)
    np.testing.assert_allclose(v.transform_point(m32, Vec3.of(p)).array(), m[:3, :3] @ p + m[:3, 3], rtol=1e-5)
    np.testing.assert_allclose(v.transform_vector(m32, Vec3.of(p)).array(), m[:3, :3] @ p, rtol=1e-5)
