"""Materials of glTF 2.0: metallic-roughness factors, emission, and textures of colour, alpha, emission and normals."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import unquote

import numpy as np

from ..parts import Bitmap, Bsdf, Conductor, Diffuse, Mask, NormalMap, SceneError, TwoSided
from .textures import decoded

if TYPE_CHECKING:
    from .gltf import _File

_WRAPS = {33071: "clamp", 33648: "mirror", 10497: "repeat"}  # 5.26.3
_NEAREST = (9728, 9984, 9986)
_MAPPED = ("baseColorTexture", "emissiveTexture", "normalTexture")


class Materials:
    """Materials by index; meshes that use the same one share the object."""

    def __init__(self, file: _File):
        self.file, self.made = file, cast(dict[Any, tuple[Bsdf, dict[str, Any]]], {})
        names = [file.name(file.item("materials", k), "") for k in range(len(file.table(file.json, "materials")))]
        self.names = [n if n and names.count(n) == 1 else f"{n or 'material'}_{k}" for k, n in enumerate(names)]

    def get(self, index: Any, mapped: bool) -> tuple[Bsdf, dict[str, Any]]:
        """The BSDF, and the emission as keywords of a shape. `mapped`: whether the mesh has texture coordinates."""
        if index is None:
            self.file.notes.append(f"{self.file.path}: meshes without a material are made grey and diffuse")
            return self.made.setdefault(None, (Diffuse(), {}))
        entry = self.file.item("materials", index)
        if (index, mapped) not in self.made:
            self.made[index, mapped] = self._make(entry, self.names[index], mapped)
        return self.made[index, mapped]

    def _make(self, entry: dict[str, Any], name: str, mapped: bool) -> tuple[Bsdf, dict[str, Any]]:
        file, where = self.file, f"material {name!r}"
        pbr = file.entry(entry, "pbrMetallicRoughness")
        factor = file.numbers(pbr, "baseColorFactor", [1.0, 1.0, 1.0, 1.0], where)
        metallic = float(file.numbers(pbr, "metallicFactor", 1.0, where))
        rough = float(file.numbers(pbr, "roughnessFactor", 1.0, where))
        image = self._picture(pbr.get("baseColorTexture"))
        if image is not None and image.shape[2] < 4:
            rgb = np.broadcast_to(image, (*image.shape[:2], 3)) if image.shape[2] < 3 else image
            image = np.concatenate([rgb, np.ones_like(rgb[..., :1])], -1)
        rgba: Any = factor if image is None else np.minimum(image * factor, 1.0)
        even = image is None or not mapped
        rgba = rgba.mean((0, 1)) if image is not None and even else rgba
        place = self._placed(pbr.get("baseColorTexture"))
        colour = rgba[:3] if even else Bitmap(rgba[..., :3], **place)
        bsdf: Bsdf = Diffuse(colour, id=name)
        if metallic >= 0.5:
            bsdf = Conductor(alpha=rough * rough, eta=0.0, k=1.0, specular_reflectance=colour, id=name)  # B.3.2: α
        bsdf = self._turned(bsdf, entry, name, mapped)
        if entry.get("doubleSided") is True:
            bsdf = TwoSided(bsdf)
        mode = entry.get("alphaMode", "OPAQUE")
        if mode in ("MASK", "BLEND"):
            alpha = rgba[..., 3]
            cutoff = float(file.numbers(entry, "alphaCutoff", 0.5, where))
            alpha = np.where(alpha >= cutoff, 1.0, 0.0) if mode == "MASK" else alpha
            if (alpha < 1).any():
                opacity = float(alpha) if even else Bitmap(alpha, **place)
                bsdf = Mask(bsdf, opacity=opacity, id=f"{name}.mask")
        elif mode != "OPAQUE":
            file.notes.append(f"{file.path}: {where} is taken as opaque (alphaMode {str(mode)[:20]})")
        look = self._emission(entry, name, mapped)
        self._note_textures(entry, pbr, where, mapped)
        return bsdf, look

    def _turned(self, bsdf: Bsdf, entry: dict[str, Any], name: str, mapped: bool) -> Bsdf:
        info = entry.get("normalTexture")
        image = self._picture(info, raw=True) if mapped else None
        if image is None or image.shape[2] < 3:
            return bsdf
        scale = float(
            self.file.numbers(self.file.entry(entry, "normalTexture"), "scale", 1.0, f"material {name!r}.normalTexture")
        )
        n = (2.0 * image[..., :3] - 1.0) * [scale, scale, 1.0]
        n = n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-6)
        return NormalMap(bsdf, Bitmap(0.5 * n + 0.5, **self._placed(info)), shadowed=False, id=f"{name}.normals")

    def _emission(self, entry: dict[str, Any], name: str, mapped: bool) -> dict[str, Any]:
        file, where = self.file, f"material {name!r}"
        emissive = file.entry(file.entry(entry, "extensions"), "KHR_materials_emissive_strength")
        strength = float(file.numbers(emissive, "emissiveStrength", 1.0, where))
        emission: Any = strength * file.numbers(entry, "emissiveFactor", [0.0, 0.0, 0.0], where)
        if not emission.any():
            return {}
        image = self._picture(entry.get("emissiveTexture"))
        if image is not None:
            rgb = image[..., :3] * emission
            emission = Bitmap(rgb, **self._placed(entry["emissiveTexture"])) if mapped else rgb.mean((0, 1))
        if entry.get("doubleSided") is True:
            file.notes.append(f"{file.path}: {where} emits on its front side only")
        return {"emission": emission, "emission_id": f"{name}.emitter"}

    def _note_textures(self, entry: dict[str, Any], pbr: dict[str, Any], where: str, mapped: bool) -> None:
        left = [
            f"{k} {self._image(v)}"
            for k, v in [*pbr.items(), *entry.items()]
            if k.endswith("Texture") and (k not in _MAPPED or not mapped or self._picture(v) is None)
        ]
        if left:
            self.file.notes.append(f"{self.file.path}: {where}: textures are not mapped ({', '.join(left)})")

    def _picture(self, info: Any, raw: bool = False) -> np.ndarray | None:
        """A texture's picture, (H, W, C) and linear unless `raw`; None where there is none that can be read."""
        try:
            image = self.file.item("images", self.file.item("textures", info["index"])["source"])
            if "bufferView" in image:
                view = self.file.item("bufferViews", image["bufferView"])
                start = view.get("byteOffset", 0)
                return decoded(self.file.buffer(view["buffer"])[start : start + view["byteLength"]], raw)
            uri = image["uri"]
            if uri.startswith("data:"):
                return decoded(base64.b64decode(uri.partition(",")[2]), raw)
            return decoded((Path(self.file.path).parent / unquote(uri)).read_bytes(), raw)
        except (KeyError, TypeError, ValueError, OSError, AttributeError):
            return None

    def _placed(self, info: Any) -> dict[str, Any]:
        """How a texture is laid over a surface: its sampler (3.8.4) and KHR_texture_transform."""
        try:
            sampler = self.file.table(self.file.json, "samplers")[self.file.item("textures", info["index"])["sampler"]]
            wrap, nearest = _WRAPS.get(sampler.get("wrapS"), "repeat"), sampler.get("magFilter") in _NEAREST
        except (KeyError, TypeError, IndexError, AttributeError):
            wrap, nearest = "repeat", False
        laid: dict[str, Any] = {"wrap": wrap, "filter": "nearest" if nearest else "bilinear"}
        moved = (info or {}).get("extensions", {}) if isinstance(info, dict) else {}
        if isinstance(moved, dict) and isinstance(moved.get("KHR_texture_transform"), dict):
            change, where = moved["KHR_texture_transform"], "KHR_texture_transform"
            (x, y), (w, h) = (
                self.file.numbers(change, k, d, where) for k, d in (("offset", [0.0] * 2), ("scale", [1.0] * 2))
            )
            turn = float(self.file.numbers(change, "rotation", 0.0, where))
            c, s = np.cos(turn), np.sin(turn)
            laid["to_uv"] = [[w * c, h * s, x], [-w * s, h * c, y]]
        return laid

    def _image(self, info: Any) -> str:
        """A name for a texture; whatever is wrong with it does not matter yet."""
        try:
            texture = self.file.item("textures", info["index"])
            image = self.file.item("images", texture["source"])
            uri = str(image.get("uri", "without a name"))
            return repr(self.file.name(image, "embedded" if uri.startswith("data:") else uri))
        except (KeyError, TypeError, SceneError):
            return "without a name"
