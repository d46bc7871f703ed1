"""Instances for backends of one level: their triangles are written out, and numbers are translated."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int32

from ..instances import Instances
from ..vector import Vec3
from .dense import affine, several
from .faces import Faces


class WrittenOut(eqx.Module):
    """Rows of the search within: triangles, those of all instances, free rows, other kinds."""

    search: Any
    triangles: Int32[Array, ""]
    numbers: Int32[Array, ""]  # of all instances
    blocks: tuple[int, ...] = eqx.field(static=True)
    copies: int = eqx.field(static=True)

    @classmethod
    def build(cls, backend: Any, faces: Faces, instances: Instances) -> WrittenOut:
        """`backend`: of the search within."""
        geometry, counts, blocks, copies = faces.geometry, faces.counts, faces.blocks, faces.copies
        triangles, numbers = counts[0], instances.ends[-1]
        place = jnp.arange(blocks[0] + copies)
        own = place < triangles
        row, k = instances.find(jnp.where(own, place, instances.rows + place - triangles))
        real = place < triangles + numbers
        m = instances.to_world[jnp.where(real, k, 0)].reshape(-1, 3, 4)
        o, a, b = (geometry[jnp.where(real, row, 0), j : j + 3] for j in (0, 3, 6))
        turn = lambda v: jnp.einsum("nij,nj->ni", m[:, :, :3], v, precision="highest")
        moved = [turn(o) + m[:, :, 3], turn(a), turn(b)]
        moved = jnp.where(own[:, None], jnp.concatenate([o, a, b], -1), jnp.concatenate(moved, -1))
        moved = jnp.where(real[:, None], moved, 0.0)
        within = Faces(
            geometry=jnp.concatenate([moved, geometry[blocks[0] :]]),
            maps=jnp.concatenate([affine(moved[:, :3], moved[:, 3:6], moved[:, 6:]), faces.maps[blocks[0] :]]),
            counts=counts.at[0].add(numbers),
            center=faces.center,
            epsilon=faces.epsilon,
            blocks=(blocks[0] + copies, *blocks[1:]),
            grids=faces.grids,
        )
        return cls(backend.build(within), triangles, numbers, blocks, copies)

    def closest(self, o: Vec3, d: Vec3, exclude: Any = None) -> Any:
        """Number of the first face along the ray, −1 if none. `exclude`: faces to skip, one or several numbers."""
        face = self.search.closest(o, d, self._within(exclude))
        other = jnp.where(face < self.blocks[0] + self.copies, sum(self.blocks) - self.triangles, -self.copies)
        return jnp.where(face < self.triangles, face, face + other)

    def occluded(self, o: Vec3, d: Vec3, distance: Any, exclude: Any = None) -> Any:
        """Whether any face but the excluded ones lies before `distance` (m)."""
        return self.search.occluded(o, d, distance, self._within(exclude))

    def _within(self, exclude: Any) -> Any:
        """The same faces in the search within."""
        if exclude is None:
            return None
        moved = lambda f: jnp.where(f < sum(self.blocks), f + self.copies, f - sum(self.blocks) + self.triangles)
        return tuple(jnp.where(f < self.blocks[0], f, moved(f)) for f in map(jnp.asarray, several(exclude)))
