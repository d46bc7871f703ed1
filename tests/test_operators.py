"""The algebra: G, K, T, their adjoints and series, against the laws of the notes, furnaces and the path method."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import WALLS, box_room, frame, hits, mean_and_error, moved, sphere_directions, world_of

import jaxrt
from jaxrt.casting import cast
from jaxrt.operators import Zero, add, adjoint, compose, inner, neumann, norm, sub
from jaxrt.sampling.sobol import Stream
from jaxrt.vector import Spectrum, Vec3, dot
from jaxrt.world import prepare

pytestmark = pytest.mark.usefixtures("short_loops")

RHO = {"floor": 0.7, "ceiling": 0.3, "left": 0.5, "right": 0.2, "back": 0.6}


class Wave(eqx.Module):
    """A radiance function without symmetry: positive, smooth in position and direction, 0 on the enclosure."""

    p: tuple[float, float, float]
    q: tuple[float, float, float]
    mixed: float = 0.2

    def at(self, x, w):
        """The same in numpy, for positions and directions (N, 3)."""
        return 1.5 + x @ np.array(self.p) + w @ np.array(self.q) + self.mixed * x[:, 0] * w[:, 1]

    def __call__(self, x, w, s=None):
        value = 1.5 + dot(x.position, Vec3(*self.p)) + dot(w, Vec3(*self.q)) + self.mixed * x.position.x * w.y
        return Spectrum((jnp.where(x.face >= 0, value, 0.0),))


A, B = Wave((0.3, -0.1, 0.2), (0.1, 0.4, -0.2)), Wave((-0.2, 0.25, 0.1), (0.3, -0.3, 0.1), -0.3)


@functools.cache
def room():
    """Five diffuse walls of their own reflectances, a rough GGX wall, the ceiling lit."""
    bsdfs = {k: jaxrt.Diffuse(r, id=k) for k, r in RHO.items()} | {"front": jaxrt.Conductor(0.6, 0.0, 1.0, 0.9)}
    return box_room(bsdfs=bsdfs, emission={"ceiling": 1.0})


def started(scene, n=256, seed=0):
    """Points of the room's walls seen from inside, and the directions back."""
    o = np.random.default_rng(seed).uniform(-0.9, 0.9, (n, 3)).astype(np.float32)
    return o, sphere_directions(n, seed + 1).astype(np.float32)


@functools.partial(jax.jit, static_argnames=("make", "plan"))
def _evaluate(scene, o, d, seed, make, plan):
    """make(world) at (ψ(o, d), −d) with a sample stream for each ray, (N, C)."""
    world = prepare(scene, plan)
    L = make(world)

    def one(o, d, i):
        x = cast(world, Vec3.of(o), Vec3.of(d))
        return L(x, -Vec3.of(d), Stream(i, seed)).array()

    return jax.vmap(one)(o, d, jnp.arange(o.shape[0], dtype=jnp.uint32))


def evaluate(scene, make, o, d, seed=0, plan=None):
    return np.asarray(_evaluate(scene, o, d, jnp.uint32(seed), make, plan or jaxrt.plan(scene)))


def coarse(world):
    return jaxrt.QuadratureRule(world, 4, 8)


# --------------------------------------------------------------------------------------------------- G


def first_wall(o, d):
    """Where a ray from inside meets the cube [-1, 1]³."""
    with np.errstate(divide="ignore"):
        t = np.min((np.sign(d) - o) / d, axis=1)
    return o + t[:, None] * d


def _transported(world):
    return jaxrt.G(world)(A)


def test_g_is_what_psi_sees():
    """(G L)(x, ω) = L(ψ(x, ω), −ω): here x is a wall, ω looks back into the room."""
    o, d = started(room())
    got = evaluate(room(), _transported, o, d)[:, 0]
    x = first_wall(o.astype(np.float64), d.astype(np.float64))
    y = first_wall(x * (1 - 1e-9), -d.astype(np.float64))
    np.testing.assert_allclose(
        got, A.at(y, d.astype(np.float64)), atol=2e-5
    )  # a start 2e-6 off the wall, over a cosine


def _twice(world):
    G = jaxrt.G(world)
    return G(G(A))


def test_g_is_its_own_inverse():
    """G² = 1 where every ray lands on M: light goes back along the same segment."""
    o, d = started(room())
    x = first_wall(o.astype(np.float64), d.astype(np.float64))
    np.testing.assert_allclose(evaluate(room(), _twice, o, d)[:, 0], A.at(x, -d.astype(np.float64)), atol=5e-5)


# --------------------------------------------------------------------------------------------------- K


def _linear(world):
    K = jaxrt.K(world, jaxrt.BrdfRule(world, 4))  # random, but the same nodes for the same stream
    return Apart((K(sub(add(A, B), add(A, add(A, A)))), K(B), K(A)))  # B − 2A


class Apart(eqx.Module):
    """Several radiance functions at the same place, with the same stream, as channels."""

    parts: tuple

    def __call__(self, x, w, s):
        return Spectrum(tuple(c for f in self.parts for c in f(x, w, s).channels))


def test_k_is_linear():
    o, d = started(room())
    both, of_b, of_a = evaluate(room(), _linear, o, d, seed=3).T
    np.testing.assert_allclose(both, of_b - 2 * of_a, atol=2e-5)
    assert np.abs(of_a).min() > 0.05


def _reflections(world):
    one = Constant(1.0)
    return Apart((jaxrt.K(world, coarse(world))(one), jaxrt.K(world, jaxrt.BrdfRule(world, 16))(one)))


class Constant(eqx.Module):
    value: float

    def __call__(self, x, w, s=None):
        return Spectrum((jnp.where(x.face >= 0, self.value, 0.0) * jnp.ones_like(w.x),))


def test_k_of_a_constant_is_the_directional_albedo():
    o, d = started(room(), 256, 5)
    by_quadrature, by_samples = evaluate(room(), _reflections, o, d).T
    face = hits(room(), o, d).face
    for k, r in enumerate(RHO.values()):
        np.testing.assert_allclose(by_quadrature[face == k], r, rtol=1e-5)
        np.testing.assert_allclose(by_samples[face == k], r, rtol=1e-5)
    rough = face == 5
    assert rough.sum() > 20
    assert (by_samples[rough] <= 0.9 + 1e-5).all() and by_samples[rough].mean() > 0.5
    # 32 nodes for a lobe of α = .6, against 16 samples: alike in the mean.
    assert by_quadrature[rough].mean() == pytest.approx(by_samples[rough].mean(), abs=0.05)


# ------------------------------------------------------------------------------------ inner products


@functools.partial(jax.jit, static_argnames=("make", "plan", "n"))
def _products(scene, keys, make, plan, n):
    world = prepare(scene, plan)
    left, right = zip(*make(world), strict=True)
    return jax.vmap(lambda key: inner(world, Apart(left), Apart(right), key, n))(keys)


def products(make, scene, sets=12, n=2048):
    """Inner products of pairs of radiance functions: estimates (sets, pairs) with the same points for all pairs."""
    keys = jax.random.split(jax.random.key(7), sets)
    return np.asarray(_products(scene, keys, make, jaxrt.plan(scene), n), np.float64)


def _pairs(world):
    G, K = jaxrt.G(world), jaxrt.K(world, jaxrt.BrdfRule(world, 4))
    T = compose(K, G)
    # T A is random; inner gives its two sides numbers of their own, so that ⟨T A, T A⟩ is unbiased.
    yield from (
        (G(A), B),
        (A, G(B)),
        (K(A), B),
        (A, K(B)),
        (T(A), B),
        (A, adjoint(T)(B)),
        (A, T(B)),
        (T(A), T(A)),
        (A, A),
    )


@functools.cache
def pairs():
    return products(_pairs, room())


@pytest.mark.parametrize("operator, left, right", [("G", 0, 1), ("K", 2, 3), ("T and G K", 4, 5)])
def test_adjoints(operator, left, right):
    """⟨G a, b⟩ = ⟨a, G b⟩, ⟨K a, b⟩ = ⟨a, K b⟩, ⟨T a, b⟩ = ⟨a, T* b⟩ with T* = G K."""
    a, b = pairs()[:, left], pairs()[:, right]
    mean, error = mean_and_error(a - b)
    assert error < 0.01 * abs(a.mean())
    assert abs(mean) < 5 * error  # of 12 sets: a chance of 4e-4, were the sets normal


def test_t_is_not_its_own_adjoint():
    """The test functions tell T from T*: else the test above could not fail."""
    mean, error = mean_and_error(pairs()[:, 4] - pairs()[:, 6])
    assert abs(mean) > 10 * error


def test_the_bound_of_t():
    """‖T a‖ ≤ ρ ‖a‖ with the largest directional albedo, .9."""
    ta, a = pairs()[:, 7:].mean(0)
    assert 0.05 * a < ta < 0.81 * a


def test_adjoints_by_structure():
    world = world_of(room())
    G, K, T = jaxrt.G(world), jaxrt.K(world), jaxrt.T(world)
    assert adjoint(G) is G and adjoint(K) is K
    assert [type(o) for o in adjoint(T).operators] == [type(G), type(K)]
    assert [type(o) for o in adjoint(adjoint(T)).operators] == [type(K), type(G)]
    assert [type(o) for o in adjoint(compose(T, G)).operators] == [type(G), type(T)]


class On(eqx.Module):
    """A function of the points of one shape, 0 elsewhere."""

    faces: tuple[int, int]
    linear: bool = False

    def __call__(self, x, w, s=None):
        here = (x.face >= self.faces[0]) & (x.face < self.faces[1])
        value = x.position.x + 2.0 * x.position.y + 0.5 * dot(x.normal, w) if self.linear else jnp.ones_like(w.x)
        return Spectrum((jnp.where(here, value, 0.0),))


def test_the_measure_of_m():
    """⟨1, 1⟩ = 2π A over both sides of everything, exactly; and points are spread evenly over every kind of face."""
    parts = {  # area, and the mean of x + 2y
        "rectangle": (jaxrt.Rectangle(to_world=moved(2.0, (1, 2, 3))), 16.0, 5.0),
        "disk": (jaxrt.Disk(to_world=moved(2.0)), 4 * np.pi, 0.0),
        "sphere": (jaxrt.Sphere(center=(1, 2, 3), radius=0.8), 2.56 * np.pi, 5.0),
        "mesh": (jaxrt.Mesh(vertices=[[0, 0, 0], [2, 0, 0], [0, 3, 0]], faces=[[0, 1, 2]]), 3.0, 2 / 3 + 2.0),
        "cylinder": (jaxrt.Cylinder(p0=(1, 0, 0), p1=(1, 2, 0), radius=0.5), 2 * np.pi, 3.0),
    }
    scene = jaxrt.Scene.build([shape for shape, _, _ in parts.values()])
    at = {name: (start, stop) for name, _, start, stop in scene.structure.shapes}
    ranges = [at[name] for name in parts]
    one = On((0, scene.faces))

    def make(world):
        yield one, one
        for faces in ranges:
            yield On(faces), one
            yield On(faces, True), one

    got = products(make, scene)
    area = sum(a for _, a, _ in parts.values())
    np.testing.assert_allclose(got[:, 0], 2 * np.pi * area, rtol=1e-5)
    mean, error = mean_and_error(got[:, 1:])
    want = 2 * np.pi * np.array([v for _, a, m in parts.values() for v in (a, a * m)])  # ω·n is as often below 0
    stratum = 2 * np.pi * area / 2048  # the choice of a face is stratified: its share is a whole number of points
    assert (np.abs(mean - want) < 5 * error + stratum).all()
    assert (error < 0.01 * 2 * np.pi * area).all()


def test_the_norm_of_a_constant():
    squared = jax.jit(lambda world: norm(world, Constant(3.0), 0, 64))(world_of(room()))
    assert float(squared[0]) == pytest.approx(3 * np.sqrt(2 * np.pi * 24), rel=1e-5)


# ------------------------------------------------------------------------------------ composition, series


def test_composition_and_sums():
    o, d = started(room(), 8)

    def parts(world):
        K, G, zero = jaxrt.K(world), jaxrt.G(world), Zero(1)
        return Apart((compose(K, G)(A), K(G(A)), jaxrt.T(world)(A), compose()(A), sub(A, A), add(A, zero), A, zero))

    kg, nested, t, same, nothing, plus, a, zero = evaluate(room(), parts, o, d, seed=4).T
    np.testing.assert_array_equal(kg, nested)
    np.testing.assert_array_equal(kg, t)
    np.testing.assert_array_equal(same, a)
    np.testing.assert_array_equal(plus, a)
    np.testing.assert_array_equal(nothing, 0)
    np.testing.assert_array_equal(zero, 0)


@functools.cache
def furnace(rho=0.5):
    return box_room(rho, {k: 1.5 for k in WALLS})


def _literal(world):
    L0, T = jaxrt.emission(world), jaxrt.T(world)
    return add(L0, T(add(L0, T(add(L0, T(L0))))))


def test_the_notes_series_in_a_furnace():
    """L⁰ + T(L⁰ + T(L⁰ + …)), jitted and vmapped: Le (1 − ρⁿ⁺¹)/(1 − ρ) for every single sample."""
    o, d = started(furnace(), 512)
    np.testing.assert_allclose(evaluate(furnace(), _literal, o, d), 1.5 * (1 - 0.5**4) / (1 - 0.5), rtol=1e-5)


def test_neumann_nests_as_the_notes_do():
    world = world_of(furnace())
    L0, T = jaxrt.emission(world), jaxrt.T(world)
    assert eqx.tree_equal(neumann(L0, T, 3), _literal(world))
    assert neumann(L0, T, 0) is L0


def test_operators_are_pytrees():
    """They go through jit as arguments, so another scene of the same shapes uses the same program."""
    compiled = []

    @jax.jit
    def apply(operator, L, psi, w):
        compiled.append(1)
        return operator(L)(psi(jnp.zeros(3), w), -Vec3.of(w), Stream(jnp.uint32(1), jnp.uint32(2))).array()

    results = []
    for rho in (0.5, 0.25):
        world = world_of(furnace(rho))
        w = np.array([0.0, 0.6, 0.8], np.float32)
        results.append(float(apply(jaxrt.T(world), jaxrt.emission(world), jaxrt.psi(world), w)[0]))
    assert len(compiled) == 1
    np.testing.assert_allclose(results, [0.75, 0.375], rtol=1e-5)


def _exact_field(world):
    rest = Constant(1.5 * 0.5 / (1 - 0.5))
    return jaxrt.estimate(world, 1, rest)


def test_the_exact_field_leaves_no_variance():
    """With R̃ = R every sample of D + T R̃ − R̃ is 0 (directions drawn by cosine: no light samples here)."""
    o, d = started(furnace(), 256)
    plan = jaxrt.plan(furnace(), light_sampling=False)
    np.testing.assert_allclose(evaluate(furnace(), _exact_field, o, d, plan=plan), 3.0, rtol=1e-5)


# -------------------------------------------------------------------------- the series against the path method


@functools.cache
def mirrored():
    """A mirror for a floor, a diffuse ball over it, one lit wall, other walls of three reflectances."""
    bsdfs = {k: jaxrt.Diffuse(r, id=k) for k, r in RHO.items() if k != "floor"}
    bsdfs |= {"floor": jaxrt.Conductor(0.0, 0.2, 3.9), "front": jaxrt.Diffuse(0.8)}
    ball = jaxrt.Sphere(center=(0.2, 0.1, -0.3), radius=0.4, bsdf=jaxrt.Diffuse(0.6))
    return box_room(bsdfs=bsdfs, emission={"ceiling": 1.0}, others=[ball])


@functools.cache
def lit_cube():
    """A closed cube of ρ = .5 with one emitting face."""
    return box_room(0.5, {"ceiling": 1.0})


def unit(rows):
    return np.array(rows, np.float32) / np.linalg.norm(rows, axis=1, keepdims=True).astype(np.float32)


RAYS_OF = {  # floor and walls under the lit ceiling, the mirror, the ball
    lit_cube: ([(0.3, -0.4, 0.2)] * 3, unit([(-0.1, 0.3, -0.9), (0.9, 0.3, 0.3), (0.2, 0.9, 0.2)])),
    mirrored: ([(0.3, -0.8, 0.6)] * 3, unit([(-0.3, 0.2, -0.9), (-0.1, 0.9, -0.8), (0.6, 0.5, 0.1)])),
}


def by_path(scene, o, d, max_depth, spp=4096):
    """Radiance along rays and its standard error, by the path method."""
    out = [np.asarray(jaxrt.radiance(scene, o, d, k, spp=spp, max_depth=max_depth))[:, 0] for k in range(6)]
    return mean_and_error(out)


def _estimate(world):
    return jaxrt.estimate(world, 1)


@pytest.mark.parametrize("scene", [lit_cube, mirrored])
def test_estimate_is_the_path_method(scene):
    """estimate(scene, 1) has the mean of paths of depth 3: emission, direct light, and one bounce of it."""
    o, d = (np.array(a, np.float32) for a in RAYS_OF[scene])
    n = 4096
    many = evaluate(scene(), _estimate, np.repeat(o, n, 0), np.repeat(d, n, 0))[:, 0].reshape(3, n)
    mean, error = many.mean(1), many.std(1) / np.sqrt(n)
    path, path_error = by_path(scene(), o, d, 3)
    assert (path > 0.05).all()
    assert (error < 0.02 * path).all() or (error[error > 0] < 0.02 * path[error > 0]).all()
    assert (np.abs(mean - path) < 4.5 * np.hypot(error, path_error) + 1e-5).all()


def _quadrature(world, turn):
    L0, T = jaxrt.emission(world), jaxrt.T(world, jaxrt.QuadratureRule(world, 20, 40, turn))
    return neumann(L0, T, 2)


@functools.partial(jax.jit, static_argnames=("plan", "turn"))
def _by_quadrature(scene, o, d, plan, turn):
    world = prepare(scene, plan)
    L = _quadrature(world, turn)
    one = lambda ray: L(cast(world, Vec3.of(ray[0]), Vec3.of(ray[1])), -Vec3.of(ray[1]), None).array()
    return jax.lax.map(one, (o, d))


@functools.cache
def rough():
    """A GGX floor of α = .5 and a diffuse ball over it in a box with a lit ceiling: occlusion and gloss, no mirror."""
    bsdfs = {k: jaxrt.Diffuse(r, id=k) for k, r in RHO.items() if k != "floor"}
    bsdfs |= {"floor": jaxrt.Conductor(0.5, 0.2, 3.9), "front": jaxrt.Diffuse(0.8)}
    ball = jaxrt.Sphere(center=(0.2, 0.1, -0.3), radius=0.4, bsdf=jaxrt.Diffuse(0.6))
    return box_room(bsdfs=bsdfs, emission={"ceiling": 1.0}, others=[ball])


RAYS_OF[rough] = RAYS_OF[mirrored]


@pytest.mark.parametrize("scene", [lit_cube, rough])
def test_the_series_by_quadrature_is_the_path_method(scene):
    """L⁰ + T L⁰ + T² L⁰ by a deterministic rule is the mean of paths of depth 3."""
    o, d = (np.array(a, np.float32) for a in RAYS_OF[scene])
    plan = jaxrt.plan(scene())
    got = np.asarray(_by_quadrature(scene(), o, d, plan, 0.5))[:, 0]
    path, path_error = by_path(scene(), o, d, 3)
    # 800 nodes: the lit face's outline cuts some 60 of them, each in or out by half, which leaves √60/2/800 = 5e-3.
    assert (path_error < 3e-3 * path).all()
    np.testing.assert_allclose(got, path, rtol=1.5e-2)


def test_a_lamp_behind_another_one_does_not_count():
    """Light sampling in D must not take the radiance of the lamp in front for that of the one behind it."""
    shapes = [jaxrt.Rectangle(to_world=moved(5.0, (0, 0, 0)))]
    for z in (1.0, 2.0):
        shapes.append(jaxrt.Rectangle(emission=1.0, to_world=moved(1.0, (0, 0, z), frame((0, 0, -1), (1, 0, 0)))))
    scene = jaxrt.Scene.build(shapes)
    world = world_of(scene)

    @jax.jit
    def mean(world):
        x, up = jaxrt.psi(world)(jnp.asarray([0.0, 0, 0.5]), jnp.asarray([0.0, 0, -1])), Vec3(0.0, 0.0, 1.0)
        one = lambda i: jaxrt.D(world)(x, up, Stream(i, jnp.uint32(3))).array()
        return jax.vmap(one)(jnp.arange(8192, dtype=jnp.uint32)).mean()

    x = 1 / np.sqrt(2)  # on the axis of a square of half-side 1 at distance 1: F = 4/(2π) 2 X atan X
    want = 0.5 * 4 / np.pi * x * np.arctan(x)
    assert float(mean(world)) == pytest.approx(want, rel=5e-3)


def test_direct_light_is_differentiated_in_one_form():
    """d/dz of D under a lamp that rises, light and BRDF samples together: Lambert's formula."""
    lamp = moved(0.5, (0, 0, 1), frame((0, 0, -1), (1, 0, 0)))
    floor = jaxrt.Rectangle(to_world=moved(5.0, (0, 0, 0)), bsdf=jaxrt.Diffuse(0.5))
    scene = jaxrt.Scene.build([floor, jaxrt.Rectangle(id="lamp", emission=1.0, to_world=lamp)])

    @jax.jit
    def direct(z):
        pose = jnp.asarray(lamp, jnp.float32).at[2, 3].set(z)
        world = prepare(jaxrt.with_params(scene, {"lamp.to_world": pose}), jaxrt.plan(scene))
        x, up = jaxrt.psi(world)(jnp.asarray([0.0, 0, 0.5]), jnp.asarray([0.0, 0, -1])), Vec3(0.0, 0.0, 1.0)
        one = lambda i: jaxrt.D(world)(x, up, Stream(i, jnp.uint32(3))).array()
        return jax.vmap(one)(jnp.arange(8192, dtype=jnp.uint32)).mean()

    def exact(z):
        x = 0.5 / np.hypot(z, 0.5)
        return 0.5 * 4 / np.pi * x * np.arctan(x)

    assert float(jax.grad(direct)(1.0)) == pytest.approx((exact(1.001) - exact(0.999)) / 0.002, rel=0.01)


def test_a_ray_may_be_asked_for_what_hides_a_point():
    @jax.jit
    def answers(scene):
        psi, o, up = jaxrt.psi(scene), [0, 0, 0], [0, 0, 1]
        x = psi(o, up)
        hidden = [psi.occluded(o, up, factor * x.distance) for factor in (0.9, 1.1)]
        hidden.append(psi.occluded(o, up, 1.1 * x.distance, exclude=x.face))
        return hidden, x.face, psi(o, up, exclude=jnp.asarray([x.face, 77])).face

    hidden, face, behind = answers(furnace())
    assert [bool(h) for h in hidden] == [False, True, False]
    assert behind != face
