"""A scene's tables without effects that were forced out of its plan: they hold rows that nothing would read rightly."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from ..brdf import LOBES, MAPPED, NODES, MaterialColumns
from ..parts.textures import TEXTURES
from ..scene import Scene
from .static import Plan


def without(scene: Scene, plan: Plan) -> Scene:
    """Materials of a lobe that was cut are black, those made of others are the first of these, and parameters take the
    mean of a texture. Pure."""
    columns, cut = MaterialColumns(scene.channels), plan.cut
    materials, radiance_map = scene.materials, scene.radiance_map
    lobe, first = columns["lobe"][0], columns["first"][0]
    is_any = lambda numbers: jnp.isin(jnp.round(materials[:, lobe]).astype(int), jnp.array(numbers, int))[:, None]
    kinds = [TEXTURES.index(k) for k in TEXTURES if f"texture:{k}" in cut]
    if kinds:
        gone = jnp.isin(scene.textures[:, 0], jnp.array(kinds)).at[0].set(True)
        maps = np.concatenate([np.arange(*columns[f"map:{f}"]) for f in MAPPED])
        numbers = materials[:, maps]
        materials = materials.at[:, maps].set(jnp.where(gone[numbers.astype(int)], 0.0, numbers))
        radiance_map = jnp.where(gone[radiance_map], 0, radiance_map)
    nodes = [NODES[k] for k in NODES if k in cut]
    for _ in range(plan.depth if nodes else 0):
        materials = jnp.where(is_any(nodes), materials[materials[:, first].astype(int)], materials)
    lobes = [LOBES[k].number for k in LOBES if f"lobe:{k}" in cut]
    if lobes:
        materials = jnp.where(is_any(lobes), materials[:1], materials)
    return dataclasses.replace(scene, materials=materials, radiance_map=radiance_map)
