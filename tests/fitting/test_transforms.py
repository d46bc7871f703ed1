"""Values that keep to their bounds, motions that are rigid, displacements that are smooth; and what fits refuse."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import box_room, camera, edges_of, icosphere, moved, rotation

import jaxrt
from jaxrt.fitting import views
from jaxrt.fitting.losses import halved, loss_of
from jaxrt.fitting.parameters import Free
from jaxrt.fitting.steps import Descent, LeastSquares
from jaxrt.fitting.views import checked, scattered, views_of


@functools.cache
def scene():
    """A room of two paints with a ball that has a seam, and two cameras of which one is larger."""
    vertices, faces = icosphere(2)
    seam = np.concatenate([vertices, vertices[:1]])
    faces = np.array(faces)
    faces[np.nonzero((faces == 0).any(1))[0][:2]] = np.where(
        faces[np.nonzero((faces == 0).any(1))[0][:2]] == 0, len(vertices), faces[np.nonzero((faces == 0).any(1))[0][:2]]
    )
    ball = jaxrt.Mesh(
        id="ball", vertices=seam, faces=faces, to_world=moved(0.3, (0.2, 0.1, -0.4), rotation(0)), bsdf=jaxrt.Null()
    )
    bsdfs = {"floor": jaxrt.Diffuse([0.1, 0.5, 0.9], id="floor_paint"), "left": jaxrt.Diffuse(0.0, id="black")}
    sensors = [camera((0.5, -0.6, 0.6), (-0.6, 0.4, -0.8), 16, 12), camera((0, 0, 0.6), (0, 0.4, -0.8), 20, 12)]
    return box_room([0.5, 0.4, 0.3], bsdfs=bsdfs, emission={"ceiling": [1.0, 0.0, 2.0]}, others=[ball], sensors=sensors)


def transform(name, given=None):
    return Free.of(scene(), {name: given}).transforms[name]


def slope_error(t, z, h=1e-2):
    """Largest difference between t's derivative and central differences, of largest derivative."""
    J = np.asarray(jax.jacfwd(t)(z)).reshape(-1, z.size)
    columns = [
        (np.asarray(t(z + h * e), float) - np.asarray(t(z - h * e), float)).ravel() / (2 * h)
        for e in np.eye(z.size, dtype=np.float32).reshape(-1, *z.shape)
    ]
    return np.abs(J - np.stack(columns, 1)).max() / np.abs(J).max()


# -------------------------------------------------------------------------------------- transforms


@pytest.mark.parametrize(
    "name, given, low, high",
    [
        ("floor_paint.reflectance", None, 0.0, 1.0),
        ("floor_paint.reflectance", (0.05, 0.95), 0.05, 0.95),
        ("ceiling.emitter.radiance", None, 0.0, np.inf),
    ],
)
def test_values_keep_to_their_bounds(name, given, low, high):
    t = transform(name, given)
    value = np.asarray(jaxrt.params(scene())[name])
    np.testing.assert_allclose(t(t.start), value, atol=3e-3)  # a dark channel starts a little above
    far = np.concatenate([np.asarray(t(t.start + z)) for z in (-50.0, -3.0, 3.0, 50.0)])
    assert (far >= low).all() and (far <= high).all() and np.isfinite(far).all()
    assert far.min() < low + 0.01 and far.max() > min(0.99 * high, 100)
    assert slope_error(t, t.start) < 1e-3


def test_what_has_no_bounds_is_as_it_is():
    name = scene().structure.sensor_ids[0] + ".fov"
    t = transform(name)
    assert float(t(t.start)) == float(jaxrt.params(scene())[name]) and float(t(t.start + 1.5)) == float(t.start) + 1.5


@pytest.mark.parametrize("name", ["ball.to_world", None])
def test_rigid_motions(name):
    name = name or scene().structure.sensor_ids[0] + ".to_world"
    t = transform(name)
    z = jnp.array([0.3, -0.5, 0.2, 0.1, 0.4, -0.2])
    start, there = np.asarray(jaxrt.params(scene())[name], float), np.asarray(t(z), float)
    np.testing.assert_allclose(t(t.start), start, atol=1e-6)
    motion = there @ np.linalg.inv(start)
    np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-5)
    assert np.linalg.det(motion[:3, :3]) == pytest.approx(1, abs=1e-5)
    back = np.asarray(t(-z), float) @ np.linalg.inv(start)  # the motion's inverse, about the same middle
    np.testing.assert_allclose(motion @ back, np.eye(4), atol=1e-5)
    # turning alone keeps the middle; its angle is |z|
    turned = np.asarray(t(z.at[3:].set(0.0)), float) @ np.linalg.inv(start)
    middle = np.append(np.asarray(t.middle, float), 1.0)
    np.testing.assert_allclose(turned @ middle, middle, atol=1e-5)
    angle = np.arccos((np.trace(turned[:3, :3]) - 1) / 2)
    assert angle == pytest.approx(np.linalg.norm(z[:3]), abs=1e-4)
    assert slope_error(t, z) < 1e-3 and slope_error(t, jnp.zeros(6)) < 1e-3


def test_the_middle_of_a_mesh_is_that_of_its_vertices():
    t = transform("ball.to_world")
    np.testing.assert_allclose(t.middle, (0.2, 0.1, -0.4), atol=0.02)
    assert float(t.size) == pytest.approx(0.3 * 3**0.5, rel=0.05)


@pytest.mark.parametrize("given", ["shift", jaxrt.Shift(((0.0, 0.0, 1.0), (1.0, 2.0, 0.0)))])
def test_shifts_turn_nothing(given):
    t = transform("ball.to_world", given)
    start, axes = np.asarray(jaxrt.params(scene())["ball.to_world"], float), np.asarray(jaxrt.Shift().directions)
    axes = axes if given == "shift" else np.asarray(given.directions)
    z = np.linspace(0.2, -0.5, len(axes))
    moved = np.asarray(t(jnp.asarray(z)), float) - start
    np.testing.assert_allclose(t(t.start), start, atol=1e-6)
    np.testing.assert_allclose(moved[:3, 3], z @ axes * 0.3 * 3**0.5, rtol=0.05)
    np.testing.assert_array_equal(np.delete(moved, 3, 1), 0)
    assert slope_error(t, t.start) < 1e-3


def test_displacements_are_smooth():
    """(1 + λL)(v − v₀) = size · z, with L from the faces; a step at one vertex moves its neighbours nearly as far."""
    t = transform("ball.vertices", jaxrt.Smooth(10.0))
    vertices, faces = icosphere(2)
    assert t.start.shape == vertices.shape  # both ends of the seam are one place
    rng = np.random.default_rng(0)
    z = rng.normal(size=vertices.shape).astype(np.float32)
    start = np.asarray(jaxrt.params(scene())["ball.vertices"], float)
    step = np.asarray(t(jnp.asarray(z)), float) - start
    np.testing.assert_allclose(step[0], step[-1], atol=1e-6)  # the seam does not open
    L = np.zeros((len(vertices), len(vertices)))
    for a, b in edges_of(faces):
        L[[a, b], [a, b]] += 1
        L[[a, b], [b, a]] -= 1
    order = np.unique(start[:-1], axis=0, return_inverse=True)[1].reshape(-1)
    solved = np.linalg.solve(np.eye(len(L)) + 10.0 * L, z[order]) * float(t.size)
    np.testing.assert_allclose(step[:-1], solved, atol=2e-5)
    rough = lambda v: np.einsum("ik,ij,jk", v, L, v) / (v**2).sum()
    assert rough(step[:-1]) < 0.2 * rough(z[order])
    assert slope_error(lambda x: t(jnp.zeros_like(t.start).at[5].set(x)), jnp.zeros(3)) < 1e-3
    pulled = jax.vjp(t, jnp.asarray(z))[1](jnp.asarray(step, jnp.float32))[0]  # reverse mode is the transpose
    assert float((pulled * z).sum()) == pytest.approx(float((step**2).sum()), rel=1e-3)


# ------------------------------------------------------------------------------------------ losses


def test_losses_in_closed_form():
    rng = np.random.default_rng(0)
    image, target = rng.random((2, 8, 6, 3)).astype(np.float32)
    level = np.sqrt((target**2).mean())
    mean_square = lambda name: float(
        (loss_of(name).residuals(jnp.asarray(image), jnp.asarray(target), level) ** 2).mean()
    )
    off = image - target
    assert mean_square("l2") == pytest.approx((off**2).mean(), rel=1e-5)
    assert mean_square("relative") == pytest.approx(jaxrt.relative_mse(image, target), rel=1e-4)
    logs = np.log((image + 0.01 * level) / (target + 0.01 * level))
    assert mean_square("log") == pytest.approx((logs**2).mean(), rel=1e-4)
    half = off.reshape(4, 2, 3, 2, 3).mean((1, 3))
    quarter = half[:, :2].reshape(2, 2, 1, 2, 3).mean((1, 3))
    np.testing.assert_allclose(halved(jnp.asarray(off)), half, atol=1e-6)
    assert mean_square("multiscale") == pytest.approx(np.mean([(a**2).mean() for a in (off, half, quarter)]), rel=1e-4)


def test_the_callers_losses(monkeypatch):
    """Residuals and one number, of two views each: the mean of squares, and the mean."""
    pictures = [np.random.default_rng(k).random((12, 16, 3)) for k in range(3)]
    monkeypatch.setattr(views, "measure", lambda *args, **more: jnp.asarray(pictures[2], jnp.float32))
    free, group = Free.of(scene(), "*paint*"), views_of(scene(), checked(scene(), pictures[:2], [0, 0]))

    def value(loss):
        measuring = views.Measuring(loss_of(loss), 1, None, None, 2, True)
        return float(Descent(None, measuring, False, False).loss(free.start, scene(), free, group, jax.random.key(0)))

    want = np.mean([(pictures[2] - t) ** 2 for t in pictures[:2]])
    assert value("l2") == pytest.approx(want, rel=1e-5)
    assert value(lambda image, target: (image - target)[..., :2]) == pytest.approx(
        np.mean([(pictures[2] - t)[..., :2] ** 2 for t in pictures[:2]]), rel=1e-5
    )
    assert value(lambda image, target: ((image - target) ** 2).mean()) == pytest.approx(want, rel=1e-5)
    single = views.Measuring(loss_of(lambda image, target: (image - target).sum()), 1, None, None, 2, True)
    with pytest.raises(jaxrt.SceneError, match="gives one number; least squares needs residuals"):
        LeastSquares(None, single, False).residuals(free.start, (scene(), free, group, jax.random.key(0)))


def test_pixels_are_drawn_evenly():
    drawn = jax.vmap(lambda k: scattered(k, 7, 30))(jax.random.split(jax.random.key(0), 6000))
    counts = np.bincount(np.asarray(drawn).ravel(), minlength=30)
    assert counts.size == 30 and (np.abs(counts - 1400) < 4.5 * np.sqrt(1400)).all()


def test_coarse_targets_are_means_and_views_that_are_alike_are_together():
    pictures = [np.random.default_rng(k).random((12, w, 3)) for k, w in ((0, 16), (1, 20))]
    apart = views_of(scene(), checked(scene(), pictures, [0, 1]), 2)
    assert [v.targets.shape for v in apart] == [(1, 6, 8, 3), (1, 6, 10, 3)]
    np.testing.assert_allclose(apart[1].targets[0], pictures[1].reshape(6, 2, 10, 2, 3).mean((1, 3)), rtol=1e-6)
    alike = views_of(scene(), checked(scene(), [pictures[0], pictures[0]], [0, 0]))
    assert [v.targets.shape for v in alike] == [(2, 12, 16, 3)]


# ------------------------------------------------------------------------------------------ errors


PICTURE = np.ones((12, 16, 3))


@pytest.mark.parametrize(
    "free, more, message",
    [
        ("flor_paint.reflectance", {}, "no such parameter; closest: floor_paint.reflectance"),
        ("*.reflectanse", {}, "no such parameter"),
        ((), {}, "free: is empty"),
        ({"black.reflectance": "positive"}, {}, "black.reflectance: starts at 0, which a positive parameter cannot leave"),
        ({"floor_paint.reflectance": (0.2, 0.8)}, {}, "starts at 0.1 to 0.9, outside its bounds"),
        ({"floor_paint.reflectance": (0.8, 0.2)}, {}, "leave no room"),
        ({"floor_paint.reflectance": "unity"}, {}, "'unity' is not known; give plain, positive, unit, rigid, shift, smooth"),
        ({"floor_paint.reflectance": 3}, {}, "is no transform"),
        ({"floor_paint.reflectance": "rigid"}, {}, "a rigid motion is one of a to_world"),
        ({"floor_paint.reflectance": "shift"}, {}, "a rigid motion is one of a to_world"),
        ({"floor.to_world": jaxrt.Shift((1.0, 0.0, 0.0))}, {}, "are no directions; give up to three"),
        ({"floor.to_world": jaxrt.Shift(((1, 0, 0), (2, 0, 0)))}, {}, "are no directions; give up to three"),
        ({"floor.to_world": "smooth"}, {}, "has no Laplacian"),
        ("*paint*", {"targets": PICTURE[:8]}, r"has shape \(8, 16, 3\); give \(12, 16, 3\)"),
        ("*paint*", {"targets": PICTURE * np.nan}, "not finite"),
        ("*paint*", {"targets": [PICTURE], "sensor": [0, 1]}, "1 pictures for 2 sensors"),
        ("*paint*", {"sensor": 5}, "has 2 sensors, no number 5"),
        ("*paint*", {"loss": "l1"}, "loss: 'l1' is not known; give l2, relative, log, multiscale"),
        ("*paint*", {"loss": "log", "unbiased": True}, "is not quadratic"),
        ("*paint*", {"loss": "multiscale", "pixels": 8}, "takes whole pictures"),
        ("*paint*", {"coarse": [(5, 10)]}, "5 does not divide a picture of 16x12"),
        ("*paint*", {"coarse": [4]}, "is no stage"),
        ("*paint*", {"steps": 0}, "steps: is 0"),
        ("*paint*", {"spp": 0}, "spp: is 0"),
        ("*paint*", {"seed": 0.5}, "seed: is 0.5"),
        ("*paint*", {"max_depth": -1}, "finite number of bounces"),
        ("*paint*", {"optimiser": "adam"}, "optimiser: str is not known"),
        ("*paint*", {"resume": True}, "resume: has no file"),
    ],
)  # fmt: skip
def test_mistakes_are_named(free, more, message):
    with pytest.raises(jaxrt.SceneError, match=message) as caught:
        jaxrt.fit(scene(), **{"targets": PICTURE, "free": free, "steps": 1, "max_depth": 2, **more})
    assert "\n" not in str(caught.value)


def test_mistakes_of_least_squares_are_named():
    import optimistix

    lm = optimistix.LevenbergMarquardt(1e-3, 1e-3)
    for more, message in (
        ({"frozen": False}, "compares residuals"),
        ({"pixels": 8}, "takes whole pictures"),
        ({"unbiased": True}, "LevenbergMarquardt takes no step that raises the sum of squares"),
    ):
        with pytest.raises(jaxrt.SceneError, match=message):
            jaxrt.fit(scene(), PICTURE, "*paint*", optimiser=lm, max_depth=2, **more)


def test_a_plan_that_takes_a_free_parameter_for_granted_is_refused():
    grey = jaxrt.with_params(
        scene(), {n: 0.5 for n in ("wall.reflectance", "floor_paint.reflectance", "ceiling.emitter.radiance")}
    )
    plan = jaxrt.plan(grey, free=None)
    with pytest.raises(jaxrt.SceneError, match=r"floor_paint\.reflectance: is traced, but the plan relies on it"):
        jaxrt.fit(grey, PICTURE, "*paint*", plan=plan, max_depth=2)
