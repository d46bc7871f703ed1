"""Pictures to a tolerance or within a time: they reach it, say the truth, and are not biased by where samples go."""

import functools
import itertools
import time

import numpy as np
import pytest
from helpers import box_room, camera
from test_lamps import covered
from test_lamps import scene as before_a_lamp

import jaxrt
from jaxrt.files.image import read_exr
from jaxrt.solver.render import render
from jaxrt.solver.solution import relative_mse
from jaxrt.solver.tally import Tally, mean_and_variance
from jaxrt.solver.tolerance import allotted
from jaxrt.solver.work import missing

TRUE = 3.0 * covered()[..., None]  # the lamp's radiance by its share of each pixel


@functools.cache
def lit_room():
    """A room lit by its ceiling, all diffuse, without end of its paths."""
    return box_room(0.5, {"ceiling": 1.0}, sensors=[camera((0.3, -0.4, 0.2), (-0.5, 0.6, -0.7), 32, 32, 80.0)])


def to_tolerance(rtol, seed, **more):
    return render(before_a_lamp(), None, seed, rtol=rtol, method="path", max_depth=1, **more)


# ------------------------------------------------------------------------------------------------ sums of samples


@pytest.mark.parametrize("block", [None, 4])
def test_a_tally_is_its_samples(block):
    rng = np.random.default_rng(0)
    tally = Tally(5, 3, 0, block)
    sets = tally.sums.shape[1]
    values = rng.exponential(size=(5, 50, 3))
    of = np.arange(50) % 4 if block is None else np.arange(50) // 4 % 2
    until = np.array([50, 32, 8, 13, 0])
    for pixels in (np.array([0, 0, 1, 2]), np.array([3, 1])):  # pieces in turn, and a pixel twice in one call
        for p, k in zip(pixels, itertools.count()):
            first = tally.taken[p]
            last = 20 if p == 0 and first == 0 else until[p] if p != 1 or k else 16
            part = np.stack([(values[p, first:last] * (of[first:last] == s)[:, None]).sum(0) for s in range(sets)])
            tally.add(np.array([p]), np.array([first]), np.array([last]), part[None])
    np.testing.assert_array_equal(tally.taken, until)
    mean, variance = tally.found()
    for p in range(4):
        own = [values[p, : until[p]][of[: until[p]] == s] for s in range(sets)]
        np.testing.assert_allclose(mean[p], values[p, : until[p]].mean(0), rtol=1e-6)
        means, n = np.array([o.mean(0) for o in own]), np.array([len(o) for o in own])[:, None]
        expected = (n * (means - mean[p]) ** 2).sum(0) / (sets - 1) / until[p]
        np.testing.assert_allclose(variance[p], expected, rtol=1e-4)
    assert np.isnan(variance[4]).all()


def test_samples_out_of_turn_are_left_out():
    tally = Tally(2, 1, 0)
    one = np.ones((1, 4, 1))
    tally.add(np.array([1]), np.array([4]), np.array([8]), one)
    assert tally.samples == 0 and not tally.sums.any()
    twice = np.array([1, 1]), np.array([0, 4]), np.array([4, 8]), np.ones((2, 4, 1))
    tally.add(*twice)
    assert tally.taken.tolist() == [0, 8] and tally.sums[1].sum() == 8


def test_pieces_are_what_is_missing():
    rng = np.random.default_rng(1)
    have, want = rng.integers(0, 300, 40), rng.integers(0, 900, 40)
    batch = missing(have, want, rng.permutation(40), most=256)
    assert (batch.last - batch.first).max() <= 256 and (np.diff(batch.last - batch.first) <= 0).all()
    taken = have.copy()
    for pixel, first, last in zip(batch.pixels, batch.first, batch.last, strict=True):
        assert taken[pixel] == first  # those of one pixel in their order
        taken[pixel] = last
    np.testing.assert_array_equal(taken, np.maximum(have, want))


def test_the_relative_error_of_few_samples_is_not_hidden():
    """Rare bright samples: the more a pixel has, the brighter it is as well."""
    rng, n, spp = np.random.default_rng(2), 4096, 64
    tally = Tally(n, 1, 0)
    hit = rng.random((n, 4, spp // 4)) < 0.01
    tally.add(np.arange(n), np.zeros(n, int), np.full(n, spp), hit.sum(-1)[..., None].astype(float))
    true = relative_mse(tally.found()[0], np.full((n, 1), 0.01))
    assert tally.relative_variances(apart=False).mean() < 0.8 * true
    assert tally.relative_variances().mean() > 0.95 * true


def test_mean_and_variance_of_unequal_sets():
    sums, counts = np.array([[[2.0]], [[9.0]]]), np.array([[1], [3]])
    mean, variance = mean_and_variance(sums, counts)
    assert mean[0, 0] == 11 / 4
    assert np.isclose(variance[0, 0], (1 * (2 - 2.75) ** 2 + 3 * (3 - 2.75) ** 2) / 1 / 4)


# ------------------------------------------------------------------------------------------------ to a tolerance


@functools.cache
def settled(size):
    return render(jaxrt.resized(lit_room(), 0, size, size), 16384, 99, method="path", max_depth=4).image


def test_a_tolerance_is_reached_and_the_claim_holds():
    rtol, found = 0.03, []
    for seed in range(20):
        sol = render(lit_room(), None, seed, rtol=rtol, method="path", max_depth=4)
        assert sol.error.claim <= rtol and not sol.failed
        assert sol.stats["spp"] == round(float(sol.spp.mean()), 1) and sol.header["rtol"] == rtol
        found.append(np.sqrt(relative_mse(sol.image, settled(32))) / sol.error.claim)
    found = np.array(found)
    assert (found <= 1.0).sum() >= 17  # of 20, where 19 are expected
    assert (found > 1 / 3).all()


def test_samples_go_where_the_error_is():
    sol = to_tolerance(0.01, 3)
    partly = (TRUE[..., 0] > 1e-6) & (TRUE[..., 0] < 3.0 - 1e-6)
    assert sol.spp[partly].mean() > 2 * sol.spp[~partly].mean()
    assert sol.spp.min() > 0
    even = render(before_a_lamp(), 1, seconds=None, method="path", max_depth=1).spp
    assert even[partly].mean() == 8  # which takes borders of lamps so often


def test_no_bias_by_stopping_and_right_standard_errors():
    scene = jaxrt.resized(lit_room(), 0, 8, 8)
    found = [render(scene, None, seed, rtol=0.2, method="path", max_depth=4) for seed in range(80)]
    off = np.stack([sol.image - settled(8) for sol in found]).astype(np.float64)
    each = off.mean(0) / (off.std(0, ddof=1) / np.sqrt(len(off)))
    assert abs(off.mean() / off.mean(0).std()) < 4 / np.sqrt(off[0].size)
    assert abs((each**2).mean() - 1.0) < 4 * np.sqrt(2 / each[..., 0].size)
    scores = off / np.stack([sol.stderr for sol in found])
    assert abs((np.abs(scores) < 1.0).mean() - 0.68) < 0.03
    assert abs((np.abs(scores) < 1.96).mean() - 0.95) < 0.02


def test_shares_are_of_one_average():
    shares = np.random.default_rng(0).exponential(size=1000) ** 4
    each = allotted(shares)
    assert np.isclose(each.mean(), 1.0) and each.max() / each.min() <= 8.0001
    assert (np.diff(each[np.argsort(shares)]) >= 0).all()
    np.testing.assert_array_equal(allotted(np.zeros(5)), np.ones(5))


def test_what_it_costs_is_foretold():
    told = []
    sol = to_tolerance(0.004, 1, foretold=told.extend)
    assert [one.error for one in told] == pytest.approx([0.004, 0.002, 0.0004])
    assert told[0].seconds <= told[1].seconds <= told[2].seconds
    assert told[2].seconds > 10 * told[0].seconds
    assert sol.error.claim <= 0.004


def test_within_a_time():
    to_tolerance(0.05, 0)  # its programs
    began = time.perf_counter()
    sol = render(before_a_lamp(), seconds=1.5, method="path", max_depth=1)
    assert time.perf_counter() - began < 3.0  # 1.65, and other processes
    assert sol.stats["spp"] > 100 and not sol.failed
    least = render(before_a_lamp(), seconds=1e-3, method="path", max_depth=1)
    assert least.spp.min() >= 4 and np.isfinite(least.stderr).all()
    both = render(before_a_lamp(), seconds=60.0, rtol=0.05, method="path", max_depth=1)
    assert both.error.claim <= 0.05 and both.stats["spp"] < sol.stats["spp"]


def test_the_file_says_how_many_samples_each_pixel_has(tmp_path):
    import OpenEXR

    sol = to_tolerance(0.02, 1)
    sol.save(tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["spp"].pixels, sol.spp)
    np.testing.assert_allclose(read_exr(tmp_path / "a.exr")[1], np.broadcast_to(sol.stderr, (*sol.spp.shape, 3)))


@pytest.mark.parametrize(
    "more, said",
    [
        ({"spp": 4, "rtol": 0.1}, "rtol: is given beside spp"),
        ({"rtol": -0.1}, "rtol: is -0.1; give a positive number"),
        ({"seconds": 0}, "seconds: is 0; give a positive number"),
        ({"rtol": "1%"}, "rtol: is 1%; give a positive number"),
    ],
)
def test_what_cannot_be_asked(more, said):
    with pytest.raises(jaxrt.SceneError, match=said):
        render(before_a_lamp(), **more)


# ------------------------------------------------------------------------------------------- the field, and series


def test_by_a_field_its_elements_are_part_of_the_error():
    scene = jaxrt.resized(lit_room(), 0, 16, 16)
    true = render(scene, 4096, 9, method="path").image
    sol = render(scene, rtol=0.05, method="field")
    assert sol.stats["method"] == "field" and sol.error.discretisation >= 0 and sol.error.truncation == 1e-3
    assert sol.error.claim >= np.hypot(sol.error.statistical, sol.error.discretisation)
    assert set(sol.error.each) == {"statistical", "truncation", "discretisation"}
    assert np.sqrt(relative_mse(sol.image, true)) < sol.error.claim


@pytest.mark.slow
def test_what_elements_are_too_coarse_for_is_said():
    scene = jaxrt.resized(lit_room(), 0, 16, 16)
    true = render(scene, 4096, 9, method="path").image
    missed = render(scene, rtol=2e-3, method="field")  # which samples cannot reach, and that is said
    assert missed.failed and missed.error.claim > 2e-3
    assert np.sqrt(relative_mse(missed.image, true)) < missed.error.claim


def test_the_series_ends_where_the_rest_is_small():
    """Of a room of one albedo ρ the rest after d edges is at most ρᵈ/(1 − ρ) of the brightest light."""
    scene = jaxrt.resized(lit_room(), 0, 16, 16)
    sol = render(scene, rtol=0.04)
    depth = sol.stats["max_depth"]
    assert 2 < depth < 40 and sol.error.truncation <= 0.1 * 0.04
    assert "at most" in sol.stats["bounces"] and "50%" in sol.stats["bounces"]
    scale = np.sqrt(sol.image**2 + 0.01 * (sol.image**2).mean())
    bound = 0.5**depth / 0.5 / scale
    assert np.isclose(sol.error.truncation, np.sqrt((bound**2).mean()), rtol=0.2)
    whole, cut = (render(scene, 1024, 5, max_depth=d, method="path").image for d in (-1, depth))
    assert np.sqrt(relative_mse(cut, whole)) < sol.error.truncation + 0.02
    assert render(scene, rtol=0.04, max_depth=-1).stats["max_depth"] == -1  # asked for


def test_where_there_is_no_bound_the_rest_is_estimated():
    bsdf = jaxrt.Conductor(alpha=0.3, id="gloss")
    scene = box_room(bsdf, {"ceiling": 1.0}, sensors=[camera((0.3, -0.4, 0.2), (-0.5, 0.6, -0.7), 16, 16, 80.0)])
    sol = render(scene, rtol=0.1)
    assert "estimated" in sol.stats["bounces"] and sol.stats["max_depth"] > 2
    assert 0 < sol.error.truncation <= 0.01
    blend = jaxrt.Blend(jaxrt.Diffuse(0.9, id="light"), jaxrt.Diffuse(0.2, id="dark"), weight=0.5, id="both")
    scene = box_room(blend, {"ceiling": 1.0}, sensors=[camera((0.3, -0.4, 0.2), (-0.5, 0.6, -0.7), 16, 16, 80.0)])
    assert "estimated" in render(scene, rtol=0.2).stats["bounces"]
