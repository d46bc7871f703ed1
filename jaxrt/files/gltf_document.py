"""The document of a glTF 2.0 file: its container, JSON, buffers and accessors.

Look-ups fail with the name of what is wrong. Section numbers are those of the glTF 2.0 specification (Khronos, 2021).
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any, NoReturn, cast
from urllib.parse import unquote

import numpy as np

from .mesh import fail
from .reading import read_bytes, take

KNOWN = {
    "EXT_lights_ies", "EXT_mesh_gpu_instancing", "EXT_texture_webp", "KHR_lights_punctual", "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_transmission",
    "KHR_materials_unlit", "KHR_materials_volume", "KHR_mesh_quantization", "KHR_texture_transform",
}  # fmt: skip
"""Extensions that are read."""

_NOTED = {"KHR_texture_basisu", "KHR_xmp_json_ld"}
"""Those that are not read, but may be required: what they say is noted where it is missed, or says nothing of light."""

_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # 3.6.2.2
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Document:
    """One document. `notes`: what the reader wants said."""

    def __init__(self, path: str | Path):
        self.path, self.notes, self.binary = path, cast(list[str], []), cast(bytes | None, None)
        self.buffers: dict[int, bytes] = {}
        self.arrays: dict[int, np.ndarray] = {}
        data = read_bytes(path)
        if data[:4] == b"glTF":
            data = self._chunks(data)
        try:
            self.json = json.loads(data)
        except (ValueError, RecursionError):
            self.fail("is not glTF, or its JSON is damaged; check the path or export it again")
        if not isinstance(self.json, dict) or not str(self.entry(self.json, "asset").get("version")).startswith("2."):
            self.fail("is not glTF 2; export it as glTF 2.0")
        required = {str(e) for e in self.table(self.json, "extensionsRequired")}
        if compressed := sorted(required & set(_COMPRESSED)):
            self.fail(f"requires {', '.join(compressed)}, which jaxrt cannot unpack; export it without compression")
        if missing := sorted(required - KNOWN - _NOTED):
            self.fail(f"requires {', '.join(missing)}, which jaxrt cannot read; export it without")

    def _chunks(self, data: bytes) -> bytes:
        """The JSON of a GLB (4.4); its binary chunk is kept."""
        if len(data) < 20 or int.from_bytes(data[8:12], "little") > len(data):
            self.fail("is truncated; copy or export it again")
        if data[4:8] != b"\2\0\0\0" or data[16:20] != b"JSON":
            self.fail("is not a GLB of version 2; export it as glTF 2.0")
        at, parts = 12, {}
        while at + 8 <= len(data):
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > len(data):
                self.fail("is truncated; copy or export it again")
            parts.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        self.binary = parts.get(b"BIN\0")
        return parts[b"JSON"]

    def fail(self, problem: str) -> NoReturn:
        fail(self.path, problem)

    def note(self, what: str) -> None:
        self.notes.append(f"{self.path}: {what}")

    # Typed look-ups in the JSON

    def entry(self, owner: Any, key: str) -> dict[str, Any]:
        value = owner.get(key, {})
        if not isinstance(value, dict):
            self.fail(f"{key} is not a JSON object; export it again")
        return value

    def extension(self, owner: dict[str, Any], name: str) -> dict[str, Any]:
        """What an extension says of `owner`; {} where it says nothing."""
        return self.entry(self.entry(owner, "extensions"), name)

    def table(self, owner: dict[str, Any], key: str) -> list[Any]:
        value = owner.get(key, [])
        if not isinstance(value, list):
            self.fail(f"{key} is not a JSON list; export it again")
        return value

    def item(self, key: str, index: Any) -> dict[str, Any]:
        """The `index`-th entry of a top-level list."""
        table = self.table(self.json, key)
        if not isinstance(index, int) or not 0 <= index < len(table) or not isinstance(table[index], dict):
            self.fail(f"there is no {key}[{index}] among {len(table)}; export it again")
        return table[index]

    def integer(self, owner: dict[str, Any], key: str, default: int | None = None, where: str = "") -> int:
        value = owner.get(key, default)
        if type(value) is not int or not 0 <= value < 1 << 40:
            self.fail(f"{where}{key} is {str(value)[:40]}, not a whole number; export it again")
        return value

    def numbers(self, owner: dict[str, Any], key: str, default: Any, where: str) -> np.ndarray:
        value = owner.get(key, default)
        try:
            a = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            a = np.array(np.nan)
        if a.shape != np.shape(default) or not np.isfinite(a).all():
            self.fail(f"{where}.{key} is {str(value)[:40]}, not {np.size(default)} finite number(s); export it again")
        return a

    def name(self, owner: dict[str, Any], default: str) -> str:
        name = owner.get("name")
        return name if isinstance(name, str) and name else default

    # Buffers

    def uri(self, uri: str, what: str) -> bytes:
        """What a URI of `what` refers to: data of its own, or a file beside the document."""
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2])
            except (binascii.Error, ValueError):
                self.fail(f"{what} holds damaged base64 data; export it again")
        if "://" in uri:
            self.fail(f"{what} is at {uri[:60]}; download it and refer to the local file")
        return read_bytes(Path(self.path).parent / unquote(uri))

    def buffer(self, index: int) -> bytes:
        if index not in self.buffers:
            entry, what = self.item("buffers", index), f"buffers[{index}]"
            uri, size = entry.get("uri"), self.integer(entry, "byteLength", where=f"{what}.")
            if uri is None and index == 0 and self.binary is not None:
                data = self.binary
            elif isinstance(uri, str):
                data = self.uri(uri, what)
            else:
                packed = [e for e in _COMPRESSED if e in self.entry(entry, "extensions")]
                why = f"is compressed ({packed[0]}); export it without" if packed else "has no data; export it again"
                self.fail(f"{what} {why}")
            if len(data) < size:
                self.fail(f"{what} has {len(data)} bytes of {size}; it is truncated, export it again")
            self.buffers[index] = data[:size]
        return self.buffers[index]

    def view(self, index: Any, what: str) -> tuple[memoryview, int]:
        """The bytes of a bufferView, and its stride (0: none is given)."""
        view, of = self.item("bufferViews", index), f"bufferViews[{index}]."
        data = self.buffer(self.integer(view, "buffer", where=of))
        first, length = self.integer(view, "byteOffset", 0, of), self.integer(view, "byteLength", where=of)
        if first + length > len(data):
            self.fail(f"{what} lies outside of its buffer; it is truncated, export it again")
        stride = self.integer(view, "byteStride", 0, of)
        if "byteStride" in view and not stride:
            self.fail(f"{what} lies outside of its buffer, by a stride of 0; export it again")
        return memoryview(data)[first : first + length], stride

    def spend(self, cost: int) -> None:
        """Bytes of memory, where data are repeated or none stand behind them."""
        take(self.path, cost, "export it with fewer copies")

    def accessor(self, index: Any, kinds: tuple[str, ...]) -> np.ndarray:
        """The numbers of an accessor (3.6.2), (count, width); normalised integers as floats."""
        entry, where = self.item("accessors", index), f"accessors[{index}]."
        count, kind = self.integer(entry, "count", where=where), entry.get("type")
        component = entry.get("componentType")
        if kind not in kinds or not isinstance(component, int) or component not in _COMPONENTS:
            self.fail(
                f"{where}type is {str(kind)[:20]} of {str(component)[:20]}, not {' or '.join(kinds)}; export it again"
            )
        if index not in self.arrays:
            dtype = np.dtype(_COMPONENTS[component])
            if "bufferView" in entry:
                a = self._rows(entry, where[:-1], count, dtype, _WIDTHS[kind])
            else:
                self.spend(count * _WIDTHS[kind] * dtype.itemsize)
                a = np.zeros((count, _WIDTHS[kind]), dtype)
            if "sparse" in entry or entry.get("normalized") is True:
                self.spend(8 * a.size)
            if "sparse" in entry:
                a = self._replaced(self.entry(entry, "sparse"), f"{where}sparse", a)
            if entry.get("normalized") is True and dtype.kind in "iu":
                a = np.maximum(a / np.iinfo(dtype).max, -1.0)
            self.arrays[index] = a
        return self.arrays[index]

    def _rows(self, entry: dict[str, Any], what: str, count: int, dtype: np.dtype, width: int) -> np.ndarray:
        """Rows from the bufferView and byteOffset that an entry names."""
        data, stride = self.view(entry["bufferView"], what)
        start, size = self.integer(entry, "byteOffset", 0, f"{what}."), dtype.itemsize * width
        stride = stride or size
        if not count or stride < size or start + stride * (count - 1) + size > len(data):
            self.fail(f"{what} lies outside of its buffer; it is truncated, export it again")
        return np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))

    def _replaced(self, sparse: dict[str, Any], what: str, a: np.ndarray) -> np.ndarray:
        """An array with some of its rows replaced (3.6.2.3)."""
        count = self.integer(sparse, "count", where=f"{what}.")
        indices, values = (self.entry(sparse, key) for key in ("indices", "values"))
        dtype = _COMPONENTS.get(self.integer(indices, "componentType", where=f"{what}.indices."), "")
        if "u" not in dtype or not ("bufferView" in indices and "bufferView" in values):
            self.fail(f"{what} has no indices and values; export it again")
        at = self._rows(indices, f"{what}.indices", count, np.dtype(dtype), 1)[:, 0]
        rows = self._rows(values, f"{what}.values", count, a.dtype, a.shape[1])
        if at.max() >= len(a):
            self.fail(f"{what} replaces row {at.max()} of {len(a)}; export it again")
        a = a.copy()
        a[at] = rows
        return a
