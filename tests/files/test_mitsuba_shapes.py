"""What rays meet in Mitsuba's scenes, shape by shape: distance, normals, coordinates and tangents, against Mitsuba."""

import dataclasses
import itertools

import numpy as np
import pytest
from helpers import ball_of_distances, hits
from serialized import volume, written

import jaxrt

pytestmark = [pytest.mark.peer, pytest.mark.usefixtures("short_loops")]

MOVES = {
    "plain": "",
    "turned": '<scale value=".7"/><rotate x=".6" y=".8" angle="40"/>',
    "mirrored": '<scale x="-.8" y=".8" z=".8"/><rotate y="1" angle="70"/>',
    "uneven": '<scale x=".5" y="1.2" z=".9"/><rotate x="1" angle="30"/>',
}
FLIP, FLAT = (f'<boolean name="{k}_normals" value="true"/>' for k in ("flip", "face"))


def moved(move, k=0):
    """A to_world, in the k-th place of a grid."""
    return f'<transform name="to_world">{move}<translate x="{5 * (k % 6)}" y="{5 * (k // 6)}"/></transform>'


def file(name, more=""):
    return f'<string name="filename" value="{name}"/>{more}'


BARE = "v 0 0 0\nv 1 0 0\nv 1 1 .5\nv 0 1 0\nv 2 0 1\n"
CORNERS = BARE + "vt 0 0\nvt 1 .25\nvt .3 .9\nvt .8 .9\n"
SMOOTH, DOWN = "vn 0 0 1\nvn .3 .1 1\nvn .1 -.5 1\n", "vn 0 0 -1\nvn .3 .1 -1\nvn .1 -.5 -1\n"
FACES = "g one\no thing\nf 1/1/1 2/2/2 3/3/3 4/4/1 # four\ng two\nusemtl none\nf 2/2/2 5/3/1 3/1/3\n"
MESHES = {
    "bare.obj": BARE + "f 1 2 5 3 4\n",  # five corners
    "flat.obj": BARE + "f 1 2 3\n",
    "degenerate.obj": CORNERS + "f 1/1 2/2 3/3 4/1\n",  # two corners of the second triangle share coordinates
    "smooth.obj": CORNERS + SMOOTH + FACES,
    "down.obj": CORNERS + DOWN + FACES,
}
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0], [2, 0, 1]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]])
NORMALS = np.array([[0, 0, 1], [0.3, 0.1, 1], [0.1, -0.5, 1], [0, 0.2, 1], [0, 0, 2]])
UVS = np.array([[0, 0.1], [0.9, 0], [1, 0.8], [0.2, 1], [1, 0.2]])


def ply(extra, rows):
    """A PLY file with further columns of its vertices."""
    head = ["ply", "format ascii 1.0", "element vertex 5", *(f"property float {c}" for c in ("x", "y", "z", *extra))]
    head += ["element face 3", "property list uchar int vertex_indices", "end_header"]
    body = [" ".join(map(str, row)) for row in np.concatenate([POINTS, rows], 1)]
    return "\n".join(head + body + [f"3 {a} {b} {c}" for a, b, c in TRIANGLES]) + "\n"


@pytest.fixture
def meshes(tmp_path):
    """Files that the scenes refer to, with the elements that do."""
    plys = {
        "none.ply": ply((), np.zeros((5, 0))),
        "uv.ply": ply(("u", "v"), UVS),
        "st.ply": ply(("nx", "ny", "nz", "s", "t"), np.concatenate([NORMALS, UVS], 1)),
    }
    for name, text in (MESHES | plys).items():
        (tmp_path / name).write_text(text)
    made = [("obj", file(name)) for name in MESHES] + [("ply", file(name)) for name in plys]
    made += [
        (kind, file(name, f'<boolean name="flip_tex_coords" value="{flip}"/>'))
        for kind, name, flip in (("obj", "smooth.obj", "false"), ("ply", "uv.ply", "true"))
    ]
    for version, double in itertools.product((3, 4), (False, True)):
        name, more = f"{version}{double}.serialized", {"version": version, "double": double}
        several = [
            {"vertices": POINTS, "faces": TRIANGLES, "normals": NORMALS, "uvs": UVS, "colours": POINTS, "flat": True},
            {"vertices": -POINTS, "faces": TRIANGLES, "uvs": UVS},
            {"vertices": POINTS - 0.5, "faces": TRIANGLES},
        ]
        (tmp_path / name).write_bytes(written(several, **more))
        for k in range(3):
            made.append(("serialized", file(name, f'<integer name="shape_index" value="{k}"/>')))
    return made


def compare(tmp_path, body, aim):
    """Rays from around each point of `aim` (N, 3) towards it."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path, rng = tmp_path / "scene.xml", np.random.default_rng(0)
    path.write_text(f'<scene version="3.0.0"><emitter type="constant"/><sensor type="perspective"/>{body}</scene>')
    theirs, ours = mi.load_file(str(path)), jaxrt.load(path)
    aim = np.repeat(aim, 60, 0)
    o = rng.normal(size=aim.shape)
    o = aim + 3.0 * o / np.linalg.norm(o, axis=1)[:, None]
    d = aim + rng.uniform(-0.9, 0.9, aim.shape) - o
    o, d = o.astype(np.float32), (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)
    plan = dataclasses.replace(jaxrt.plan(ours, backend="dense"), coordinates=True, tangents=True)
    x = hits(ours, o, d, plan=plan)
    found = [theirs.ray_intersect(mi.Ray3f(a.tolist(), b.tolist())) for a, b in zip(o, d, strict=True)]
    there = np.array([si.is_valid() for si in found])
    distance = np.where(there, [si.t for si in found], np.inf)
    same = there & np.isclose(x.distance, distance, atol=1e-4)
    assert there.mean() > 0.15
    assert (same == (there | (x.face >= 0))).mean() > 0.998  # but for rays at edges
    found = [si for si, good in zip(found, same, strict=True) if good]
    columns = lambda v: np.stack([np.asarray(c) for c in v], 1)[same]
    close = lambda a, b, atol: np.abs(a - b).max(1) < atol
    normal = np.array([si.sh_frame.n for si in found]).reshape(-1, 3)
    assert close(columns(x.shading), normal, 1e-4).mean() > 0.998
    front = (columns(x.normal) * columns(x.shading)).sum(1) > 0  # Mitsuba's may be behind
    assert front.all()
    off = columns(x.place.uv) - np.array([si.uv for si in found]).reshape(-1, 2)
    off -= np.round(off) * (np.abs(off) > 0.99)  # angles begin anew
    assert close(off, 0.0, 1e-4).mean() > 0.998
    along = columns(x.tangent)
    along = along - normal * (along * normal).sum(1)[:, None]
    along /= np.linalg.norm(along, axis=1)[:, None]
    assert close(along, np.array([si.sh_frame.s for si in found]).reshape(-1, 3), 1e-3).mean() > 0.99


def places(count):
    return np.array([[5.0 * (k % 6), 5.0 * (k // 6), 0.0] for k in range(count)])


def test_shapes_of_closed_form(tmp_path):
    made = []
    for kind, move, flip in itertools.product(("rectangle", "cube", "disk", "sphere", "cylinder"), MOVES, ("", FLIP)):
        if kind not in ("sphere", "cylinder") or move != "uneven":
            flat = FLAT if kind in ("rectangle", "cube") and flip else ""
            made.append(f'<shape type="{kind}">{flip}{flat}{moved(MOVES[move], len(made))}</shape>')
    compare(tmp_path, "".join(made), places(len(made)))


def test_meshes(tmp_path, meshes):
    flags = itertools.cycle(["", FLIP, FLAT, FLIP + FLAT, ""])  # five, so that they go around the moves
    made = []
    for kind, given in meshes:
        for move in ("plain", "mirrored", "uneven"):
            to_world = moved(MOVES[move], len(made))
            made.append(f'<shape type="{kind}">{given}{next(flags)}{to_world}</shape>')
    middle = places(len(made)) + [0.3, 0.3, 0.2]
    compare(tmp_path, "".join(made), middle)


@pytest.mark.parametrize("curved", [False, True])
def test_instances(tmp_path, meshes, curved):
    """Also of what has a transform, turned sides or is merged; in a group of curved shapes only even scales."""
    kinds = ("sphere", "cylinder", "disk", "cube") if curved else ("rectangle", "cube")
    small = '<scale value=".4"/><rotate y="1" angle="20"/>'
    inner = [
        f'<shape type="{kind}">{(FLIP, "")[k % 2]}<transform name="to_world">{small}<translate z="{k - 1}"/></transform></shape>'
        for k, kind in enumerate(kinds)
    ]
    meshes = [m for m in meshes if m[1] != file("degenerate.obj")]  # whose instances Mitsuba gives other tangents
    inner += [
        f'<shape type="{kind}">{given}{(FLIP, "")[k % 2]}<transform name="to_world"><translate z="{0.3 * k}"/></transform></shape>'
        for k, (kind, given) in enumerate(meshes[2:8])
    ]
    body = f"""<shape type="shapegroup" id="toy">{inner[0]}<shape type="merge">{"".join(inner[1:-1])}
    <shape type="merge">{inner[-1]}</shape></shape></shape><shape type="merge"><shape type="cube">{moved("", 5)}</shape>
    <shape type="sphere">{moved("", 4)}</shape></shape>"""
    moves = [m for m in MOVES.values() if not curved or m != MOVES["uneven"]]
    body += "".join(f'<shape type="instance"><ref id="toy"/>{moved(m, k)}</shape>' for k, m in enumerate(moves))
    compare(tmp_path, body, np.concatenate([places(6), places(6) + [0.4, 0.3, 0.2]]))


def test_grids_of_distances(tmp_path):
    """Mitsuba searches a turned or mirrored one only as an instance."""
    grids = {"ball": ball_of_distances(9), "rough": ball_of_distances(8, 0.05)}
    for name, grid in grids.items():
        (tmp_path / f"{name}.vol").write_bytes(volume(grid))
    kinds = [(name, normals) for name in grids for normals in ("smooth", "analytic")]
    middle, scale = '<translate x="-.5" y="-.5" z="-.5"/>', '<scale x="1.6" y="1.2" z="2"/>'
    shape = lambda name, normals, to_world: (
        f'<shape type="sdfgrid">{file(name + ".vol")}<string name="normals" value="{normals}"/>{to_world}</shape>'
    )
    body = "".join(shape(*kind, moved(middle + scale, k)) for k, kind in enumerate(kinds))
    inner = moved(middle).replace('<translate x="0" y="0"/>', "")
    body += "".join(
        f"""<shape type="shapegroup" id="g{k}">{shape(*kind, inner)}</shape><shape type="instance"><ref id="g{k}"/>
        {moved(scale + '<scale x="-1"/><rotate x=".6" y=".8" angle="40"/>', k + 6)}</shape>"""
        for k, kind in enumerate(kinds)
    )
    aim = places(10)[[0, 1, 2, 3, 6, 7, 8, 9]]
    compare(tmp_path, body, aim)
