"""Default view, light and sides, and the choice of a loader by suffix."""

import sys
import types

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrt import files, parts
from jaxrt.files import view
from jaxrt.files.transforms import look_at
from jaxrt.parts import Description, SceneError

QUICK = settings(max_examples=80, deadline=None)
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
OUTWARDS = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def mesh(vertices=TETRAHEDRON, faces=OUTWARDS, **more):
    return parts.Mesh(vertices=vertices, faces=faces, **more)


def seen(sensor, points):
    """Picture coordinates in [-1, 1] across the smaller side, and depth, of points in the world."""
    p = (np.asarray(points) - sensor.to_world[:3, 3]) @ np.linalg.inv(sensor.to_world[:3, :3]).T
    return -p[:, :2] / p[:, 2:] / np.tan(np.radians(sensor.fov) / 2) * [1, -1], p[:, 2]


def test_a_bare_object_gets_a_view_and_light():
    given_ = Description([mesh()], notes=["said before"])
    scene = view.complete(given_)
    (sensor,) = scene.sensors
    assert scene.enclosure.radiance == 1
    assert [s.id for s in scene.shapes[1:]] == ["softbox"]
    assert len(scene.notes) == 3
    assert scene.notes[0] == "said before"
    assert (sensor.film.width, sensor.film.height) == (512, 512)
    origin = sensor.to_world[:3, 3] - [0.5, 0.5, 0.5]
    assert 0 < origin[0] < origin[2]  # in front, to the right
    assert 0 < origin[1] < origin[2]  # and a little above
    assert sensor.to_world[1, 1] > 0
    picture, _ = seen(sensor, [[1, 0, 0], [0, 0, 0], [0, 1, 0]])
    assert picture[0, 0] > picture[1, 0]  # +x of the world is to the right in the picture, not mirrored
    assert picture[2, 1] > picture[1, 1]
    assert len(given_.shapes) == 1  # the given one is left as it is
    assert given_.notes == ["said before"]


COORDINATE = st.floats(-1e3, 1e3).map(lambda x: round(x, 6))  # a size below rounding is none


@QUICK
@given(st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=1, max_size=20))
def test_everything_is_in_the_picture_and_the_softbox_is_not(points):
    points = np.array(points)
    sensor = view.default_view(points)
    picture, depth = seen(sensor, points)
    assert np.abs(picture).max() <= 1 - view.MARGIN + 1e-9
    assert (depth > sensor.near).all()
    assert (depth < sensor.far).all()
    if np.ptp(points, axis=0).max() > 1e-3:  # else stood off further, for it has no size
        box = view.softbox(sensor, points)
        assert box is not None
        assert (seen(sensor, view.world_points(box))[1] < 0).all()


def test_the_object_fills_the_picture_to_the_margin():
    rng = np.random.default_rng(1)
    for scale in (1e-6, 1.0, 1e6):
        points = rng.normal(size=(100, 3)) * scale + 3 * scale
        picture, _ = seen(view.default_view(points), points)
        assert np.abs(picture).max() == pytest.approx(1 - view.MARGIN)


def test_the_softbox_gives_the_irradiance_it_promises():
    points = np.array([[-1.0, -1, -1], [1, 1, 1]])
    box = view.softbox(view.default_view(points), points)
    n = 64
    u = (np.arange(n) + 0.5) / n * 2 - 1
    local = np.stack([*np.meshgrid(u, u), np.zeros((n, n))], -1).reshape(-1, 3)
    p = local @ box.to_world[:3, :3].T + box.to_world[:3, 3]
    front = box.to_world[:3, 2]
    area = 4 * np.linalg.norm(box.to_world[:3, 0]) * np.linalg.norm(box.to_world[:3, 1])
    d2 = (p**2).sum(1)
    cosine = -(p @ front) / np.sqrt(d2)  # at both ends, for a surface at the centre that faces the box
    irradiance = box.emission[0] * area * np.mean(cosine**2 / d2)
    assert irradiance == pytest.approx(view.KEY_IRRADIANCE, rel=0.05)  # the box is not a point


def test_no_softbox_for_a_camera_inside_of_a_room():
    room = parts.Cube(flip_normals=True)
    scene = view.complete(Description([room], [parts.Sensor()]))
    assert scene.shapes == [room]
    assert scene.enclosure is not None


def test_a_scene_with_a_camera_or_light_keeps_it():
    lamp = parts.Rectangle(emission=[3.0, 0, 0])
    sensor = parts.Sensor(to_world=look_at((0, 0, 9), (0, 0, 0), (0, 1, 0)))
    scene = view.complete(Description([lamp], [sensor]))
    assert (scene.shapes, scene.sensors, scene.enclosure, scene.notes) == ([lamp], [sensor], None, [])
    sky = parts.Enclosure([0.0, 0, 0.5], id="sky")
    assert view.complete(Description([mesh()], [sensor], sky)).enclosure is sky
    dark = view.complete(Description([parts.Rectangle(emission=0.0)], [sensor], parts.Enclosure(0.0, id="sky")))
    assert (dark.enclosure.id, dark.enclosure.radiance) == ("sky", 1)


def test_without_light_there_is_only_a_note():
    scene = view.complete(Description([mesh()], [parts.Sensor()]), light=False)
    assert scene.enclosure is None
    assert len(scene.shapes) == 1
    assert "black" in scene.notes[0]


def test_mistakes():
    with pytest.raises(SceneError, match="no shapes"):
        view.complete(Description([]))
    huge = mesh((2 * TETRAHEDRON - 1) * 1e308)
    with pytest.raises(SceneError, match="too large"):
        view.complete(Description([huge]))
    assert view.complete(Description([huge], [parts.Sensor()])).enclosure is not None
    assert view.complete(Description([mesh(np.zeros((4, 3)))])).sensors


def test_world_points_hold_the_shapes():
    place = np.array([[0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1.0]])
    for shape, low, high in [
        (parts.Rectangle(to_world=place), [-1, 0, 3], [3, 4, 3]),
        (parts.Disk(to_world=place), [-1, 0, 3], [3, 4, 3]),
        (parts.Cube(to_world=place), [-1, 0, 1], [3, 4, 5]),
        (parts.Sphere(to_world=place, center=(1, 0, 0), radius=2), [-3, 0, -1], [5, 8, 7]),
        (parts.Cylinder(to_world=place, p1=(0, 0, 2), radius=0.5), [0, 1, 2], [2, 3, 8]),
        (mesh(np.concatenate([TETRAHEDRON, [[99.0, 99, 99]]]), to_world=place), [-1, 2, 3], [1, 4, 5]),
    ]:
        points = view.world_points(shape)
        assert (points.min(0) <= low).all()
        assert (points.max(0) >= high).all()
        assert np.abs(points).max() < 10


@pytest.mark.parametrize(
    ("vertices", "faces", "closed"),
    [
        (TETRAHEDRON, OUTWARDS, True),
        (TETRAHEDRON + 1e4, OUTWARDS, True),
        (TETRAHEDRON[OUTWARDS].reshape(-1, 3), np.arange(12).reshape(4, 3), True),  # each face its own vertices
        (TETRAHEDRON, np.concatenate([OUTWARDS, [[0, 0, 1]]]), True),  # with a degenerate face
        (TETRAHEDRON, OUTWARDS[:, ::-1], False),  # inside out
        (TETRAHEDRON, OUTWARDS[:3], False),  # open
        (TETRAHEDRON, np.concatenate([OUTWARDS[:3], OUTWARDS[3:, ::-1]]), False),  # one face wrong
        (TETRAHEDRON, np.concatenate([OUTWARDS, OUTWARDS]), False),  # twice
        (np.concatenate([TETRAHEDRON, TETRAHEDRON + 5]), np.concatenate([OUTWARDS, OUTWARDS + 4]), True),
        (np.concatenate([9 * TETRAHEDRON, TETRAHEDRON + 20]), np.concatenate([OUTWARDS, OUTWARDS[:, ::-1] + 4]), False),
        (np.zeros((4, 3)), OUTWARDS, False),
    ],
)
def test_closed_outwards(vertices, faces, closed):
    assert view.closed_outwards(mesh(vertices, faces)) == closed
    mirror = np.diag([1.0, 1, -1, 1])
    assert not view.closed_outwards(mesh(vertices, faces, to_world=mirror)) or not closed


def test_unsure_sides_reflect_on_both():
    paint = parts.Diffuse(0.3, id="paint")
    sheets = [mesh(faces=OUTWARDS[:k], bsdf=paint, id=f"sheet{k}") for k in (1, 2)]
    solid, box = mesh(bsdf=paint, id="solid"), parts.Rectangle()
    scene = view.complete(Description([*sheets, solid, box], [parts.Sensor()]), orient=True)
    a, b, c, d = scene.shapes[:4]
    assert isinstance(a.bsdf, parts.TwoSided)
    assert a.bsdf is b.bsdf
    assert a.bsdf.bsdf is paint
    assert a.vertices is sheets[0].vertices
    assert (c, d) == (solid, box)
    assert sheets[0].bsdf is paint
    assert "sheet1, sheet2" in scene.notes[0]
    kept = view.complete(Description([*sheets], [parts.Sensor()]))
    assert kept.shapes[0].bsdf is paint


# ------------------------------------------------------------------------------- load_description

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def test_a_mesh_file_becomes_a_whole_scene(tmp_path):
    (tmp_path / "A.OBJ").write_text(OBJ)
    scene = files.load_description(str(tmp_path / "A.OBJ"))
    assert [s.id for s in scene.shapes] == ["A", "softbox"]
    assert isinstance(scene.shapes[0].bsdf, parts.TwoSided)
    assert len(scene.sensors) == 1
    assert len(scene.notes) == 3


def test_mistakes_about_files(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "a.stl").write_text(OBJ)
    (tmp_path / "b.xml").mkdir()
    for path, more, says in [
        (tmp_path / "none.xml", {}, "no such file"),
        (tmp_path / "b.xml", {}, "no such file"),
        ("x" * 5000 + ".ply", {}, "no such file"),
        ("a\0.ply", {}, "no such file"),
        (tmp_path / "a.stl", {}, ".stl is not a scene format"),
        (tmp_path / "a", {}, "no suffix"),
        (tmp_path / "a.obj", {"spp": "4"}, "'spp' has no meaning in a .obj file"),
    ]:
        with pytest.raises(SceneError, match=says) as error:
            files.load_description(path, **more)
        assert "\n" not in str(error.value)


def test_xml_gets_its_defaults_and_a_view_but_no_light(tmp_path, monkeypatch):
    (tmp_path / "a.xml").write_text("<scene/>")
    taken = []
    stand_in = types.ModuleType("mitsuba")
    stand_in.load = lambda path, defaults: taken.append((path, defaults)) or Description([mesh()])
    monkeypatch.setitem(sys.modules, "jaxrt.files.mitsuba", stand_in)
    monkeypatch.setattr(files, "mitsuba", stand_in, raising=False)
    scene = files.load_description(tmp_path / "a.xml", spp="4")
    assert taken == [(tmp_path / "a.xml", {"spp": "4"})]
    assert len(scene.sensors) == 1
    assert scene.enclosure is None
    assert "black" in scene.notes[-1]


def test_lamps_without_extent_are_light():
    shapes = [parts.Rectangle()]
    for lamp, dark in ((parts.Point(), False), (parts.Directional(), False), (parts.Point(intensity=0.0), True)):
        found = view.complete(Description(shapes, lamps=[lamp]), light=True)
        assert any("no light" in note for note in found.notes) == dark
        assert list(found.lamps) == [lamp]


def test_attributes_of_meshes_are_light():
    for scale, dark in ((1.0, False), (0.0, True)):
        shape = parts.Rectangle(emission=parts.MeshAttribute("vertex_glow", scale))
        found = view.complete(Description([shape]), light=True)
        assert any("no light" in note for note in found.notes) == dark
