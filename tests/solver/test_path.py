"""The path method against furnaces, energy, form factors and itself: depth, roulette, standard errors, determinism."""

import dataclasses
import functools
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from helpers import (
    WALLS,
    box_room,
    camera,
    frame,
    hemisphere_directions,
    look_at,
    mean_and_error,
    moved,
    picture,
    world_of,
)

import jaxrt
from jaxrt.solver.lamps import borders
from jaxrt.solver.measure import view_of

# ------------------------------------------------------------------------------------------- one room for all
# The cube [-1, 1]³ of six rectangles that may all shine: every scene here is it with other values, so all share
# two programs for pictures (with and without light sampling) and one for meters.


@functools.cache
def empty():
    return box_room(0.5, {k: 0.0 for k in WALLS}, sensors=[camera((0.3, -0.4, 0.2), (-0.5, 0.6, 0.7), 16, 16, 100.0)])


@functools.cache
def plan(lights=True):
    return jaxrt.plan(empty(), light_sampling=lights)


def room(rho, size=(16, 16), **radiance):
    """The room with one reflectance and with the radiance of walls; `walls`: of those not named."""
    rest = radiance.pop("walls", 0.0)
    values = {f"{k}.emitter.radiance": np.full(1, radiance.get(k, rest)) for k in WALLS}
    return jaxrt.resized(jaxrt.with_params(empty(), {"wall.reflectance": np.full(1, rho), **values}), 0, *size)


def render(scene, spp, seed=0, max_depth=-1, rr_depth=10**6, lights=True, **more):
    return jaxrt.render(scene, spp, seed, plan=plan(lights), max_depth=max_depth, rr_depth=rr_depth, **more)


def mean_of(solution):
    """Mean of a picture and its standard error."""
    return solution.image.mean(dtype=np.float64), np.sqrt(
        (solution.stderr.astype(np.float64) ** 2).sum()
    ) / solution.image.size


def z(a, b):
    return (a[0] - b[0]) / np.hypot(a[1], b[1])


# --------------------------------------------------------------------------------------------------- furnaces


@pytest.mark.parametrize("rho, depth", [(0.5, 1), (0.5, 2), (0.5, 20), (0.9, 60), (0.99, 200), (0.999, 600)])
def test_the_furnace_at_finite_depth(rho, depth):
    """Le (1 − ρᵈ)/(1 − ρ), and every single sample has it where directions are drawn by cosine alone."""
    image = render(room(rho, (8, 8), walls=1.5), 4, max_depth=depth, lights=False).image
    rho = float(np.float32(rho))
    # Every bounce rounds the throughput by 1e-7 or so.
    np.testing.assert_allclose(image, 1.5 * (1 - rho**depth) / (1 - rho), rtol=1e-4)


@pytest.mark.parametrize("rho, depth", [(0.5, 8), (0.9, 60)])
def test_the_furnace_with_light_sampling(rho, depth):
    solution = render(room(rho, walls=1.5), 256, max_depth=depth)
    mean, error = mean_of(solution)
    want = 1.5 * (1 - rho**depth) / (1 - rho)
    assert error < 1e-3 * want
    assert abs(mean - want) < 4 * error


def test_the_furnace_to_convergence():
    """No limit of depth: roulette ends paths, and 1/(1 − ρ) is what they have in the mean."""
    solution = render(room(0.9, walls=1.5), 256, max_depth=-1, rr_depth=5)
    mean, error = mean_of(solution)
    assert error < 3e-3 * 15
    assert abs(mean - 15) < 4 * error


def test_the_furnace_of_a_mesh():
    """A closed icosphere; the camera sits inside."""
    from helpers import icosphere

    v, f = icosphere(1)
    mesh = jaxrt.Mesh(vertices=v, faces=f[:, ::-1].copy(), bsdf=jaxrt.Diffuse(0.9), emission=1.0)
    scene = jaxrt.Scene.build([mesh], sensors=[camera((0.1, 0.2, 0), (1, 0, 0), 8, 8, 90)])
    flat = jaxrt.plan(scene, light_sampling=False)
    image = jaxrt.render(scene, 8, plan=flat, max_depth=40, rr_depth=10**6).image
    np.testing.assert_allclose(image, (1 - 0.9**40) / (1 - 0.9), rtol=1e-4)


def test_the_furnace_in_float64():
    """With x64 on everything is float64: the furnace holds to its rounding."""
    with jax.enable_x64(True):
        scene = box_room(0.5, {k: 1.5 for k in WALLS}, sensors=empty_sensor())
        image = picture(scene, 0, jaxrt.plan(scene, light_sampling=False), spp=2, max_depth=10)
        assert image.dtype == np.float64
        # The cosine hemisphere's polynomial for the circle is good to 4e-7, but it only turns directions.
        np.testing.assert_allclose(image, 1.5 * (1 - 0.5**10) / (1 - 0.5), rtol=1e-12)


def empty_sensor():
    return [camera((0.3, -0.4, 0.2), (-0.5, 0.6, 0.7), 4, 4, 100.0)]


# ------------------------------------------------------------------------------------------------ energy


def on_walls(n, seed=0):
    """Random points on the walls, n each, and the normals into the room."""
    rng = np.random.default_rng(seed)
    points, normals = [], []
    for axis in WALLS.values():
        out = np.array(axis, float)
        p = rng.uniform(-1, 1, (n, 3))
        points.append(np.where(out != 0, out, p))
        normals.append(np.broadcast_to(-out, (n, 3)))
    return np.concatenate(points), np.concatenate(normals)


@pytest.mark.parametrize("rho, want", [(0.5, 1 / 3), (0.9, 5 / 3)])
def test_the_energy_identity(rho, want):
    """Closed, uniform ρ: Σ A B = Σ A E/(1 − ρ). One face of exitance 1: mean B is 1/3 and 5/3 (oracles)."""
    points, normals = on_walls(256)
    scene = room(rho, ceiling=1 / np.pi)
    e = np.asarray(jaxrt.irradiance(scene, points, normals, 3, plan=plan(), spp=64, max_depth=-1), np.float64)[:, 0]
    mean, error = mean_and_error(1 / 6 + rho * e)
    assert error < 0.02 * want
    assert abs(mean - want) < 4 * error


def test_concentric_spheres(short_loops):
    """F21 = (r1/r2)², F22 = 1 − F21: B1 = 1.111111, B2 = .222222 (oracles)."""
    inner = jaxrt.Sphere(radius=0.5, bsdf=jaxrt.Diffuse(0.5, id="a"), emission=1 / np.pi)
    outer = jaxrt.Sphere(radius=1.0, bsdf=jaxrt.Diffuse(0.5, id="b"), flip_normals=True)
    scene = jaxrt.Scene.build([inner, outer])
    from helpers import sphere_directions

    d = sphere_directions(128)
    points, normals = np.concatenate([0.5 * d, d]), np.concatenate([d, -d])
    e = np.asarray(jaxrt.irradiance(scene, points, normals, spp=256, max_depth=-1), np.float64).reshape(2, 128)
    mean, error = mean_and_error(e.T)
    assert (error < 3e-3).all()
    np.testing.assert_array_less(np.abs([1, 0] + 0.5 * mean - [1.111111, 0.222222]), 0.5 * 4 * error)


# -------------------------------------------------------------------------------------------- form factors


@functools.cache
def lamps():
    """A square, a disc and a ball, 100 m apart: what the others send is below 1e-7 of each one's light."""
    down = frame((0, 0, -1), (1, 0, 0))
    return jaxrt.Scene.build(
        [
            jaxrt.Rectangle(id="square", to_world=moved(0.5, (0, 0, 1), down), emission=1 / np.pi),
            jaxrt.Disk(id="disc", to_world=moved(1.0, (100, 0, 1), down), emission=1 / np.pi),
            jaxrt.Sphere(id="ball", center=(-100, 0, 2), radius=1.0, emission=1 / np.pi),
        ]
    )


N_METERS = 512


def mean_irradiance(points, normal, scene=None):
    normals = np.broadcast_to(np.asarray(normal, float), points.shape)
    e = jaxrt.irradiance(lamps() if scene is None else scene, points, normals, 1, spp=64, max_depth=1)
    return mean_and_error(np.asarray(e, np.float64)[:, 0])


def squares(size):
    m = moved(size / 2, (0, 0, 1), frame((0, 0, -1), (1, 0, 0)))
    return jaxrt.with_params(lamps(), {"square.to_world": m})


def assert_form_factor(estimate, want):
    mean, error = estimate
    assert error < 0.03 * want
    assert abs(mean - want) < 4 * error + 1e-6


def stratified(seed):
    """Points of the unit square, one in each of 512 cells."""
    i, j = np.meshgrid(np.arange(32), np.arange(16), indexing="ij")
    u = np.random.default_rng(seed).random((N_METERS, 2))
    return (np.stack([i.ravel(), j.ravel()], -1) + u) / [32, 16]


@pytest.mark.parametrize("size, want", [(1.0, 0.199824896), (2.0, 0.415253284), (10.0, 0.826994522)])
def test_parallel_squares(size, want):
    u = (stratified(1) - 0.5) * size
    points = np.concatenate([u, np.zeros((N_METERS, 1))], -1)
    assert_form_factor(mean_irradiance(points, (0, 0, 1), squares(size)), want)


def test_perpendicular_squares_with_a_shared_edge():
    u = stratified(2)
    points = np.stack([np.full(N_METERS, 0.5), u[:, 0] - 0.5, 1 - u[:, 1]], -1)
    assert_form_factor(mean_irradiance(points, (-1, 0, 0)), 0.200043776)


@pytest.mark.parametrize("gap, want", [(1.0, 0.381966011), (2.0, 0.171572875)])
def test_coaxial_discs(gap, want):
    u = stratified(3)
    r, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    points = np.stack([100 + r * np.cos(phi), r * np.sin(phi), np.full(N_METERS, 1 - gap)], -1)
    assert_form_factor(mean_irradiance(points, (0, 0, 1)), want)


@pytest.mark.parametrize("where, want", [((0.5, 0.5), 0.138531606), ((0.0, 0.0), 0.239456470)])
def test_an_element_under_a_square(where, want):
    points = np.broadcast_to([*where, 0.0], (N_METERS, 3))
    assert_form_factor(mean_irradiance(points, (0, 0, 1)), want)


def test_a_sphere_light_over_tilted_receivers():
    """E over its table (oracles), 0 to 115°; both strategies take part, and the horizon cuts the ball."""
    table = {0: 0.785398, 30: 0.680175, 60: 0.392699, 75: 0.221201, 90: 0.0905861, 100: 0.0354490, 115: 0.00124003}
    angles = np.radians(np.array(list(table)))
    each = N_METERS // 8
    normals = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], -1)
    normals = np.concatenate([np.repeat(normals, each, 0), np.tile([0, 0, 1.0], (each, 1))])
    points = np.tile([-100.0, 0, 0], (N_METERS, 1))
    e = np.asarray(jaxrt.irradiance(lamps(), points, normals, 2, spp=64, max_depth=1), np.float64)[:, 0]
    for k, want in enumerate(table.values()):
        mean, error = mean_and_error(np.pi * e[k * each : (k + 1) * each])
        assert error < (0.02 if want > 0.05 else 0.1) * want
        assert abs(mean - want) < 4 * error + 1e-5 * want


# ------------------------------------------------------------------------------------ depth, hidden emitters


def along(scene, max_depth, spp=256):
    """Radiance seen from inside towards the lit ceiling and straight down, and its standard error over 64 rays."""
    scene, found = jaxrt.resized(scene, 0, 8, 8), []
    for d in ((0.1, 0.2, 1.0), (0, 0, -1.0)):  # each a picture of one point
        view = {"sensor.to_world": look_at((0, 0, 0), d, (0, 1, 0)), "sensor.fov": 1e-3}
        found.append(render(jaxrt.with_params(scene, view), spp, 5, max_depth=max_depth).image.reshape(64))
    return mean_and_error(np.stack(found, 1))


def test_depths_as_mitsuba_counts_them():
    """1: emission. 2: direct light, here the form factor of an element under a 2 x 2 square at height 2."""
    scene = room(0.5, ceiling=2.0)
    one, _ = along(scene, 1)
    np.testing.assert_array_equal(one, [2.0, 0.0])
    two, error = along(scene, 2)
    direct = 0.5 * 2.0 * 0.239456470
    assert abs(two[1] - direct) < 4 * error[1] and error[1] < 3e-3
    assert two[0] == pytest.approx(2.0, rel=1e-6)  # nothing else shines, so the lamp's own reflection is 0
    three, error3 = along(scene, 3)
    assert three[1] > two[1] + 0.05 and three[0] > 2.0 + 0.05
    deep, error_deep = along(scene, 40)
    endless, error_endless = along(scene, -1)
    assert (np.abs(deep - endless) < 4 * np.hypot(error_deep, error_endless)).all()
    assert (deep > three).all()


def test_depth_0_is_black():
    """Le (1 − ρ⁰)/(1 − ρ) = 0, as in Mitsuba."""
    np.testing.assert_array_equal(along(room(0.5, ceiling=2.0), 0)[0], 0.0)


def test_hidden_emitters(short_loops):
    """The camera looks through a lamp at the wall behind it, which the lamp still lights."""
    wall = jaxrt.Rectangle(to_world=moved(3.0, (0, 0, 0)), bsdf=jaxrt.Diffuse(0.5, id="paint"))
    lamp = jaxrt.Rectangle(to_world=moved(0.5, (0, 0, 1), frame((0, 0, -1), (1, 0, 0))), emission=1.0)
    hide = jaxrt.Integrator(max_depth=2, hide_emitters=True)
    scene = jaxrt.Scene.build(
        [wall, lamp], sensors=[camera((0, 0, 3), (0, 0, 0), 4, 4, 2.0, up=(0, 1, 0))], integrator=hide
    )
    image = jaxrt.render(scene, 1024).image
    x = 0.5 / np.hypot(1.0, 0.5)  # form factor of a square on its axis: 4/(2π) 2 X atan X
    np.testing.assert_allclose(image.mean(), 0.5 * 4 / np.pi * x * np.arctan(x), rtol=0.01)
    shown = dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, integrator=(2, 5, False, 1)))
    both = jaxrt.plan(scene, free=None)  # hides emitters where a picture asks for it
    np.testing.assert_array_equal(jaxrt.render(shown, 4, plan=both).image, 0.0)  # its back
    mean = lambda r: jaxrt.measure(jaxrt.with_params(scene, {"paint.reflectance": r}), 0, spp=256).mean()
    slope = jax.jvp(mean, (jnp.array([0.5]),), (jnp.ones(1),))[1]
    np.testing.assert_allclose(slope, 2 * image.mean(), rtol=0.02)


def test_hidden_emitters_shine_on_meters(short_loops):
    """hide_emitters is about pictures: irradiance keeps all light."""
    hidden = dataclasses.replace(
        lamps(), structure=dataclasses.replace(lamps().structure, integrator=(-1, 5, True, 16))
    )
    points = np.zeros((N_METERS, 3))
    assert_form_factor(mean_irradiance(points, (0, 0, 1), hidden), 0.239456470)


def test_what_the_scene_file_asks_for_is_the_default():
    scene = room(0.5, (8, 8), walls=1.5)
    asked = dataclasses.replace(scene.structure, integrator=(3, 9, False, 4))
    solution = jaxrt.render(dataclasses.replace(scene, structure=asked), plan=plan(False))
    np.testing.assert_allclose(solution.image, 1.5 * 1.75, rtol=1e-5)
    assert solution.stats["spp"] == 4 and solution.stats["max_depth"] == 3


@pytest.mark.parametrize("half", [1.0, 100.0])
@pytest.mark.parametrize("inwards", [False, True])
def test_tubes_do_not_hide_their_own_light(half, inwards, short_loops):
    """Light sampling agrees with reflection alone, whatever the size of the scene around."""
    tube = jaxrt.Cylinder(
        p0=(-1, 0, 1), p1=(1, 0, 1.2), radius=0.3, emission=1.0, flip_normals=inwards, bsdf=jaxrt.Diffuse(0.0)
    )
    scene = jaxrt.Scene.build(
        [tube, jaxrt.Rectangle(to_world=moved(half, (0, 0, 0))), jaxrt.Rectangle(to_world=moved(0.01, (0, 0, 1.1)))]
    )
    at = (0.1, 0.1, 1.05) if inwards else (0.2, 0.1, 0.5)
    o, n = np.broadcast_to(at, (64, 3)), np.broadcast_to([0, 0, -1.0 if inwards else 1.0], (64, 3))
    both, one = (
        mean_and_error(jaxrt.irradiance(scene, o, n, spp=1024, max_depth=1, plan=jaxrt.plan(scene, light_sampling=on)))
        for on in (True, False)
    )
    assert one[0] > 0.1
    assert abs(both[0] - one[0]) < 4 * np.hypot(both[1], one[1]) + 1e-3 * one[0]


def test_a_dark_lamp_takes_nothing_from_a_bright_one(short_loops):
    """A plan that relies on the dark one staying dark, in any order of the two."""
    lamps = [
        jaxrt.Rectangle(
            to_world=moved(0.5, (x, 0, 1), frame((0, 0, -1), (1, 0, 0))), emission=e, bsdf=jaxrt.Diffuse(0.0)
        )
        for x, e in ((-0.6, 0.0), (0.6, 1.0))
    ]
    means = []
    for order in (lamps, lamps[::-1], lamps[1:]):
        scene = jaxrt.Scene.build([jaxrt.Rectangle(to_world=moved(3.0, (0, 0, 0))), *order])
        plan = jaxrt.plan(scene, free=None)
        means.append(float(jaxrt.radiance(scene, (0, 0, 0.5), (0, 0, -1), spp=8192, max_depth=2, plan=plan)[0]))
    np.testing.assert_allclose(means, means[2], rtol=0.01)


def test_a_tube_that_shines_inwards_is_dark_outside(short_loops):
    tube = jaxrt.Cylinder(p0=(0, 0, -1), p1=(0, 0, 1), radius=0.5, flip_normals=True, emission=1.0)
    scene = jaxrt.Scene.build([tube, jaxrt.Rectangle(to_world=moved(1.0, (0, 0, -9)))])
    points = np.broadcast_to([2.0, 0, 0], (64, 3))
    e = jaxrt.irradiance(scene, points, np.broadcast_to([-1.0, 0, 0], (64, 3)), spp=16, max_depth=1)
    np.testing.assert_array_equal(e, 0.0)


# ----------------------------------------------------------------------------------- roulette and strategies


@pytest.fixture(scope="module")
def lit_by_one():
    """Pictures of the room with one lit face at ρ = .8, depth 12, by what ought not to matter."""
    scene = room(0.8, ceiling=1.0)
    return {
        "plain": render(scene, 256, 1, max_depth=12),
        "roulette": render(scene, 256, 2, max_depth=12, rr_depth=1),
        "cosine": render(scene, 1024, 3, max_depth=12, lights=False),
    }


@pytest.mark.parametrize("other", ["roulette", "cosine"])
def test_roulette_and_light_sampling_do_not_change_the_mean(lit_by_one, other):
    a, b = lit_by_one["plain"], lit_by_one[other]
    assert not np.array_equal(a.image, b.image)
    assert abs(z(mean_of(a), mean_of(b))) < 4
    assert mean_of(a)[1] < 3e-3 * mean_of(a)[0]
    # And pixel by pixel: the differences are as large as the standard errors say.
    scores = (a.image - b.image) / np.hypot(a.stderr, b.stderr)
    assert np.abs(scores).max() < 5.5  # of 256
    assert 0.8 < scores.std() < 1.2


def test_light_sampling_lowers_the_error(lit_by_one):
    plain, cosine = lit_by_one["plain"], lit_by_one["cosine"]
    assert mean_of(plain)[1] * np.sqrt(256) < 0.7 * mean_of(cosine)[1] * np.sqrt(1024)


def test_standard_errors_cover():
    """Of pictures against a far better one, 68 % lie within one standard error and 95 % within 1.96."""
    scene = room(0.6, ceiling=1.0)
    truth = np.mean([render(scene, 4096, 1000 + k, max_depth=4).image.astype(np.float64) for k in range(2)], 0)
    scores = []
    for seed in range(16):
        s = render(scene, 64, seed, max_depth=4)
        # Pixels that see only the lamp and what has no noise would not tell anything.
        scores.append(((s.image - truth) / np.where(s.stderr > 0, s.stderr, np.inf))[s.stderr > 0])
    scores = np.abs(np.concatenate(scores))
    assert scores.size > 3000  # a binomial standard error of .8 % at 68 %
    assert np.mean(scores < 1) == pytest.approx(0.6827, abs=0.03)
    assert np.mean(scores < 1.96) == pytest.approx(0.95, abs=0.02)


# ----------------------------------------------------------------------------------------- bits and sizes


def test_the_same_seed_gives_the_same_bits():
    scene = room(0.5, ceiling=1.0)
    a, b, c = (render(scene, 16, seed, max_depth=6) for seed in (7, 7, 8))
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.stderr, b.stderr)
    assert (a.image != c.image).mean() > 0.5


def test_another_chunk_gives_the_same_picture_within_rounding():
    scene = room(0.5, (20, 16), ceiling=1.0)
    a, b = (render(scene, 16, 7, max_depth=6, chunk=chunk) for chunk in (256, 77))
    # Samples are numbered, so the same paths are traced. Another vector width may round a hit or a direction
    # differently, and a path at an edge may then part: up to six pixels of 320, by processor.
    close = np.isclose(a.image, b.image, rtol=1e-5)
    assert close.mean() > 0.97
    assert np.median(np.abs(a.image / b.image - 1)) < 1e-6


def test_samples_are_numbered():
    """16 samples are the first 8 and eight more: the means of passes add up."""
    scene = room(0.5, (8, 8), ceiling=1.0)
    few, many = render(scene, 8, 5, max_depth=4), render(scene, 512, 5, max_depth=4)
    assert abs(z(mean_of(few), mean_of(many))) < 4
    one = render(scene, 256, 5, max_depth=4).image.astype(np.float64)
    # 512 samples are two passes; were the second a copy of the first, the pictures would be the same.
    assert np.abs(many.image - one).max() > 1e-4


@pytest.mark.parametrize("size", [(7, 5), (1, 1), (13, 9), (1, 30), (300, 1)])
def test_odd_sizes(size):
    solution = render(room(0.5, size, walls=1.5), 4, max_depth=3, lights=False)
    assert solution.image.shape == solution.stderr.shape == (size[1], size[0], 1)
    np.testing.assert_allclose(solution.image, 1.5 * 1.75, rtol=1e-5)
    assert solution.stats["samples"] == 4 * size[0] * size[1]


@pytest.mark.parametrize("spp", [1, 2, 3, 5, 258])
def test_odd_numbers_of_samples(spp):
    scene = room(0.5, (8, 8), ceiling=1.0, floor=0.5)
    solution = render(scene, spp, 3, max_depth=3)
    assert np.isfinite(solution.image).all()
    assert solution.image.dtype == np.float32
    if spp == 1:
        assert np.isnan(solution.stderr).all()
        return
    assert np.isfinite(solution.stderr).all() and (solution.stderr >= 0).all()
    good = render(scene, 4096, 9, max_depth=3)
    scores = (solution.image - good.image) / np.hypot(solution.stderr, good.stderr)
    assert abs(scores.mean()) < 5 / np.sqrt(scores.size) * 1.5  # two sets tell their own spread only roughly


def test_render_and_measure_agree():
    scene = room(0.5, ceiling=1.0)
    image = jax.jit(lambda s: jaxrt.measure(s, 11, plan=plan(), spp=16, max_depth=5, rr_depth=5))(scene)
    solution = render(scene, 16, 11, max_depth=5, rr_depth=5)
    again = np.zeros(256, bool)  # pixels that a picture takes several times
    again[borders(world_of(scene, plan()), jax.tree.map(np.asarray, view_of(scene, 0)))] = True
    close = np.isclose(image, solution.image, rtol=1e-5).reshape(256, -1)[~again]
    assert again.mean() < 0.2
    assert close.mean() > 0.99  # one is compiled for 256 lanes, the other for 512: see the test of chunks


def test_stats_and_progress():
    seen = []
    scene = room(0.5, (8, 8), walls=1.5)
    solution = render(scene, 300, max_depth=2, lights=False, progress=seen.append)
    assert seen[-1] == 1.0 and sorted(seen) == seen
    assert solution.stats["rays"] == 2 * 300 * 64 or solution.stats["rays"] == 3 * 300 * 64
    assert solution.stats["nonfinite"] == 0
    assert solution.result == optimistix.RESULTS.successful


@pytest.mark.parametrize("scale", [2.0**10, 2.0**-10])
def test_the_picture_does_not_change_with_scale(scale):
    """By powers of two every number scales exactly, so only what has a size of its own could show."""
    scene = room(0.7, ceiling=1.0, left=0.3)
    values = {f"{k}.to_world": moved(scale) @ np.asarray(jaxrt.params(scene)[f"{k}.to_world"]) for k in WALLS}
    pose = np.array(jaxrt.params(scene)["sensor.to_world"])
    pose[:3, 3] *= scale
    values |= {"sensor.to_world": pose, "sensor.near_clip": 0.01 * scale, "sensor.far_clip": 1e4 * scale}
    a, b = render(scene, 16, 2, max_depth=6), render(jaxrt.with_params(scene, values), 16, 2, max_depth=6)
    np.testing.assert_allclose(a.image, b.image, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shift", [100.0, 1e4])
def test_the_picture_does_not_change_with_place(shift):
    """Moved by 1e4 m the room's own numbers are rounded to 1e-3 m; its light stays."""
    scene = room(0.7, ceiling=1.0, left=0.3)
    values = {
        f"{k}.to_world": moved(1.0, (shift,) * 3) @ np.asarray(jaxrt.params(scene)[f"{k}.to_world"]) for k in WALLS
    }
    pose = np.array(jaxrt.params(scene)["sensor.to_world"])
    pose[:3, 3] += shift
    values |= {"sensor.to_world": pose}
    a = mean_of(render(scene, 256, 2, max_depth=6))
    b = mean_of(render(jaxrt.with_params(scene, values), 256, 3, max_depth=6))
    # A ray starts 1e-2 m off its wall at 1e4 m; light is missed or gained along edges in that proportion.
    assert abs(a[0] - b[0]) < 4 * np.hypot(a[1], b[1]) + 2e-6 * shift * a[0]


# --------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"spp": 0}, "spp"),
        ({"spp": 2.5}, "spp"),
        ({"max_depth": -2}, "max_depth"),
        ({"chunk": 0}, "chunk"),
        ({"sensor": 3}, "sensors"),
        ({"method": "photon"}, "method"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words):
    with pytest.raises(jaxrt.SceneError, match=words):
        jaxrt.render(empty(), **arguments)


def test_a_scene_without_a_camera_is_refused():
    scene = jaxrt.Scene.build([jaxrt.Sphere()])
    with pytest.raises(jaxrt.SceneError, match="0 sensors"):
        jaxrt.render(scene)


def test_wrong_rays_are_refused():
    with pytest.raises(ValueError, match="shape"):
        jaxrt.radiance(empty(), np.zeros((4, 2)), np.zeros((4, 3)))


def test_a_scene_that_reflects_nothing():
    """A lamp alone: no bounce is compiled. In a process of its own, for it is one that XLA ends."""
    code = """
import jaxrt
lamp = jaxrt.Sphere(emission=1.0, bsdf=jaxrt.Diffuse(0.0))
film = jaxrt.Film(8, 8, "box")
pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1.05], [0, 0, 0, 1]]
scene = jaxrt.Scene.build([lamp], sensors=[jaxrt.Sensor(to_world=pose, film=film, fov=20.0)])
image = jaxrt.render(scene, 4).image
assert image.min() == image.max() == 1.0, image
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[:500]


def test_a_meter_sums_what_its_rays_see():
    """Irradiance is the cosine-weighted mean of `radiance` over the hemisphere: the same room by two ways."""
    scene = room(0.6, ceiling=1.0)
    p, n = np.array([[0.2, 0.1, -1.0]]), np.array([[0, 0, 1.0]])
    rays = hemisphere_directions(128, 4)
    mean, error = mean_and_error(
        np.pi * np.asarray(jaxrt.radiance(scene, p + [[0, 0, 1e-5]], rays, 3, plan=plan(), spp=256, max_depth=3))[:, 0]
    )
    meters = np.asarray(
        jaxrt.irradiance(scene, np.repeat(p, 1536, 0), np.repeat(n, 1536, 0), 8, plan=plan(), spp=64, max_depth=3)
    )
    direct, direct_error = mean_and_error(meters[:, 0])
    assert direct_error < 0.01 * direct
    assert abs(mean - direct) < 4 * np.hypot(error, direct_error)


@pytest.mark.slow
def test_the_last_ray_is_cast_only_where_a_lamp_may_be(short_loops):
    """The picture is the same without an enclosure and with a black one, in which every last ray is cast."""
    turned = lambda *at: moved(0.2, at, frame([0.2, 0.3, -1.0], [1, 0, 0]))
    lamps = [
        jaxrt.Sphere(center=(0.5, 0.5, 0.2), radius=0.1, emission=3.0),
        jaxrt.Disk(to_world=turned(-0.5, 0.5, 0.5), emission=5.0),
        jaxrt.Cylinder(p0=(-0.5, -0.5, 0), p1=(-0.2, -0.5, 0.3), radius=0.05, emission=4.0),
        jaxrt.Rectangle(to_world=turned(0.3, -0.6, 0.4), emission=6.0),
        jaxrt.Mesh(vertices=[[0.8, 0, 0], [0.8, 0.4, 0], [0.8, 0, 0.7]], faces=[[0, 2, 1]], emission=9.0),
    ]
    for some in (lamps, [lamps[0], lamps[3]] * 9):  # one by one, and by one sphere around all of them
        scene = box_room(0.6, others=some)
        few, all_ = (
            jaxrt.render(scene, 64, 0, max_depth=3, plan=jaxrt.plan(scene, free=None, enclosure=on))
            for on in (False, True)
        )
        np.testing.assert_allclose(few.image, all_.image, rtol=1e-4, atol=1e-6)
        assert few.stats["rays"] < (0.85 if some is lamps else 1.0) * all_.stats["rays"]
