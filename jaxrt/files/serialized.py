"""Mitsuba's own format of meshes, .serialized: little-endian, each mesh compressed, their offsets at the end."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from .mesh import MeshData, checked, fail
from .reading import read_bytes, take

_MAGIC, _HEADER = 0x041C, 1 << 16
_NORMALS, _UVS, _COLOURS, _DOUBLE = (
    0x1,
    0x2,
    0x8,
    0x2000,
)  # bits of a mesh; 0x10, faces without normals, Mitsuba 3 ignores
_RATIO = 1032
"""To which DEFLATE compresses at most, so that a small file cannot ask for much memory."""


def read_serialized(path: str | Path, index: int = 0) -> MeshData:
    """The mesh of number `index` in a file of version 3 or 4, in single or double precision.

    Its name is not kept; colours become the attribute `vertex_color`. Format: Mitsuba's documentation of the plugin
    `serialized`. Raises `SceneError` for a file that is missing, malformed or truncated, or has no such mesh.
    """
    data = read_bytes(path)
    start = _start(path, data, index)
    if len(data) - start < 4 or struct.unpack_from("<H", data, start)[0] != _MAGIC:
        fail(path, "is not a serialized mesh, or is damaged; check the path or export it again")
    version = struct.unpack_from("<H", data, start + 2)[0]
    if version not in (3, 4):
        fail(path, f"is of version {version}; export it as version 4 or 3")
    unpacked = zlib.decompressobj()
    try:
        body = unpacked.decompress(data[start + 4 :], _HEADER)
        flags, at = struct.unpack_from("<I", body)[0], 4
        if version == 4:
            at = body.index(b"\0", at) + 1  # behind the name
        vertices, triangles = struct.unpack_from("<QQ", body, at)
        real = np.dtype("<f8" if flags & _DOUBLE else "<f4")
        widths = {"vertices": 3, "normals": 3 * bool(flags & _NORMALS), "uvs": 2 * bool(flags & _UVS)}
        widths["colours"] = 3 * bool(flags & _COLOURS)
        size = at + 16 + vertices * sum(widths.values()) * real.itemsize + triangles * 12
        if size > _RATIO * (len(data) - start):
            raise EOFError
        take(path, 3 * size, "export a smaller mesh", len(data))
        if size > len(body):
            body += unpacked.decompress(unpacked.unconsumed_tail, size - len(body))
        if size > len(body):
            raise EOFError
    except (zlib.error, struct.error, ValueError, EOFError):
        fail(path, "is damaged or ends within a mesh; export it again")
    at += 16
    columns: dict[str, np.ndarray | None] = {}
    for name, width in widths.items():
        values = np.frombuffer(body, real, vertices * width, at).reshape(-1, width or 1)
        columns[name] = values.astype(np.float64) if width else None
        at += values.nbytes
    faces = np.frombuffer(body, "<u4", 3 * triangles, at).reshape(-1, 3)
    if not triangles:
        fail(path, "has no faces; jaxrt needs a surface mesh")
    if (faces >= vertices).any():
        fail(path, f"a face names a vertex outside 0..{vertices - 1}; repair the mesh")
    colours, positions = columns.pop("colours"), columns.pop("vertices")
    assert positions is not None
    attributes = {} if colours is None else {"vertex_color": colours}
    return checked(path, MeshData(positions, faces.astype(np.int32), **columns, attributes=attributes))


def _start(path: str | Path, data: bytes, index: int) -> int:
    """Where a mesh begins, by the table of offsets at the end of the file, of which the first one needs none."""
    if index == 0:
        return 0
    count = struct.unpack_from("<I", data, len(data) - 4)[0] if len(data) >= 8 else 0
    width, kind = (8, "<Q") if data[2:4] == b"\4\0" else (4, "<I")
    table = len(data) - 4 - width * count
    if table < 0:
        fail(path, "has no table of its meshes at its end; it is truncated, export it again")
    if not 0 < index < count:
        fail(path, f"has no mesh of number {index}; give a shape_index from 0 to {max(count, 1) - 1}")
    return min(struct.unpack_from(kind, data, table + width * index)[0], len(data))
