"""The dense backend: every ray against every face, in unrolled blocks. The fastest up to a few hundred faces.

A flat face is an affine map to its own coordinates (height, u, v), 12 numbers; triangles, parallelograms and
disks differ only in which (u, v) are inside. Coordinates are about the scene's centre, so that a scene far
from the origin loses nothing. Inside tests reach out by the rounding error: no ray slips between neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from ..grids import Grids
from ..vector import Vec3, cross, dot
from .faces import Faces
from .grids import meet

FLAT = ("triangle", "parallelogram", "disk")
UNROLL = 6  # measured best on both jax 0.10 and 0.12 between 4 and 12


class Dense(eqx.Module):
    flat: tuple[Float[Array, "n 13"], ...]  # triangles, parallelograms, disks: height, u, v maps and a tolerance
    spheres: Float[Array, "n 4"]
    cylinders: Float[Array, "n 8"]
    counts: Int32[Array, " 6"]
    grids: Grids | None
    center: Float[Array, " 3"]
    least: Float[Array, ""]
    blocks: tuple[int, ...] = eqx.field(static=True)
    first_kind: int = eqx.field(static=True)  # kinds before it are searched elsewhere

    @classmethod
    def build(cls, faces: Faces, first_kind: int = 0) -> Dense:
        """Tables of faces, from a kind on; instances are not among them."""
        geometry, blocks = faces.geometry, faces.blocks
        table = flat_columns(faces.maps, faces.epsilon)
        starts = [sum(blocks[:k]) for k in range(6)]
        flat = [table[starts[k] : starts[k + 1] if k >= first_kind else starts[k]] for k in range(3)]
        o, a, b = geometry[:, :3], geometry[:, 3:6], geometry[:, 6:9]
        ball, tube = slice(starts[3], starts[4]), slice(starts[4], starts[5])
        l2 = jnp.sum(a[tube] ** 2, -1, keepdims=True)
        used = l2 > 0
        tubes = [o[tube], jnp.where(used, a[tube] / jnp.where(used, l2, 1.0), 0.0)]
        tubes += [jnp.where(used, l2, -1.0), jnp.sum(b[tube] ** 2, -1, keepdims=True)]
        return cls(
            flat=tuple(flat),
            spheres=jnp.concatenate([o[ball], jnp.sum(a[ball] ** 2, -1, keepdims=True)], -1),
            cylinders=jnp.concatenate(tubes, -1),
            grids=faces.grids,
            counts=faces.counts,
            center=faces.center,
            least=-0.5 * faces.epsilon,
            blocks=blocks,
            first_kind=first_kind,
        )

    def closest(self, o: Vec3, d: Vec3, exclude: Any = None, best: tuple[Any, Any] | None = None) -> Any:
        """Number of the first face along the ray, −1 if none. `exclude`: faces to skip, one or several numbers.

        `best`: distance and face that another search has found already.
        """
        return jnp.imag(self.nearest(o, d, exclude, best)).astype(jnp.int32)

    def nearest(self, o: Vec3, d: Vec3, exclude: Any = None, best: tuple[Any, Any] | None = None) -> Any:
        """As `closest`: distance (m) and face in one complex number, ∞ and −1 if none."""
        o, d = self._ray(o, d)

        # Distance and face travel as one complex number: XLA writes one kernel an output, and two
        # outputs would test every face twice (29 ns a ray instead of 42 at 36 triangles).
        real = d.x.dtype

        def nearer(best: Any, face: Any, ok: Any, t: Any) -> Any:
            ok = ok & (t < jnp.real(best)) & allowed(face, exclude)
            return jnp.where(ok, jax.lax.complex(t, jnp.full_like(t, face.astype(real))), best)

        t, face = best or (jnp.full_like(d.x, jnp.inf), jnp.full_like(d.x, -1.0))
        found = jax.lax.complex(t, jnp.asarray(face, real))
        return self._each(o, d, found, nearer)

    def occluded(self, o: Vec3, d: Vec3, distance: Any, exclude: Any = None) -> Any:
        """Whether any face but the excluded ones lies before `distance` (m)."""
        o, d = self._ray(o, d)

        def block(found: Any, face: Any, ok: Any, t: Any) -> Any:
            return found | (ok & (t < distance) & allowed(face, exclude))

        return self._each(o, d, jnp.zeros(jnp.shape(d.x), bool), block)

    def _ray(self, o: Vec3, d: Vec3) -> tuple[Vec3, Vec3]:
        o, d = jax.lax.stop_gradient((o, d))
        return o - Vec3(*self.center), d

    def _each(self, o: Vec3, d: Vec3, carry: Any, update: Callable[..., Any]) -> Any:
        """Folds `update(carry, face, inside, t)` over all faces."""
        tests = [*(_flat_test(kind, table) for kind, table in zip(FLAT, self.flat, strict=True))]
        tests += [_sphere_test(self.spheres), _cylinder_test(self.cylinders)]
        for k, (test, size) in enumerate(zip(tests, self.blocks[:5], strict=True)):
            if size == 0 or k < self.first_kind:
                continue
            first, unroll = sum(self.blocks[:k]), min(UNROLL, size)

            def body(i: Any, c: Any, test: Any = test, first: int = first, unroll: int = unroll) -> Any:
                for j in range(unroll):
                    row = jnp.minimum(i * unroll + j, size - 1)  # noqa: B023
                    for ok, t in test(row, o, d):
                        c = update(c, first + row, ok & (t > self.least), t)
                return c

            carry = jax.lax.fori_loop(0, (self.counts[k] + unroll - 1) // unroll, body, carry)
        return carry if self.grids is None else self._each_grid(self.grids, o, d, carry, update)

    def _each_grid(self, grids: Grids, o: Vec3, d: Vec3, carry: Any, update: Callable[..., Any]) -> Any:
        def body(k: Any, c: Any) -> Any:
            return update(c, sum(self.blocks[:5]) + k, *meet(grids, k, o, d, self.least))

        return jax.lax.fori_loop(0, self.counts[5], body, carry)


def allowed(face: Any, exclude: Any) -> Any:
    ok = True
    for other in several(exclude):
        ok = ok & (face != other)
    return ok


def several(exclude: Any) -> tuple[Any, ...]:
    """Faces to skip, given as nothing, a number, numbers or an array of them."""
    if exclude is None:
        return ()
    if isinstance(exclude, (tuple, list)):
        return tuple(exclude)
    return tuple(exclude) if jnp.ndim(exclude) else (exclude,)


def affine(o: Any, a: Any, b: Any) -> Any:
    """Rows (n, c₀, U, c₁, V, c₂): height n·p + c₀ and coordinates U·p + c₁, V·p + c₂ of p over o + u a + v b."""
    area = jnp.cross(a, b)
    l2 = jnp.sum(area * area, -1, keepdims=True)
    ok = l2 > 0
    safe = jnp.where(ok, l2, 1.0)
    n = jnp.where(ok, area * jax.lax.rsqrt(safe), 0.0)
    u, v = jnp.where(ok, jnp.cross(b, area) / safe, 0.0), jnp.where(ok, jnp.cross(area, a) / safe, 0.0)
    constant = lambda w: -jnp.sum(w * o, -1, keepdims=True)
    # A face without area lies nowhere: its height is constant, so a ray never reaches it.
    return jnp.concatenate([n, jnp.where(ok, constant(n), 1.0), u, constant(u), v, constant(v)], -1)


def flat_columns(maps: Any, epsilon: Any) -> Any:
    """`affine` maps of flat faces, and how far in u and v their inside tests reach out, (n, 13)."""
    u, v = maps[:, 4:7], maps[:, 8:11]
    steep = jnp.sqrt(jnp.maximum(jnp.sum(u * u, -1), jnp.sum(v * v, -1)))
    return jnp.concatenate([maps, (0.5 * epsilon * steep)[:, None]], -1)


def _flat_test(kind: str, table: Any) -> Callable[..., Any]:
    def test(k: Any, o: Vec3, d: Vec3) -> Any:
        return (flat_crossing(kind, [table[k, j] for j in range(13)], o, d),)

    return test


def flat_crossing(kind: str, r: Any, o: Vec3, d: Vec3) -> Any:
    """Whether a ray crosses the flat face with the columns r, and at which distance."""
    n, u, v = Vec3(*r[0:3]), Vec3(*r[4:7]), Vec3(*r[8:11])
    t = -(dot(n, o) + r[3]) / dot(n, d)
    p = o + d * t
    a, b, slack = dot(u, p) + r[7], dot(v, p) + r[11], r[12]
    if kind == "triangle":
        inside = jnp.minimum(jnp.minimum(a, b), 1.0 - a - b) >= -slack
    elif kind == "parallelogram":
        inside = jnp.maximum(jnp.abs(a - 0.5), jnp.abs(b - 0.5)) <= 0.5 + slack
    else:
        inside = a * a + b * b <= 1.0
    return inside, t


def _sphere_test(table: Any) -> Callable[..., Any]:
    def test(k: Any, o: Vec3, d: Vec3) -> Any:
        s, r2 = o - Vec3(table[k, 0], table[k, 1], table[k, 2]), table[k, 3]
        b = dot(s, d)
        away = s - d * b
        disc = r2 - dot(away, away)
        q = -(b + jnp.where(b >= 0, 1.0, -1.0) * jnp.sqrt(jnp.maximum(disc, 0.0)))
        other = (dot(s, s) - r2) / q
        return ((disc > 0, q), (disc > 0, other))

    return test


def _cylinder_test(table: Any) -> Callable[..., Any]:
    def test(k: Any, o: Vec3, d: Vec3) -> Any:
        r = [table[k, j] for j in range(8)]
        s, along, l2, r2 = o - Vec3(*r[0:3]), Vec3(*r[3:6]), r[6], r[7]
        hs, hd = dot(s, along), dot(d, along)  # heights, 0 to 1 along the axis
        axis = along * l2
        so, do = s - axis * hs, d - axis * hd
        a, b, c = dot(do, do), dot(so, do), dot(so, so) - r2
        turn = cross(so, do)
        disc = a * r2 - dot(turn, turn)  # b² − a c, which cancels far from a thin tube
        q = -(b + jnp.where(b >= 0, 1.0, -1.0) * jnp.sqrt(jnp.maximum(disc, 0.0)))
        t0, t1 = q / a, c / q
        fits = lambda t: (disc > 0) & (l2 > 0) & (hs + t * hd >= 0) & (hs + t * hd <= 1)
        return ((fits(t0), t0), (fits(t1), t1))

    return test
