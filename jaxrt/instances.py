"""Instances: groups of triangles that stand in the scene several times and are stored once.

A group's triangles have rows of their own in every table, in the group's space. What a ray meets there is
numbered behind all rows: instance by instance, each with as many numbers as its group has triangles.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from .vector import Vec3, dot


class Instances(eqx.Module):
    """Placements by 3x4 matrices in rows; a last one, the identity, for all else."""

    groups: Int32[Array, "G 2"]  # first row and how many; they lie in order
    group: Int32[Array, " I"]  # of each instance, −1 for padding
    first: Int32[Array, " I"]  # row of its first triangle
    ends: Int32[Array, " I"]  # how many numbers the instances up to this one take
    to_world: Float[Array, "I1 12"]
    to_local: Float[Array, "I1 12"]
    rows: int = eqx.field(static=True)  # of the tables

    @classmethod
    def of(cls, scene: Any) -> Instances:
        """The instances of a scene about the origin."""
        group = jnp.maximum(scene.instance_group, 0)
        count = jnp.where(scene.instance_group >= 0, scene.groups[group, 1], 0)
        m = jnp.concatenate([scene.instances, jnp.eye(4, dtype=scene.instances.dtype)[None]])
        rows = lambda m: m[:, :3].reshape(-1, 12)
        first, ends = scene.groups[group, 0], jnp.cumsum(count)
        return cls(scene.groups, scene.instance_group, first, ends, rows(m), rows(jnp.linalg.inv(m)), scene.faces)

    @property
    def group_of_row(self) -> Any:
        """The group of each row, −1 if none."""
        row = jnp.arange(self.rows)
        k = jnp.searchsorted(self.groups[:, 0], row, side="right").astype(jnp.int32) - 1
        inside = (k >= 0) & (row < self.groups[jnp.maximum(k, 0)].sum(-1))
        return jnp.where(inside, k, -1)

    def _over_groups(self, reduce: Any, rows: Any) -> Any:
        """Rows (P, ...) of each group reduced to one, (G, ...)."""
        g, group = len(self.groups), self.group_of_row
        return reduce(rows, jnp.where(group < 0, g, group), g + 1)[:g]

    def centers(self, origins: Any) -> Any:
        """A point in the middle of each group, (G, 3). Held fixed."""
        total = self._over_groups(jax.ops.segment_sum, jax.lax.stop_gradient(origins))
        return total / jnp.maximum(self.groups[:, 1:], 1)

    def about(self, center: Any, centers: Any) -> Instances:
        """The same for world positions about `center` and a group's about its own centre, so that both stay small."""
        m = self.to_world.reshape(-1, 3, 4)
        inner = jnp.concatenate([centers[jnp.maximum(self.group, 0)], center[None]])
        shift = m[:, :, 3] + jnp.einsum("ijk,ik->ij", m[:, :, :3], inner, precision="highest") - center[None]
        shift = shift.at[-1].set(0.0)  # the identity
        inverse = self.to_local.reshape(-1, 3, 4)[:, :, :3]
        back = -jnp.einsum("ijk,ik->ij", inverse, shift, precision="highest")
        rows = lambda linear, shift: jnp.concatenate([linear, shift[:, :, None]], -1).reshape(-1, 12)
        return dataclasses.replace(self, to_world=rows(m[:, :, :3], shift), to_local=rows(inverse, back))

    def find(self, face: Any) -> tuple[Any, Any]:
        """The row of a face, and which placement it stands in."""
        number = face - self.rows
        k = jnp.searchsorted(self.ends, number, side="right", method="scan").astype(jnp.int32)
        k = jnp.where(number < 0, len(self.ends), jnp.minimum(k, len(self.ends)))
        last = jnp.minimum(k, len(self.ends) - 1)
        start = jnp.where(last > 0, self.ends[jnp.maximum(last - 1, 0)], 0)
        return jnp.where(number < 0, face, self.first[last] + number - start), k

    def boxes(self, low: Any, high: Any) -> tuple[Any, Any]:
        """Low and high corners of each instance, from those of every row."""
        low, high = self._over_groups(jax.ops.segment_min, low), self._over_groups(jax.ops.segment_max, high)
        group = jnp.maximum(self.group, 0)
        middle, half = 0.5 * (low + high)[group], 0.5 * (high - low)[group]
        m = self.to_world[:-1].reshape(-1, 3, 4)
        middle = jnp.einsum("kij,kj->ki", m[:, :, :3], middle, precision="highest") + m[:, :, 3]
        half = jnp.einsum("kij,kj->ki", jnp.abs(m[:, :, :3]), half, precision="highest")
        real = (self.group >= 0)[:, None]
        return jnp.where(real, middle - half, jnp.inf), jnp.where(real, middle + half, -jnp.inf)

    def placement(self, k: Any) -> Placement:
        return Placement(*([table[k, j] for j in range(12)] for table in (self.to_world, self.to_local)))

    def smallest_scale(self) -> Any:
        """For each row, the least factor by which an instance of its group shrinks lengths; 1 outside of groups."""
        scale = jnp.linalg.svd(self.to_world[:-1].reshape(-1, 3, 4)[:, :, :3], compute_uv=False)[:, 2]
        scale, group = jnp.where(self.group >= 0, scale, jnp.inf), jnp.maximum(self.group, 0)
        least, of_row = jax.ops.segment_min(scale, group, len(self.groups)), self.group_of_row
        return jnp.where(of_row < 0, 1.0, least[jnp.maximum(of_row, 0)])


class Placement(eqx.Module):
    """One placement: how functions and vectors of a group's space come into the world."""

    to_world: list[Any]
    to_local: list[Any]

    def function(self, g: Vec3, c: Any) -> tuple[Vec3, Any]:
        """The affine function g · x + c of the group's space as one of world positions."""
        m = self.to_local
        column = lambda j: g.x * m[j] + g.y * m[4 + j] + g.z * m[8 + j]
        return Vec3(column(0), column(1), column(2)), column(3) + c

    def vector(self, v: Vec3) -> Vec3:
        m = self.to_world
        return Vec3(*(dot(Vec3(m[4 * i], m[4 * i + 1], m[4 * i + 2]), v) for i in range(3)))
