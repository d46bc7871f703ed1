"""ψ, the ray casting function, in the two forms that the algebra and the path use."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .surface import SurfacePoint, leave, surface_point
from .vector import Vec3
from .world import World


def cast(world: World, x: SurfacePoint | Vec3, w: Vec3, exclude: Any = None) -> SurfacePoint:
    """ψ(x, ω): the first point of M seen from x along ω. Total: the enclosure, face −1, where there is none.

    From a surface point the ray starts just off the surface; from a `Vec3`, exactly there.
    """
    o = leave(world, x, w) if isinstance(x, SurfacePoint) else x
    return surface_point(world, world.settle(world.search.closest(o, w, exclude)), o, w)


class Psi(eqx.Module):
    """ψ as a callable pytree: (x, ω, exclude=faces) -> SurfacePoint, for one ray; batch it with `jax.vmap`.

    x: a `SurfacePoint`, a `Vec3` or an array (3,) (m); ω: a unit `Vec3` or array (3,). `exclude`: number
    or numbers of faces to skip. Positions, normals and distance are differentiable, the search is not.
    """

    world: World

    def __call__(self, x: Any, w: Any, exclude: Any = None) -> SurfacePoint:
        return cast(self.world, x if isinstance(x, SurfacePoint) else self._vector(x), self._vector(w), exclude)

    def occluded(self, x: Any, w: Any, distance: Any, exclude: Any = None) -> Any:
        """Whether a face (but those of `exclude`) lies before `distance` (m) from x along ω."""
        w = self._vector(w)
        o = leave(self.world, x, w) if isinstance(x, SurfacePoint) else self._vector(x)
        return self.world.search.occluded(o, w, jnp.asarray(distance, self.world.faces.dtype), exclude)

    def _vector(self, a: Any) -> Vec3:
        return Vec3(*(jnp.asarray(c, self.world.faces.dtype) for c in Vec3.of(a)))
