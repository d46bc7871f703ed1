"""ψ's search: which face a ray meets first. One file a backend, chosen by the plan.

A backend is a pytree with `closest(o, d, exclude) -> face` and `occluded(o, d, distance, exclude) -> bool`,
for one ray in components. It returns a face number only; where the ray meets that face is recomputed,
so derivatives do not know which backend ran. Inputs are held fixed under differentiation.
"""

from __future__ import annotations

from typing import Any, Protocol

from ..vector import Vec3
from .dense import Dense, affine


class Search(Protocol):
    """What a backend offers for one ray. Distances from −tolerance/2 on count, see `surface.leave`."""

    def closest(self, o: Vec3, d: Vec3, exclude: Any = None) -> Any: ...

    def occluded(self, o: Vec3, d: Vec3, distance: Any, exclude: Any = None) -> Any: ...


BACKENDS = {"dense": Dense}


def build_search(
    geometry: Any, maps: Any, counts: Any, blocks: tuple[int, ...], center: Any, epsilon: Any, plan: Any
) -> Search:
    """The search structure of a plan's backend over faces (origin, e₁, e₂) and their affine maps about `center`.

    `epsilon`: how far rounding may move a surface point, m.
    """
    return BACKENDS[plan.backend].build(geometry, maps, counts, blocks, center, epsilon)


__all__ = ["BACKENDS", "Search", "affine", "build_search"]
