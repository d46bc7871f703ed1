"""Radiometry: the measures σ and μ and the worked examples of the notes, section 1.

Angles in radians, lengths in one unit of the caller's, radiance in W·m⁻²·sr⁻¹, irradiance and
exitance in W·m⁻², intensity in W·sr⁻¹, flux in W. Functions are elementwise and differentiable.
They are stable for small angles: 1 − cosθ in float32 is off by 7 % at R/r = 1e-3; here it is not formed.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .vector import safe_sqrt

Real = Float[Array, "..."]

LUMEN_PER_WATT = 683.002
"""Luminous efficacy of monochromatic light at 540 THz, lm/W (SI, definition of the candela)."""

SUN_IRRADIANCE = 500.0
"""Irradiance of the sun at noon as the notes take it, W·m⁻² (section 1.2)."""

SUN_ANGLE = 0.01
"""Angular diameter of the sun as the notes take it, rad (section 1.2)."""

LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec. 709 primaries, white D65


def solid_angle_cap(theta: ArrayLike) -> Real:
    """σ of the cap of half-angle θ: 2π(1 − cosθ) = 4π sin²(θ/2) (notes, 1.1)."""
    return 4.0 * jnp.pi * jnp.sin(0.5 * jnp.asarray(theta)) ** 2


def solid_angle_band(theta1: ArrayLike, theta2: ArrayLike) -> Real:
    """σ of the band between polar angles θ₁ ≤ θ₂: 2π(cosθ₁ − cosθ₂), by the product of sines (notes, 1.1)."""
    a, b = jnp.asarray(theta1), jnp.asarray(theta2)
    return 4.0 * jnp.pi * jnp.sin(0.5 * (a + b)) * jnp.sin(0.5 * (b - a))


def solid_angle_disc(radius: ArrayLike, distance: ArrayLike) -> Real:
    """σ of a disc of radius R on the axis at distance r: a cap with tanθ = R/r (notes, 1.1). 2π at distance 0."""
    r, d = jnp.asarray(radius), jnp.asarray(distance)
    slant = jnp.hypot(r, d)
    return 2.0 * jnp.pi * (r / slant) * (r / (slant + d))


def one_minus_cos(sin: ArrayLike) -> Real:
    """1 − cosθ of an acute θ from sinθ, as s²/(1 + √(1 − s²)): exact to rounding for small s."""
    s = jnp.asarray(sin)
    return s * s / (1.0 + safe_sqrt((1.0 - s) * (1.0 + s)))


def solid_angle_sphere(radius: ArrayLike, distance: ArrayLike) -> Real:
    """σ of a sphere of radius R whose centre is at distance r: a cap with sinθ = R/r (notes, 1.1); 4π inside it."""
    r, d = jnp.asarray(radius), jnp.asarray(distance)
    outside = d >= r
    s = jnp.where(outside, r / jnp.where(outside, d, 1.0), 0.0)
    return jnp.where(outside, 2.0 * jnp.pi * one_minus_cos(s), 4.0 * jnp.pi)


def projected_solid_angle_cap(theta: ArrayLike) -> Real:
    """μ of a cap of half-angle θ ≤ π/2 around the normal: π sin²θ. The hemisphere has μ = π."""
    return jnp.pi * jnp.sin(jnp.asarray(theta)) ** 2


def projected_solid_angle_band(theta1: ArrayLike, theta2: ArrayLike) -> Real:
    """μ of the band between θ₁ ≤ θ₂ ≤ π/2: π(sin²θ₂ − sin²θ₁) = π sin(θ₂ + θ₁) sin(θ₂ − θ₁)."""
    a, b = jnp.asarray(theta1), jnp.asarray(theta2)
    return jnp.pi * jnp.sin(b + a) * jnp.sin(b - a)


def sun_radiance(irradiance: ArrayLike = SUN_IRRADIANCE, diameter: ArrayLike = SUN_ANGLE) -> Real:
    """L = E/(π d²/4) of a small perpendicular disc of angular diameter d (notes, 1.2): 6.4·10⁶ for the sun."""
    return jnp.asarray(irradiance) / (0.25 * jnp.pi * jnp.asarray(diameter) ** 2)


def lambertian_exitance(reflectance: ArrayLike, irradiance: ArrayLike) -> Real:
    """M = R·E (notes, 1.3)."""
    return jnp.asarray(reflectance) * jnp.asarray(irradiance)


def lambertian_radiance(reflectance: ArrayLike, irradiance: ArrayLike) -> Real:
    """L = R/π·E (notes, 1.3)."""
    return lambertian_exitance(reflectance, irradiance) / jnp.pi


def exitance_of_radiance(radiance: ArrayLike) -> Real:
    """M = ∫ L dμ = πL of a surface with the same radiance in every direction (notes, 1.3)."""
    return jnp.pi * jnp.asarray(radiance)


def radiance_of_exitance(exitance: ArrayLike) -> Real:
    """L = M/π of a surface with the same radiance in every direction."""
    return jnp.asarray(exitance) / jnp.pi


def irradiance_of_radiance(radiance: ArrayLike, projected_solid_angle: ArrayLike) -> Real:
    """E = L·μ of a source of one radiance over a projected solid angle."""
    return jnp.asarray(radiance) * jnp.asarray(projected_solid_angle)


def flux_of_exitance(exitance: ArrayLike, area: ArrayLike) -> Real:
    """Φ = M·A."""
    return jnp.asarray(exitance) * jnp.asarray(area)


def intensity_of_radiance(radiance: ArrayLike, area: ArrayLike, cos_theta: ArrayLike = 1.0) -> Real:
    """I = L·A·cosθ of a small flat source."""
    return jnp.asarray(radiance) * jnp.asarray(area) * jnp.asarray(cos_theta)


def irradiance_of_intensity(intensity: ArrayLike, distance: ArrayLike, cos_theta: ArrayLike = 1.0) -> Real:
    """E = I·cosθ/r² of a point source."""
    return jnp.asarray(intensity) * jnp.asarray(cos_theta) / jnp.asarray(distance) ** 2


def luminous(radiometric: Float[Array, "... channels"], efficacy: float = LUMEN_PER_WATT) -> Real:
    """Photometric value of a linear Rec. 709 (or one-channel) radiometric value: W → lm, W·m⁻² → lux, W·sr⁻¹ → cd.

    The scene's RGB is taken as radiometric per primary and weighted by luminance; `efficacy` in lm/W.
    """
    a = jnp.asarray(radiometric)
    if a.shape[-1] == 1:
        return efficacy * a[..., 0]
    if a.shape[-1] != 3:
        raise ValueError(f"luminance needs 1 or 3 channels, not {a.shape[-1]}")
    return efficacy * (a @ jnp.asarray(LUMINANCE, a.dtype))
