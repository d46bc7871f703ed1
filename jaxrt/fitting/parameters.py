"""Which parameters of a scene are free, by name or pattern."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array

from ..parts import SceneError
from ..scene import Scene, in_working_precision, with_params
from .transforms import Transform, transform_of


class Free(eqx.Module):
    """The free parameters' transforms, by name."""

    transforms: dict[str, Transform]

    @classmethod
    def of(cls, scene: Scene, free: str | Iterable[str] | Mapping[str, Any]) -> Free:
        """`free`: names or patterns, or a mapping from these to transforms; where several match, the last counts.

        Raises `SceneError` for a name that there is not, with the closest ones.
        """
        given = dict(free) if isinstance(free, Mapping) else dict.fromkeys([free] if isinstance(free, str) else free)
        if not given:
            raise SceneError('free: is empty; name a parameter, as "red.reflectance" or "*.reflectance"')
        names, chosen = [name for name, _ in scene.structure.slots], {}
        for pattern, transform in given.items():
            matching = [pattern] if pattern in names else fnmatch.filter(names, pattern)
            if not matching:
                scene.structure.slot(pattern)  # raises with the closest names
            chosen |= dict.fromkeys(matching, transform)
        made = {name: transform_of(scene, name, chosen[name]) for name in names if name in chosen}
        return in_working_precision(cls(made))

    @property
    def start(self) -> dict[str, Array]:
        return {name: transform.start for name, transform in self.transforms.items()}

    def values(self, z: Mapping[str, Array]) -> dict[str, Array]:
        return {name: transform(z[name]) for name, transform in self.transforms.items()}

    def __call__(self, scene: Scene, z: Mapping[str, Array]) -> Scene:
        """The scene with the values of z."""
        return with_params(scene, self.values(z))

    @property
    def numbers(self) -> int:
        """How many numbers are free."""
        return sum(leaf.size for leaf in jax.tree.leaves(self.start))
