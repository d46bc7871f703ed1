"""Light sampling: irradiance in closed form, densities that agree with the sampler, selection among lights."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera, frame, mean_and_error, moved

import jaxrt
from jaxrt import emitter
from jaxrt.casting import cast
from jaxrt.sampling.sobol import Stream
from jaxrt.vector import Vec3, dot
from jaxrt.world import prepare

SETS, POINTS = 8, 2048  # independent randomisations, and stratified points of each


@functools.partial(jax.jit, static_argnames="plan")
def _draw(scene, x, n, plan):
    world = prepare(scene, plan)

    def one(seed, i):
        light = emitter.sample(world, Vec3.of(x), Stream(i, seed), 0, Vec3.of(n))
        y = cast(world, Vec3.of(x), light.w)
        met = emitter.density(world, Vec3.of(x), y, light.w)
        return (
            light.w.array(),
            light.distance,
            light.radiance.array(),
            light.pdf,
            light.known,
            light.face,
            y.face,
            met,
            dot(Vec3.of(n), light.w),
        )

    seeds, index = jnp.arange(SETS, dtype=jnp.uint32) * jnp.uint32(77), jnp.arange(POINTS, dtype=jnp.uint32)
    return jax.vmap(lambda s: jax.vmap(lambda i: one(s, i))(index))(seeds)


class Draws:
    """Light samples at a point: arrays (SETS, POINTS, ...), and the irradiance on a plane with normal n."""

    def __init__(self, scene, x, n, plan=None):
        n = np.asarray(n, np.float64) / np.linalg.norm(n)
        out = _draw(scene, np.asarray(x, np.float32), n.astype(np.float32), plan or jaxrt.plan(scene))
        self.w, self.distance, radiance, self.pdf, self.known, self.face, self.met, self.density, cos = map(
            np.asarray, out
        )
        share = np.where(self.pdf > 0, np.maximum(cos, 0) / np.where(self.pdf > 0, self.pdf, 1), 0).astype(np.float64)
        self.values = radiance[..., 0] * share

    def irradiance(self, face=None):
        return mean_and_error((self.values * (1 if face is None else self.face == face)).mean(1))


def assert_is(estimate, want, relative=2e-3):
    """Within five standard errors (of eight sets: a chance of 2e-3 were they normal), which are small themselves."""
    mean, error = estimate
    assert error < relative * want
    assert abs(mean - want) < 5 * error + 2e-6 * want


def polygon(x, n, corners):
    """Irradiance of a polygon of radiance 1 wholly above the horizon: Lambert's formula."""
    v = np.asarray(corners, float) - x
    total = 0.0
    for a, b in zip(v, np.roll(v, -1, 0), strict=True):
        c = np.cross(a, b)
        total += np.arctan2(np.linalg.norm(c), a @ b) * (c / np.linalg.norm(c)) @ n
    return abs(total) / 2


def by_area(x, n, points, normals, areas):
    """∫ cosθ cosθ'/r² dA by a sum over small pieces."""
    d = points - x
    r2 = (d**2).sum(-1)
    cos, there = np.maximum(d @ n, 0), np.maximum(-(d * normals).sum(-1), 0)
    return (cos * there / r2**2 * areas).sum()


@pytest.fixture(params=[False, True], ids=["by area", "by solid angle"])
def how(request):
    """Both ways to sample flat lamps, as overrides of a plan."""
    return {"solid_angle": request.param}


LAMP = {"to_world": moved(0.5, (0, 0, 1), frame((0, 0, -1), (1, 0, 0)))}  # 1 x 1 m at height 1, facing down
FAR = moved(0.1, (50, 50, 50))


# ------------------------------------------------------------------------- one light: no choice is compiled


@functools.cache
def alone(kind, radiance=1.0, **more):
    """A scene with one light."""
    return jaxrt.Scene.build([getattr(jaxrt, kind)(emission=radiance, **more)])


@functools.cache
def square(radiance=1.0):
    return jaxrt.Scene.build([jaxrt.Rectangle(emission=radiance, **LAMP)])


def test_form_factors_of_a_square(how):
    """Under its corner and its middle, E = πF (oracles); tilted, by Lambert's formula."""
    plan = jaxrt.plan(square(), **how)
    corners = [(-0.5, -0.5, 1), (0.5, -0.5, 1), (0.5, 0.5, 1), (-0.5, 0.5, 1)]
    assert_is(Draws(square(), (0.5, 0.5, 0), (0, 0, 1), plan).irradiance(), np.pi * 0.138531606)
    assert_is(Draws(square(), (0, 0, 0), (0, 0, 1), plan).irradiance(), np.pi * 0.239456470)
    n = np.array([0.48, 0.36, 0.8])
    x = np.array([-0.3, 0.2, -0.1])
    assert_is(Draws(square(), x, n, plan).irradiance(), polygon(x, n, corners))


@pytest.mark.parametrize("kind", ["Rectangle", "Disk"])
def test_lamps_are_sampled_where_they_light_most(kind):
    """On a wall below a lamp that goes on behind it, and on a floor beside: unlit corners are nearly left out."""
    scene = jaxrt.Scene.build([getattr(jaxrt, kind)(emission=1.0, **LAMP)])
    spread = lambda values: (values.std(axis=1) / values.mean(axis=1)).mean()
    for x, n, most in (((0, 0, 0), (1, 0, 0), 0.9), ((1.0, 0.7, 0), (0, 0, 1), 0.15)):
        draws = Draws(scene, x, n)
        even = draws.values * draws.pdf / draws.known  # what each would give, drawn evenly: by its share of draws
        evenly = np.sqrt((even * draws.values).mean(1) / draws.values.mean(1) ** 2 - 1).mean()
        assert spread(draws.values) < most < evenly


def test_radiance_scales_and_the_back_is_dark():
    one, many = Draws(square(), (0, 0, 0), (0, 0, 1)), Draws(square(1e12), (0, 0, 0), (0, 0, 1))
    np.testing.assert_allclose(many.values, 1e12 * one.values, rtol=1e-5)
    behind = Draws(square(), (0, 0, 2), (0, 0, -1))
    np.testing.assert_array_equal(behind.values, 0)
    np.testing.assert_array_equal(behind.pdf, 0)


@pytest.mark.parametrize(
    "x, n",
    [
        ((0.9, 0.0, 1.0), (-1, 0, 0)),  # in the plane of the light: it is seen edge on
        ((0.9, 0.0, 1 - 1e-6), (-1, 0, 0)),
        ((0.5, 0.5, 1.0), (0, 0, -1)),  # on a corner
        ((0.0, 0.0, 1.0), (0, 0, 1)),  # on the light
        ((0.0, 0.0, 1 - 1e-6), (0, 0, 1)),
    ],
)
def test_hard_places_are_finite(x, n, how):
    """Oracles, hard case 6."""
    draws = Draws(square(), x, n, jaxrt.plan(square(), **how))
    for a in (draws.w, draws.distance, draws.pdf, draws.values):
        assert np.isfinite(a).all()
    np.testing.assert_allclose(np.linalg.norm(draws.w, axis=-1)[draws.pdf > 0], 1.0, atol=1e-5)
    mean, error = draws.irradiance()
    assert mean < np.pi * 1.001 + 5 * error


SPHERE = {0: 0.785398, 30: 0.680175, 60: 0.392699, 75: 0.221201, 90: 0.0905861, 100: 0.0354490, 115: 0.00124003}


@functools.cache
def ball(center=(0.0, 0.0, 2.0), radius=1.0, flip=False):
    return jaxrt.Scene.build([jaxrt.Sphere(center=center, radius=radius, emission=1.0, flip_normals=flip)])


@pytest.mark.parametrize("tilt", SPHERE)
def test_a_sphere_light_over_a_tilted_receiver(tilt):
    n = (np.sin(np.radians(tilt)), 0, np.cos(np.radians(tilt)))
    # By solid angle; the last degrees before the horizon of the cone are few of the samples.
    assert_is(Draws(ball(), (0, 0, 0), n).irradiance(), SPHERE[tilt], 2e-3 if tilt < 100 else 0.03)


@pytest.mark.parametrize(
    "radius, distance", [(5e-5, 1.0), (1e-3, 1.0), (1.0, 1e4), (1e3, 1e4), (1e-6, 2e-6), (1.0, 1.001)]
)
def test_a_sphere_at_any_size_and_distance(radius, distance):
    """E = π (R/r)² for a receiver that faces it, down to 1e-8 sr (oracles, hard case 7)."""
    draws = Draws(ball((0.0, 0.0, distance), radius), (0, 0, 0), (0, 0, 1))
    ratio = float(np.float32(radius)) / float(np.float32(distance))
    # Above the sun's size and below it: float32 holds R/r to EPS, and directions within a cone of 1e-4 to 1e-3 of it.
    assert_is(draws.irradiance(), np.pi * ratio**2, 2e-3)
    assert (draws.pdf > 0).all()


def test_inside_a_sphere_that_shines_inwards():
    """E = π everywhere inside, on any plane."""
    scene = ball((0.0, 0.0, 2.0), 1.0, True)
    for x, n in (((0, 0, 2), (0, 0, 1)), ((0.5, 0.3, 1.7), (0.6, 0, 0.8))):
        assert_is(Draws(scene, x, n).irradiance(), np.pi, 0.02)  # by area, with 1/r² and half of the points behind
    # From outside its inner side is hidden.
    np.testing.assert_array_equal(Draws(scene, (0, 0, 0), (0, 0, 1)).values, 0)


# ------------------------------------------------------------------------------------ by solid angle


FACES = {
    "triangle": jaxrt.Mesh(
        vertices=[(-0.6, -0.5, 1), (-0.3, 0.7, 1.1), (0.7, -0.4, 0.8)], faces=[[0, 1, 2]], emission=1.0
    ),
    "square": jaxrt.Rectangle(emission=1.0, **LAMP),
    "rhomboid": jaxrt.Rectangle(
        emission=1.0, to_world=LAMP["to_world"] @ np.array([[1, 0.8, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    ),
    "strip": jaxrt.Rectangle(emission=1.0, to_world=LAMP["to_world"] @ np.diag([4.0, 0.04, 1, 1])),
}


@pytest.mark.parametrize("kind", FACES)
@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.7), (3.0, 2.0, -1.0)])
def test_directions_are_uniform_in_the_solid_angle_of_a_face(kind, x):
    """The density is 1/σ everywhere, and directions fill the face evenly: moments against a fine sum over it."""
    scene = jaxrt.Scene.build([FACES[kind]])
    draws = Draws(scene, x, (0, 0, 1), jaxrt.plan(scene, solid_angle=True))
    o, a, b = np.asarray(prepare(scene, jaxrt.plan(scene)).geometry[0], np.float64).reshape(3, 3)
    n = 400
    u, v = (k.ravel() for k in np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n))
    if kind == "triangle":
        u, v = 1 - np.sqrt(u), v * np.sqrt(u)
    to = o + u[:, None] * a + v[:, None] * b - x
    d = np.linalg.norm(to, axis=1)
    area = np.linalg.norm(np.cross(a, b)) * (0.5 if kind == "triangle" else 1.0)
    piece = area / u.size * np.abs(to @ np.cross(a, b)) / np.linalg.norm(np.cross(a, b)) / d**3
    sigma = piece.sum()
    np.testing.assert_allclose(draws.pdf, 1 / sigma, rtol=2e-3)
    w, want = draws.w.astype(np.float64), to / d[:, None]
    for f in (lambda w: w[..., 0], lambda w: w[..., 1], lambda w: w[..., 0] * w[..., 1], lambda w: w[..., 2] ** 2):
        mean, error = mean_and_error(f(w).mean(1))
        expected = (f(want) * piece).sum() / sigma
        assert error < 5e-3
        assert abs(mean - expected) < 5 * error + 2e-4


def test_a_plan_samples_by_solid_angle_where_that_lowers_variance():
    """Under a lamp as wide as its height above the floor: a part of the variance. Far from it: not worth it."""
    floor = jaxrt.Rectangle(to_world=np.diag([0.5, 0.5, 1.0, 1.0]))

    def under(height):
        lamp = jaxrt.Rectangle(emission=1.0, to_world=moved(0.5, (0, 0, height), frame((0, 0, -1), (1, 0, 0))))
        return jaxrt.Scene.build([floor, lamp])

    near, far = under(0.3), under(5.0)
    assert jaxrt.plan(near).solid_angle and not jaxrt.plan(far).solid_angle
    variance = [
        Draws(near, (0.3, 0.2, 0), (0, 0, 1), jaxrt.plan(near, solid_angle=on)).values.var() for on in (False, True)
    ]
    assert variance[1] < 0.3 * variance[0]


# --------------------------------------------------------------------------- many lights of every kind


def rings(n=400):
    """Pieces of the unit disc: positions and areas."""
    r, phi = np.meshgrid((np.arange(n) + 0.5) / n, 2 * np.pi * (np.arange(n) + 0.5) / n, indexing="ij")
    return np.stack([r * np.cos(phi), r * np.sin(phi), 0 * r], -1).reshape(-1, 3), (r * 2 * np.pi / n**2).ravel()


TRIANGLE = np.array([(3.0, -0.5, 1.0), (3.5, 0.8, 1.2), (4.2, -0.6, 0.9)])
DISK = moved(0.6, (-3, 1, 1.5), frame((0.3, 0, -1), (1, 0, 0)))
TUBE = (np.array([-1.0, -4.0, 1.0]), np.array([1.0, -4.0, 1.3]), 0.3)
POWERS = {"triangle": 1.0, "rectangle": 3.0, "disk": 0.5, "sphere": 2.0, "cylinder": 1.5}


@functools.cache
def lights():
    """One light of each kind, side by side, and their numbers as faces."""
    shapes = [
        jaxrt.Mesh(id="triangle", vertices=TRIANGLE, faces=[[0, 1, 2]], emission=POWERS["triangle"]),
        jaxrt.Rectangle(id="rectangle", emission=POWERS["rectangle"], **LAMP),
        jaxrt.Disk(id="disk", to_world=DISK, emission=POWERS["disk"]),
        jaxrt.Sphere(id="sphere", center=(0, 4, 2), radius=0.8, emission=POWERS["sphere"]),
        jaxrt.Cylinder(id="cylinder", p0=TUBE[0], p1=TUBE[1], radius=TUBE[2], emission=POWERS["cylinder"]),
        jaxrt.Rectangle(id="dark", to_world=FAR),
    ]
    scene = jaxrt.Scene.build(shapes)
    return scene, {name: start for name, _, start, _ in scene.structure.shapes}


X, N = np.array([0.2, 0.1, 0.0]), np.array([0.0, 0.0, 1.0])


def expected(kind):
    if kind == "triangle":
        return polygon(X, N, TRIANGLE)
    if kind == "rectangle":
        return polygon(X, N, [(-0.5, -0.5, 1), (0.5, -0.5, 1), (0.5, 0.5, 1), (-0.5, 0.5, 1)])
    if kind == "disk":
        p, a = rings()
        return by_area(X, N, p @ DISK[:3, :3].T + DISK[:3, 3], np.broadcast_to(DISK[:3, 2] / 0.6, p.shape), a * 0.36)
    if kind == "sphere":
        d = np.array([0, 4, 2]) - X
        return np.pi * 0.8**2 * (d @ N) / np.linalg.norm(d) ** 3
    p0, p1, r = TUBE
    h, phi = np.meshgrid((np.arange(400) + 0.5) / 400, 2 * np.pi * (np.arange(400) + 0.5) / 400, indexing="ij")
    axis = p1 - p0
    turn = frame(axis, (0, 1, 0))
    normal = np.cos(phi)[..., None] * turn[:, 0] + np.sin(phi)[..., None] * turn[:, 1]
    pieces = np.full(h.size, 2 * np.pi * r * np.linalg.norm(axis) / h.size)
    return by_area(X, N, (p0 + h[..., None] * axis + r * normal).reshape(-1, 3), normal.reshape(-1, 3), pieces)


@functools.cache
def everywhere(solid_angle=False):
    return Draws(lights()[0], X, N, jaxrt.plan(lights()[0], solid_angle=solid_angle))


@pytest.mark.parametrize("kind", POWERS)
def test_irradiance_of_each_of_many_lights(kind, how):
    """What the samples on one of the lights add up to is that light's irradiance."""
    # A fifth of the points fall on a light, so its error is a few per cent of a single set's.
    assert_is(everywhere(**how).irradiance(lights()[1][kind]), POWERS[kind] * expected(kind), 0.02)


def test_lights_are_chosen_by_power():
    """95 % of the samples by power (area x radiance), 5 % evenly; never a face that is no light."""
    areas = {"triangle": 0.0, "rectangle": 1.0, "disk": np.pi * 0.36, "sphere": 4 * np.pi * 0.64}
    areas["triangle"] = np.linalg.norm(np.cross(TRIANGLE[1] - TRIANGLE[0], TRIANGLE[2] - TRIANGLE[0])) / 2
    areas["cylinder"] = 2 * np.pi * TUBE[2] * np.linalg.norm(TUBE[1] - TUBE[0])
    power = {k: POWERS[k] * a for k, a in areas.items()}
    total = sum(power.values())
    numbers = lights()[1]
    face = everywhere().face
    assert set(np.unique(face)) == {numbers[k] for k in POWERS}
    for k in POWERS:
        # A choice by the first number of a pair: stratified to one of 2048 points a set at each end of its range.
        assert (face == numbers[k]).mean() == pytest.approx(0.95 * power[k] / total + 0.05 / 5, abs=2 / POINTS)


@pytest.mark.parametrize(
    "kind, accurate",
    [
        *((k, 0.999) for k in ("triangle", "rectangle", "disk", "sphere")),
        # Where a ray grazes it the cosine at the surface is small and its rounding is not: in 1 % of the samples.
        ("cylinder", 0.98),
    ],
)
def test_the_density_of_a_direction_is_that_of_its_sample(kind, accurate, how):
    """`density` for what a ray meets is the pdf with which `sample` drew that direction."""
    draws = everywhere(**how)
    drawn = (draws.face == lights()[1][kind]) & (draws.pdf > 0)
    same = drawn & (draws.met == draws.face)
    assert same.sum() > 300 and same.sum() > 0.998 * drawn.sum()  # lights do not hide each other here
    ratio = draws.density[same] / draws.known[same]
    assert np.mean(np.abs(ratio - 1) < 1e-3) > accurate


@pytest.mark.parametrize("scene, x", [(square, (0.3, 0, 0)), (ball, (0.2, 0.1, 0.3))])
def test_the_density_of_a_lone_light(scene, x, how):
    draws = Draws(scene(), x, N, jaxrt.plan(scene(), **how))
    same = (draws.met == 0) & (draws.pdf > 0)
    assert same.mean() > 0.999
    np.testing.assert_allclose(draws.density[same], draws.known[same], rtol=1e-3)


def test_the_density_integrates_to_the_chance_of_a_lit_sample():
    """∫ density dσ = Σ chance over what is seen: the mean of density/pdf' for directions drawn otherwise."""
    draws = everywhere()
    # Importance weights of the sampler against itself: E[1/pdf] over lit samples is the solid angle of all lights.
    solid = np.where(draws.pdf > 0, 1 / np.where(draws.pdf > 0, draws.pdf, 1), 0) * (
        draws.face == lights()[1]["sphere"]
    )
    d = np.array([0, 4, 2]) - X
    want = 2 * np.pi * (1 - np.sqrt(1 - 0.8**2 / (d @ d)))
    assert_is(mean_and_error(solid.mean(1)), want, 0.02)


def test_samples_beyond_the_enclosure_have_no_density():
    """A direction that meets no light, or its back, has density 0."""
    scene, numbers = lights()

    @jax.jit
    def density(w):
        world = prepare(scene, jaxrt.plan(scene))
        one = lambda w: (
            emitter.density(
                world,
                Vec3.of(jnp.asarray(X, jnp.float32)),
                y := cast(world, Vec3.of(jnp.asarray(X, jnp.float32)), Vec3.of(w)),
                Vec3.of(w),
            ),
            y.face,
        )
        return jax.vmap(one)(w)

    w = np.random.default_rng(0).normal(size=(4096, 3)).astype(np.float32)
    p, face = density(w / np.linalg.norm(w, axis=1, keepdims=True))
    p, face = np.asarray(p), np.asarray(face)
    np.testing.assert_array_equal(p[face < 0], 0)
    np.testing.assert_array_equal(p[face == numbers["dark"]], 0)
    front = face == numbers["sphere"]
    assert front.any() and (p[front] > 0).all()


def test_faces_emit_about_their_vertex_normals():
    """A triangle of area A far away, whose normals lean by 60°: E = L A cos 60°/d², and nothing beyond their horizon."""
    normals = np.tile([np.sin(np.pi / 3), 0.0, -np.cos(np.pi / 3)], (3, 1))
    vertices = np.array([(-0.1, -0.1, 0), (-0.1, 0.1, 0), (0.1, 0, 0.0)]) + [0.1 / 3, 0, 0]  # about its middle
    lamp = jaxrt.Mesh(vertices=vertices, faces=np.array([[0, 1, 2]]), normals=normals, emission=2.0, id="lamp")
    scene = jaxrt.Scene.build([lamp], sensors=[camera((0, 0, -4), (0, 0, 0), 2, 2, 1.0, up=(0, 1, 0))])
    got = jaxrt.irradiance(scene, [[0.0, 0, -5], [-5.0, 0, -1]], [[0.0, 0, 1], [1.0, 0, 0]], spp=1024)[:, 0]
    np.testing.assert_allclose(got, [2.0 * 0.02 * 0.5 / 25, 0.0], rtol=5e-3)
    seen = lambda x: jaxrt.measure(
        jaxrt.with_params(scene, {"lamp.vertices": vertices + x[None]}), 0, spp=1, max_depth=1
    )
    with pytest.raises(jaxrt.SceneError, match="dark by their vertex normals"):
        jax.jvp(seen, (jnp.zeros(3),), (jnp.ones(3),))
