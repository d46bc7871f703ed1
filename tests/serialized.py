"""Mitsuba's .serialized meshes, written by its documented format alone."""

import struct
import zlib

import numpy as np


def written(meshes, version=4, double=False):
    """A file of meshes: dictionaries of vertices, faces, and normals, uvs, colours, flat where they have them."""
    parts, offsets, at = [], [], 0
    for mesh in meshes:
        flags = sum(bit for key, bit in (("normals", 1), ("uvs", 2), ("colours", 8), ("flat", 16)) if key in mesh)
        body = struct.pack("<I", flags | (0x2000 if double else 0x1000)) + (b"a mesh\0" if version == 4 else b"")
        body += struct.pack("<QQ", len(mesh["vertices"]), len(mesh["faces"]))
        for key in ("vertices", "normals", "uvs", "colours"):
            body += np.asarray(mesh.get(key, ()), "<f8" if double else "<f4").tobytes()
        body += np.asarray(mesh["faces"], "<u4").tobytes()
        parts.append(struct.pack("<HH", 0x041C, version) + zlib.compress(body))
        offsets.append(at)
        at += len(parts[-1])
    table = struct.pack(f"<{len(offsets)}{'Q' if version == 4 else 'I'}", *offsets)
    return b"".join(parts) + table + struct.pack("<I", len(meshes))


def volume(grid, version=3, kind=1):
    """The bytes of a .vol file, of values (Z, Y, X) or (Z, Y, X, channels)."""
    grid = np.asarray(grid, "<f4")
    z, y, x, channels = (*grid.shape, 1)[:4]
    return b"VOL" + struct.pack("<B5i6f", version, kind, x, y, z, channels, 0, 0, 0, 1, 1, 1) + grid.tobytes()
