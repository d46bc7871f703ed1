"""Fresnel reflectance of metals against the complex formula in float64."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrt.brdf.fresnel import conductor
from jaxrt.vector import Spectrum

N = 64
COSINES = np.concatenate([np.linspace(1, 0.01, N - 4), [1e-3, 1e-4, 1e-6, 1e-12]]).astype(np.float32)


def _reflectance(eta, k, cos):
    return conductor(Spectrum((eta,)), Spectrum((k,)), cos).channels[0]


_many = jax.jit(jax.vmap(_reflectance, (None, None, 0)))
_slopes = jax.jit(jax.vmap(jax.grad(_reflectance, (0, 1, 2)), (None, None, 0)))


def exact(eta, k, cos):
    """(|r_s|² + |r_p|²)/2 of Fresnel's equations at index η + ik, by complex arithmetic."""
    n2, cos = complex(eta, k) ** 2, np.asarray(cos, np.float64)
    inner = np.sqrt((complex(eta, k) - 1) * (complex(eta, k) + 1) + cos**2)  # n² − sin²θ; does not cancel at n = 1
    rs = (cos - inner) / (cos + inner)
    rp = (n2 * cos - inner) / (n2 * cos + inner)
    return (np.abs(rs) ** 2 + np.abs(rp) ** 2) / 2


@given(st.floats(0, 8, width=32), st.floats(0, 10, width=32))
@settings(max_examples=100)
def test_against_the_complex_formula(eta, k):
    if abs(eta) + abs(k) < 0.05:
        eta = 0.05
    got = np.asarray(_many(np.float32(eta), np.float32(k), COSINES))
    # Roundings of a few EPS in η² − k² − s², magnified by up to 1/|η² − k² − s² ± ...| where total reflection begins:
    # there F has a square-root edge, and EPS becomes √EPS. Elsewhere 1e-5 holds.
    edge = np.abs(complex(eta, k) ** 2 - (1 - COSINES.astype(np.float64) ** 2)) < 1e-3
    want = exact(eta, k, COSINES)
    np.testing.assert_allclose(got[~edge], want[~edge], atol=2e-5)
    np.testing.assert_allclose(got[edge], want[edge], atol=5e-3)
    assert (got >= -1e-6).all() and (got <= 1 + 1e-6).all()


def test_a_perfect_mirror_reflects_exactly_everything():
    np.testing.assert_array_equal(_many(np.float32(0), np.float32(1), COSINES), 1.0)


def test_known_metals_at_normal_incidence():
    """((η − 1)² + k²)/((η + 1)² + k²); gold in red and aluminium, glass as a metal without absorption."""
    for eta, k in ((0.143, 3.98), (1.66, 8.1), (1.5, 0.0)):
        want = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
        assert float(_many(np.float32(eta), np.float32(k), COSINES)[0]) == pytest.approx(want, rel=1e-5)


def test_brewster_and_grazing():
    brewster = np.full(N, np.cos(np.arctan(1.5)), np.float32)
    assert float(_many(np.float32(1.5), np.float32(0), brewster)[0]) == pytest.approx(
        exact(1.5, 0, brewster[0]), abs=1e-6
    )
    assert float(_many(np.float32(1.5), np.float32(2), COSINES)[-1]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("eta, k", [(0.0, 1.0), (0.0, 0.0), (1.0, 0.0), (1.5, 0.0), (0.2, 3.9), (0.0, 0.5), (1.0, 1.0)])
def test_derivatives_are_finite(eta, k):
    for slope in _slopes(np.float32(eta), np.float32(k), np.maximum(COSINES, np.float32(1e-6))):
        assert np.isfinite(slope).all()


@pytest.mark.parametrize("eta, k", [(0.2, 3.9), (1.66, 8.1), (2.9, 3.1)])
def test_derivatives_against_differences(eta, k):
    cos = np.linspace(0.99, 0.2, N).astype(np.float32)
    slopes = _slopes(np.float32(eta), np.float32(k), cos)
    h = 1e-4
    c = cos.astype(np.float64)
    want = (
        (exact(eta + h, k, c) - exact(eta - h, k, c)) / (2 * h),
        (exact(eta, k + h, c) - exact(eta, k - h, c)) / (2 * h),
        (exact(eta, k, c + h) - exact(eta, k, c - h)) / (2 * h),
    )
    for got, w in zip(slopes, want, strict=True):
        np.testing.assert_allclose(got, w, rtol=2e-3, atol=2e-5)


def test_the_derivative_at_normal_incidence():
    """F is even in θ: its derivative with respect to cosθ at 1 is that of the formula, and what differences give."""
    one = np.full(N, 1.0, np.float32)
    c = np.float64(1 - 1e-4)
    want = (exact(0.2, 3.9, c) - exact(0.2, 3.9, c - 1e-6)) / 1e-6
    assert float(_slopes(np.float32(0.2), np.float32(3.9), one)[2][0]) == pytest.approx(want, abs=1e-3)
