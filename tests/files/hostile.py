"""Small whole files of each format, what reads them, and words that harm them: for tests and for fuzzing."""

import io
import json
import random
import re
import struct
import zlib
from pathlib import Path

import numpy as np
from gltf_files import DATA, document

from jaxrt.files import load_description
from jaxrt.files.ies import load_ies
from jaxrt.files.image import write_exr
from jaxrt.files.reading import reading
from jaxrt.files.serialized import read_serialized
from jaxrt.files.spectra import read_spd
from jaxrt.files.textures import read_picture
from jaxrt.files.vol import read_vol

SCENES = Path(__file__).parents[2] / "scenes"

WORDS = [
    "", "0", "-1", "nan", "inf", "-inf", "1e400", "1e38", "1e-38", "1e-300", "99999999999999999999", "2147483648",
    "0 0 0", "1 2", "nan, 0, 0", "1e20 1e20 1e20", "true", "none", "$r", "400:1, 300:2", "é", "a" * 300,
]  # fmt: skip
"""Values that an attribute or a field may get."""


def whole(head: str = "", body: str = '<shape type="sphere"/>') -> str:
    return f'<scene version="3.0.0">{head}{body}</scene>'


XML = whole(
    '<default name="r" value="2"/><bsdf type="roughconductor" id="gold"><string name="material" value="Au"/>'
    '<float name="alpha" value=".2"/></bsdf><bsdf type="principled" id="paint"><float name="roughness" value=".4"/>'
    '<rgb name="base_color" value=".4 .5 .6"/></bsdf><alias id="gold" as="or"/>',
    '<shape type="sphere"><float name="radius" value="$r"/><point name="center" value="1 2 3"/><ref id="or"/>'
    '<emitter type="area"><spectrum name="radiance" value="400:1,700:2"/></emitter></shape><shape type="cylinder">'
    '<transform name="to_world"><scale z="3"/><rotate x="1" angle="30"/><translate x="1"/></transform><ref id="paint"/>'
    '</shape><shape type="shapegroup" id="group"><shape type="disk"/></shape><shape type="instance"><ref id="group"/>'
    '<transform name="to_world"><matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>'
    '<shape type="cube"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><transform name="to_uv">'
    '<scale value="4"/></transform></texture></bsdf></shape><sensor type="thinlens"><float name="fov" value="40"/>'
    '<float name="aperture_radius" value=".1"/><float name="focus_distance" value="3"/><transform name="to_world">'
    '<lookat origin="0 0 5" target="0 0 0" up="0 1 0"/></transform><film type="hdrfilm"><integer name="width" value="8"'
    '/><integer name="height" value="8"/><rfilter type="gaussian"><float name="stddev" value=".5"/></rfilter></film>'
    '<sampler type="independent"><integer name="sample_count" value="4"/></sampler></sensor><integrator type="path">'
    '<integer name="max_depth" value="3"/></integrator><emitter type="sunsky"><float name="turbidity" value="3"/>'
    '<vector name="sun_direction" value="0 1 1"/></emitter><emitter type="spot"><float name="cutoff_angle" value="20"/>'
    '<rgb name="intensity" value="1"/></emitter>',
)

OBJ = (
    b"# square\nmtllib a.mtl\no square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nvt 0 0.25\nvt 1 0\nvn 0 0 2\n"
    b"usemtl red\nf 1/1/1 2/2/1 3/1/1 -1/2/1\nf 1//1 3//1 4//1\ng other\nf 1 2 4\n"
)


def ply(order: str) -> bytes:
    head = f"ply\nformat {order} 1.0\ncomment c\nelement vertex 4\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n"
    head += "property list uchar int vertex_indices\nproperty float heat_0\nend_header\n"
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.5)]
    rows = [(*corner, 0, 0, 1, 0.5, 0.5, 255, 0, 7) for corner in corners]
    faces = [([0, 1, 2, 3], 0.5), ([0, 2, 3], 1.5)]
    if order == "ascii":
        lines = [*rows, *((len(f), *f, heat) for f, heat in faces)]
        return (head + "".join(" ".join(map(str, line)) + "\n" for line in lines)).encode()
    sign = "<" if order == "binary_little_endian" else ">"
    data = b"".join(struct.pack(f"{sign}8f3B", *row) for row in rows)
    data += b"".join(struct.pack(f"{sign}B{len(f)}if", len(f), *f, heat) for f, heat in faces)
    return head.encode() + data


def gltf() -> bytes:
    import base64

    doc = document(cameras=[{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}])
    doc["nodes"].append({"camera": 0, "rotation": [0, 0, 0, 1], "translation": [0, 0, 4]})
    doc["scenes"][0]["nodes"].append(1)
    doc["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(png()).decode()}]
    doc["textures"] = [{"source": 0}]
    doc["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    doc["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(DATA).decode()
    return json.dumps(doc).encode()


def glb(doc: dict | None = None, binary: bytes = DATA) -> bytes:
    text = json.dumps(doc or document()).encode()
    chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", binary + b"\0" * (-len(binary) % 4))]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def exr(folder: Path) -> bytes:
    path = folder / "seed.exr"
    write_exr(path, np.linspace(0, 1, 36, dtype=np.float32).reshape(3, 4, 3), attributes={"jaxrt": "x"})
    return path.read_bytes()


def png(size: tuple[int, int] = (4, 3), mode: str = "RGBA") -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.new(mode, size).save(out, "PNG")
    return out.getvalue()


def png_head(width: int, height: int) -> bytes:
    """A PNG that claims a size, and holds next to nothing."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")


IES = (
    b"IESNA:LM-63-2002\r\n[TEST] none\r\nTILT=NONE\r\n1 1000 1 3 2 1 2 0 0 0\r\n1 1 50\r\n0 45 90\r\n0 90\r\n"
    b"10 20 30\r\n40 50 60\r\n"
)
SPD = b"# nm value\n400 .1\n500 .5\n700 1e0\n"
PFM = b"PF\n2 2\n-1.0\n" + np.arange(12, dtype="<f4").tobytes()
HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 8\n" + b"\2\2\0\x08" + b"\x88\x80" * 4
VOL = struct.pack("<3sB5i6f", b"VOL", 3, 1, 2, 2, 2, 1, *[0.0] * 3, *[1.0] * 3) + np.arange(8, dtype="<f4").tobytes()


def serialized(vertices: int = 3, triangles: int = 1, body: bytes | None = None) -> bytes:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    head = struct.pack("<I", 0x1000) + b"name\0" + struct.pack("<QQ", vertices, triangles)
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(head + (points if body is None else body)) + b"\0" * 8


def seeds(folder: Path) -> dict[str, bytes]:
    """A whole file of each format, by the name that it has to have."""
    return {
        "a.xml": XML.encode(), "a.obj": OBJ, "ascii.ply": ply("ascii"), "little.ply": ply("binary_little_endian"),
        "big.ply": ply("binary_big_endian"), "a.gltf": gltf(), "a.glb": glb(), "a.exr": exr(folder), "a.png": png(),
        "a.ies": IES, "a.spd": SPD, "a.pfm": PFM, "a.hdr": HDR, "a.vol": VOL, "a.serialized": serialized(),
    }  # fmt: skip


READERS = {".ies": load_ies, ".spd": read_spd, ".vol": read_vol, ".serialized": read_serialized}
READERS |= dict.fromkeys(
    (".exr", ".png", ".pfm", ".hdr", ".jpg", ".ppm", ".webp", ".tga", ".bmp", ".gif"), read_picture
)


def read(path: Path) -> object:
    """What a file holds. Raises `SceneError`, and nothing else."""
    with reading():
        return READERS.get(path.suffix, load_description)(path)


def damaged(data: bytes, number: int) -> bytes:
    """Bytes turned, numbers and words replaced, pieces cut out, doubled and moved: a few of these, by a number."""
    rng, data = random.Random(number), bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        at, size = rng.randrange(len(data) + 1), rng.choice([1, 1, 2, 4, 8, 30])
        kind = rng.randrange(7)
        if kind == 0:
            data[at : at + 1] = bytes([rng.randrange(256)])
        elif kind == 1:
            data[at : at + size] = rng.choice([b"\0", b"\xff", b"\x7f", b"\x80"]) * size
        elif kind == 2:
            del data[at : at + size]
        elif kind == 3:
            data[at:at] = data[at : at + size] * rng.choice([1, 1, 1, 100])
        elif kind == 4:
            del data[at:]
        elif numbers := list(re.finditer(rb"-?[0-9][0-9.e+-]*", bytes(data))):
            found = rng.choice(numbers)
            data[found.start() : found.end()] = rng.choice(WORDS).encode()
    return bytes(data)


TAG = re.compile(r"<(?![/?!])[^<>]*>")


def altered(text: str, number: int) -> str:
    """XML that stays well-formed, but with attributes of other values, elements missing, doubled or of other names."""
    rng = random.Random(number)
    for _ in range(rng.randint(1, 3)):
        tags = list(TAG.finditer(text))
        tag = rng.choice(tags[1:])
        found, kind = tag[0], rng.randrange(8)
        if kind == 0 and found.endswith("/>"):
            new = rng.choice(["", found * 2, rng.choice(tags)[0].rstrip("/>") + "/>"])
        elif kind == 1 and found.endswith("/>"):
            new = re.sub(
                r"\w+", rng.choice(["rgb", "float", "integer", "string", "transform", "ref", "point"]), found, count=1
            )
        elif attributes := list(re.finditer(r'"([^"]*)"', found)):
            chosen = rng.choice(attributes)
            words = [*WORDS, *re.findall(r'"([^"]*)"', text)]
            new = found[: chosen.start(1)] + rng.choice(words) + found[chosen.end(1) :]
        else:
            continue
        text = text[: tag.start()] + new + text[tag.end() :]
    return text
