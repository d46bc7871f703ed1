"""Disney's principled surface of a thin sheet (Burley 2015) as Mitsuba 3 has it: alike from both sides, not bending
light, with paint that light gets through. What facets transmit is what others, of the roughness of both faces, would
reflect, mirrored.

As in `principled`, the density is of all directions that are drawn, also of those that have no value.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from ..sampling.warp import cosine_hemisphere
from ..vector import Spectrum, Vec3, dot, normalise, where
from . import ggx
from .lobe import Lobe
from .material import Material
from .principled import FIELDS, LEAST, facets, glint, glint_density, mean, mirrored, paint, reflected


def _through(m: Any) -> Material:
    """Facets that spread light as far as the two faces of the sheet do together (Burley 2015, figure 15)."""
    return facets(m, (0.65 * m.ior - 0.35) * m.roughness)


def _split(m: Any, cos: Any) -> tuple[Spectrum, Spectrum]:
    """What a facet reflects, and what it transmits."""
    shine, clear = reflected(m, 0.0, m.ior, cos)
    return shine * m.spec_trans, m.reflectance * (m.spec_trans * (1.0 - clear))


def _both(wi: Vec3, wo: Vec3) -> tuple[Vec3, Vec3]:
    """The directions with ω_o above."""
    side = jnp.where(wo.z < 0, -1.0, 1.0)
    return mirrored(side, wi), mirrored(side, wo)


def _half(i: Vec3, o: Vec3) -> Vec3:
    """Half-way between o and i mirrored up."""
    return normalise(Vec3(i.x, i.y, jnp.abs(i.z)) + o)


def eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    i, o = _both(wi, wo)
    h = _half(i, o)
    shine, through = _split(m, dot(o, h))
    body, leaves = 1.0 - m.spec_trans, 0.5 * m.diff_trans
    above = shine * glint(facets(m, m.roughness), h, i, o)
    above = above + paint(m, h, i, o, body * (1.0 - leaves), body * (1.0 - leaves) * m.sheen)
    behind = jnp.where(dot(i, h) < 0, glint(_through(m), h, i, o), 0.0)  # on the other side of the facet as well
    below = through * behind + m.reflectance * (body * leaves / np.pi)
    seen = lambda up, down: jnp.where(o.z > 0, jnp.where(i.z > 0, up, jnp.where(i.z < 0, down, 0.0)), 0.0)
    return above.map(seen, below)


def _chances(m: Any, o: Vec3) -> tuple[Any, Any, Any]:
    """Of drawing a facet that reflects, one that transmits, and paint on this side, by about how bright they look; the
    rest is paint's on the other."""
    shine, through = (jnp.maximum(mean(s), LEAST * m.spec_trans) for s in _split(m, o.z))
    body, leaves = 1.0 - m.spec_trans, 0.5 * m.diff_trans
    body = body * (jnp.maximum(mean(m.reflectance), LEAST) + LEAST * m.sheen)
    total = shine + through + body
    return shine / total, through / total, (1.0 - leaves) * body / total


def sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    m, wo = sg((m, wo))
    _, o = _both(wo, wo)
    shine, through, stays = _chances(m, o)
    glints = u[2] < shine + through
    front = (u[2] < shine) | (~glints & (u[2] < shine + through + stays))
    rough, smooth = facets(m, m.roughness).alpha, _through(m).alpha
    h = ggx.visible_normal(where(front, rough, smooth), o, u)
    i = normalise(where(glints, h * (2.0 * dot(o, h)) - o, cosine_hemisphere((u[0], u[1]))))
    return mirrored(jnp.where(front == (wo.z >= 0), 1.0, -1.0), i)


def pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    m, wi, wo = sg((m, wi, wo))
    i, o = _both(wi, wo)
    shine, through, stays = _chances(m, o)
    cast = lambda rough, i: glint_density(rough, normalise(i + o), o)
    p = shine * cast(facets(m, m.roughness), i) + through * cast(_through(m), mirrored(-1.0, i))
    leaves = 1.0 - shine - through - stays
    return p + jnp.where(i.z > 0, stays * i.z, jnp.maximum(leaves, 0.0) * -i.z) / np.pi


SHEET = (*(f for f in FIELDS if f not in ("metallic", "clearcoat", "clearcoat_gloss")), "diff_trans")
LOBE = Lobe("principled_thin", 21, SHEET, sample, eval, pdf, transmits=True, translucent=True, chooses=True)
