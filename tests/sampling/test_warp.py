"""Warps of the unit square: χ² tests against their densities, and the polynomial circle against the library."""

import jax
import numpy as np
import pytest
from scipy import stats

from jaxrt.sampling import warp
from jaxrt.sampling.sobol import Stream

N = 1 << 16
UNIFORM = np.random.default_rng(2024).random((N, 2)).astype(np.float32)
UNIFORM = np.minimum(UNIFORM, np.float32(1 - 2.0**-24))


def chi_squared(counts, expected):
    """The chance of counts at least this far from what is expected (equal totals up to sampling)."""
    counts, expected = np.ravel(counts), np.ravel(expected)
    assert expected.min() > 5, "bins too small for the test"
    return stats.chi2.sf(((counts - expected) ** 2 / expected).sum(), len(counts) - 1)


def warped(f, *args):
    out = jax.jit(jax.vmap(lambda u: f((u[0], u[1]), *args)))(UNIFORM)
    return np.stack([np.asarray(c, np.float64) for c in out], -1)


def sphere_counts(p, least=-1.0):
    """Counts in boxes of equal solid angle: 12 of z in [least, 1], 24 of φ."""
    phi = np.arctan2(p[:, 1], p[:, 0])
    return np.histogram2d(p[:, 2], phi, (12, 24), range=[[least, 1], [-np.pi, np.pi]])[0]


def assert_unit(p):
    np.testing.assert_allclose(np.linalg.norm(p, axis=-1), 1.0, atol=1e-6)


def test_circle():
    u = np.concatenate([np.linspace(0, 1, 100001), np.arange(9) / 8]).astype(np.float32)
    c, s = (np.asarray(a) for a in jax.jit(warp.circle)(u))
    np.testing.assert_allclose(c, np.cos(2 * np.pi * u.astype(np.float64)), atol=4e-7)
    np.testing.assert_allclose(s, np.sin(2 * np.pi * u.astype(np.float64)), atol=4e-7)
    axes = np.array([0, 0.25, 0.5, 0.75], np.float32)
    np.testing.assert_array_equal(np.stack(warp.circle(axes)), [[1, 0, -1, 0], [0, 1, 0, -1]])


def test_cosine_hemisphere():
    p = warped(warp.cosine_hemisphere)
    assert_unit(p)
    assert (p[:, 2] > 0).all()
    z = np.linspace(0, 1, 13)
    share = np.diff(z**2) / 24  # ∫ cosθ/π dσ over a band is z₂² − z₁²
    assert chi_squared(sphere_counts(p, 0.0), N * np.repeat(share, 24)) > 1e-3


def test_cosine_hemisphere_is_never_in_the_plane():
    edge = warp.cosine_hemisphere((np.float32(1 - 2.0**-24), np.float32(0.3)))
    assert float(edge.z) > 0


def test_uniform_sphere():
    p = warped(warp.uniform_sphere)
    assert_unit(p)
    assert chi_squared(sphere_counts(p), np.full(288, N / 288)) > 1e-3


@pytest.mark.parametrize("one_minus_cos", [2.0, 0.5, 1e-3, 1e-8])
def test_uniform_cone(one_minus_cos):
    p = warped(warp.uniform_cone, np.float32(one_minus_cos))
    assert_unit(p)
    sin2 = p[:, 0] ** 2 + p[:, 1] ** 2
    # 1 − z from the sine below the equator's cap: z itself cannot resolve a cone of 1e-8.
    height = np.where(p[:, 2] > 0.5, sin2 / (1 + np.sqrt(1 - np.minimum(sin2, 1))), 1 - p[:, 2]) / one_minus_cos
    assert height.max() < 1 + 1e-6
    phi = np.arctan2(p[:, 1], p[:, 0])
    counts = np.histogram2d(height, phi, (12, 24), range=[[0, 1 + 1e-6], [-np.pi, np.pi]])[0]
    assert chi_squared(counts, np.full(288, N / 288)) > 1e-3


def test_uniform_disk():
    p = warped(warp.uniform_disk)
    r2 = (p**2).sum(1)
    assert r2.max() <= 1 + 1e-6
    counts = np.histogram2d(r2, np.arctan2(p[:, 1], p[:, 0]), (12, 24), range=[[0, 1 + 1e-6], [-np.pi, np.pi]])[0]
    assert chi_squared(counts, np.full(288, N / 288)) > 1e-3


def test_uniform_disk_at_its_centre_and_corners():
    half, top = np.float32(0.5), np.float32(1 - 2.0**-24)
    assert tuple(map(float, warp.uniform_disk((half, half)))) == (0.0, 0.0)
    for u in ((0.0, 0.0), (top, top), (0.0, top), (half, top)):
        a, b = warp.uniform_disk(tuple(map(np.float32, u)))
        np.testing.assert_allclose(np.hypot(a, b), 1.0, atol=1e-6)


def test_uniform_triangle():
    p = warped(warp.uniform_triangle)
    assert p.min() >= 0 and p.sum(1).max() <= 1 + 1e-6
    # Sixteenths by lines along the sides: 15 squares cut in two by the diagonals, all of the same area.
    i, j = (p[:, 0] * 8).astype(int), (p[:, 1] * 8).astype(int)
    upper = (p[:, 0] * 8 % 1) + (p[:, 1] * 8 % 1) > 1
    counts = np.zeros((8, 8, 2))
    np.add.at(counts, (np.minimum(i, 7), np.minimum(j, 7), upper.astype(int)), 1)
    inside = [counts[a, b, k] for a in range(8) for b in range(8) for k in range(2) if a + b + k < 8]
    assert len(inside) == 64
    assert chi_squared(inside, np.full(64, N / 64)) > 1e-3


@pytest.mark.parametrize("corners", [(1.0, 1.0, 1.0, 1.0), (0.05, 2.0, 1.0, 0.95), (0.05, 0.05, 0.05, 3.85)])
def test_bilinear(corners):
    """Counts in 64 boxes, whose middles give the mean density of each; and the density that comes with a point."""
    at = lambda x, y: (
        np.array([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y]).T @ np.array(corners) / np.mean(corners)
    )
    p = warped(lambda u: (lambda place, density: (*place, density))(*warp.bilinear(u, tuple(map(np.float32, corners)))))
    assert p[:, :2].min() >= 0 and p[:, :2].max() < 1
    np.testing.assert_allclose(p[:, 2], at(p[:, 0], p[:, 1]), rtol=1e-4)
    counts = np.histogram2d(p[:, 0], p[:, 1], 8, range=[[0, 1], [0, 1]])[0]
    middle = (np.arange(8) + 0.5) / 8
    assert chi_squared(counts, np.stack([at(x, middle) for x in middle]) * N / 64) > 1e-3


@pytest.mark.parametrize("kind", ["triangle", "parallelogram", "disk"])
def test_corners_of_flat_faces(kind):
    u = np.array([(0, 0), (1, 0), (0, 1), (1, 1)], np.float32)
    np.testing.assert_allclose(np.stack(warp.FLAT[kind]((u[:, 0], u[:, 1])), -1), warp.CORNERS[kind], atol=1e-6)


@pytest.mark.parametrize("f", [warp.cosine_hemisphere, warp.uniform_sphere, warp.uniform_disk, warp.uniform_triangle])
def test_warps_keep_sobol_points_evenly_spread(f):
    """The mean of 1024 stratified points is far nearer to the truth than random points' would be."""
    s = jax.jit(jax.vmap(lambda i: f(Stream(i, np.uint32(3)).pair_at(0))))(np.arange(1024, dtype=np.uint32))
    mean = np.array([np.mean(np.asarray(c, np.float64)) for c in s])
    want = {"cosine_hemisphere": (0, 0, 2 / 3), "uniform_triangle": (1 / 3, 1 / 3)}.get(f.__name__, 0.0)
    # Random points: a standard deviation of about .5 over √1024, .016. Stratified: a tenth of it.
    np.testing.assert_allclose(mean, want, atol=2e-3)
