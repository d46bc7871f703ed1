"""IES LM-63: what of a file becomes a photometric web, and what is refused by name."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxrt
from jaxrt.files.ies import read_ies

LABELS = "[TEST] 12, see TILT = below\n[MANUFAC] Lamps & Söhne\n"
NUMBERS = """1 1000 2.5 3 2 1 2 .1 .1 0
.9 1.1 40
0 45, 90
0 90
10 20 30
11 21
31 """


def file(header="IESNA:LM-63-1995", tilt="NONE", numbers=NUMBERS):
    return f"{header}\n{LABELS}TILT={tilt}\n{numbers}".encode("latin-1")


@pytest.mark.parametrize(
    "header, factor",
    [
        ("[TEST] of 1986", 2.5 * 0.9 * 1.1),
        ("IESNA91", 2.5 * 0.9 * 1.1),
        ("IESNA:LM-63-1995", 2.5 * 0.9 * 1.1),
        ("IESNA:LM-63-2002", 2.5 * 0.9),
        ("IES:LM-63-2019", 2.5 * 0.9),
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_each_edition(header, factor, newline, tmp_path):
    (tmp_path / "a.ies").write_bytes(file(header).replace(b"\n", newline.encode()) + b"\x1a")
    web = jaxrt.load_ies(tmp_path / "a.ies")
    np.testing.assert_allclose(web.data[..., 0], factor * np.array([[10, 20, 30], [11, 21, 31]]))
    np.testing.assert_array_equal(web.vertical, [0, 45, 90])
    np.testing.assert_array_equal(web.horizontal, [0, 90])
    red = jaxrt.load_ies(tmp_path / "a.ies", (2.0, 1.0, 0.5))
    np.testing.assert_allclose(red.data, web.data * [2.0, 1.0, 0.5])


def test_planes_that_end_before_the_whole_circle():
    numbers = "1 -1 1 2 4 1 1 0 0 0 1 1 0  0 180  0 90 180 270  1 2 3 4 5 6 7 8"
    web = read_ies(file(numbers=numbers), "a.ies")
    np.testing.assert_array_equal(web.horizontal, [0, 90, 180, 270, 360])
    np.testing.assert_array_equal(web.data[..., 0], [[1, 2], [3, 4], [5, 6], [7, 8], [1, 2]])


@pytest.mark.parametrize(
    "content, problem",
    [
        (b"solid cube", "no line TILT="),
        (file(tilt="INCLUDE"), "has a TILT, which is not supported; give a file with TILT=NONE"),
        (file(tilt="lamp.tlt"), "has a TILT, which"),
        (file(numbers=NUMBERS.replace("3 2 1 2", "3 2 2 2")), "photometry of type B; only type C"),
        (file(numbers=NUMBERS.replace("3 2 1 2", "3 2 3 2")), "photometry of type A"),
        (file(numbers=NUMBERS.replace("3 2 1 2", "3 2 7 2")), "photometry of type 7"),
        (file(numbers=NUMBERS[:-4]), "has 23 numbers, not those for 3 by 2 angles"),
        (file(numbers=NUMBERS + " 5"), "has 25 numbers"),
        (file(numbers=NUMBERS.replace("3 2 1 2", "-3 2 1 2")), "not those for -3 by 2"),
        (file(numbers="1 1 1 2.5 1 1 1 0 0 0 1 1 0  0 90 1 2 3 4"), "not those for 2.5 by 1"),
        (file(numbers=NUMBERS.replace("2.5", "1e300")), "web.data: has a value that is not between 0"),
        (file(numbers="1 2 3"), "is truncated"),
        (file(numbers=NUMBERS.replace("31", "nan")), "not finite"),
        (file(numbers=NUMBERS.replace("31", "x")), "something else than numbers"),
        (file(numbers=NUMBERS.replace("31", "-31")), "web.data: has a value that is not between 0"),
        (file(numbers=NUMBERS.replace("0 90\n", "0 45\n")), "web.horizontal: go from 0 to 45"),
        (file(numbers=NUMBERS.replace("0 45, 90", "0 95 90")), "web.vertical: are no angles that ascend"),
    ],
)
def test_what_is_refused(content, problem):
    with pytest.raises(jaxrt.SceneError) as error:
        read_ies(content, "a.ies")
    assert str(error.value).startswith("a.ies: ")
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_missing(tmp_path):
    with pytest.raises(jaxrt.SceneError, match="no such file"):
        jaxrt.load_ies(tmp_path / "b.ies")


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 160), st.integers(0, 160), st.binary(max_size=6))
def test_damaged_files_are_refused_or_read(start, length, junk):
    whole = file()
    try:
        assert read_ies(whole[:start] + junk + whole[start + length :], "a.ies").data.size
    except jaxrt.SceneError as error:
        assert "\n" not in str(error)
