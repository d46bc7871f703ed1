"""Textures of glTF materials: their pictures, how they are laid over a surface, and numbers in their channels."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from ..parts import Bitmap, SceneError
from .gltf_document import Document
from .reading import RefusedError
from .textures import decoded

_WRAPS = {33071: "clamp", 33648: "mirror", 10497: "repeat"}  # 5.26.3
_NEAREST = (9728, 9984, 9986)


class Pictures:
    """The textures of a document. Those that cannot be read are taken for none, with a note."""

    def __init__(self, file: Document):
        self.file, self._read = file, cast(dict[Any, np.ndarray | None], {})

    def picture(self, info: Any, raw: bool = False) -> np.ndarray | None:
        """A texture's picture, (H, W, 1, 3 or 4) and linear unless `raw`; None where there is none that can be read."""
        try:
            texture = self.file.item("textures", info["index"])
            webp = self.file.extension(texture, "EXT_texture_webp")
            source = webp["source"] if "source" in webp else texture["source"]
            if (source, raw) not in self._read:
                self._read[source, raw] = self._decoded(self.file.item("images", source), f"images[{source}]", raw)
            return self._read[source, raw]
        except RefusedError:
            raise
        except (KeyError, TypeError, SceneError):
            return None

    def _decoded(self, image: dict[str, Any], what: str, raw: bool) -> np.ndarray | None:
        try:
            if "bufferView" in image:
                data = bytes(self.file.view(image["bufferView"], what)[0])
            else:
                data = self.file.uri(image["uri"], what)
            return decoded(data, f"{self.file.path}: {what}", raw)
        except RefusedError:
            raise
        except (KeyError, AttributeError, ValueError):
            return None

    def name(self, info: Any) -> str:
        """A name for a texture, whatever is wrong with it."""
        try:
            image = self.file.item("images", self.file.item("textures", info["index"])["source"])
            uri = str(image.get("uri", "without a name"))
            return repr(self.file.name(image, "embedded" if uri.startswith("data:") else uri))
        except (KeyError, TypeError, SceneError):
            return "without a name"

    def coordinates(self, info: Any) -> int:
        """Which of a mesh's texture coordinates a texture is laid by."""
        moved = self._moved(info).get("texCoord")
        given = info.get("texCoord") if isinstance(info, dict) else None
        return next((k for k in (moved, given) if type(k) is int), 0)

    def _moved(self, info: Any) -> dict[str, Any]:
        extensions = info.get("extensions") if isinstance(info, dict) else None
        moved = extensions.get("KHR_texture_transform") if isinstance(extensions, dict) else None
        return moved if isinstance(moved, dict) else {}

    def laid(self, info: Any) -> dict[str, Any]:
        """How a texture is laid over a surface, as keywords of a `Bitmap`: its sampler (3.8.4) and
        KHR_texture_transform."""
        wrap, nearest = ("repeat", "repeat"), False
        try:
            sampler = self.file.item("samplers", self.file.item("textures", info["index"])["sampler"])
            wrap = tuple(_WRAPS.get(sampler.get(k, 10497), "repeat") for k in ("wrapS", "wrapT"))
            nearest = sampler.get("magFilter") in _NEAREST
        except (KeyError, TypeError, SceneError):
            pass
        if wrap[0] != wrap[1]:
            self.file.note(f"texture {self.name(info)}: wrapS ({wrap[0]}) is taken for wrapT ({wrap[1]}) as well")
        laid: dict[str, Any] = {"wrap": wrap[0], "filter": "nearest" if nearest else "bilinear"}
        if change := self._moved(info):
            where = "KHR_texture_transform"
            (x, y), (w, h) = (
                self.file.numbers(change, k, d, where) for k, d in (("offset", [0.0] * 2), ("scale", [1.0] * 2))
            )
            turn = float(self.file.numbers(change, "rotation", 0.0, where))
            c, s = np.cos(turn), np.sin(turn)
            laid["to_uv"] = [[w * c, h * s, x], [-w * s, h * c, y]]
        return laid


class MaterialEntry:
    """One material, its numbers and textures, on meshes that have texture coordinates of some numbers (`coordinates`).

    Its textures are laid by those of one number, `mapped`, which the first of them asks for that meshes have. Where a
    texture asks for others, or meshes have none, its mean is taken, or for normals nothing; `left` names it.
    """

    FIRST = (
        ("pbrMetallicRoughness", "baseColorTexture"),
        ("pbrMetallicRoughness", "metallicRoughnessTexture"),
        ("", "normalTexture"),
        ("", "emissiveTexture"),
        ("KHR_materials_transmission", "transmissionTexture"),
    )
    """Textures in the order in which they are asked, and where they stand."""

    def __init__(self, pictures: Pictures, entry: dict[str, Any], name: str, coordinates: frozenset[int]):
        self.file, self.pictures, self.entry = pictures.file, pictures, entry
        self.id, self.where, self.left = name, f"material {name!r}", cast(list[str], [])
        found = [(self.owner(place), key) for place, key in self.FIRST]
        wanted = [pictures.coordinates(owner[key]) for owner, key in found if key in owner]
        self.mapped = next((k for k in wanted if k in coordinates), None)

    def owner(self, place: str) -> dict[str, Any]:
        """Where properties stand: the entry itself, its metallic-roughness part, or an extension of it."""
        if place.startswith("KHR_"):
            return self.file.extension(self.entry, place)
        return self.file.entry(self.entry, place) if place else self.entry

    def note(self, what: str) -> None:
        self.file.note(f"{self.where}{what}")

    def numbers(self, owner: dict[str, Any], key: str, default: Any) -> np.ndarray:
        return self.file.numbers(owner, key, default, self.where)

    def picture(self, owner: dict[str, Any], key: str, raw: bool = False) -> tuple[np.ndarray | None, bool]:
        """The picture of a texture, and whether it is laid over the surface."""
        if key not in owner:
            return None, False
        image = self.pictures.picture(owner[key], raw)
        laid = image is not None and self.mapped == self.pictures.coordinates(owner[key])
        if not laid:
            self.left.append(f"{key} {self.pictures.name(owner[key])}")
        return image, laid

    def bitmap(self, data: np.ndarray, owner: dict[str, Any], key: str) -> Any:
        """A texture of values, or the one value that all of them are."""
        flat = data.reshape(-1, *data.shape[2:])
        return flat[0] if (flat == flat[0]).all() else Bitmap(data, **self.pictures.laid(owner[key]))

    def number(self, owner: dict[str, Any], factor: str, default: float, key: str, channel: int, power: int = 1) -> Any:
        """A factor times a channel of a texture, to a power: one number, or a `Bitmap`."""
        value = float(self.numbers(owner, factor, default))
        image, laid = self.picture(owner, key, raw=True)
        if image is None:
            return value**power
        channels = image.shape[2]
        full = channel == 3 and channels < 4  # no alpha
        values = np.ones_like(image[..., 0]) if full else image[..., min(channel, channels - 1)]
        data = (np.float32(value) * values) ** power
        found = self.bitmap(data, owner, key) if laid else data.mean(dtype=np.float64)
        return found if isinstance(found, Bitmap) else float(found)
