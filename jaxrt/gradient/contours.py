"""Contours of vertex normals: curves inside faces where these turn away from who looks, n(x)·(o − x) = 0.

Radiance jumps there, short of the mesh's outline (Hertzmann and Zorin 2000, "Illustrating smooth surfaces", section
4). With f = n·(o − x) and L = H(f) L₊ + H(−f) L₋ on a face

    d ∫ h L dq = ∫ h (L₊ − L₋) δ(f) ḟ dq,

ḟ being the change at a place q of the film, or in a direction, that is held fixed. On a face f is a quadratic
polynomial of its coordinates (u, v): roots are found along lines across the contour.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient as sg

from ..scene import FACE
from ..surface import surface_point
from ..texture import _row
from ..vector import Vec3, cross, dot, length, normalise, safe_sqrt
from ..world import World
from .curves import corners
from .edges import CANDIDATES, candidates, pick, sums_of


class Contour(eqx.Module):
    """A point of a contour: its face, (u, v) there; points of the face beside it (m), where normals look away from the
    eye (`dark`) and where not; the inverse of its density over du dv, times δ(f)/δ(`level`), 0 if there is none."""

    face: Any
    uv: tuple[Any, Any]
    dark: Vec3
    light: Vec3
    weight: Any

    def seen_from(self, world: World, x: Vec3) -> tuple[Vec3, Any]:
        """Its direction, and the solid angle (sr) of du dv there."""
        _, a, b = corners(world, self.face)
        to = at(world, self.face, self.uv) - x
        d = normalise(to)
        return d, jnp.abs(dot(cross(a, b), d)) / jnp.maximum(dot(to, to), world.epsilon**2)


def at(world: World, face: Any, uv: tuple[Any, Any]) -> Vec3:
    """The point of a face at (u, v)."""
    o, a, b = corners(world, face)
    return o + a * uv[0] + b * uv[1]


def level(world: World, face: Any, o: Vec3, d: Vec3) -> Any:
    """−n·d of the unit normal where the ray (o, d) meets the face, attached: 0 on the contour."""
    return -dot(surface_point(world, face, o, d).shading, d) * sg(_row(world.faces, face)[FACE["side"]])


NEARER = 0.1
"""Where between an edge and what is met beside it light is taken: it varies across faces that are seen end-on."""


def short_of(world: World, face: Any, edge: tuple[Vec3, Vec3], ray: tuple[Vec3, Vec3]) -> tuple[Vec3, Vec3]:
    """Of the ray to an edge, and one that meets a face beside it, one between them, nearer to the edge, and on the
    edge's side of a contour of that face: where a contour leaves through an edge it is as close as one likes."""
    here, there = level(world, face, *edge), level(world, face, *ray)
    gap = jnp.abs(here) + jnp.abs(there)
    crossed = (face >= 0) & ((here < 0) != (there < 0))
    share = jnp.where(crossed, jnp.minimum(0.3 * jnp.abs(here) / jnp.where(gap > 0, gap, 1.0), NEARER), NEARER)
    o, d = (a + (b - a) * share for a, b in zip(edge, ray, strict=True))
    return o, normalise(d)


def _normals(world: World, face: Any) -> tuple[Vec3, Vec3, Vec3]:
    row, k = _row(world.faces, face), FACE["extra"]
    return tuple(Vec3(*(row[j] for j in range(i, i + 3))) for i in (k, k + 3, k + 6))  # pyright: ignore


class _Lines(eqx.Module):
    """f over a face as seen from x, 1, u, v, u², v², uv by their factors, and lines across its contour: directions
    along g, at distances from `low` to `high` along its perpendicular p, in coordinates (u, v)."""

    factors: tuple[Any, ...]
    g: tuple[Any, Any]
    p: tuple[Any, Any]
    low: Any
    high: Any

    @classmethod
    def of(cls, world: World, face: Any, x: Vec3) -> _Lines:
        (o, a, b), (n, n1, n2) = corners(world, face), _normals(world, face)
        e, m, k = x - o, n1 - n, n2 - n
        f = dot(n, e), dot(m, e) - dot(n, a), dot(k, e) - dot(n, b), -dot(m, a), -dot(k, b), -dot(m, b) - dot(k, a)
        g = f[1] + (2 * f[3] + f[5]) / 3, f[2] + (2 * f[4] + f[5]) / 3  # ∇f in the middle
        size = safe_sqrt(g[0] * g[0] + g[1] * g[1])
        over = jnp.where(size > 0, size, 1.0)
        g = jnp.where(size > 0, g[0] / over, 0.0), jnp.where(size > 0, g[1] / over, 1.0)
        p = -g[1], g[0]
        ends = jnp.stack([0.0 * p[0], *p])
        return cls(f, g, p, ends.min(), ends.max())

    @property
    def share(self) -> Any:
        """About how many of the lines meet the contour; 0 where it cannot be on the face."""
        f, u, v, uu, vv, uv = self.factors
        ends = f, f + u + uu, f + v + vv
        bezier = jnp.stack([*ends, f + u / 2, f + v / 2, f + (u + v + uv) / 2])  # f is between these
        a, b, c = jnp.sort(jnp.stack(ends))
        up, down = -a / jnp.where(b > a, b - a, 1.0), c / jnp.where(c > b, c - b, 1.0)
        share = jnp.clip(jnp.where(b > 0, up, down), 0.05, 1.0)
        return jnp.where((bezier.min() < 0) & (bezier.max() > 0), share, 0.0)

    def root(self, s: Any, u: Any, fine: Any) -> tuple[Any, Any, Any, Any]:
        """One of the roots on line s inside the face, by u; how far beside it to look, ∂f there, and their number."""
        f, g, at = self.factors, self.g, (self.p[0] * s, self.p[1] * s)
        low, high = jnp.full_like(s, -jnp.inf), jnp.full_like(s, jnp.inf)
        for value, slope in ((at[0], g[0]), (at[1], g[1]), (1.0 - at[0] - at[1], -g[0] - g[1])):
            border = -value / jnp.where(slope == 0, 1.0, slope)
            low = jnp.where(slope > 0, jnp.maximum(low, border), low)
            high = jnp.where(slope < 0, jnp.minimum(high, border), high)
        a = f[3] * g[0] ** 2 + f[4] * g[1] ** 2 + f[5] * g[0] * g[1]
        b = (f[1] + 2 * f[3] * at[0] + f[5] * at[1]) * g[0] + (f[2] + 2 * f[4] * at[1] + f[5] * at[0]) * g[1]
        c = f[0] + (f[1] + f[3] * at[0]) * at[0] + (f[2] + f[4] * at[1] + f[5] * at[0]) * at[1]
        d = safe_sqrt(b * b - 4 * a * c)
        half = -0.5 * (b + jnp.where(b < 0, -d, d))
        one, two = half / jnp.where(a == 0, 1.0, a), c / jnp.where(half == 0, 1.0, half)
        first = (a != 0) & (d > 0) & (one > low) & (one < high)
        second = (half != 0) & (d > 0) & (two > low) & (two < high)
        chosen = jnp.where(first & ~(second & (u < 0.5)), one, two)
        room = jnp.minimum(chosen - low, high - chosen)
        room = jnp.where(first & second, jnp.minimum(room, jnp.abs(one - two)), room)
        aside = jnp.minimum(fine * (high - low), 0.5 * room)
        return chosen, aside, 2 * a * chosen + b, first.astype(s.dtype) + second.astype(s.dtype)


def choose(world: World, x: Vec3, n: Vec3 | None, s: Any, every: bool = False) -> Contour:
    """A point of a contour as seen from x, above the horizon of n. `every`: whether to look at all faces, else at
    those that are drawn by area where there are many."""
    u, v = s.pair_at(0)
    total = world.blocks[0]
    numbers, scale = jnp.arange(total), jnp.ones(total, world.faces.dtype)
    if total > CANDIDATES and not every:
        area = cross(*(Vec3(*world.geometry[:total, k : k + 3].T) for k in (3, 6)))
        chance = length(area) * jnp.any(world.faces[:total, FACE["extra"] : FACE["extra"] + 9] != 0, -1)
        numbers, scale = candidates(chance / jnp.maximum(chance.sum(), 1e-30), s.pair_at(1)[0])

    def weigh(face: Any, scale: Any) -> Any:
        lines, (o, a, b) = _Lines.of(world, face, x), corners(world, face)
        to, along = o + (a + b) * (1 / 3) - x, (a * lines.p[0] + b * lines.p[1]) * (lines.high - lines.low)
        r = jnp.maximum(length(to), world.epsilon)
        above = True if n is None else (jnp.stack([dot(n, c - x) for c in (o, o + a, o + b)]) > 0).any()
        return jnp.where(above, scale * length(cross(along, to)) / (r * r * r) * safe_sqrt(lines.share), 0.0)

    weights = jax.vmap(weigh)(numbers, scale)
    if len(numbers) <= CANDIDATES:
        sums = sums_of(weights)
        k = pick(sums, u)
    else:  # the same for all points
        sums = jnp.cumsum(weights)
        k = jnp.minimum(jnp.searchsorted(sums, u * sums[-1], side="right"), total - 1)
    face, chance = numbers[k], weights[k] / jnp.where(sums[-1] > 0, sums[-1], 1.0)
    lines = _Lines.of(world, face, x)
    line = lines.low + (lines.high - lines.low) * v
    fine = 5e-3 if world.faces.dtype == jnp.float32 else 1e-4
    t, aside, slope, count = lines.root(line, s.pair_at(2)[0], fine)
    place = lambda t: (lines.p[0] * line + lines.g[0] * t, lines.p[1] * line + lines.g[1] * t)
    uv, step = place(t), jnp.where(slope < 0, -aside, aside)
    n0, n1, n2 = _normals(world, face)
    unit = length(n0 * (1 - uv[0] - uv[1]) + n1 * uv[0] + n2 * uv[1]) * length(at(world, face, uv) - x)
    ok = (chance > 0) & (count > 0) & (aside > 0) & (slope != 0)
    weight = (lines.high - lines.low) * count * unit * scale[k] / jnp.where(ok, jnp.abs(slope) * chance, 1.0)
    dark, light = at(world, face, place(t - step)), at(world, face, place(t + step))
    return Contour(face, uv, dark, light, jnp.where(ok, weight, 0.0))
