"""Film filters by importance: positions are distributed as the filter, cut off at the picture's edge, and where that is
negative they count so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from jaxrt.sensor import film

W, H = 9, 7
FILTERS = {"box": ("box", 0.5, 0.5), "wide box": ("box", 1.5, 0.5), "tent": ("tent", 1.0, 0.5)}
FILTERS |= {"wide tent": ("tent", 2.0, 0.5), "gaussian": ("gaussian", 2.0, 0.5), "soft": ("gaussian", 3.0, 1.0)}
FILTERS |= {"mitchell": ("mitchell", 2.0), "catmullrom": ("catmullrom", 2.0), "lanczos": ("lanczos", 3.0)}
# The inverse of the distribution is a table of 1024 even chances; in the tails its cells are wide (a tenth of a
# pixel at three standard deviations), and an edge there is out by the curvature over one cell.
SLACK = 0.01
EVERY = pytest.mark.parametrize("name", FILTERS)


def shape_of(name):
    """The filter as Mitsuba defines it: a gaussian is lowered so that it ends at 0."""
    kind, radius, stddev = (*FILTERS[name], 0.5)[:3]
    low = np.exp(-0.5 * (radius / stddev) ** 2)
    return {
        "box": lambda x: np.where(np.abs(x) <= radius, 1.0, 0.0),
        "tent": lambda x: np.maximum(1 - np.abs(x) / radius, 0.0),
        "gaussian": lambda x: np.maximum(np.exp(-0.5 * (x / stddev) ** 2) - low, 0.0),
        "mitchell": cubic(1 / 3, 1 / 3),
        "catmullrom": cubic(0, 1 / 2),
        "lanczos": lambda x: np.where(np.abs(x) <= radius, np.sinc(x) * np.sinc(x / radius), 0.0),
    }[kind]


def cubic(b, c):
    """Mitchell and Netravali's (1988) family of cubics, as polynomials of |x|."""
    near, far = (12 - 9 * b - 6 * c, -18 + 12 * b + 6 * c, 0, 6 - 2 * b), (-b - 6 * c, 6 * b + 30 * c, -12 * b - 48 * c, 8 * b + 24 * c)  # fmt: skip
    return lambda x: np.select([np.abs(x) < 1, np.abs(x) < 2], [np.polyval(k, np.abs(x)) for k in (near, far)], 0.0) / 6


def _place(name):
    @jax.jit
    def place(column, row, u):
        made = (0, 0, *FILTERS[name])
        p = film.pixel(made, column, row, W, H)

        def one(v):
            at = film.sample(made, p, (v[0], v[1]))
            return jnp.stack([*at, jnp.ones(()) if p.weight is None else film.weight(made, p, at)])

        return jax.vmap(one)(u)

    return place


PLACES = {name: _place(name) for name in FILTERS}


def drawn(name, column, row, u):
    found = np.asarray(PLACES[name](jnp.float32(column), jnp.float32(row), u), np.float64)
    return found[:, :2], found[:, 2]


def positions(name, column, row, u):
    return drawn(name, column, row, u)[0]


def distribution(name, center, size):
    """Distribution of positions along an axis: the filter cut off at the picture's edges and scaled up."""
    radius, h = FILTERS[name][1], shape_of(name)
    low, high = max(0.0, center - radius), min(float(size), center + radius)
    x = np.linspace(low, high, 4001)
    cdf = integrate.cumulative_simpson(np.abs(h(x - center)), x=x, initial=0)
    return low, high, lambda q: np.interp(q, x, cdf / cdf[-1])


@EVERY
@pytest.mark.parametrize("column, row", [(4, 3), (0, 0), (8, 6), (1, 5)])
def test_positions_are_distributed_as_the_filter(name, column, row):
    u = np.random.default_rng(7).random((20000, 2)).astype(np.float32)
    p = positions(name, column, row, u)
    for axis, (at, size) in enumerate(((column, W), (row, H))):
        low, high, cdf = distribution(name, at + 0.5, size)
        assert p[:, axis].min() >= low - SLACK and p[:, axis].max() <= high + SLACK
        assert stats.kstest(p[:, axis], cdf).pvalue > 1e-3
    assert abs(np.corrcoef(p.T)[0, 1]) < 4.5 / np.sqrt(len(p))


@EVERY
@pytest.mark.parametrize("column", [0, 4])
def test_the_inverse_distribution_is_accurate(name, column):
    """F(F⁻¹(u)) = u to the curvature of a table of 1024 cells; no randomness."""
    u = ((np.arange(4096) + 0.5) / 4096).astype(np.float32)
    q = positions(name, column, 3, np.stack([u, u], -1))[:, 0]
    np.testing.assert_allclose(distribution(name, column + 0.5, W)[2](q), u, atol=1e-3)


@EVERY
def test_positions_stay_in_the_picture(name):
    edge = np.array([0.0, 2.0**-24, 0.5, 1 - 2.0**-24], np.float32)
    u = np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2)
    for column in (0, 8):
        for row in (0, 6):
            p = positions(name, column, row, u)
            assert p.min() >= -SLACK and p[:, 0].max() <= W + SLACK and p[:, 1].max() <= H + SLACK


@EVERY
@pytest.mark.parametrize("column", [0, 1, 4, 8])
def test_a_ramp_averages_to_the_filter_weighted_mean(name, column):
    """∫ h_p(q) q dq: the pixel's centre inside the picture, shifted inwards at its edge."""
    h = shape_of(name)
    low, high, _ = distribution(name, column + 0.5, W)
    points = [k for k in np.arange(column - 2.5, column + 4) if low < k < high]
    want = integrate.quad(lambda q: q * h(q - column - 0.5), low, high, points=points)[0]
    want /= integrate.quad(lambda q: h(q - column - 0.5), low, high, points=points)[0]
    # Even points, and the table, are out by a thousandth.
    u = ((np.arange(32768) + 0.5) / 32768).astype(np.float32)
    middle = np.full_like(u, 0.5)
    p, along = drawn(name, column, 3, np.stack([u, middle], -1))
    _, across = drawn(name, column, 3, np.stack([middle, u], -1))
    _, at = drawn(name, column, 3, np.stack([middle, middle], -1))  # weights are products of one of each axis
    np.testing.assert_allclose((along * p[:, 0]).mean() / along.mean(), want, atol=FILTERS[name][1] * 1e-3)
    np.testing.assert_allclose(along.mean() * across.mean() / at[0], 1.0, atol=1e-3)


def test_a_border_is_sampled_beyond_the_edge():
    """Then the mean of a ramp is its value at the pixel's centre, at the edge too."""
    made = (0, 0, *film.Filter("gaussian", 2.0, border=True))
    u = ((np.arange(1024) + 0.5) / 1024).astype(np.float32)
    p = film.pixel(made, jnp.float32(0), jnp.float32(H - 1), W, H)
    x, y = jax.vmap(lambda v: film.sample(made, p, (v, v)))(u)
    assert x.min() < -1 and y.max() > H + 1
    np.testing.assert_allclose([x.mean(), y.mean()], [0.5, H - 0.5], atol=1e-3)


@EVERY
@pytest.mark.parametrize("column", [0, 4])
def test_the_density_is_the_filter(name, column):
    """h_p at positions in the picture, by a table of 1024 steps, as outlines need it; and nothing beyond its edge."""
    made, h, row = (0, 0, *FILTERS[name]), shape_of(name), 3
    p = film.pixel(made, jnp.float32(column), jnp.float32(row), W, H)
    at = np.random.default_rng(1).uniform(0, (W, H), (64, 2))
    got = jax.vmap(lambda q: film.density(made, p, (q[0], q[1])))(at.astype(np.float32))
    want, peak = np.ones(len(at)), 1.0
    for axis, (center, size) in enumerate(((column + 0.5, W), (row + 0.5, H))):
        x = np.linspace(0, size, 20001)
        total = integrate.trapezoid(h(x - center), x)
        want, peak = want * h(at[:, axis] - center) / total, peak * h(0.0) / total
    np.testing.assert_allclose(got, want, atol=0.01 * peak)
    beyond = jax.vmap(lambda q: film.density(made, p, (q[0], q[1])))(
        np.array([[-0.2, 3.5], [1.0, -0.1], [W + 0.1, 3.5]], np.float32)
    )
    assert not beyond.any()
