"""Disney's principled surface (Burley 2012; 2015) as Mitsuba 3 has it: paint, a clear coat, and microfacets that
reflect as metal, tinted or clear glass, and transmit.

Seen from below, a surface is the one mirrored in its plane, with the inverse index, without paint, coat and colour of
reflections. A direction is drawn from one of paint, coat and facets; a facet drawn reflects or transmits. The density
is of all directions so drawn, also of those that have no value.
"""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..radiometry import LUMINANCE
from ..sampling.warp import circle, cosine_hemisphere
from ..vector import Spectrum, Vec3, dot, normalise, safe_sqrt, where
from . import ggx, rough
from .fresnel import dielectric
from .lobe import Lobe
from .material import Material

LEAST = 0.05
"""How bright a part is taken to be at least when one is drawn: dark ones have derivatives."""


def facets(m: Any, roughness: Any) -> Material:
    """Microfacets: α along both tangents (Burley 2012, section 5.4)."""
    aspect = safe_sqrt(jnp.maximum(1.0 - 0.9 * m.anisotropic, 0.05))
    a = roughness * roughness
    return Material(alpha=tuple(jnp.maximum(x, 1e-3) for x in (a / aspect, a * aspect)))


def schlick(cos: Any) -> Any:
    """(1 − cosθ)⁵, the part of Schlick's reflectance that grows towards grazing."""
    a = jnp.clip(1.0 - cos, 0.0, 1.0)
    return (a * a) * (a * a) * a


def tint(color: Spectrum) -> Spectrum:
    """A colour at luminance 1 (mean 1, if its channels are not red, green and blue); white for black."""
    c = color.channels
    weights = LUMINANCE if len(c) == 3 else (1.0 / len(c),) * len(c)
    y = sum(w * x for w, x in zip(weights, c, strict=True))
    colored = y > 1e-6
    return color.map(lambda x: jnp.where(colored, x / jnp.where(colored, y, 1.0), 1.0))


def mean(s: Spectrum) -> Any:
    return sum(s.channels) / len(s.channels)


def reflected(m: Any, metallic: Any, ratio: Any, cos: Any) -> tuple[Spectrum, Any]:
    """Reflectance of a facet: of metal and tinted glass by Schlick, of clear glass by Fresnel; and that of the last."""
    clear, t, _ = dielectric(ratio, cos)
    grazing = schlick(jnp.where(ratio > 1.0, cos, t))
    r0, glass = ((ratio - 1.0) / (ratio + 1.0)) ** 2, 1.0 - metallic

    def one(base: Any, hue: Any) -> Any:
        metal, tinted = base + (1.0 - base) * grazing, r0 * hue + (1.0 - r0 * hue) * grazing
        return metallic * metal + glass * ((1.0 - m.spec_tint) * clear + m.spec_tint * tinted)

    return m.reflectance.map(one, tint(m.reflectance)), clear


glint = functools.partial(rough.reflected, rough.GGX)
"""D G₁ G₁ / (4 cosθ_i cosθ_o) of microfacets, for h, ω_i and ω_o."""


def glint_density(m: Material, h: Vec3, o: Vec3) -> Any:
    """Of mirror directions about the normals that o sees, h half-way between the two."""
    return jnp.where(h.z > 0, 0.5 * ggx.distribution(m, h) * rough.GGX.masked(m, o), 0.0)


def paint(m: Any, h: Vec3, i: Vec3, o: Vec3, body: Any, sheen: Any) -> Spectrum:
    """Diffuse and retroreflection, flattened as if scattered inside, `body` times, and sheen."""
    ci, co, d = jnp.abs(i.z), o.z, dot(o, h)
    fi, fo, r = schlick(ci), schlick(co), 2.0 * m.roughness * d * d
    diffuse = (1.0 - 0.5 * fi) * (1.0 - 0.5 * fo) + r * (fi + fo + fi * fo * (r - 1.0))
    inside = (1.0 + (0.5 * r - 1.0) * fi) * (1.0 + (0.5 * r - 1.0) * fo)
    flat = 1.25 * (inside * (1.0 / ggx.positive(ci + co) - 0.5) + 0.5)
    shade = body / np.pi * (diffuse + m.flatness * (flat - diffuse))
    glow = sheen * schlick(d)
    return m.reflectance.map(lambda c, hue: c * shade + glow * (1.0 + m.sheen_tint * (hue - 1.0)), tint(m.reflectance))


def mirrored(side: Any, w: Vec3) -> Vec3:
    return Vec3(w.x, w.y, side * w.z)


def _sides(m: Any, wo: Vec3) -> tuple[Any, Any]:
    """−1 where ω_o is below, else 1; and the index on the other side over that on its own. An index of 1, whose
    facets would be seen by nobody, is taken as 1.001."""
    index = m.ior + sg(jnp.where(jnp.abs(m.ior - 1.0) < 1e-3, 1.001 - m.ior, 0.0))
    below = wo.z < 0
    return jnp.where(below, -1.0, 1.0), jnp.where(below, 1.0 / index, index)


def _split(m: Any, side: Any, ratio: Any, cos: Any) -> tuple[Spectrum, Spectrum]:
    """What a facet reflects, and what it transmits."""
    shine, clear = reflected(m, m.metallic, ratio, cos)
    glass = (1.0 - m.metallic) * m.spec_trans
    through = m.reflectance.map(lambda c: safe_sqrt(c) * (glass * (1.0 - clear)))
    return where(side > 0, shine, shine * 0.0 + glass * clear), through


def _coat_roughness(m: Any) -> Any:
    return jnp.maximum(0.1 - 0.099 * m.clearcoat_gloss, 5e-4)


def _coat_distribution(m: Any, h: Vec3) -> Any:
    """GTR of exponent 1 (Burley 2012, appendix B)."""
    a2 = _coat_roughness(m) ** 2
    return (a2 - 1.0) / (np.pi * jnp.log(a2) * (h.x * h.x + h.y * h.y + a2 * h.z * h.z))


def _coat(m: Any, ratio: Any, h: Vec3, i: Vec3, o: Vec3) -> Any:
    cos, masked = dot(o, h), functools.partial(rough.GGX.masked, Material(alpha=(0.25, 0.25)))
    f = 0.04 + 0.96 * schlick(jnp.where(ratio > 1.0, cos, dielectric(ratio, cos)[1]))
    return m.clearcoat * f * _coat_distribution(m, h) * jnp.abs(i.z) * o.z * masked(i) * masked(o)


def _bent(ratio: Any, i: Vec3, o: Vec3) -> tuple[Vec3, Any, Any, Any]:
    """The normal about which o is refracted into i, cosθ of both to it (0 if there is none), and |o + η i|²."""
    b = o + i * ratio
    h = normalise(b)
    h = h * jnp.where(h.z < 0, -1.0, 1.0)
    ci, co = -dot(i, h), dot(o, h)
    found = (ci > 0) & (co > 0)
    return h, jnp.where(found, ci, 0.0), jnp.where(found, co, 0.0), ggx.positive(dot(b, b))


def eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    side, ratio = _sides(m, wo)
    i, o, micro = mirrored(side, wi), mirrored(side, wo), facets(m, m.roughness)
    up, opaque = i.z > 0, 1.0 - m.metallic
    bent, ci, co, n = _bent(ratio, i, o)
    h = where(up, normalise(i + o), bent)
    shine, through = _split(m, side, ratio, jnp.where(up, dot(o, h), co))
    seen = glint(micro, h, i, o)
    layers = paint(m, h, i, o, opaque * (1.0 - m.spec_trans), opaque * m.sheen) + _coat(m, ratio, h, i, o)
    above = shine * seen + layers.map(lambda c: jnp.where(side > 0, c, 0.0))
    f = where(up, above, through * (seen * 4.0 * ci * co / n))
    return f.map(lambda c: jnp.where((o.z > 0) & (i.z != 0), c, 0.0))


def _chances(m: Any, side: Any, ratio: Any, o: Vec3) -> tuple[Any, Any]:
    """Of drawing a facet and of drawing the coat, by about how bright they look; the rest is paint's."""
    shine, through = _split(m, side, ratio, o.z)
    front, opaque = jnp.where(side > 0, 1.0, 0.0), 1.0 - m.metallic
    body = opaque * (1.0 - m.spec_trans) * jnp.maximum(mean(m.reflectance), LEAST) + LEAST * opaque * m.sheen
    facet = jnp.maximum(mean(shine) + mean(through), 2.0 * LEAST)
    coat, body = front * LEAST * m.clearcoat, front * body
    total = facet + coat + body
    return facet / total, coat / total


def _through(m: Any, side: Any, ratio: Any, cos: Any) -> Any:
    """The chance that a facet transmits."""
    shine, through = (mean(s) for s in _split(m, side, ratio, cos))
    total = shine + through
    return jnp.where(total > 0, through / jnp.where(total > 0, total, 1.0), 0.0)


def sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    m, wo = sg((m, wo))  # directions and densities are held fixed
    side, ratio = _sides(m, wo)
    o, micro = mirrored(side, wo), facets(m, m.roughness)
    facet, coat = _chances(m, side, ratio, o)
    h = ggx.visible_normal(micro.alpha, o, u)
    cos = jnp.maximum(dot(o, h), 0.0)
    refracted = h * (cos / ratio - dielectric(ratio, cos)[1]) - o * (1.0 / ratio)
    a2, (c, s) = _coat_roughness(m) ** 2, circle(u[0])
    sin2 = (jnp.exp(jnp.log(a2) * (1.0 - u[1])) - a2) / (1.0 - a2)
    sin = safe_sqrt(sin2)
    k = where(u[2] < facet, h, Vec3(sin * c, sin * s, safe_sqrt(1.0 - sin2)))
    i = where(u[2] < facet + coat, k * (2.0 * dot(o, k)) - o, cosine_hemisphere((u[0], u[1])))
    i = where(u[2] < facet * _through(m, side, ratio, cos), refracted, i)
    return mirrored(side, normalise(i))


def pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    m, wi, wo = sg((m, wi, wo))
    side, ratio = _sides(m, wo)
    i, o, micro = mirrored(side, wi), mirrored(side, wo), facets(m, m.roughness)
    facet, coat = _chances(m, side, ratio, o)
    h = normalise(i + o)
    cos = dot(o, h)
    p = facet * (1.0 - _through(m, side, ratio, cos)) * glint_density(micro, h, o)
    p = p + coat * _coat_distribution(m, h) * jnp.abs(h.z) / (4.0 * ggx.positive(cos))
    p = p + (1.0 - facet - coat) * jnp.maximum(i.z, 0.0) / np.pi
    h, ci, co, n = _bent(ratio, i, o)
    seen = ggx.visible_density(micro.alpha, h, o) * jnp.where(co > 0, 1.0, 0.0)
    return p + facet * _through(m, side, ratio, co) * seen * ci * ratio * ratio / n


FIELDS = (
    "reflectance", "ior", "roughness", "anisotropic", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint",
    "flatness", "clearcoat", "clearcoat_gloss",
)  # fmt: skip
LOBE = Lobe("principled", 20, FIELDS, sample, eval, pdf, transmits=True, translucent=True, chooses=True)
