"""Light of an enclosure with a picture or a sky: looked up by direction, and sampled where it is bright.

Directions have coordinates (u, v): φ/2π around +y of the enclosure's own space, from −z over +x, and θ/π from +y. The
density is even in each cell of a grid as fine as the texture, in proportion to what comes from there; a share is spread
over all directions, so that none that carries light is forgotten.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from . import sky
from .sampling.warp import invert, uniform_sphere
from .texture import LAYOUT, sky_rows
from .vector import Vec3, normalise, safe_sqrt, transform_vector, where

if TYPE_CHECKING:
    from .scene import Scene

EVEN = 0.05
"""Of the samples, those that go into all directions alike."""


def _bitmap_lines(scene: Scene, first: Any, width: int, height: int) -> Any:
    """A picture at edges and middles of the grid's rows, (2 height + 1, width), in the mean of its channels."""
    texels = jax.lax.dynamic_slice_in_dim(scene.texels, first, width * height).mean(-1).reshape(height, width)
    rows = (jnp.arange(2 * height + 1) / (2.0 * height)) * (height - 1)
    low = jnp.minimum(rows.astype(jnp.int32), height - 2)
    part = (rows - low)[:, None].astype(texels.dtype)
    return texels[low] * (1.0 - part) + texels[low + 1] * part


def _sky_lines(scene: Scene, first: Any, width: int, height: int) -> Any:
    """The same of a sky."""
    u, v = (jnp.arange(width) + 0.5) / width, jnp.arange(2 * height + 1)[:, None] / (2.0 * height)
    dtype = scene.texels.dtype
    return sky.look_up(sky_rows(scene.texels, first), u[None].astype(dtype), v.astype(dtype)).array().mean(-1)


LINES = {"bitmap": _bitmap_lines, "sky": _sky_lines}


class Environment(eqx.Module):
    """The grid (rows, columns): `down` the cumulated share of its rows, `along` of the columns in each row, `density`
    per unit of u and v."""

    to_world: Any
    to_local: Any
    down: Any
    along: Any
    density: Any

    @classmethod
    def of(cls, scene: Scene, size: tuple[int, int], kind: str) -> Environment:
        """`size`: width and height of the enclosure's texture; `kind`: of that, bitmap or sky."""
        (width, height), first = size, scene.textures[scene.radiance_map[1], LAYOUT.index("offset")]
        # Means over cells whose corners lie between texels, and what bleeds in from beside them.
        lines = sg(LINES[kind](scene, first, width, height))
        light = 0.25 * lines[:-2:2] + 0.5 * lines[1:-1:2] + 0.25 * lines[2::2]
        light = 0.75 * light + 0.125 * (jnp.roll(light, 1, 1) + jnp.roll(light, -1, 1))
        theta = (np.arange(height) + 0.5) * np.pi / height
        light = light * jnp.asarray(np.sin(theta), light.dtype)[:, None]
        across, total = light.sum(1), light.sum()
        safe = jnp.where(across > 0, across, 1.0)[:, None]
        along = jnp.where(across[:, None] > 0, jnp.cumsum(light, 1) / safe, jnp.arange(1, width + 1)[None] / width)
        lit = total > 0
        down = jnp.where(lit, jnp.cumsum(across) / jnp.where(lit, total, 1.0), jnp.arange(1, height + 1) / height)
        density = jnp.where(lit, light * (width * height / jnp.where(lit, total, 1.0)), 1.0)
        turn = scene.around_to_world[0, :3, :3]
        return cls(turn, jnp.linalg.inv(turn), down, along, density)

    def coordinates(self, w: Vec3) -> tuple[Any, Any]:
        """(u, v) of a direction of the world."""
        x, y, z = normalise(transform_vector(self.to_local, w))
        across = x * x + z * z
        pole = across < 1e-12
        u = jnp.arctan2(jnp.where(pole, 0.0, x), jnp.where(pole, 1.0, -z)) / (2.0 * np.pi)
        return u - jnp.floor(u), jnp.arctan2(safe_sqrt(across), y) / np.pi

    def sample(self, u: tuple[Any, Any]) -> tuple[Vec3, Any]:
        """A direction of the world, and its density (sr⁻¹)."""
        height, width = self.density.shape
        even = u[0] < EVEN
        u = jnp.where(even, u[0] / EVEN, jnp.minimum((u[0] - EVEN) / (1.0 - EVEN), 1.0 - 2.0**-24)), u[1]
        at = lambda cdf, k: cdf.at[k].get(mode="clip", wrap_negative_indices=False)
        row, v = invert(lambda k: at(self.down, k), height, height, u[1])
        column, along = invert(lambda k: at(self.along.reshape(-1), row * width + k), width, width, u[0])
        phi, theta = 2.0 * np.pi * (column + along) / width, np.pi * (row + v) / height
        s = jnp.sin(theta)
        local = Vec3(jnp.sin(phi) * s, jnp.cos(theta), -jnp.cos(phi) * s)
        w = where(even, uniform_sphere(u), normalise(transform_vector(self.to_world, local)))
        return w, self.pdf(w)

    def pdf(self, w: Vec3) -> Any:
        """Density (sr⁻¹) of a direction of the world."""
        height, width = self.density.shape
        u, v = self.coordinates(w)
        column = jnp.clip((u * width).astype(jnp.int32), 0, width - 1)
        row = jnp.clip((v * height).astype(jnp.int32), 0, height - 1)
        s = jnp.maximum(jnp.sin(np.pi * v), 1e-6)
        cell = self.density.reshape(-1).at[row * width + column].get(mode="clip")
        return EVEN / (4.0 * np.pi) + (1.0 - EVEN) * cell / (2.0 * np.pi**2 * s)
