"""Diffuse paint below a rough clear coat, Mitsuba's `roughplastic`: facets of the coat reflect as `rough` has them, and
what they let through is reflected diffusely, and leaves by the same share as it entered.

That share T(cosθ), and how much of even light the coat throws back inside, are integrals over facets. They depend on
alpha and index alone, and are found once a render for each material (`derive`).
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..sampling.warp import cosine_hemisphere
from ..vector import Spectrum, Vec3, dot, normalise, safe_sqrt, where
from . import ggx, plastic, rough
from .fresnel import dielectric
from .lobe import Lobe
from .material import DERIVED


def _unit_rule(n: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(n)
    return 0.5 * (x + 1.0), 0.5 * w


def _at(cos: Any) -> Vec3:
    return Vec3(safe_sqrt((1.0 - cos) * (1.0 + cos)), 0.0 * cos, cos)


def _masked(normals: rough.Normals, m: Any, w: Vec3) -> Any:
    """G₁ but for a factor that stays finite at grazing: what has a kink in T, of Walter's fit."""
    return 2.0 * normals.masked(m, w) * ggx.length(m, w)


def _share(normals: rough.Normals, m: Any, index: Any, cos: Any, through: bool) -> Any:
    """Of light at incidence cosθ, what facets reflect or let through to the other side, where the index is `index`.

    By a product rule in the numbers that visible normals are drawn with. Normals are held fixed under differentiation:
    if they moved with alpha, single nodes would meet the infinite slope at total reflection.
    """
    wo = _at(cos)
    radial, weights = _unit_rule(24)
    angles = (np.arange(24) + 0.5) / 48  # the other half is alike

    def one(a: Any, b: Any) -> Any:
        h = ggx.visible_normal(sg(m.alpha), wo, (a, b))
        c = dot(h, wo)
        f, bent, _ = dielectric(index, c)
        wi = wo * (1.0 / index) - h * (c / index - bent) if through else h * (2.0 * c) - wo
        wi = Vec3(wi.x, wi.y, jnp.maximum(wi.z, 0.0))  # masked alike on both sides
        masked = 4.0 * c * wi.z * rough.reflected(normals, m, h, wi, wo)
        return (1.0 - f if through else f) * masked / ggx.positive(ggx.visible_density(sg(m.alpha), h, wo))

    over = jax.vmap(jax.vmap(one, (0, None)), (None, 0))
    values = over(jnp.asarray(angles, jnp.result_type(cos)), jnp.asarray(radial, jnp.result_type(cos)))
    return (values.mean(1) * weights).sum()


def _scale(m: Any) -> Any:
    """Of cosines near grazing, where facets are seen that lean towards the light and T changes fast."""
    return 0.1 + m.alpha[0]


def _derive(normals: rough.Normals, m: Any) -> dict[str, Any]:
    """`coat`: coefficients of T over `_masked`, in Chebyshev polynomials of cosθ (1 + b)/(cosθ + b), b = `_scale`.
    `inside`: reflectance of even light, as Mitsuba takes it: its mean over 64 cosines counts both ends in full, which
    is (R(1) − R)/64 more than the integral, and its pictures are darker by that."""
    n = DERIVED["coat"]
    t = np.cos(np.pi * (np.arange(n) + 0.5) / n)
    to_series = np.cos(np.arange(n)[:, None] * np.arccos(t)) * (2.0 / n)
    to_series[0] *= 0.5
    real, b = jnp.result_type(m.ior), _scale(m)
    y = jnp.asarray(0.5 * (t + 1.0), real)
    enters = jax.vmap(lambda c: _share(normals, m, m.ior, c, True) / _masked(normals, m, _at(c)))
    enters = enters(b * y / (1.0 + b - y))
    # Inside, total reflection begins at a kink.
    x, w = _unit_rule(12)
    kink = safe_sqrt(1.0 - 1.0 / (m.ior * m.ior))
    inside = 0.0
    for start, end in ((0.0, kink), (kink, 1.0)):
        cos = start + (end - start) * jnp.asarray(x, real)
        back = jax.vmap(lambda c: _share(normals, m, 1.0 / m.ior, c, False))(cos)
        inside += (end - start) * (2.0 * w * cos * back).sum()
    inside += (_share(normals, m, 1.0 / m.ior, jnp.ones((), real), False) - inside) / 64.0
    return {"coat": tuple((jnp.asarray(to_series, real) * enters[None]).sum(1)), "inside": inside}


def _enters(normals: rough.Normals, m: Any, w: Vec3) -> Any:
    """T(cosθ), by Clenshaw's sum."""
    cos = jnp.clip(w.z, 0.0, 1.0)
    b = _scale(m)
    t = 2.0 * cos * (1.0 + b) / (cos + b) - 1.0
    after, later = 0.0 * t, 0.0 * t
    for c in m.coat[:0:-1]:
        after, later = c + 2.0 * t * after - later, after
    return jnp.clip(_masked(normals, m, w) * (m.coat[0] + t * after - later), 0.0, 1.0)


def _chance(normals: rough.Normals, m: Any, wo: Vec3) -> Any:
    return plastic.chance_of(m, 1.0 - _enters(normals, m, wo))


def _sample(normals: rough.Normals, m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    return where(u[2] < _chance(normals, m, wo), ggx.sample(m, wo, u), cosine_hemisphere((u[0], u[1])))


def _pdf(normals: rough.Normals, m: Any, wi: Vec3, wo: Vec3) -> Any:
    chance = _chance(normals, m, wo)
    return chance * ggx.pdf(m, wi, wo) + (1.0 - chance) * wi.z / np.pi


def _eval(normals: rough.Normals, m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    h = normalise(wi + wo)
    shine = dielectric(m.ior, jnp.clip(dot(h, wo), 0.0, 1.0))[0] * rough.reflected(normals, m, h, wi, wo)
    enters = _enters(normals, m, wi) * _enters(normals, m, wo)
    return m.specular * shine + plastic.paint(m, m.inside) * (enters / (np.pi * m.ior * m.ior))


FIELDS = ("alpha", "reflectance", "specular", "ior", "nonlinear", *DERIVED)


def _lobe(name: str, number: int, normals: rough.Normals) -> Lobe:
    of = lambda f: functools.partial(f, normals)
    return Lobe(name, number, FIELDS, of(_sample), of(_eval), of(_pdf), chooses=True, derive=of(_derive))


LOBES = _lobe("rough_plastic", 12, rough.GGX), _lobe("rough_plastic_beckmann", 13, rough.BECKMANN)
