"""EXR and PNG: what is written is read again, atomically, and mistakes are refused by name."""

import os
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxrt.files import image as m
from jaxrt.parts import SceneError

QUICK = settings(max_examples=50, deadline=None)
SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3))
PICTURE = np.random.default_rng(0).random((5, 7, 3), np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("image")


@QUICK
@given(hnp.arrays(np.float32, SHAPES, elements=st.floats(width=32)), st.booleans())
def test_exr_round_trip_is_exact(folder, picture, with_stderr):
    m.write_exr(folder / "a.exr", picture, picture[::-1] if with_stderr else None)
    image, stderr, _ = m.read_exr(folder / "a.exr")
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, picture)  # NaN and infinity too
    np.testing.assert_array_equal(stderr, picture[::-1]) if with_stderr else None
    assert with_stderr == (stderr is not None)


def test_exr_of_one_channel_other_types_and_strides(tmp_path):
    for picture in (PICTURE.astype(np.float64), PICTURE.transpose(1, 0, 2), PICTURE[::2, ::-1], PICTURE[..., :1]):
        m.write_exr(tmp_path / "a.exr", picture, picture)
        for read in m.read_exr(tmp_path / "a.exr")[:2]:
            np.testing.assert_array_equal(read, np.broadcast_to(picture, (*picture.shape[:2], 3)).astype(np.float32))


def test_exr_attributes(tmp_path):
    given_ = {"jaxrt": '{"scene": "Würfel"}', "empty": "", "spp": 64, "seed": 2**63, "low": -(2**31), "rate": 0.5}
    given_ |= {"n": np.int64(3), "x": np.float32(0.25), "long": "x" * 100_000}
    m.write_exr(tmp_path / "a.exr", PICTURE, attributes=given_)
    read = m.read_exr(tmp_path / "a.exr")[2]
    assert {k: read[k] for k in given_} == given_ | {"seed": str(2**63)}


@pytest.mark.parametrize("attributes", [{"a": [1]}, {"a": None}, {"": 1}, {"channels": "x"}, {"é": 1}, {"a" * 300: 1}])
def test_attributes_that_exr_cannot_hold(tmp_path, attributes):
    with pytest.raises(SceneError, match="attribute"):
        m.write_exr(tmp_path / "a.exr", PICTURE, attributes=attributes)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 2), (4, 4, 4), (0, 4, 3), (1, 40000, 1), (1, 2, 3, 3)])
def test_shapes_that_are_no_picture(tmp_path, shape):
    picture = np.zeros(shape, np.float32)
    for write in (m.write_exr, m.write_png):
        with pytest.raises(SceneError, match="shape"):
            write(tmp_path / "a", picture)
    with pytest.raises(SceneError, match="give the same"):
        m.write_exr(tmp_path / "a.exr", PICTURE, PICTURE[:2])
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("write", [m.write_exr, m.write_png])
def test_mistakes_about_the_path(tmp_path, write):
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    for path, says in [
        (tmp_path / "none" / "a.exr", "none does not exist"),
        (tmp_path / "file" / "a.exr", "does not exist|cannot be written"),
        (tmp_path, "is not a file"),
        (tmp_path / "pipe", "is not a file"),
        (tmp_path / ("x" * 300), "cannot be written"),
        (tmp_path / "a\0b", "cannot be written"),
    ]:
        with pytest.raises(SceneError, match=says) as error:
            write(path, PICTURE)
        assert "\n" not in str(error.value)
    assert sorted(os.listdir(tmp_path)) == ["file", "pipe"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="nothing is forbidden to root")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(SceneError, match="Permission"):
        m.write_png(tmp_path / "a.png", PICTURE)
    tmp_path.chmod(0o700)


@pytest.mark.parametrize("write", [m.write_exr, m.write_png])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, write):
    write(tmp_path / "a", PICTURE)
    old = (tmp_path / "a").read_bytes()
    for error, seen in ((OSError(28, "No space left on device"), SceneError), (KeyboardInterrupt, KeyboardInterrupt)):
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", lambda *_, error=error: (_ for _ in ()).throw(error))
            with pytest.raises(seen):
                write(tmp_path / "a", 2 * PICTURE)
    assert os.listdir(tmp_path) == ["a"]
    assert (tmp_path / "a").read_bytes() == old
    write(tmp_path / "a", 2 * PICTURE)
    assert (tmp_path / "a").read_bytes() != old


def test_a_reader_never_sees_half_a_file(tmp_path):
    m.write_exr(tmp_path / "a.exr", PICTURE)
    stop = threading.Event()

    def keep_writing():
        while not stop.is_set():
            m.write_exr(tmp_path / "a.exr", PICTURE)

    writer = threading.Thread(target=keep_writing)
    writer.start()
    try:
        for _ in range(20):
            np.testing.assert_array_equal(m.read_exr(tmp_path / "a.exr")[0], PICTURE)
    finally:
        stop.set()
        writer.join()


def test_the_file_has_the_usual_permissions(tmp_path):
    (tmp_path / "plain").touch()
    m.write_exr(tmp_path / "a.exr", PICTURE)
    assert (tmp_path / "a.exr").stat().st_mode == (tmp_path / "plain").stat().st_mode


def exr(path, channels):
    import OpenEXR

    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))
    return path


def test_exr_of_other_programs(tmp_path):
    grey = np.linspace(0, 1, 12, dtype=np.float16).reshape(3, 4)
    image, stderr, _ = m.read_exr(exr(tmp_path / "grey.exr", {"Y": grey, "A": grey}))
    np.testing.assert_array_equal(image, np.stack([grey] * 3, -1).astype(np.float32))
    assert stderr is None
    image, _, _ = m.read_exr(exr(tmp_path / "rgba.exr", {"RGBA": np.ones((3, 4, 4), np.float32)}))
    assert image.shape == (3, 4, 3)
    with pytest.raises(SceneError, match=r"channels Z, but not R, G, B or Y"):
        m.read_exr(exr(tmp_path / "depth.exr", {"Z": grey}))


def test_files_that_are_no_exr(tmp_path):
    (tmp_path / "a.exr").write_text("text")
    m.write_png(tmp_path / "b.exr", PICTURE)
    for path, says in [
        (tmp_path / "a.exr", "not an EXR"),
        (tmp_path / "b.exr", "not an EXR"),
        (tmp_path / "none.exr", "no such file"),
        (tmp_path, "no such file"),
        ("a\0", "no such file|cannot be read"),
        ("x" * 5000, "no such file|cannot be read"),
    ]:
        with pytest.raises(SceneError, match=says) as error:
            m.read_exr(path)
        assert "\n" not in str(error.value)


@QUICK
@given(st.data())
def test_a_damaged_exr_is_refused_or_read(folder, data):
    m.write_exr(folder / "good.exr", PICTURE, PICTURE, {"jaxrt": "x"})
    bad = bytearray((folder / "good.exr").read_bytes())
    for _ in range(data.draw(st.integers(0, 3))):
        bad[data.draw(st.integers(0, len(bad) - 1))] = data.draw(st.integers(0, 255))
    keep = data.draw(st.just(len(bad)) | st.integers(0, len(bad) - 1))
    (folder / "bad.exr").write_bytes(bad[:keep])
    try:
        image, _, _ = m.read_exr(folder / "bad.exr")
    except SceneError as error:
        assert "\n" not in str(error)
    else:
        assert image.ndim == 3


def test_srgb_is_the_standards_curve():
    """IEC 61966-2-1: mid grey, the joint of line and power, and the ends."""
    linear = np.array([0.0, 0.0031308, 0.18, 0.2140, 0.5, 1.0])
    expected = [0, 10, 118, 127, 188, 255]
    assert m.to_srgb(linear.reshape(1, -1, 1))[0, :, 1].tolist() == expected
    assert m.to_srgb(linear.reshape(1, -1, 1) / 4, exposure=2)[0, :, 0].tolist() == expected


@QUICK
@given(hnp.arrays(np.float32, SHAPES, elements=st.floats(width=32)), st.floats(-1e4, 1e4))
def test_srgb_of_any_numbers(picture, exposure):
    out = m.to_srgb(picture, exposure)
    assert out.dtype == np.uint8
    bad = np.isnan(picture).any(-1)
    assert (out[bad] == (255, 0, 255)).all()
    good = picture[~bad]
    assert (out[~bad][good <= 0] == 0).all()
    if exposure == 0:
        assert (out[~bad][good >= 1] == 255).all()


def test_srgb_of_infinity_and_nonsense_exposure():
    assert m.to_srgb(np.array([[[np.inf, -np.inf, 1.0]]])).tolist() == [[[255, 0, 255]]]
    with pytest.raises(SceneError, match="exposure"):
        m.to_srgb(PICTURE, float("nan"))


def test_png_round_trip(tmp_path):
    import PIL.Image

    m.write_png(tmp_path / "a.png", PICTURE, exposure=-1)
    with PIL.Image.open(tmp_path / "a.png") as picture:
        assert picture.format == "PNG"
        np.testing.assert_array_equal(np.asarray(picture), m.to_srgb(PICTURE, -1))
