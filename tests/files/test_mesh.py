"""PLY, OBJ and serialized meshes: what is read, in which order, and that damaged files are refused by name."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serialized import written

from jaxrt.files.mesh import smooth_normals
from jaxrt.files.obj import load_obj, read_obj
from jaxrt.files.ply import _ORDERS, load_ply, read_ply
from jaxrt.files.serialized import read_serialized
from jaxrt.parts import Diffuse, SceneError

FLOATS = st.floats(-1e6, 1e6, width=32)
QUICK = settings(max_examples=60, deadline=None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("mesh")


def write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def ply(kind, vertices, polygons, extra=(), rows=None):
    """A PLY file by struct and text alone; `extra`: names of further float columns of `rows`."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    rows = np.asarray(vertices if rows is None else rows, np.float32)
    head = f"ply\nformat {kind} 1.0\ncomment made by a test\nelement vertex {len(rows)}\n"
    head += "".join(f"property float {k}\n" for k in ("x", "y", "z", *extra))
    head += f"element face {len(polygons)}\nproperty list uchar int vertex_indices\nend_header\n"
    if not order:
        lines = [" ".join(repr(float(x)) for x in row) for row in rows]
        lines += [" ".join(map(str, (len(p), *p))) for p in polygons]
        return (head + "\n".join(lines) + "\n").encode()
    body = b"".join(struct.pack(f"{order}{rows.shape[1]}f", *row) for row in rows)
    return head.encode() + body + b"".join(struct.pack(f"{order}B{len(p)}i", len(p), *p) for p in polygons)


KINDS = pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0.25]]


@KINDS
@pytest.mark.parametrize("polygons", [[[0, 1, 2], [2, 3, 4]], [[0, 1, 2, 3, 4]], [[0, 1, 2], [0, 1, 2, 3], [3, 2, 4]]])
def test_ply_polygons_become_fans_in_the_order_of_the_file(tmp_path, kind, polygons):
    mesh = read_ply(write(tmp_path / "a.ply", ply(kind, SQUARE, polygons)))
    assert mesh.faces.dtype == np.int32
    assert mesh.vertices.dtype == np.float64
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    assert mesh.faces.tolist() == [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    assert mesh.normals is None
    assert mesh.uvs is None


@KINDS
@pytest.mark.parametrize("names", [("u", "v"), ("s", "t"), ("texture_u", "texture_v")])
def test_ply_normals_and_uvs(tmp_path, kind, names):
    rows = np.concatenate([SQUARE, np.tile([0, 0, 2, 0.25, 0.5], (5, 1))], 1)
    mesh = read_ply(write(tmp_path / "a.ply", ply(kind, SQUARE, [[0, 1, 2]], ("nx", "ny", "nz", *names), rows)))
    np.testing.assert_array_equal(mesh.normals, np.tile([0.0, 0, 1], (5, 1)))  # made unit
    np.testing.assert_array_equal(mesh.uvs, np.tile([0.25, 0.5], (5, 1)))


@QUICK
@given(st.lists(st.tuples(FLOATS, FLOATS, FLOATS), min_size=3, max_size=8), st.data())
def test_ply_round_trip(folder, vertices, data):
    polygons = data.draw(st.lists(st.lists(st.integers(0, len(vertices) - 1), min_size=3, max_size=5), min_size=1))
    read = [read_ply(write(folder / "a.ply", ply(kind, vertices, polygons))) for kind in _ORDERS]
    for mesh in read:
        np.testing.assert_array_equal(mesh.vertices, np.array(vertices, np.float32))
        np.testing.assert_array_equal(mesh.faces, read[0].faces)


def test_ply_other_elements_lists_types_and_line_ends(tmp_path):
    head = (
        "ply\r\nformat binary_big_endian 1.0\r\nobj_info x\r\nelement camera 2\r\nproperty list ushort double a\r\n"
        "property uchar b\r\nelement vertex 3\r\nproperty double z\r\nproperty double y\r\nproperty double x\r\n"
        "element face 1\r\nproperty uchar red\r\nproperty list uint8 uint vertex_index\r\n"
        "property list uchar float texcoord\r\nelement none 0\r\nproperty int a\r\nend_header\r\n"
    )
    body = struct.pack(">H1dB", 1, 1.0, 2) + struct.pack(">H3dB", 3, 1.0, 2.0, 3.0, 4)
    body += struct.pack(">9d", *range(9)) + struct.pack(">BB3I", 1, 3, 2, 1, 0) + struct.pack(">B6f", 6, *range(6))
    mesh = read_ply(write(tmp_path / "a.ply", head.encode() + body))
    np.testing.assert_array_equal(mesh.vertices, [[2, 1, 0], [5, 4, 3], [8, 7, 6]])
    assert mesh.faces.tolist() == [[2, 1, 0]]


def test_ply_as_a_scene(tmp_path):
    rows = np.concatenate([SQUARE, np.ones((5, 3))], 1)
    file = write(tmp_path / "thing.ply", ply("ascii", SQUARE, [[0, 1, 2]], ("red", "green", "blue"), rows))
    scene = load_ply(file)
    assert [s.id for s in scene.shapes] == ["thing"]
    assert scene.shapes[0].bsdf.reflectance.name == "vertex_color"
    np.testing.assert_array_equal(scene.shapes[0].attributes["vertex_color"], np.ones((5, 3)))


HEAD = "ply\nformat ascii 1.0\n"
VERTEX = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
POINTS = "0 0 0\n1 0 0\n0 1 0\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not a PLY"),
        (b"\x00\xff" * 50, "not a PLY"),
        (HEAD + VERTEX, "no end"),
        (HEAD + "element vertex many\n" + FACE, "line 3 of its header"),
        (HEAD + "element vertex -3\n" + FACE, "line 3 of its header"),
        (HEAD + "property float x\n" + FACE, "line 3 of its header"),
        (HEAD + VERTEX.replace("float x", "quad x") + FACE + POINTS, "line 4 of its header"),
        ("ply\nformat ascii 2.0\n" + VERTEX + FACE + POINTS, "line 2 of its header"),
        ("ply\n" + VERTEX + FACE + POINTS, "line 3 of its header"),
        (HEAD + VERTEX + FACE + POINTS, "does not fit|truncated"),
        (HEAD + VERTEX + FACE + "0 0 0\n1 0 0\n", "truncated"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1", "truncated|does not fit"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1 2\n3 0 1 2\n", "after the last"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1 3\n", "outside 0..2"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1 -1\n", "outside 0..2"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1 1.5\n", "outside 0..2"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1 nan\n", "outside 0..2"),
        (HEAD + VERTEX + FACE + POINTS + "2 0 1\n", "2 corners"),
        (HEAD + VERTEX + FACE + POINTS + "-1\n", "does not fit"),
        (HEAD + VERTEX + FACE + POINTS + "1e300 0 1 2\n", "does not fit"),
        (HEAD + VERTEX + FACE + POINTS + "3 0 1 two\n", "not all numbers"),
        (HEAD + VERTEX + FACE + POINTS.replace("1", "nan", 1) + "3 0 1 2\n", "vertex 1 is not finite"),
        (HEAD + VERTEX + FACE.replace("face 1", "face 0") + POINTS, "no faces"),
        (HEAD + VERTEX + "end_header\n" + POINTS, "no faces"),
        (HEAD + FACE + "3 0 1 2\n", "no vertices"),
        (HEAD + VERTEX.replace("vertex 3", "vertex 999999999999999") + FACE + POINTS, "truncated"),
        (HEAD.replace("ascii", "binary_little_endian") + VERTEX + FACE + "0" * 37, "does not fit"),
        (HEAD.replace("ascii", "binary_little_endian") + VERTEX.replace("3", "4000000000") + FACE, "truncated"),
    ],
)
def test_damaged_ply_is_refused(tmp_path, content, says):
    file = write(tmp_path / "bad.ply", content)
    with pytest.raises(SceneError, match=rf"bad\.ply: .*({says})") as error:
        read_ply(file)
    assert "\n" not in str(error.value)


def test_huge_list_is_refused_before_it_is_allocated(tmp_path):
    head = HEAD.replace("ascii", "binary_little_endian") + VERTEX + FACE.replace("uchar", "uint")
    with pytest.raises(SceneError, match="does not fit"):
        read_ply(write(tmp_path / "a.ply", head.encode() + b"\0" * 36 + b"\xff" * 16))


@QUICK
@given(st.binary(max_size=200), st.booleans())
def test_random_bytes_are_refused(folder, content, headed):
    file = write(folder / "a.ply", (HEAD + VERTEX + FACE).encode() * headed + content)
    for read in (read_ply, read_obj, load_obj):
        with pytest.raises(SceneError):
            read(file)


@QUICK
@given(st.data())
def test_damage_anywhere_is_refused_or_harmless(folder, data):
    rows = np.concatenate([SQUARE, np.ones((5, 5))], 1)
    kind = data.draw(st.sampled_from(sorted(_ORDERS)))
    extra = ("nx", "ny", "nz", "u", "v")
    good = bytearray(ply(kind, SQUARE, [[0, 1, 2], [0, 1, 2, 3], [4, 3, 2]], extra, rows))
    for _ in range(data.draw(st.integers(1, 3))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    keep = data.draw(st.integers(0, len(good)) | st.just(len(good)))
    try:
        mesh = read_ply(write(folder / "a.ply", bytes(good[:keep])))
    except SceneError:
        return
    assert mesh.faces.max() < len(mesh.vertices)


@pytest.mark.parametrize("read", [read_ply, read_obj, load_ply, load_obj, read_serialized])
def test_missing_files_folders_and_odd_names(tmp_path, read):
    for path in (tmp_path / "none.ply", tmp_path, "/dev/zero", "a\0b.ply", "x" * 5000):
        with pytest.raises(SceneError, match="check the path"):
            read(path)


# -------------------------------------------------------------------------------------------- OBJ

CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nv 0 0 1\n"
OBJ = (
    "# comment\n" + CORNERS + "vt 0 0.25\nvt 1 0\nvt 1 1\nvn 0 0 2\nvn 0 1 1\n"
    "f 4/1/1 3/2/1 2/3/1 1/1/1\ng other\nf 5/1/2 1/1/1 2/3/2 # end\n\nf 3/1/1\t4/1/1 5/1/1\r\n"
)


def test_obj_vertices_are_distinct_triples_in_order_of_use(tmp_path):
    mesh = read_obj(write(tmp_path / "a.obj", OBJ))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 3, 5], [6, 0, 7]]
    expected = [[0, 1, 0.5], [1, 1, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0], [0, 0, 1]]
    np.testing.assert_array_equal(mesh.vertices, expected)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, rtol=1e-15)
    np.testing.assert_array_equal(mesh.uvs[:3], [[0, 0.75], [1, 1], [1, 0]])
    np.testing.assert_array_equal(read_obj(tmp_path / "a.obj", flip_v=False).uvs[:3], [[0, 0.25], [1, 0], [1, 1]])


def test_obj_long_lines_may_go_on(tmp_path):
    mesh = read_obj(write(tmp_path / "a.obj", CORNERS + "f 1 \\\n 2 3\nf 3 4 \\\r\n5\n"))
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 3, 4]]


def test_obj_negative_indices_count_back_from_the_line(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\nf 1 2 3\n"
    mesh = read_obj(write(tmp_path / "a.obj", text))
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5], [0, 1, 2]]
    assert mesh.vertices[3:, 0].tolist() == [5, 6, 5]


def test_missing_normals_become_smooth_ones(tmp_path):
    text = CORNERS + "vn 0 0 0\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1 3 4\nf 1//2 2//2 3//2\n"
    mesh = read_obj(write(tmp_path / "a.obj", text))
    np.testing.assert_array_equal(mesh.normals[:3], [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(mesh.normals[-3:], [[1, 0, 0]] * 3)
    assert read_obj(write(tmp_path / "a.obj", CORNERS + "vn 0 0 0\nf 1//1 2//1 3//1\n")).normals is None


def test_smooth_normals_are_weighted_by_angle():
    """At a corner of a cube three right angles meet, however its squares are cut into triangles."""
    v = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    np.testing.assert_allclose(smooth_normals(v, faces), v / np.sqrt(3), rtol=1e-12)
    np.testing.assert_array_equal(smooth_normals(np.zeros((3, 3)), np.array([[0, 1, 2]])), [[1, 0, 0]] * 3)


@QUICK
@given(st.lists(st.tuples(FLOATS, FLOATS, FLOATS), min_size=3, max_size=9))
def test_obj_round_trip(folder, vertices):
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices)
    mesh = read_obj(write(folder / "a.obj", text + f"f {' '.join(str(k + 1) for k in range(len(vertices)))}"))
    np.testing.assert_array_equal(mesh.vertices, vertices)
    assert mesh.faces.tolist() == [[0, k, k + 1] for k in range(1, len(vertices) - 1)]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "no faces"),
        (CORNERS, "no faces"),
        (CORNERS + "f 1 2\n", "line 6"),
        (CORNERS + "f 1 2 6\n", "vertex 6 of 5"),
        (CORNERS + "f 1 2 0\n", "line 6"),
        (CORNERS + "f 1 2 -6\n", "line 6"),
        (CORNERS + "f 1 2 99999999999999999999\n", "line 6"),
        (CORNERS + "f 1/1 2/1 3/1\n", "texture coordinate 1 of 0"),
        (CORNERS + "f 1//2 2//2 3//2\nvn 0 0 1\n", "normal 2 of 1"),
        (CORNERS + "f 1/1/1/1 2 3\n", "line 6"),
        (CORNERS + "f //1 2 3\n", "line 6"),
        (CORNERS + "f a b c\n", "line 6"),
        (CORNERS + "v 1 2\n", "line 6"),
        (CORNERS + "v 1 2 x\nf 1 2 3\n", "line 6"),
        (CORNERS + "v nan 0 0\nf 1 2 6\n", "vertex 2 is not finite"),
        (CORNERS + "vn inf 0 0\nf 1//1 2//1 3//1\n", "normal of vertex 0 is not finite"),
    ],
)
def test_damaged_obj_is_refused(tmp_path, content, says):
    with pytest.raises(SceneError, match=rf"bad\.obj: .*({says})") as error:
        read_obj(write(tmp_path / "bad.obj", content))
    assert "\n" not in str(error.value)


WORDS = st.sampled_from([*"0123456789", "-1", "1/1", "1//1", "1/1/1", "-2/-1", "nan", "1e400", "/", "#", "\\", "é"])
KEYS = st.sampled_from(["v", "vt", "vn", "f", "f", "usemtl", "o", "mtllib", "l"])


@QUICK
@given(st.lists(st.tuples(KEYS, st.lists(WORDS, max_size=5))))
def test_obj_of_any_words_is_read_or_refused(folder, lines):
    text = CORNERS + "vt 0 0\nvn 0 0 1\n" + "\n".join(" ".join([key, *words]) for key, words in lines)
    try:
        scene = load_obj(write(folder / "a.obj", text))
    except SceneError as error:
        assert "a.obj" in str(error)
        assert "\n" not in str(error)
    else:
        assert all(len(s.faces) for s in scene.shapes)


# ----------------------------------------------------------------------------------- OBJ with MTL

MTL = "newmtl red\nKd 0.8 0.1 0.2\nKs 0.5 0.5 0.5\nd 0.5\nmap_Kd -s 2 2 wood.png\n"
MTL += "\nnewmtl lamp\nKe 3 2 1\nKd .25\nillum 2\n"


def test_obj_materials(tmp_path):
    write(tmp_path / "my look.mtl", MTL)
    faces = "o wall\nusemtl red\nf 1 2 3\nusemtl lamp\nf 3 4 5\nusemtl red\nf 1 2 4\no\nusemtl ghost\nf 1 2 5\n"
    scene = load_obj(write(tmp_path / "a.obj", "mtllib my look.mtl\n" + CORNERS + faces))
    red, lamp, _ = scene.shapes
    assert [s.id for s in scene.shapes] == ["red_mesh", "lamp_mesh", "ghost_mesh"]
    assert red.vertices[red.faces].tolist() == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]]
    assert isinstance(red.bsdf, Diffuse)
    assert red.bsdf.id == "red"
    np.testing.assert_array_equal(red.bsdf.reflectance, [0.8, 0.1, 0.2])
    assert red.emission is None
    np.testing.assert_array_equal(lamp.emission, [3, 2, 1])
    np.testing.assert_array_equal(lamp.bsdf.reflectance, [0.25])
    assert lamp.emission_id == "lamp.emitter"
    assert len(lamp.vertices) == 3
    notes = "\n".join(scene.notes)
    for words in ("wood.png (red.map_Kd)", "transparency is not used: red", "highlights (Ks)", "grey: ghost"):
        assert words in notes


def test_obj_names_meshes_after_objects(tmp_path):
    write(tmp_path / "a.mtl", MTL)
    faces = "o wall\nusemtl red\nf 1 2 3\no bulb\nusemtl lamp\nf 3 4 5\n"
    scene = load_obj(write(tmp_path / "a.obj", "mtllib a.mtl\n" + CORNERS + faces))
    assert [s.id for s in scene.shapes] == ["wall", "bulb"]
    scene = load_obj(write(tmp_path / "plain.obj", CORNERS + "f 1 2 3\n"))
    assert [s.id for s in scene.shapes] == ["plain"]
    assert not scene.notes


def test_mtl_mistakes(tmp_path):
    file = write(tmp_path / "a.obj", "mtllib a.mtl\n" + CORNERS + "usemtl red\nf 1 2 3\n")
    scene = load_obj(file)
    assert "a.mtl: no such file" in scene.notes[0]
    for bad in ("Kd 1.5 0 0", "Kd x y z", "Ke nan 0 0", "Ke -1 0 0", "Kd spectral a.rfl", "Kd"):
        write(tmp_path / "a.mtl", f"newmtl red\n{bad}\n")
        with pytest.raises(SceneError, match=r"a\.obj: red\."):
            load_obj(file)


# ------------------------------------------------------------------------------------- serialized

FULL = {
    "vertices": SQUARE,
    "faces": [[0, 1, 2], [2, 3, 4]],
    "normals": SQUARE,
    "uvs": np.ones((5, 2)),
    "colours": SQUARE,
}


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("double", [False, True])
def test_serialized_meshes_by_number(tmp_path, version, double):
    bare = {"vertices": np.add(SQUARE, np.pi), "faces": [[4, 3, 2]]}
    file = write(tmp_path / "a.serialized", written([FULL, bare, FULL], version, double))
    for index in (0, 2):
        mesh = read_serialized(file, index)
        assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32
        np.testing.assert_array_equal(mesh.vertices, SQUARE)
        np.testing.assert_array_equal(mesh.attributes["vertex_color"], SQUARE)
        np.testing.assert_array_equal(mesh.uvs, np.ones((5, 2)))
        assert mesh.faces.tolist() == FULL["faces"]
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, rtol=1e-15)  # the missing one is smooth
    mesh = read_serialized(file, 1)
    np.testing.assert_allclose(mesh.vertices, bare["vertices"], rtol=1e-15 if double else 1e-6)
    assert mesh.normals is None and mesh.uvs is None and not mesh.attributes
    with pytest.raises(SceneError, match=r"no mesh of number 3; give a shape_index from 0 to 2"):
        read_serialized(file, 3)


def huge(vertices, triangles):
    """A small file whose header promises much."""
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(struct.pack("<IBQQ", 0x1000, 0, vertices, triangles))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not a serialized mesh"),
        (b"ply\n" * 9, "not a serialized mesh"),
        (struct.pack("<HH", 0x041C, 2) + b"0" * 9, "version 2; export it as version 4"),
        (struct.pack("<HH", 0x041C, 4) + b"0" * 9, "damaged"),
        (struct.pack("<HH", 0x041C, 4) + zlib.compress(b"\0\x10\0\0a name without end"), "damaged"),
        (huge(1 << 40, 1), "damaged or ends"),
        (huge(3, (1 << 64) - 1), "damaged or ends"),
        (huge(3, 1), "damaged or ends"),
        (written([FULL])[:40], "damaged or ends"),
        (written([{"vertices": SQUARE, "faces": np.zeros((0, 3))}]), "no faces"),
        (written([{"vertices": SQUARE, "faces": [[0, 1, 5]]}]), "outside 0..4"),
        (written([{"vertices": np.multiply(SQUARE, np.nan), "faces": [[0, 1, 2]]}]), "vertex 0 is not finite"),
    ],
)
def test_damaged_serialized_is_refused(tmp_path, content, says):
    with pytest.raises(SceneError, match=rf"bad\.serialized: .*{says}") as error:
        read_serialized(write(tmp_path / "bad.serialized", content))
    assert "\n" not in str(error.value)


@QUICK
@given(st.data())
def test_serialized_damage_anywhere_is_refused_or_harmless(folder, data):
    good = bytearray(written([FULL, FULL], data.draw(st.sampled_from([3, 4])), data.draw(st.booleans())))
    for _ in range(data.draw(st.integers(1, 3))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    keep = data.draw(st.integers(0, len(good)) | st.just(len(good)))
    try:
        mesh = read_serialized(write(folder / "a.serialized", bytes(good[:keep])), data.draw(st.integers(0, 2)))
    except SceneError:
        return
    assert mesh.faces.max() < len(mesh.vertices)


# ------------------------------------------------------------------------------------------- peers


@pytest.mark.peer
def test_order_normals_and_uvs_are_mitsubas(tmp_path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rows = np.concatenate([SQUARE, np.tile([0, 3, 4, 0.25, 0.5], (5, 1))], 1)
    files = [
        write(tmp_path / "full.obj", OBJ),
        write(tmp_path / "bare.obj", CORNERS + "f 4 3 2 1\nf 1 2 5\n"),
        write(tmp_path / "bare.ply", ply("ascii", SQUARE, [[0, 1, 2], [2, 3, 4], [4, 0, 2]])),
        write(
            tmp_path / "le.ply", ply("binary_little_endian", SQUARE, [[4, 3, 2]], ("nx", "ny", "nz", "u", "v"), rows)
        ),
        write(tmp_path / "be.ply", ply("binary_big_endian", SQUARE, [[4, 3, 2]], ("nx", "ny", "nz", "s", "t"), rows)),
    ]
    for file in files:
        kind = file.suffix[1:]
        mesh = (read_obj if kind == "obj" else read_ply)(file)
        peer = mi.traverse(mi.load_dict({"type": kind, "filename": str(file)}))
        assert np.array(peer["faces"]).reshape(-1, 3).tolist() == mesh.faces.tolist()
        np.testing.assert_allclose(np.array(peer["vertex_positions"]), mesh.vertices.ravel(), rtol=1e-6)
        normals = mesh.normals if mesh.normals is not None else smooth_normals(mesh.vertices, mesh.faces)
        np.testing.assert_allclose(np.array(peer["vertex_normals"]), normals.ravel(), atol=1e-6)
        uvs = [] if mesh.uvs is None else mesh.uvs.ravel()
        np.testing.assert_allclose(np.array(peer["vertex_texcoords"]), uvs, rtol=1e-6)
