"""Scrambled Sobol points: stratified in every elementary interval, independent between seeds, free of order."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxrt.sampling import sobol
from jaxrt.sampling.sobol import Drawn, Stream

SEEDS = [0, 1, 2**31 + 5, 0xDEADBEEF]


@jax.jit
def points(index, seed, pair):
    """(N, 2) of the points of one pair of dimensions."""
    return jax.vmap(lambda i: jnp.stack(Stream(i, seed, pair).pair_at(0)))(index)


def draw(n, seed=0, pair=0, first=0):
    return np.asarray(
        points(np.arange(first, first + n, dtype=np.uint32), np.uint32(seed), np.uint32(pair)), np.float64
    )


def cells(p, a, b):
    """Which of the 2^a x 2^b boxes each point lies in."""
    return (p[:, 0] * 2**a).astype(int) * 2**b + (p[:, 1] * 2**b).astype(int)


@pytest.mark.parametrize("seed, pair", [*itertools.product(SEEDS, [0, 1, 17])])
def test_256_points_put_one_into_every_elementary_interval(seed, pair):
    p = draw(256, seed, pair)
    for a in range(9):
        assert len(set(cells(p, a, 8 - a))) == 256, (a, 8 - a)


@pytest.mark.parametrize("first", [256, 4096, 3 << 24])
def test_later_blocks_of_a_power_of_two_are_stratified_too(first):
    p = draw(64, 5, 2, first)
    for a in range(7):
        assert len(set(cells(p, a, 6 - a))) == 64


def test_the_nodes_of_a_point_and_the_points_together_are_stratified():
    """Node j of n: 16 points of 16 nodes are 256 consecutive points of one set of sequences."""
    node = jax.jit(jax.vmap(lambda i, j: jnp.stack(Stream(i, np.uint32(9)).node(j, 16).pair_at(0))))
    i, j = (a.ravel().astype(np.uint32) for a in np.meshgrid(np.arange(16), np.arange(16), indexing="ij"))
    p = np.asarray(node(i, j), np.float64)
    for a in range(9):
        assert len(set(cells(p, a, 8 - a))) == 256
    for k in range(16):  # each point's own nodes as well
        assert len(set(cells(p[i == k], 2, 2))) == 16


@pytest.mark.parametrize("seed", SEEDS)
def test_means_of_65536_points(seed):
    """One point in each of 65536 strata: the mean of a dimension is off by at most half a stratum, and a bit of rounding."""
    for pair in (0, 3):
        np.testing.assert_allclose(draw(65536, seed, pair).mean(0), 0.5, atol=2.0**-17 + 2.0**-25)


def test_points_lie_in_the_half_open_interval():
    p = draw(65536, 7)
    assert p.min() >= 0.0 and p.max() < 1.0
    top = sobol.unit_interval(jnp.uint32(0xFFFFFFFF))
    assert float(top) < 1.0 and float(sobol.unit_interval(jnp.uint32(0))) == 0.0


def correlation(a, b):
    return float(np.corrcoef(a, b)[0, 1])


# Of 4096 independent points a correlation has the standard error 1/64. 4.5 of them: a chance of 7e-6 a number.
BOUND = 4.5 / 64


@pytest.mark.parametrize("other", [1, 2, 3, 1 << 16, 1 << 31, 0x9E3779B9])
def test_seeds_are_independent(other):
    a, b = draw(4096, 12345), draw(4096, 12345 ^ other)
    for i, j in itertools.product(range(2), range(2)):
        assert abs(correlation(a[:, i], b[:, j])) < BOUND
    joint = np.histogram2d(a[:, 0], b[:, 0], 8)[0]
    assert stats.chisquare(joint.ravel()).pvalue > 1e-4


@pytest.mark.parametrize("other", range(1, 8))
def test_pairs_are_independent(other):
    a, b = draw(4096, 3, 0), draw(4096, 3, other)
    for i, j in itertools.product(range(2), range(2)):
        assert abs(correlation(a[:, i], b[:, j])) < BOUND
    joint = np.histogram2d(a[:, 0], b[:, 1], 8)[0]
    assert stats.chisquare(joint.ravel()).pvalue > 1e-4


def test_two_pairs_integrate_a_product():
    """Padded pairs are independent: ∫ x y z w = 1/16 over four dimensions, as well as random points do at least."""
    a, b = draw(65536, 21, 0), draw(65536, 21, 1)
    f = a[:, 0] * a[:, 1] * b[:, 0] * b[:, 1]
    # The variance of the product is 1/81 − 1/256, so the standard error of random points is 3.6e-4.
    assert abs(f.mean() - 1 / 16) < 3 * 3.6e-4


def test_scrambling_is_uniform_for_the_first_point():
    """Over seeds, every single point is uniform in the square: else a picture of few samples is biased."""
    first = np.asarray(
        jax.jit(jax.vmap(lambda s: jnp.stack(Stream(np.uint32(0), s).pair_at(0))))(
            sobol.hash_u32(jnp.arange(65536, dtype=jnp.uint32))
        ),
        np.float64,
    )
    counts = np.histogram2d(first[:, 0], first[:, 1], 16, range=[[0, 1], [0, 1]])[0]
    assert stats.chisquare(counts.ravel()).pvalue > 1e-4


def test_points_do_not_depend_on_order_or_company():
    index = np.random.default_rng(0).permutation(512).astype(np.uint32)
    np.testing.assert_array_equal(points(index, np.uint32(4), np.uint32(1)), draw(512, 4, 1)[index])
    alone = [np.asarray(points(index[k : k + 1], np.uint32(4), np.uint32(1)))[0] for k in range(3)]
    np.testing.assert_array_equal(alone, draw(512, 4, 1)[index[:3]])


def test_advance_drawn_and_child():
    s = Stream(np.uint32(3), np.uint32(8), 2)
    assert s.advance(3).pair_at(1) == s.pair_at(4)
    traced = Stream(np.uint32(3), np.uint32(8), jnp.uint32(2))
    assert traced.advance(3).pair_at(1) == s.pair_at(4)
    assert Drawn.of(s, 3).pair_at(2) == s.pair_at(2)
    assert s.child(1).pair_at(0) != s.pair_at(0) != s.child(2).pair_at(0)


def test_the_second_dimension_is_that_of_sobol():
    """Before scrambling, the second dimension is scipy's second Sobol dimension (Joe and Kuo's first polynomial)."""
    bits = np.asarray(sobol._pascal(jnp.arange(256, dtype=jnp.uint32))).astype(np.uint64)
    reverse = np.array([int(f"{b:032b}"[::-1], 2) for b in bits]) / 2.0**32
    gray = stats.qmc.Sobol(2, scramble=False, bits=30).random(256)  # in Gray code order
    index = np.arange(256) ^ (np.arange(256) >> 1)
    np.testing.assert_array_equal(reverse[index], gray[:, 1])


def test_keys_of_either_style_and_integers_seed_the_hash():
    new, old = jax.random.key(3), jax.random.PRNGKey(3)
    assert int(sobol.seed_of(new)) == int(sobol.seed_of(old))
    seeds = [
        sobol.seed_of(k) for k in (jax.random.key(1), jax.random.key(2), jax.random.fold_in(new, 1), 0, 1, 2**32, -1)
    ]
    assert len({int(s) for s in seeds}) == len(seeds)


def test_the_hash_is_a_bijection_that_mixes():
    x = np.arange(1 << 16, dtype=np.uint32)
    y = np.asarray(sobol.hash_u32(jnp.asarray(x)))
    assert len(np.unique(y)) == len(x)
    flips = np.bitwise_count(y[:-1:2] ^ y[1::2])  # neighbours differ in bit 0 alone
    # 32 bits of chance 1/2: mean 16, variance 8, over 32768 pairs.
    assert abs(flips.mean() - 16) < 5 * np.sqrt(8 / 32768)
