"""Small glTF files for tests: one mesh of two triangles, in one node."""

import base64
import io
import json
import struct

import numpy as np
import PIL.Image

from jaxrt.files.gltf import load_gltf

POSITIONS = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.5], [9, 9, 9]], np.float32)
NORMALS = np.tile(np.array([0, 0, 1], np.float32), (5, 1))
UVS = np.array([[0, 0], [65535, 0], [65535, 65535], [0, 65535], [0, 0]], np.uint16)  # normalised
INDICES = np.array([0, 1, 2, 0, 2, 3], np.uint8)
DATA = POSITIONS.tobytes() + NORMALS.tobytes() + UVS.tobytes() + INDICES.tobytes()


def document(**more):
    views = [(0, 60), (60, 60), (120, 20), (140, 6)]
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "quad"}],
        "meshes": [
            {
                "name": "shape",
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}
                ],
            }
        ],
        "materials": [
            {"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0}}
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 5, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5123, "count": 5, "type": "VEC2", "normalized": True},
            {"bufferView": 3, "componentType": 5121, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in views],
        "buffers": [{"byteLength": len(DATA)}],
        **more,
    }


def glb(path, doc, data=DATA):
    text = json.dumps(doc).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    return path


def load(folder, **more):
    return load_gltf(glb(folder / "a.glb", document(**more)))


def added(doc, data, values, kind, **more):
    """The number of another accessor, and the data with its values."""
    values = np.asarray(values)
    component = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
    data += b"\0" * (-len(data) % 4)
    doc["bufferViews"] += [{"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes}]
    accessor = {"bufferView": len(doc["bufferViews"]) - 1, "componentType": component[str(values.dtype)], **more}
    doc["accessors"] += [accessor | {"count": len(values), "type": kind}]
    data += values.tobytes()
    doc["buffers"] = [{"byteLength": len(data)}]
    return len(doc["accessors"]) - 1, data


def picture(values, mode):
    """A picture as the data of a URI."""
    file = io.BytesIO()
    PIL.Image.fromarray(np.asarray(values, np.uint8), mode).save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
