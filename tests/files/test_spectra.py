"""Spectra as linear sRGB: fixed numbers, closed forms, and Mitsuba."""

import numpy as np
import pytest

from jaxrt.files import cie, spectra
from jaxrt.files.conductors import CONDUCTORS
from jaxrt.parts import SceneError

# from Mitsuba 3.9.1, scalar_rgb: wavelength:value list, as a reflectance and as a radiance
FIXED = [
    ("400:.1,700:.8", (0.662438, 0.433495, 0.19472), (0.778184, 0.413256, 0.169932)),
    ("400:.1,500:.2,700:.8", (0.629886, 0.321126, 0.126012), (0.732476, 0.306497, 0.109628)),
    ("360:1,830:1", (0.998985, 0.998874, 0.998802), (1.20488, 0.948228, 0.909267)),
    ("300:1,900:1", (0.998985, 0.998874, 0.998802), (1.20488, 0.948228, 0.909267)),
    ("400:1,700:1", (0.995342, 0.999756, 0.994909), (1.19969, 0.94952, 0.903443)),
    ("400:0,500:8,600:15.6,700:18.4", (1.0, 1.0, 1.0), (20.7108, 10.8546, 2.77115)),
    ("550:1,560:1", (0.0124793, 0.137198, 0.0), (0.0122891, 0.133081, 0.0)),
    ("400:0.2,410:0.3,430:0.3", (0.00630825, 0.0, 0.041411), (0.0069061, 0.0, 0.0453606)),
]


def table(text):
    w, v = np.array([[float(word) for word in pair.split(":")] for pair in text.split(",")]).T
    return w, v


@pytest.mark.parametrize("text, reflectance, radiance", FIXED)
def test_fixed_numbers(text, reflectance, radiance):
    np.testing.assert_allclose(spectra.to_rgb(*table(text), "reflectance")[0], reflectance, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(spectra.to_rgb(*table(text), "radiance")[0], radiance, rtol=1e-5, atol=1e-7)


def test_refractive_index_is_a_reflectance_without_an_upper_end():
    ior, clipped = spectra.to_rgb(*table("400:1.5,700:2"), "ior")
    np.testing.assert_allclose(ior, (1.89509, 1.73786, 1.56038), rtol=1e-5)
    assert not clipped
    assert spectra.to_rgb(*table("400:1.5,700:2"), "reflectance")[1]


def test_clipping_is_reported():
    assert spectra.to_rgb(*table("550:1,560:1"), "radiance")[1]
    assert not spectra.to_rgb(*table("400:.1,700:.8"), "radiance")[1]


def test_conversion_is_linear():
    w, v = table("400:.1,500:.2,700:.8")
    one, three = (spectra.to_rgb(w, k * v, "radiance")[0] for k in (1, 3))
    np.testing.assert_allclose(three, 3 * one, rtol=1e-12)


def test_equal_energy_white():
    np.testing.assert_allclose(spectra.EQUAL_ENERGY, (1.204794, 0.948291, 0.908916), atol=1e-9)


def test_observer_sees_equal_energy_and_d65_where_the_cie_says():
    x, y, z = (bar.sum() for bar in (cie.X_BAR, cie.Y_BAR, cie.Z_BAR))
    np.testing.assert_allclose([x / (x + y + z), y / (x + y + z)], [1 / 3, 1 / 3], atol=2e-4)
    x, y, z = ((cie.D65 * bar).sum() for bar in (cie.X_BAR, cie.Y_BAR, cie.Z_BAR))
    np.testing.assert_allclose([x / (x + y + z), y / (x + y + z)], [0.31272, 0.32903], atol=2e-4)  # CIE 15, table T.3
    assert cie.WAVELENGTHS[cie.Y_BAR.argmax()] == 555 and cie.D65[cie.WAVELENGTHS == 560] == 100


@pytest.mark.parametrize("text", ["500:1", "500:1,500:2", "500:1,400:2"])
def test_wavelengths_increase(text):
    with pytest.raises(ValueError, match="wavelengths"):
        spectra.to_rgb(*table(text), "radiance")


@pytest.mark.parametrize(
    "text", ["nan", "inf", "-inf", "1e999", "1_000", "0x10", "", "1.2.3", "1,5", "٣", "1e", "--1", "1f"]
)
def test_what_is_not_a_number(text):
    with pytest.raises(ValueError, match="number"):
        spectra.number(text)


@pytest.mark.parametrize("text, expected", [("1", 1), (" +.5 ", 0.5), ("-1.e2", -100), ("1E-3", 1e-3)])
def test_what_is_a_number(text, expected):
    assert spectra.number(text) == expected


def test_spd_file(tmp_path):
    path = tmp_path / "a.spd"
    path.write_text("# nm value\n400 0.1\n\n 500\t0.25 # comment\r\n700 8e-1\n")
    w, v = spectra.read_spd(path)
    assert w.tolist() == [400, 500, 700] and v.tolist() == [0.1, 0.25, 0.8]


@pytest.mark.parametrize(
    "text", ["400 1 2\n500 1", "400\n500", "400 a\n500 1", "400 nan\n500 1", "", "400 1", "500 1\n400 1"]
)
def test_spd_file_with_mistakes(tmp_path, text):
    path = tmp_path / "a.spd"
    path.write_text(text)
    with pytest.raises(SceneError, match=r"^a\.spd") as problem:
        spectra.read_spd(path)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("content", [None, b"\xff\xfe\x00"])
def test_spd_file_that_is_none(tmp_path, content):
    path = tmp_path / "a.spd"
    if content:
        path.write_bytes(content)
    with pytest.raises(SceneError, match=r"cannot be read|no such file"):
        spectra.read_spd(path)


@pytest.mark.peer
@pytest.mark.parametrize("d65", [True, False])
def test_mitsuba_converts_alike(d65):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rng = np.random.default_rng(1)
    for count in (2, 3, 10, 80):
        w = np.sort(rng.uniform(350, 850, count))
        v = rng.uniform(0.2, 0.4, count)
        theirs = np.array(mi.spectrum_list_to_srgb(w.tolist(), v.tolist(), True, d65))
        ours = spectra.to_rgb(w, v, "reflectance" if d65 else "radiance")[0]
        np.testing.assert_allclose(ours, theirs, atol=3e-4)  # float32 moves the ends of Mitsuba's sum by a step


@pytest.mark.peer
@pytest.mark.parametrize("material", sorted(CONDUCTORS))
def test_mitsuba_has_the_same_conductors(material):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    values = mi.traverse(mi.load_dict({"type": "conductor", "material": material}))
    for key, ours in zip(("eta", "k"), CONDUCTORS[material], strict=True):
        np.testing.assert_allclose(ours, np.atleast_1d(np.array(values[f"{key}.value"])), rtol=1e-5, atol=1e-12)
