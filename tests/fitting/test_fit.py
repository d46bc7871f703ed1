"""Fits of a small room: what was changed is found again, by descent and by least squares, with the error that it says."""

import functools
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from helpers import box_room, camera

import jaxrt
from jaxrt.fitting.loop import run
from jaxrt.fitting.losses import loss_of
from jaxrt.fitting.parameters import Free
from jaxrt.fitting.steps import Descent, State
from jaxrt.fitting.views import Measuring, checked, views_of

pytestmark = pytest.mark.usefixtures("short_loops")

SIDE = 16
TRUTH = {"paint.reflectance": 0.7, "side.reflectance": 0.25}
FREE = {"paint.reflectance": "unit", "side.reflectance": (0.05, 0.95)}
GAUSS = optimistix.GaussNewton(1e-3, 1e-4)


def seen_from(x):
    return camera((x, -0.6, 0.6), (-0.6, 0.4, -0.8), SIDE, SIDE, 75.0)


@functools.cache
def room():
    """A closed room with a painted floor and side, seen by two cameras; all light comes from above."""
    bsdfs = {"floor": jaxrt.Diffuse(0.7, id="paint"), "left": jaxrt.Diffuse(0.25, id="side")}
    sensors = [seen_from(0.5), seen_from(0.0)]
    return box_room(0.4, bsdfs=bsdfs, emission={"ceiling": 1.0}, sensors=sensors, integrator=jaxrt.Integrator(3))


@functools.cache
def start():
    return jaxrt.with_params(room(), {name: [0.5] for name in TRUTH})


@functools.cache
def target(sensor=0):
    return jaxrt.render(room(), spp=1024, seed=1, sensor=sensor, method="path").image


def error(fit):
    return max(abs(float(fit.parameters[name][0]) - value) for name, value in TRUTH.items())


def squares(**more):
    return jaxrt.fit(start(), target(), FREE, optimiser=GAUSS, **{"spp": 4, "progress": False, **more})


# ----------------------------------------------------------------------------------------- descent


def descend(**more):
    return jaxrt.fit(start(), [target(0), target(1)], FREE, sensor=[0, 1], coarse=[(4, 40)], steps=40, spp=8, **more)


def test_descent_finds_reflectances_from_two_views_coarse_to_fine():
    fit = descend()
    assert fit.result == optimistix.RESULTS.successful
    assert error(fit) < 0.02
    np.testing.assert_array_equal(fit.history["step"], np.arange(1, 81))
    assert fit.history["loss"].shape == (80,) and (np.diff(fit.history["seconds"]) > 0).all()
    np.testing.assert_array_equal(fit.history["side.reflectance"][-1], fit.parameters["side.reflectance"])
    found = jaxrt.params(fit.scene)
    assert all((found[name] == fit.parameters[name]).all() for name in TRUTH)
    assert fit.covariance is None and np.isnan(fit.stderr["paint.reflectance"]).all()


@pytest.mark.parametrize("stop", [17, 53])
def test_a_fit_that_was_stopped_goes_on_to_the_same_bits(tmp_path, stop):
    class StoppedError(Exception):
        pass

    def interrupt(step, loss, values):
        if step == stop:
            raise StoppedError

    path = tmp_path / "fit.npz"
    with pytest.raises(StoppedError):
        descend(checkpoint=path, progress=interrupt)
    fit = descend(checkpoint=path, resume=True)
    whole = descend()
    for name in ("loss", *TRUTH):
        np.testing.assert_array_equal(fit.history[name], whole.history[name])
    again = descend(checkpoint=path, resume=True)  # is at its end
    np.testing.assert_array_equal(again.parameters["paint.reflectance"], whole.parameters["paint.reflectance"])


def test_a_checkpoint_of_another_fit_is_refused(tmp_path):
    path = tmp_path / "fit.npz"
    squares(checkpoint=path, steps=1, progress=True)
    with pytest.raises(jaxrt.SceneError, match="is of a fit with spp 4, not 8"):
        squares(checkpoint=path, resume=True, steps=1, spp=8)
    path.write_bytes(b"nothing")
    with pytest.raises(jaxrt.SceneError, match="no checkpoint"):
        squares(checkpoint=path, resume=True)
    with pytest.raises(jaxrt.SceneError, match="does not exist"):
        squares(checkpoint=tmp_path / "none" / "fit.npz")


# ------------------------------------------------------------------------------------ least squares


def test_least_squares_find_reflectances_and_noise_does_not_move_them(monkeypatch):
    """With one set of samples in residuals and derivatives, dark values have less noise and are preferred."""
    traced, residuals = [], Measuring.residuals
    monkeypatch.setattr(Measuring, "residuals", lambda *args: traced.append(0) or residuals(*args))
    fits = [squares(seed=0)]
    before = len(traced)
    fits += [squares(seed=seed) for seed in range(1, 20)]
    assert len(traced) == before  # one program for all steps of all fits
    assert all(fit.result == optimistix.RESULTS.successful for fit in fits)
    name = "paint.reflectance"
    found = np.array([float(fit.parameters[name][0]) for fit in fits])
    mean, sigma = found.mean(), found.std(ddof=1)
    assert abs(mean - TRUTH[name]) < 4.5 * sigma / np.sqrt(20)
    assert max(map(error, fits)) < 0.03
    # what they say of their error is the spread between them
    said = np.sqrt(np.mean([fit.covariance[0, 0] for fit in fits]))
    assert sigma / 1.5 < said < 1.5 * sigma
    np.testing.assert_allclose(fits[0].stderr[name][0], np.sqrt(fits[0].covariance[0, 0]), rtol=1e-5)
    plain = np.array([float(squares(seed=seed, unbiased=False).parameters[name][0]) for seed in range(8)])
    assert abs(plain.mean() - TRUTH[name]) > 2 * abs(mean - TRUTH[name]) + 4.5 * plain.std() / np.sqrt(8)


@pytest.mark.slow
def test_levenberg_marquardt_goes_on_from_a_checkpoint(tmp_path):
    path = tmp_path / "fit.npz"
    more = {"optimiser": optimistix.LevenbergMarquardt(1e-3, 1e-4), "loss": "relative", "spp": 64}
    fit = jaxrt.fit(start(), target(), FREE, progress=False, checkpoint=path, **more)
    assert error(fit) < 0.02 and (np.diff(fit.history["loss"]) <= 0).all()
    again = jaxrt.fit(start(), target(), FREE, progress=False, checkpoint=path, resume=True, **more)
    np.testing.assert_array_equal(again.covariance, fit.covariance)
    np.testing.assert_array_equal(again.history["loss"], fit.history["loss"])


# --------------------------------------------------------------------------------------- gradients


KEYS = 64


@functools.cache
def gradients(seed, keys=KEYS, pixels=None, forward=True):
    """By key the loss and its gradient, (K,) and (K, 2)."""
    free, views = Free.of(start(), FREE), views_of(start(), checked(start(), target(), 0))
    measuring = Measuring(loss_of("l2"), 1, pixels, jaxrt.plan(start(), free=list(FREE)), 3, True)
    descent = Descent(None, measuring, True, forward)
    run = jax.jit(jax.vmap(lambda key: descent.gradient(free.start, start(), free, views, key)))
    value, slope = run(jax.random.split(jax.random.key(seed), keys))
    return value, jnp.concatenate(list(slope.values()), 1)


@pytest.mark.slow
def test_gradients_of_some_pixels_are_those_of_all_in_the_mean():
    for a, b in zip(gradients(0), gradients(1, 4 * KEYS, 48), strict=True):
        spread = np.hypot(np.std(a, 0) / KEYS**0.5, np.std(b, 0) / (4 * KEYS) ** 0.5)
        assert (np.abs(a.mean(0) - b.mean(0)) < 4.5 * spread).all()
        assert (spread < 0.1 * np.abs(a.mean(0))).all()  # or that says nothing


@pytest.mark.slow
def test_forward_and_reverse_mode_agree():
    for a, b in zip(gradients(0), gradients(0, forward=False), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6)


def test_some_pixels_have_the_values_of_the_whole_picture():
    chosen = jnp.array([0, 37, 255, 37])

    @jax.jit
    def both(rho):
        scene = jaxrt.with_params(room(), {"paint.reflectance": rho})
        whole = jaxrt.measure(scene, 3, spp=4)
        return whole.reshape(-1, 1)[chosen], jaxrt.measure(scene, 3, spp=4, pixels=chosen)

    (a, b), (da, db) = jax.jvp(both, (jnp.array([0.7]),), (jnp.ones(1),))
    np.testing.assert_allclose(a, b, rtol=1e-6)
    np.testing.assert_allclose(da, db, rtol=1e-5, atol=1e-7)
    assert b.shape == (4, 1) and float(jnp.abs(db).max()) > 0.01
    with pytest.raises(jaxrt.SceneError, match="pixels: are 0 to 256; give numbers from 0 to 255"):
        jaxrt.measure(room(), 3, pixels=[0, 256])


def test_a_fit_ends_before_what_is_not_finite(tmp_path):
    """The loop alone, with steps of which the third gives no number."""

    class Steps:
        def init(self, scene, free, views, key):
            return State(free.start, jnp.zeros(()))

        def step(self, state, scene, free, views, key):
            n = state.kept + 1
            z = {name: a + 0.1 for name, a in state.z.items()}
            return State(z, n), jnp.where(n == 3, jnp.nan, 1.0 / n), False, n != 3

    free = Free.of(start(), FREE)
    fit = run(start(), free, Steps(), [((), 5)], False, 0, {}, tmp_path / "fit.npz", False, False, 0.0)
    assert fit.result == optimistix.RESULTS.nonfinite
    np.testing.assert_allclose(fit.history["loss"], [1, 0.5])
    np.testing.assert_array_equal(fit.parameters["paint.reflectance"], fit.history["paint.reflectance"][-1])


def test_the_readmes_snippet_runs(capsys, monkeypatch):
    root = pathlib.Path(__file__).parent.parent.parent
    monkeypatch.chdir(root)
    section = (root / "README.md").read_text().partition("## Fitting scenes to pictures")[2]
    names = {}
    exec(section.split("```python")[1].partition("```")[0], names)
    found, truth = (jaxrt.params(names[k].scene if k == "fit" else names[k]) for k in ("fit", "scene"))
    off = np.abs(np.asarray(found["red.reflectance"]) - np.asarray(truth["red.reflectance"]))
    assert (off < 0.05).all() and "RESULTS" in capsys.readouterr().out
