"""Grids of signed distances, and where a ray lands on the zero set of their trilinear interpolant."""

from __future__ import annotations

import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient as sg
from jaxtyping import Array, Float, Int32

from .scene import Scene
from .vector import Vec3, dot, normalise, safe_sqrt, where


class Grids(eqx.Module):
    """All grids of a scene; what is counted in voxels is called q here, 0 to n − 1 along each axis."""

    distances: Float[Array, " D"]
    layout: Int32[Array, "G 5"]  # first sample; samples along x, y, z; whether normals are smooth
    to_grid: Float[Array, "G 12"]  # from the world, about its centre, to q; 3x4, in rows

    @classmethod
    def of(cls, scene: Scene, center: Any) -> Grids:
        m = scene.to_world[scene.face_shape[scene.offset("sdfgrid") :]]
        voxels = (scene.grids[:, 1:4] - 1).astype(m.dtype)
        linear = jnp.linalg.inv(m[:, :3, :3]) * voxels[:, :, None]
        shift = -jnp.einsum("gij,gj->gi", linear, m[:, :3, 3] - center[None], precision="highest")
        return cls(scene.distances, scene.grids, jnp.concatenate([linear, shift[:, :, None]], -1).reshape(-1, 12))

    def ray(self, k: Any, o: Vec3, d: Vec3) -> tuple[Vec3, Vec3]:
        """A ray in voxels, with the same distances along it."""
        rows = [Vec3(*(self.to_grid[k, 4 * i + j] for j in range(3))) for i in range(3)]
        return Vec3(*(dot(r, o) + self.to_grid[k, 4 * i + 3] for i, r in enumerate(rows))), Vec3(
            *(dot(r, d) for r in rows)
        )

    def gradient(self, k: Any, g: Vec3) -> Vec3:
        """A gradient by q as one in the world."""
        return Vec3(*(sum(self.to_grid[k, 4 * i + j] * c for i, c in enumerate(g)) for j in range(3)))

    def sample(self, k: Any, at: Any) -> Any:
        """The sample at whole (x, y, z), or the nearest there is."""
        x, y, z = (jnp.clip(c, 0, self.layout[k, a + 1] - 1) for a, c in enumerate(at))
        index = self.layout[k, 0] + (z * self.layout[k, 2] + y) * self.layout[k, 1] + x
        return self.distances.at[index].get(mode="clip")

    def corners(self, k: Any, cell: Any) -> list[Any]:
        """Samples at the corners of a voxel, x fastest."""
        row = self.layout[k, 1]
        first, plane = (
            self.layout[k, 0] + (cell[2] * self.layout[k, 2] + cell[1]) * row + cell[0],
            self.layout[k, 2] * row,
        )
        found = [self.distances.at[first + z * plane + y * row + x] for z, y, x in _CORNERS]
        return [one.get(mode="promise_in_bounds") for one in found]  # where it is not, XLA takes the nearest

    def cell(self, k: Any, q: Vec3) -> list[Any]:
        return [jnp.clip(jnp.floor(c).astype(jnp.int32), 0, self.layout[k, a + 1] - 2) for a, c in enumerate(sg(q))]

    def land(self, k: Any, o: Vec3, d: Vec3, t: Any, smooth: bool) -> tuple[Any, Vec3, Vec3, Vec3]:
        """Distance, position, normal and shading normal (that only if `smooth`) at the root t of `meet`.

        Differentiable by the implicit function theorem: on the surface dt = −df / (∂f/∂t).
        """
        q, v = self.ray(k, o, d)
        cell = self.cell(k, q + v * t)
        corners = self.corners(k, cell)
        f, g = trilinear(corners, within(q + v * t, cell))
        slope = sg(dot(g, v))
        t = t - (f - sg(f)) / jnp.where(slope == 0, 1.0, slope)
        p = o + d * t
        # Put back onto the surface against rounding over the distance.
        f, g = trilinear(corners, within(self.ray(k, p, d)[0], cell))
        g = self.gradient(k, g)
        steep = sg(safe_sqrt(dot(g, g)))
        steep = jnp.where(steep > 0, steep, 1.0)
        n = normalise(g)
        p = p - n * sg(f / steep)
        if not smooth:
            return t, p, n, n
        wanted = self.layout[k, 4] > 0
        return t, p, n, where(wanted, self._smooth(k, q + v * t, cell), n)

    def _smooth(self, k: Any, q: Vec3, cell: list[Any]) -> Vec3:
        """Mitsuba's smooth normal: of the gradients in the eight voxels around q, brought to length 1, the mean that is
        linear between the middles of voxels. A difference along one axis is interpolated along the others."""
        inside, voxels = tuple(within(q, cell)), [self.layout[k, a + 1] - 1 for a in range(3)]
        pairs, shares = [], []
        for a, at_a in enumerate(q):
            b, c = (a + 1) % 3, (a + 2) % 3
            low = jnp.floor(sg(at_a) - 0.5).astype(jnp.int32)

            def difference(e: Any, a: int = a, b: int = b, c: int = c) -> Any:
                total = 0.0
                for s, r in itertools.product((0, 1), repeat=2):
                    at: list[Any] = [None] * 3
                    at[b], at[c], weight = cell[b] + s, cell[c] + r, _share(inside[b], s) * _share(inside[c], r)
                    ends = [self.sample(k, [e + h if i == a else at[i] for i in range(3)]) for h in (0, 1)]
                    total = total + weight * (ends[1] - ends[0])
                return total * voxels[a]

            pairs.append((difference(jnp.maximum(low, 0)), difference(low + 1)))
            shares.append(at_a - 0.5 - low)
        total = Vec3(0.0, 0.0, 0.0)
        for x, y, z in _CORNERS:
            weight = _share(shares[0], x) * _share(shares[1], y) * _share(shares[2], z)
            total = total + normalise(Vec3(pairs[0][x], pairs[1][y], pairs[2][z])) * weight
        return normalise(self.gradient(k, Vec3(*(c / n for c, n in zip(total, voxels, strict=True)))))


_CORNERS = tuple(itertools.product((0, 1), repeat=3))


def _share(f: Any, side: int) -> Any:
    return f if side else 1.0 - f


def within(q: Vec3, cell: list[Any]) -> Vec3:
    return Vec3(*(c - i for c, i in zip(q, cell, strict=True)))


def trilinear(v: list[Any], f: Vec3) -> tuple[Any, Vec3]:
    """Value and gradient at f of the interpolant of corners v, x fastest."""
    mix = lambda a, b, s: a + (b - a) * s
    x = [mix(v[k], v[k + 1], f.x) for k in (0, 2, 4, 6)]
    y = [mix(x[0], x[1], f.y), mix(x[2], x[3], f.y)]
    along_x = [v[k + 1] - v[k] for k in (0, 2, 4, 6)]
    gx = mix(mix(along_x[0], along_x[1], f.y), mix(along_x[2], along_x[3], f.y), f.z)
    return mix(y[0], y[1], f.z), Vec3(gx, mix(x[1] - x[0], x[3] - x[2], f.z), y[1] - y[0])
