"""The notes' worked examples against closed forms in float64, at small angles above all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrt import radiometry as r

# Arguments are rounded to float32 once and every function takes a few roundings.
ROUNDING = 8 * np.finfo(np.float32).eps
ANGLES = np.array([1e-6, 1e-4, 1e-3, 0.01, 0.3, 1.0, np.pi / 2, 2.0, 3.0], np.float32)
RATIOS = np.array([1e-6, 1e-4, 1e-3, 0.01, 0.1, 0.5, 0.9], np.float32)


def exact(a):
    return np.asarray(a, np.float64)


def check(got, want, rtol=ROUNDING, atol=0.0):
    assert got.dtype in (jnp.float32, jnp.result_type(float))  # of arguments in float32, in float64 as well
    np.testing.assert_allclose(got, want, rtol=rtol, atol=atol)


def cap(theta):
    """2π(1 − cosθ) in float64, by the series where 1 − cosθ cancels."""
    theta = exact(theta)
    return np.where(theta < 1e-3, np.pi * theta**2 * (1 - theta**2 / 12), 2 * np.pi * (1 - np.cos(theta)))


def test_solid_angle_of_a_cap():
    check(r.solid_angle_cap(ANGLES), cap(ANGLES))
    check(r.solid_angle_cap(np.float32(np.pi)), 4 * np.pi)
    check(r.solid_angle_cap(np.float32(np.pi / 2)), 2 * np.pi)


def test_solid_angle_of_a_disc():
    """tanθ = R/r."""
    check(r.solid_angle_disc(RATIOS, np.float32(1)), cap(np.arctan(exact(RATIOS))))
    check(r.solid_angle_disc(np.float32(1e3), np.float32(1)), cap(np.arctan(1e3)))
    check(r.solid_angle_disc(np.float32(2), np.float32(0)), 2 * np.pi)
    check(r.solid_angle_disc(np.float32(3e-4), np.float32(4e-4)), cap(np.arctan(0.75)))


def test_solid_angle_of_a_sphere():
    """sinθ = R/r; on the sphere half of all directions, inside it all of them."""
    check(r.solid_angle_sphere(RATIOS, np.float32(1)), cap(np.arcsin(exact(RATIOS))))
    check(r.solid_angle_sphere(np.float32(2), np.float32(2)), 2 * np.pi)
    check(r.solid_angle_sphere(np.float32(2), np.array([1.0, 0.0], np.float32)), 4 * np.pi)


@pytest.mark.parametrize("ratio", [1e-3, 1e-4])
def test_small_solid_angles_do_not_cancel(ratio):
    """1 − cosθ in float32 is 7 % off at 1e-3 and gone at 1e-4 (oracles); here it is exact to rounding."""
    ratio = np.float32(ratio)
    naive = 1 - np.cos(ratio)
    assert abs(2 * np.pi * naive / cap(ratio) - 1) > 0.02
    check(r.one_minus_cos(ratio), cap(np.arcsin(exact(ratio))) / (2 * np.pi))
    check(r.solid_angle_sphere(ratio, np.float32(1)), cap(np.arcsin(exact(ratio))))
    check(r.solid_angle_disc(ratio, np.float32(1)), cap(np.arctan(exact(ratio))))


def test_one_minus_cos():
    s = np.array([0.0, 1e-8, 1e-3, 0.5, 0.999, 1.0], np.float32)
    want = exact(s) ** 2 / (1 + np.sqrt((1 - exact(s)) * (1 + exact(s))))
    check(r.one_minus_cos(s), want)


def test_a_band_is_the_difference_of_its_caps():
    low, high = ANGLES[:-1], ANGLES[1:]
    check(r.solid_angle_band(low, high), cap(high) - cap(low))
    check(r.solid_angle_band(np.float32(0), high), cap(high))
    check(r.solid_angle_band(high, high), 0 * exact(high))


def test_a_narrow_band_far_from_the_pole_does_not_cancel():
    low = np.float32(1.0)
    high = np.float32(1.0 + 1e-4)
    mean = 0.5 * (exact(low) + exact(high))
    check(r.solid_angle_band(low, high), 4 * np.pi * np.sin(mean) * np.sin(0.5 * (exact(high) - exact(low))))


def test_projected_solid_angles():
    acute = ANGLES[ANGLES <= 1.6]
    check(r.projected_solid_angle_cap(acute), np.pi * np.sin(exact(acute)) ** 2)
    check(r.projected_solid_angle_cap(np.float32(np.pi / 2)), np.pi)
    low, high = acute[:-1], acute[1:]
    want = np.pi * (np.sin(exact(high)) ** 2 - np.sin(exact(low)) ** 2)
    check(r.projected_solid_angle_band(low, high), want)


@pytest.mark.parametrize("low, high", [(0.0, 0.4), (0.3, 1.2), (0.0, np.pi / 2), (1.0, np.pi / 2)])
def test_the_measures_by_quadrature(low, high):
    """σ = ∬ sinθ dθ dφ and μ = ∬ cosθ sinθ dθ dφ, by Gauss-Legendre (exact to 1e-15 for these integrands)."""
    x, w = np.polynomial.legendre.leggauss(24)
    theta, weight = low + 0.5 * (high - low) * (x + 1), np.pi * (high - low) * w
    sigma, mu = weight @ np.sin(theta), weight @ (np.cos(theta) * np.sin(theta))
    low, high = np.float32(low), np.float32(high)
    # The rounding of the bounds moves the integral by EPS times their size.
    check(r.solid_angle_band(low, high), sigma, rtol=2e-6)
    check(r.projected_solid_angle_band(low, high), mu, rtol=2e-6)


def test_the_sun_of_the_notes():
    """500 W·m⁻² over a disc of diameter 1/100 rad, π/40000 sr: about 6·10⁶ W·m⁻²·sr⁻¹ (notes, 1.2)."""
    check(r.sun_radiance(), 500 / (np.pi / 40000))
    assert 6e6 < float(r.sun_radiance()) < 6.5e6
    check(r.irradiance_of_radiance(r.sun_radiance(), np.float32(np.pi / 40000)), 500.0)
    check(r.sun_radiance(np.float32(1000), np.float32(0.02)), 1000 / (np.pi * 1e-4))


def test_the_sun_disc_of_the_oracles():
    half = np.float32(np.deg2rad(0.533) / 2)
    check(r.solid_angle_cap(half), 6.796702e-5, rtol=1e-6)  # seven digits were given
    check(r.projected_solid_angle_cap(half), 6.796666e-5, rtol=1e-6)


def test_the_lambertian_reflector():
    """M = R·E, L = R/π·E, and M = πL is what goes in by reflectance (notes, 1.3)."""
    reflectance, e = np.float32(0.3), np.array([0.0, 1.0, 500.0], np.float32)
    check(r.lambertian_exitance(reflectance, e), 0.3 * exact(e))
    check(r.lambertian_radiance(reflectance, e), 0.3 / np.pi * exact(e))
    check(r.exitance_of_radiance(r.lambertian_radiance(reflectance, e)), 0.3 * exact(e))
    check(r.radiance_of_exitance(np.float32(2)), 2 / np.pi)


def test_conversions():
    two, three = np.float32(2), np.float32(3)
    check(r.irradiance_of_radiance(two, three), 6.0)
    check(r.flux_of_exitance(two, three), 6.0)
    check(r.intensity_of_radiance(two, three), 6.0)
    check(r.intensity_of_radiance(two, three, np.float32(0.5)), 3.0)
    check(r.irradiance_of_intensity(two, np.float32(4)), 0.125)
    check(r.irradiance_of_intensity(two, np.float32(4), np.float32(0.5)), 0.0625)
    # A small disc of radiance L at distance r gives the same irradiance by intensity and by solid angle.
    by_intensity = r.irradiance_of_intensity(r.intensity_of_radiance(two, np.float32(np.pi * 1e-6)), np.float32(1))
    by_angle = r.irradiance_of_radiance(two, r.solid_angle_disc(np.float32(1e-3), np.float32(1)))
    check(by_intensity, exact(by_angle), rtol=1e-6)  # the disc is R² = 1e-6 from being a point


def test_photometry():
    """683.002 lm/W weighted by the luminance of Rec. 709 primaries; white has the weight 1."""
    check(r.luminous(np.ones(3, np.float32)), 683.002)
    check(r.luminous(np.array([[2.0], [0.5]], np.float32)), [1366.004, 341.501])
    rgb = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    check(r.luminous(rgb), 683.002 * np.array([0.2126, 0.7152, 0.0722]), rtol=1e-4)
    check(r.luminous(np.ones(3, np.float32), efficacy=100.0), 100.0)
    with pytest.raises(ValueError, match="1 or 3 channels"):
        r.luminous(np.ones(4, np.float32))


DERIVATIVES = {
    "cap": (r.solid_angle_cap, lambda t: 2 * np.pi * np.sin(t), [0.0, 1e-4, 1.0, np.pi]),
    "projected_cap": (r.projected_solid_angle_cap, lambda t: np.pi * np.sin(2 * t), [0.0, 1e-4, 1.0]),
    "one_minus_cos": (r.one_minus_cos, lambda s: s / np.sqrt(1 - s * s), [0.0, 1e-4, 0.5, 0.99]),
    "disc": (
        lambda d: r.solid_angle_disc(1.0, d),
        lambda d: -2 * np.pi / (1 + d * d) ** 1.5,
        [0.0, 1e-4, 1.0, 100.0],
    ),
    "sphere": (
        lambda d: r.solid_angle_sphere(1.0, d),
        lambda d: -2 * np.pi / (d**3 * np.sqrt(1 - d**-2)),
        [1.1, 2.0, 1e3],
    ),
    "irradiance": (lambda d: r.irradiance_of_intensity(1.0, d), lambda d: -2 / d**3, [0.1, 1.0, 1e3]),
}


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives(name):
    f, want, at = DERIVATIVES[name]
    at = np.array(at, np.float32)
    got = jax.vmap(jax.grad(f))(at)
    # √(1 − s²) near s = 1 magnifies the rounding of s by 1/(1 − s²) = 50 at s = 0.99.
    np.testing.assert_allclose(got, want(exact(at)), rtol=50 * ROUNDING, atol=2e-6)


@pytest.mark.parametrize(
    "f, at",
    [
        (r.solid_angle_sphere, (1.0, 1.0)),
        (r.solid_angle_sphere, (1.0, 0.0)),
        (r.solid_angle_sphere, (0.0, 1.0)),
        (r.solid_angle_disc, (1.0, 0.0)),
        (r.solid_angle_disc, (0.0, 1.0)),
        (r.solid_angle_band, (0.0, 0.0)),
        (r.projected_solid_angle_band, (0.5, 0.5)),
    ],
)
def test_derivatives_are_finite_at_the_ends(f, at):
    for got in (jax.grad(f, (0, 1))(*at), jax.jacfwd(f, (0, 1))(*at)):
        assert np.isfinite(np.array(got)).all()
