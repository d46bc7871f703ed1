"""Effects of shapes: kinds of faces, instances, vertex normals."""

from __future__ import annotations

import numpy as np

from ..scene import KINDS
from .effect import Chosen, Effect, Found, named
from .facts import Facts

SHAPES = "belongs to the scene's shapes; build the scene with others"


def _kind(kind: str) -> Effect:
    def find(facts: Facts, chosen: Chosen) -> Found:
        n = facts.counts[KINDS.index(kind)]
        shapes = [name for name, of, *_ in facts.structure.shapes if of == kind]
        return Found(bool(n), f"{n} faces: {named(shapes)}" if n else "no face")

    return Effect(kind, find, lambda facts, chosen: {"kinds": (kind,)}, fixed=SHAPES)


def _instances(facts: Facts, chosen: Chosen) -> Found:
    group = np.asarray(facts.scene.instance_group)
    sizes = np.asarray(facts.scene.groups)[group[group >= 0], 1]
    return Found(sizes.size > 0, f"{sizes.size} of {sizes.sum()} triangles together" if sizes.size else "no instance")


def _smooth(facts: Facts, chosen: Chosen) -> Found:
    normals, grids = np.asarray(facts.scene.normals), bool(np.asarray(facts.scene.grids)[:, 4].any())
    if not (np.abs(normals).any() or grids or not facts.fixed("normals")):
        return Found(False, "all faces are flat")
    owners = [name.removesuffix(".normals") for name, slot in facts.structure.slots if slot.leaf == "normals"]
    owners += ["grids"] * grids
    return Found(True, f"vertex normals of {named(owners, 'shape')}")


EFFECTS = (
    *(_kind(kind) for kind in KINDS),
    Effect("instances", _instances, lambda facts, chosen: {"instances": True}, fixed=SHAPES),
    Effect("smooth_normals", _smooth, lambda facts, chosen: {"smooth_normals": True}),
)
