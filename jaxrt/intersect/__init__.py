"""ψ's search: which face a ray meets first. One file a backend, chosen by the plan.

A backend is a pytree with `closest(o, d, exclude) -> face` and `occluded(o, d, distance, exclude) -> bool`,
for one ray in components. It returns a face number only; where the ray meets that face is recomputed,
so derivatives do not know which backend ran. Inputs are held fixed under differentiation.
"""

from __future__ import annotations

from typing import Any, Protocol

import jax

from ..vector import Vec3
from . import embree
from .bvh import Bvh
from .copies import WrittenOut
from .dense import Dense, affine
from .faces import Faces

FEW = 128
"""Triangles and parallelograms up to which the dense backend is the fastest there is."""


MANY = 700
"""Faces from which the tree in JAX beats the dense backend, where there is no Embree."""


class Search(Protocol):
    """What a backend offers for one ray. Distances from −tolerance/2 on count, see `surface.leave`."""

    def closest(self, o: Vec3, d: Vec3, exclude: Any = None) -> Any: ...

    def occluded(self, o: Vec3, d: Vec3, distance: Any, exclude: Any = None) -> Any: ...


BACKENDS = {"dense": Dense, "bvh": Bvh, "embree": embree.Embree}


def refusal(backend: str) -> str | None:
    """Why a backend cannot run here, or None."""
    if backend != "embree":
        return None
    if jax.default_backend() != "cpu":
        return "it runs on CPUs"
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        return "it computes in float32"
    return embree.refusal()


def choose(faces: int) -> tuple[str, str]:
    """The backend for so many triangles and parallelograms, and why."""
    why = refusal("embree") if faces > FEW else None
    if faces <= FEW or (why is not None and faces <= MANY):
        return "dense", f"{faces} faces"
    return ("embree", f"{faces} faces") if why is None else ("bvh", f"{faces} faces; embree would be faster, but {why}")


def build_search(faces: Faces, plan: Any) -> Search:
    """The search structure of a plan's backend. Embree alone has two levels; for others, instances are written out."""
    backend = BACKENDS[plan.backend]
    if faces.instances is None or backend is embree.Embree:
        return backend.build(faces)
    return WrittenOut.build(backend, faces, faces.instances)


__all__ = ["BACKENDS", "Faces", "Search", "affine", "build_search", "choose", "refusal"]
