"""The metallic-roughness model of glTF 2.0, and what extensions of Khronos add to it, as reflectances of a scene.

The model (appendix B) is taken as Disney's principled surface of the same base colour, metallic and roughness, with an
index of refraction of 1.5 (F₀ = .04), as in Mitsuba 3. As metal it is that of appendix B; a dielectric reflects 3 to
8 % more near the normal, and at cosθ = .2 from 5 % less (roughness .2) to 30 % more (roughness 1): its paint throws
light back (Burley 2012). A clear coat dims nothing below it. What transmits is mixed in: a thin sheet, or the surface
of solid glass where there is a volume.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..parts import Bitmap, Blend, Bsdf, Dielectric, Diffuse, NormalMap, Principled, PrincipledThin, Texture, TwoSided
from .gltf_textures import MaterialEntry

_SMOOTHEST = 1e-3
"""Roughness α below which glass is smooth."""

_NEAREST_ONE = 1.001
"""The least index of refraction of what has facets, which at 1 would do nothing."""


def reflectance(entry: MaterialEntry, colour: Any) -> Bsdf:
    """(1 − metallic) of a dielectric and metallic of a metal; the dielectric reflects diffusely, or transmits
    (KHR_materials_transmission)."""
    pbr, through = entry.owner("pbrMetallicRoughness"), entry.owner("KHR_materials_transmission")
    metallic = entry.number(pbr, "metallicFactor", 1.0, "metallicRoughnessTexture", 2)
    share = entry.number(through, "transmissionFactor", 0.0, "transmissionTexture", 0)
    normals = _normals(entry)
    if not _some(share) or not _some(metallic, below=1.0):
        return _opaque(entry, colour, metallic, normals, entry.id)
    bsdf = _turned(_glass(entry, colour), normals, f"{entry.id}.glass")
    if _some(share, below=1.0):
        paint = _opaque(entry, colour, 0.0, normals, f"{entry.id}.paint")
        bsdf = Blend(paint, bsdf, weight=share, id=f"{entry.id}.transmission")
    if _some(metallic):
        metal = _opaque(entry, colour, 1.0, normals, f"{entry.id}.metal")
        bsdf = Blend(bsdf, metal, weight=metallic, id=f"{entry.id}.metallic")
    return bsdf


def _some(value: Any, below: float | None = None) -> bool:
    """Whether a number or texture is above 0 somewhere, or below a limit."""
    values = value.values() if isinstance(value, Texture) else np.asarray(value)
    return bool((values > 0).any() if below is None else (values < below).any())


def _roughness(entry: MaterialEntry, power: int = 1) -> Any:
    pbr = entry.owner("pbrMetallicRoughness")
    return entry.number(pbr, "roughnessFactor", 1.0, "metallicRoughnessTexture", 1, power)


def _opaque(entry: MaterialEntry, colour: Any, metallic: Any, normals: Bitmap | None, name: str) -> Bsdf:
    coat = entry.owner("KHR_materials_clearcoat")
    clear = entry.number(coat, "clearcoatFactor", 0.0, "clearcoatTexture", 0)
    index = _specular(entry)
    if index > 1 or _some(metallic) or _some(clear):
        coated = {"clearcoat": clear, "clearcoat_gloss": _gloss(entry, coat)} if _some(clear) else {}
        index = max(index, _NEAREST_ONE)
        bsdf: Bsdf = Principled(colour, _roughness(entry), metallic=metallic, eta=index, **coated, id=name)
    else:
        bsdf = Diffuse(colour, id=name)
    bsdf = _turned(bsdf, normals, name)
    return TwoSided(bsdf) if entry.entry.get("doubleSided") is True else bsdf


def _index(entry: MaterialEntry) -> float:
    """KHR_materials_ior; its 0 stands for a dielectric that reflects everything."""
    index = float(entry.numbers(entry.owner("KHR_materials_ior"), "ior", 1.5))
    if index < 1 and index != 0:
        entry.file.fail(f"{entry.where}.ior is {index:g}; give 1 or more")
    return index


def _specular(entry: MaterialEntry) -> float:
    """The index whose reflectance at normal incidence is that of KHR_materials_ior and KHR_materials_specular."""
    index, more = _index(entry), entry.owner("KHR_materials_specular")
    if index and not more:
        return index
    strength = entry.number(more, "specularFactor", 1.0, "specularTexture", 3)
    colour = entry.numbers(more, "specularColorFactor", [1.0, 1.0, 1.0])
    image, _ = entry.picture(more, "specularColorTexture")
    colour = colour if image is None else colour * image[..., :3].mean((0, 1))
    uneven = {"specularTexture": isinstance(strength, Bitmap), "specularColor": np.ptp(colour) > 0 or image is not None}
    if any(uneven.values()):
        entry.note(f": of {' and '.join(k for k, v in uneven.items() if v)} the mean is taken")
    strength = float(strength.mean()[0]) if isinstance(strength, Bitmap) else strength
    root = np.sqrt(np.clip(((index - 1) / (index + 1)) ** 2 * colour.mean(), 0.0, 0.99) * np.clip(strength, 0.0, 1.0))
    return float((1 + root) / (1 - root))


def _gloss(entry: MaterialEntry, coat: dict[str, Any]) -> Any:
    """Of a clear coat, whose α = roughness² is .1 − .099 gloss (Burley 2012, appendix B)."""
    alpha = entry.number(coat, "clearcoatRoughnessFactor", 0.0, "clearcoatRoughnessTexture", 1, power=2)
    if not _some(alpha, below=0.1 + 1e-6):
        entry.note(": its clear coat is made smoother, of a roughness of .32")
    if "clearcoatNormalTexture" in coat:
        entry.left.append("clearcoatNormalTexture")
    gloss = lambda a: np.clip((0.1 - a) / 0.099, 0.0, 1.0)
    if not isinstance(alpha, Bitmap):
        return float(gloss(alpha))
    alpha.data = gloss(alpha.data)
    return alpha


def _glass(entry: MaterialEntry, colour: Any) -> Bsdf:
    """A thin sheet, or with KHR_materials_volume the surface of a solid; base colour tints what crosses a surface."""
    name, alpha, volume = f"{entry.id}.glass", _roughness(entry, 2), entry.owner("KHR_materials_volume")
    index = _index(entry) or 1.5  # 0 says nothing of how light is bent
    smooth = not isinstance(alpha, Texture) and alpha < _SMOOTHEST
    alpha, index = (0.0, index) if smooth else (alpha, max(index, _NEAREST_ONE))
    if float(entry.numbers(volume, "thicknessFactor", 0.0)) > 0:
        if "attenuationDistance" in volume and (entry.numbers(volume, "attenuationColor", [1.0, 1.0, 1.0]) < 1).any():
            entry.note(": light is not absorbed in its volume (attenuationColor)")
        return Dielectric(index, 1.0, specular_transmittance=colour, alpha=alpha, id=name)
    if smooth:
        return Dielectric(index, 1.0, specular_transmittance=colour, thin=True, id=name)
    return PrincipledThin(colour, _roughness(entry), spec_trans=1.0, eta=index, id=name)


def _normals(entry: MaterialEntry) -> Bitmap | None:
    """Normals of a texture, their slopes scaled, as colours."""
    image, laid = entry.picture(entry.entry, "normalTexture", raw=True)
    if image is None or not laid or image.shape[2] < 3:
        return None
    info = entry.entry["normalTexture"]
    scale = float(entry.numbers(info, "scale", 1.0))
    n = (2.0 * image[..., :3] - 1.0) * np.array([scale, scale, 1.0], np.float32)
    n = n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-6)
    return Bitmap(0.5 * n + 0.5, **entry.pictures.laid(info))


def _turned(bsdf: Bsdf, normals: Bitmap | None, name: str) -> Bsdf:
    return bsdf if normals is None else NormalMap(bsdf, normals, shadowed=False, id=f"{name}.normals")
