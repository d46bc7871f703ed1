"""Independent samples: uniform, and without any memory of the sample, pixel or pair before."""

import jax
import numpy as np
from scipy import stats

from jaxrt.sampling.independent import SAMPLERS, Independent
from jaxrt.solver.path import sample_stream

N = 1 << 16


@jax.jit
def drawn(seed, pixel, i):
    """(N, 6): the first three pairs of samples."""
    stream = lambda pixel, i: sample_stream(Independent(seed), pixel, i)
    pairs = jax.vmap(lambda pixel, i: [stream(pixel, i).pair_at(k) for k in range(3)])(pixel, i)
    return jax.numpy.stack([u for pair in pairs for u in pair], 1)


def test_numbers_are_uniform_and_without_memory():
    i = np.arange(N)
    of_one_pixel, of_many = drawn(np.uint32(7), 0 * i + 5, i), drawn(np.uint32(7), i, 0 * i)
    for u in (np.asarray(of_one_pixel), np.asarray(of_many)):
        for k in range(6):
            counts = np.bincount((u[:, k] * 256).astype(int), minlength=256)
            assert stats.chisquare(counts).pvalue > 1e-4
        for a, b in ((u[:, 0], u[:, 1]), (u[:, 0], u[:, 2]), (u[:-1, 0], u[1:, 0]), (u[:-4, 3], u[4:, 3])):
            cells = np.bincount((a * 16).astype(int) * 16 + (b * 16).astype(int), minlength=256)
            assert stats.chisquare(cells).pvalue > 1e-4  # evener than chance would fail the next line
            assert stats.chisquare(cells).pvalue < 1 - 1e-4
        means = u[: N // 256 * 256].reshape(-1, 256, 6).mean(1)
        np.testing.assert_allclose(means.std(0, ddof=1), (1 / 12 / 256) ** 0.5, rtol=0.2)


def test_the_default_sampler_leaves_a_seed_as_it_is():
    """So that programs have nothing of the choice."""
    seed = np.uint32(3)
    assert SAMPLERS["sobol"](seed) is seed
