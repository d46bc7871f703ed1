"""Where M ends or bends: the curves along which one part of M may hide another, as seen from anywhere.

Edges of triangles and parallelograms, each once: welded where they have the same ends in their shape's own space, so
that seams of texture coordinates are no borders; left out where the faces on both sides continue each other. Made on
the device from a scene's tables, by two sorts, where a derivative asks for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32

from .. import brdf
from ..scene import Scene
from ..vector import Vec3, cross, dot, length, normalise, safe_sqrt, where
from ..world import World
from . import curves, cuts
from .outline import Outline

CORNERS = {"triangle": ((0, 0), (1, 0), (0, 1)), "parallelogram": ((0, 0), (1, 0), (1, 1), (0, 1))}
"""Coordinates of a face's corners, in order."""

FLAT = 1e-4
"""Sine of the angle up to which two faces continue each other."""


CANDIDATES = 128
"""Edges, or faces, that one point chooses from; of more, this many drawn by length or area."""


class Edges(eqx.Module):
    """Straight edges of M in world space. All of it held fixed.

    `ends`: both ends (m); `beside`: of each face at the edge a point off it, the same twice at a border; `uv`:
    coordinates of the ends on the first face. A `crease` bends enough for radiance to jump across it even where
    both faces are seen; other edges matter where one face hides the other, and a little (`faint`) where shading is
    continuous but one face is in its own shadow. The last `cuts` rows are lines along which two faces cut through
    each other.
    """

    ends: Float[Array, "E 6"]
    beside: Float[Array, "E 6"]
    uv: Float[Array, "E 4"]
    faces: Int32[Array, "E 2"]
    border: Bool[Array, " E"]
    crease: Bool[Array, " E"]
    there: Bool[Array, " E"]
    shapes: Int32[Array, " P"]  # of each face
    mirrors: Float[Array, " P"] | None  # chance of each face, by area, to be the flat mirror in which edges are seen
    blocks: tuple[int, ...] = eqx.field(static=True)  # of faces, by kind: curved ones have outlines of their own
    cuts: int = eqx.field(static=True, default=0)
    faint: Float[Array, " E"] | None = None

    @property
    def curved(self) -> bool:
        """Whether there are curves; of grids of distances none are known."""
        return len(curves.listed(self.blocks)[1]) > 0

    def faces_at(self, j: Any) -> tuple[Any, Any]:
        """The faces at edge j, or at the curve of number j − E."""
        row = self.faces.at[j].get(mode="clip") if len(self.faces) else jnp.zeros(2, jnp.int32)
        faces = curves.listed(self.blocks)[1]
        if len(faces) == 0:
            return row[0], row[1]
        curved, face = j >= len(self.faces), jnp.asarray(faces).at[j - len(self.faces)].get(mode="clip")
        return jnp.where(curved, face, row[0]), jnp.where(curved, face, row[1])

    def belongs(self, j: Any, face: Any) -> Any:
        """Whether a face is of a shape of edge j: beside an outline one soon lands on the next face but one."""
        of = lambda face: self.shapes.at[jnp.maximum(face, 0)].get(mode="clip")
        a, b = self.faces_at(j)
        return (face >= 0) & ((of(face) == of(a)) | (of(face) == of(b)))

    def curve(self, world: World, c: Any, x: Vec3, u: Any) -> tuple[Vec3, Vec3, Vec3]:
        """`curves.point` of curve number c."""
        kinds, faces, names = curves.listed(self.blocks)
        face, found = jnp.asarray(faces).at[c].get(mode="clip"), None
        for k, name in enumerate(names):
            one = curves.point(world, face, name, x, u)
            found = one if found is None else where(jnp.asarray(kinds).at[c].get(mode="clip") == k, one, found)
        assert found is not None
        return found

    def point(self, world: World, j: Any, t: Any, x: Vec3) -> Vec3:
        """The point at t on edge j, or on the curve of number j − E as seen from x, that moves with M."""
        y = None
        if len(self.faces):
            uv, faces = self.uv.at[j].get(mode="clip"), self.faces.at[j].get(mode="clip")
            o, a, b = face = curves.corners(world, faces[0])
            y = o + a * (uv[0] + (uv[2] - uv[0]) * t) + b * (uv[1] + (uv[3] - uv[1]) * t)
            if self.cuts:
                cut = (j >= len(self.faces) - self.cuts) & (j < len(self.faces))
                y = where(cut, cuts.attach(face, curves.corners(world, faces[1]), y), y)
        if not self.curved:
            assert y is not None
            return y
        curved = self.curve(world, jnp.maximum(j - len(self.faces), 0), x, t)[0]
        return curved if y is None else where(j >= len(self.faces), curved, y)

    @property
    def chance(self) -> Any:
        """Of each edge by its length, for candidates where there are many."""
        along = self.ends[:, 3:] - self.ends[:, :3]
        long = jnp.sqrt((along * along).sum(-1)) * (self.there)
        return long / jnp.maximum(long.sum(), 1e-30)


def _halves(scene: Scene) -> tuple[Any, ...]:
    """Sides of faces in their shapes' own space: start and end, shape, face, coordinates of both, whether it exists,
    normals there (0 where a mesh has none), and a corner off it."""
    out = []
    for kind, corners in CORNERS.items():
        k = ("triangle", "parallelogram").index(kind)
        n, first = scene.blocks[k], scene.offset(kind)
        if n == 0:
            continue
        if kind == "triangle":
            at, normals = scene.vertices[scene.triangles], scene.normals[scene.triangles]
        else:
            o, a, b = (scene.patches[:n, j : j + 3] for j in (0, 3, 6))
            at = jnp.stack([o + a * u + b * v for u, v in corners], 1)
            normals = jnp.zeros_like(at)
        sides = len(corners)
        turn = np.roll(np.arange(sides), -1)
        face = jnp.broadcast_to(jnp.arange(first, first + n)[:, None], (n, sides))
        uv = np.array(corners, float)
        uvs = jnp.broadcast_to(np.concatenate([uv, uv[turn], uv[np.roll(turn, -1)]], -1), (n, sides, 6))
        real = jnp.broadcast_to((jnp.arange(n) < scene.counts[k])[:, None], (n, sides))
        pair = jnp.concatenate([at, at[:, turn]], -1), jnp.concatenate([normals, normals[:, turn]], -1)
        flat = lambda a, n=n * sides: a.reshape(n, *a.shape[2:])
        out.append(tuple(map(flat, (pair[0], face, uvs, real, pair[1]))))
    return tuple(jnp.concatenate(parts) for parts in zip(*out, strict=True))


def _numbered(*columns: Any) -> Any:
    """The same number for equal rows of columns."""
    order = jnp.lexsort(columns[::-1])
    new = jnp.zeros(len(order), bool)
    for c in columns:
        sorted_column = c[order]
        new |= jnp.concatenate([jnp.zeros(1, bool), sorted_column[1:] != sorted_column[:-1]])
    return jnp.zeros(len(order), jnp.int32).at[order].set(jnp.cumsum(new).astype(jnp.int32))


def edges_of(scene: Scene, world: World) -> Edges:
    """Where the surfaces of a scene end, bend or turn away."""
    scene, geometry = jax.lax.stop_gradient((scene, world.geometry))
    mirrors = _mirrors(scene, world) if brdf.has_delta(world.plan.lobes) else None
    if sum(scene.blocks[:2]) == 0:
        none = lambda n: jnp.zeros((0, n), geometry.dtype)
        no = jnp.zeros(0, bool)
        return Edges(
            none(6), none(6), none(4), none(2).astype(int), no, no, no, scene.face_shape, mirrors, scene.blocks
        )
    flat = tuple(enumerate(scene.blocks[:2]))
    at, face, uv, real, normals = _halves(scene)
    h = len(face)
    shape = scene.face_shape[face]
    ends = jnp.concatenate([at[:, :3], at[:, 3:]]) + 0.0  # −0 is 0
    number = _numbered(jnp.concatenate([shape, shape]), *ends.T)
    a, b = number[:h], number[h:]
    real &= a != b
    low = jnp.where(real, jnp.minimum(a, b), 2 * h + jnp.arange(h, dtype=jnp.int32))  # others are like none
    high = jnp.where(real, jnp.maximum(a, b), 0)
    order = jnp.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    first = jnp.concatenate([jnp.ones(1, bool), ~same]) & real[order]
    second = jnp.concatenate([order[1:], order[:1]])
    border = ~jnp.concatenate([same, jnp.zeros(1, bool)])
    one, other = order, jnp.where(border, order, second)
    faces = jnp.stack([face[one], face[other]], -1)

    row = geometry[faces[:, 0]]
    in_world = lambda row, u, v: row[:, :3] + row[:, 3:6] * u[:, None] + row[:, 6:9] * v[:, None]
    places = uv[one]
    p, q, off = (in_world(row, places[:, k], places[:, k + 1]) for k in (0, 2, 4))
    off_other = in_world(geometry[faces[:, 1]], uv[other][:, 4], uv[other][:, 5])
    along = q - p
    across = lambda at: _unit((at - p) - along * (_dot(at - p, along) / jnp.maximum(_dot(along, along), 1e-30)))
    s, t = across(off), across(off_other)
    bend = jnp.sqrt(_dot(jnp.cross(s, t), jnp.cross(s, t))[:, 0])
    straight = ~border & (bend < FLAT) & (_dot(s, t)[:, 0] < 0)
    # A mesh with vertex normals shades smoothly across an edge at which both faces have the same ones.
    flipped = jnp.where((a[one] == a[other])[:, None], normals[other], jnp.roll(normals[other], 3, -1))
    smooth = jnp.abs(normals[one]).sum(-1) > 0
    even = ~border & smooth & (jnp.abs(normals[one] - flipped) < 1e-6).all(-1)
    there = first & ~(straight & (even | ~smooth))
    rows = [
        jnp.concatenate([p, q], -1),
        jnp.concatenate([off, off_other], -1),
        places[:, :4],
        faces,
        border,
        ~even,
        there,
    ]
    found = cuts.lines(geometry, scene.blocks, jnp.concatenate([jnp.arange(n) < scene.counts[k] for k, n in flat]))
    if found is not None:
        ends, uv, faces, there = found
        aside = jnp.concatenate([ends[:, :3] + 1.0, ends[:, :3] - 1.0], -1)  # on both sides: these hide nothing
        more = ends, aside, uv, faces, ~there & there, there, there
        rows = [jnp.concatenate(pair) for pair in zip(rows, more, strict=True)]
    edges = Edges(
        *rows, shapes=scene.face_shape, mirrors=mirrors, blocks=scene.blocks, cuts=0 if found is None else len(found[0])
    )
    return replace(edges, faint=_faint(edges, world)) if world.plan.smooth_normals else edges


def _faint(edges: Edges, world: World) -> Any:
    """About how much radiance jumps, in units of what it may be, across edges at which shading is continuous: where
    one face sees more of a lamp above its horizon than the other, and a little everywhere."""
    geometry = jax.lax.stop_gradient(world.geometry)[edges.faces]
    m, n = (_unit(jnp.cross(geometry[:, k, 3:6], geometry[:, k, 6:9])) for k in (0, 1))
    bend = jnp.sqrt(_dot(m - n, m - n))[:, 0]
    middle = 0.5 * (edges.ends[:, :3] + edges.ends[:, 3:])

    def lit(ball: Any) -> Any:
        over = lambda n: jnp.clip(((ball[None, :3] - middle) * n).sum(-1) / jnp.maximum(ball[3], 1e-30), -1.0, 1.0)
        return 0.5 * jnp.abs(over(m) - over(n))

    most = jax.lax.map(lit, jax.lax.stop_gradient(world.light_bounds)).max(0, initial=0.0)
    return jnp.where(edges.crease, 1.0, jnp.minimum(bend * most + 0.05 * bend * bend, 1.0))


def _mirrors(scene: Scene, world: World) -> Any:
    plan, flat = world.plan, sum(scene.blocks[:3])
    geometry = jax.lax.stop_gradient(world.geometry[:flat])
    lobe = jnp.full(flat, float(brdf.LOBES[plan.lobes[0]].number))
    if "lobe" in plan.fields:
        column = brdf.MaterialColumns(plan.channels, plan.fields).at["lobe"][0]
        lobe = world.finishes[scene.shape_finish[scene.face_shape[:flat]], column]
    numbers = jnp.array([brdf.LOBES[name].number for name in plan.lobes if brdf.LOBES[name].delta])
    real = jnp.concatenate([jnp.arange(n) < scene.counts[k] for k, n in enumerate(scene.blocks[:3])])
    area = jnp.sqrt((jnp.cross(geometry[:, 3:6], geometry[:, 6:9]) ** 2).sum(-1))
    area = area * (real & jnp.isin(jnp.round(lobe).astype(int), numbers))
    return area / jnp.maximum(area.sum(), 1e-30)


class Cone(eqx.Module):
    """Directions about a unit axis, by the sine of the half angle; of sine 1 or more: all. `outline`: if those of a
    face are meant, and for straight edges these alone."""

    axis: Vec3
    sine: Any
    outline: Outline | None = None

    @classmethod
    def around(cls, ball: Any, x: Vec3, plane: Plane | None = None, outline: Outline | None = None) -> Cone:
        """What a ball (centre, radius), or its image in a mirror, takes of the directions from x, and hardly more."""
        centre = Vec3(ball[0], ball[1], ball[2])
        to = (centre if plane is None else plane.image(centre)) - x
        return cls(normalise(to), ball[3] / jnp.maximum(length(to), 1e-30) * 1.0005 + 1e-6, outline)


class Plane(eqx.Module):
    """A flat mirror's: a point of it and the unit normal."""

    o: Vec3
    n: Vec3

    @classmethod
    def of(cls, world: World, face: Any) -> Plane:
        o, a, b = curves.corners(world, face)
        return cls(o, normalise(cross(a, b)))

    def image(self, p: Vec3) -> Vec3:
        """Where a point is seen in the mirror."""
        return p - self.n * (2.0 * dot(self.n, p - self.o))

    def turned(self, w: Vec3) -> Vec3:
        """A direction, reflected."""
        return w - self.n * (2.0 * dot(self.n, w))


def two_points(row: Any, plane: Plane | None = None) -> tuple[Vec3, Vec3]:
    """The two points in a row of `ends` or `beside`, or their images in a mirror."""
    p, q = Vec3(row[0], row[1], row[2]), Vec3(row[3], row[4], row[5])
    return (p, q) if plane is None else (plane.image(p), plane.image(q))


def sums_of(weights: Any) -> Any:
    """Running sums, as a product: XLA would make each weight anew for every sum that holds it."""
    n = len(weights)
    return jnp.dot(weights, jnp.asarray(np.triu(np.ones((n, n))), weights.dtype), precision="highest")


def candidates(chance: Any, u: Any) -> tuple[Any, Any]:
    """Numbers of `CANDIDATES` of those with such chances, evenly drawn, and the inverse of how often each is meant."""
    at = (jnp.arange(CANDIDATES) + u) / CANDIDATES
    numbers = jnp.clip(jnp.searchsorted(jnp.cumsum(chance), at, side="right"), 0, len(chance) - 1)
    return numbers, 1.0 / (jnp.maximum(chance[numbers], 1e-30) * CANDIDATES)


def pick(sums: Any, u: Any) -> Any:
    """The number of a weight, by the running sums of all."""
    return jnp.minimum(jnp.sum(sums <= u * sums[-1]), len(sums) - 1)


def _dot(a: Any, b: Any) -> Any:
    return (a * b).sum(-1, keepdims=True)


def _unit(a: Any) -> Any:
    n = _dot(a, a)
    return a * jax.lax.rsqrt(jnp.where(n > 0, n, 1.0))


class Arc(eqx.Module):
    """An edge as seen from a point: the part of a great circle above the horizon, about its middle.

    Directions are middle · cosφ + along · sinφ for φ in (−half, half); `pole` is their normal. `distance` (m): of the
    middle.
    """

    middle: Vec3
    along: Vec3
    pole: Vec3
    half: Any
    distance: Any

    def direction(self, phi: Any) -> Vec3:
        return self.middle * jnp.cos(phi) + self.along * jnp.sin(phi)

    def towards(self, cone: Cone) -> tuple[Any, Any]:
        """The range of φ inside a cone; empty: low ≥ high."""
        if cone.outline is None:
            return self._towards(cone)
        a, b = cone.outline.cut(self)
        a, b, flat = jnp.maximum(a, -self.half), jnp.minimum(b, self.half), cone.outline.flat
        if flat is None:
            return a, b
        low, high = self._towards(cone)
        return jnp.where(flat, a, low), jnp.where(flat, b, high)

    def _towards(self, cone: Cone) -> tuple[Any, Any]:
        c, s = dot(cone.axis, self.middle), dot(cone.axis, self.along)
        reach = safe_sqrt(c * c + s * s)
        cos = safe_sqrt(1.0 - cone.sine * cone.sine) / jnp.maximum(reach, 1e-12)
        delta = jnp.where(cos < 1.0, jnp.arccos(jnp.minimum(cos, 1.0)), -1.0)
        delta = jnp.where(cone.sine < 1.0, delta, 2 * np.pi)
        at = jnp.arctan2(s, c)
        return jnp.maximum(-self.half, at - delta), jnp.minimum(self.half, at + delta)

    def within(self, cones: Sequence[Cone | None]) -> tuple[Any, Any]:
        """The range of φ inside all of some cones."""
        low, high = -self.half, self.half
        for cone in cones:
            if cone is not None:
                a, b = self.towards(cone)
                low, high = jnp.maximum(low, a), jnp.minimum(high, b)
        return low, high


def arc_of(ends: tuple[Vec3, Vec3], x: Vec3, n: Vec3 | None) -> Arc:
    """An edge between two points as seen from x, above the horizon of the normal n if one is given."""
    a, b = ends[0] - x, ends[1] - x
    gone = False
    if n is not None:
        fa, fb = dot(n, a), dot(n, b)
        gone = (fa <= 0) & (fb <= 0)
        span = jnp.where(fa == fb, 1.0, fa - fb)
        start, stop = jnp.where(fa < 0, fa / span, 0.0), jnp.where(fb < 0, fa / span, 1.0)
        a, b = a + (b - a) * start, a + (b - a) * stop
    normal = cross(a, b)
    sine = safe_sqrt(dot(normal, normal))
    theta = jnp.where(gone, 0.0, jnp.arctan2(sine, dot(a, b)))
    middle, pole = normalise(normalise(a) + normalise(b)), normalise(normal)
    to = a + (b - a) * 0.5
    return Arc(middle, cross(pole, middle), pole, 0.5 * theta, safe_sqrt(dot(to, to)))


def lies_in(world: World, edges: Edges, j: Any, x: Vec3, n: Vec3) -> Any:
    """Whether edge j lies in the plane through x with normal n: where both are of one face."""
    near = lambda p: jnp.abs(dot(n, p - x)) < 1e-4 * length(p - x) + 2.0 * world.epsilon
    p, q = two_points(edges.ends[j])
    return near(p) & near(q) & (dot(n, n) > 0.5)


def hides(edges: Edges, j: Any, x: Vec3, pole: Vec3, plane: Plane | None = None) -> Any:
    """Whether edge j (or its image in a mirror) is an outline as seen from x: M lies on one side of it only."""
    s, t = (dot(pole, p - x) for p in two_points(edges.beside[j], plane))
    return edges.border[j] | (s * t > 0)
