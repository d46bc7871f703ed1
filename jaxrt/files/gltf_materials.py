"""Materials of glTF 2.0: base colour and coverage, emission, and the reflectance between."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np

from ..parts import Bitmap, Bsdf, Diffuse, Mask, MeshAttribute, Product, Texture
from .gltf_document import Document
from .gltf_reflectance import reflectance
from .gltf_textures import MaterialEntry, Pictures

VERTEX_COLOR, VERTEX_ALPHA = "vertex_color", "vertex_alpha"
"""Attributes that hold COLOR_0 of a mesh where it varies."""

Tint: TypeAlias = tuple[float, ...] | int | None
"""Colours of a mesh's vertices: one colour and alpha, or how many values vary (3, or 4 with alpha), or none."""


class Look(NamedTuple):
    """A reflectance, emission as keywords of a shape, the number of the texture coordinates that lay textures, and
    whether one of those turns normals."""

    bsdf: Bsdf
    emission: dict[str, Any]
    coordinates: int = 0
    turned: bool = False


class Materials:
    """Materials by index; meshes that use the same one alike share the object."""

    def __init__(self, file: Document):
        self.file, self.pictures, self.made = file, Pictures(file), cast(dict[Any, Look], {})
        names = [file.name(file.item("materials", k), "") for k in range(len(file.table(file.json, "materials")))]
        self.names = [n if n and names.count(n) == 1 else f"{n or 'material'}_{k}" for k, n in enumerate(names)]

    def get(self, index: Any, coordinates: frozenset[int], tint: Tint) -> Look:
        """The look of meshes that have these texture coordinates and colours of vertices."""
        key = index, coordinates, tint
        if index is None:
            self.file.note("meshes without a material are made grey and diffuse")
            plain = 0.5 if tint is None else MeshAttribute(VERTEX_COLOR) if isinstance(tint, int) else tint[:3]
            return self.made.setdefault(key, Look(Diffuse(plain), {}))
        entry = self.file.item("materials", index)
        if key not in self.made:
            others = sum(made[0] == index for made in self.made)
            name = f"{self.names[index]}_{others}" if others else self.names[index]
            self.made[key] = _look(MaterialEntry(self.pictures, entry, name, coordinates), tint)
        return self.made[key]


def _look(entry: MaterialEntry, tint: Tint) -> Look:
    colour, alpha = _base(entry, tint)
    if "KHR_materials_unlit" in entry.file.entry(entry.entry, "extensions"):  # as bright as it is, whatever the light
        bsdf, emission = Diffuse(0.0, id=entry.id), colour
    else:
        bsdf, emission = reflectance(entry, colour), _emission(entry)
    if emission is not None and entry.entry.get("doubleSided") is True:
        entry.note(" emits on its front side only")
    if isinstance(alpha, Texture) or alpha < 1:
        emission = None if emission is None else _times(entry, emission, alpha)  # holes do not emit
        bsdf = Mask(bsdf, opacity=alpha, id=f"{entry.id}.mask")
    if "occlusionTexture" in entry.entry:
        entry.note(": occlusionTexture is not used, rays find what hides light")
    if entry.left:
        entry.note(f": textures are not mapped ({', '.join(dict.fromkeys(entry.left))})")
    look = {} if emission is None else {"emission": emission, "emission_id": f"{entry.id}.emitter"}
    return Look(bsdf, look, entry.mapped or 0, "normalTexture" in entry.entry)


def _base(entry: MaterialEntry, tint: Tint) -> tuple[Any, Any]:
    """Base colour and coverage: factor, texture and colours of vertices multiplied."""
    pbr, key = entry.owner("pbrMetallicRoughness"), "baseColorTexture"
    factor = entry.numbers(pbr, "baseColorFactor", [1.0, 1.0, 1.0, 1.0])
    factor = factor * tint if isinstance(tint, tuple) else factor
    image, laid = entry.picture(pbr, key)
    rgba: Any = factor
    if image is not None:
        rgb = np.broadcast_to(image, (*image.shape[:2], 3)) if image.shape[2] < 3 else image
        rgba = np.concatenate([rgb, np.ones_like(rgb[..., :1])], -1) if rgb.shape[2] < 4 else rgb
        rgba = np.minimum(rgba * factor.astype(np.float32), 1.0)
        rgba = rgba if laid else rgba.mean((0, 1), dtype=np.float64)
    mode, alpha = entry.entry.get("alphaMode", "OPAQUE"), rgba[..., 3]
    if mode == "MASK":
        alpha = np.where(alpha >= float(entry.numbers(entry.entry, "alphaCutoff", 0.5)), 1.0, 0.0)
    elif mode != "BLEND":
        alpha = np.ones_like(alpha)
        if mode != "OPAQUE":
            entry.note(f" is taken as opaque (alphaMode {str(mode)[:20]})")
    colour, alpha = (entry.bitmap(a, pbr, key) if laid else a for a in (rgba[..., :3], alpha))
    if isinstance(tint, int):
        colour = _times(entry, colour, MeshAttribute(VERTEX_COLOR))
        if tint == 4 and mode == "BLEND":
            alpha = _times(entry, alpha, MeshAttribute(VERTEX_ALPHA))
        elif tint == 4 and mode == "MASK":
            entry.note(": alpha of vertices is not used where alphaMode is MASK")
    return colour, alpha if isinstance(alpha, Texture) else float(alpha)


def _times(entry: MaterialEntry, a: Any, b: Any) -> Any:
    """The product of values or textures."""
    if not isinstance(a, Texture) and not isinstance(b, Texture):
        return a * b
    if not isinstance(b, Texture):
        a, b = b, a
    if not isinstance(a, Texture):
        a = np.atleast_1d(a)
        if isinstance(b, MeshAttribute) and np.ptp(a) == 0:
            return MeshAttribute(b.name, scale=b.scale * float(a[0]))
        a = Bitmap(np.reshape(a, (1, 1, -1)))
    if isinstance(a, Product) or isinstance(b, Product):
        entry.note(": alpha does not dim what it emits, which has colours of vertices and a texture")
        return a if isinstance(a, Product) else b
    return Product(a, b)


def _emission(entry: MaterialEntry) -> Any:
    """Radiance of a material that emits, else None."""
    strength = entry.numbers(entry.owner("KHR_materials_emissive_strength"), "emissiveStrength", 1.0)
    emission = strength * entry.numbers(entry.entry, "emissiveFactor", [0.0, 0.0, 0.0])
    if not emission.any():
        return None
    image, laid = entry.picture(entry.entry, "emissiveTexture")
    if image is None:
        return emission
    rgb = image[..., :3] * emission
    return entry.bitmap(rgb, entry.entry, "emissiveTexture") if laid else rgb.mean((0, 1))
