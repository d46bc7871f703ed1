"""Grids of signed distances: roots, rays that leave, derivatives, and what they cost scenes without them."""

import helpers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ball_of_distances, hits, icosphere, moved, occluded, rotation, sphere_directions

import jaxrt
from jaxrt.casting import cast
from jaxrt.intersect import refusal
from jaxrt.surface import is_diffuse, shading_at
from jaxrt.vector import Vec3
from jaxrt.world import face_areas, prepare

pytestmark = pytest.mark.usefixtures("short_loops")

SQUEEZED = moved(np.array([0.9, 1.7, 1.2]), (0.3, -0.2, 0.5), rotation(3))


def rays_at(to_world, n, seed=0):
    """Rays from around and within a cube towards places in it."""
    rng = np.random.default_rng(seed)
    o = 0.5 + 3.0 * sphere_directions(n, seed)
    o[: n // 4] = rng.random((n // 4, 3))
    world = lambda p: p @ to_world[:3, :3].T + to_world[:3, 3]
    o, d = world(o), world(rng.random((n, 3)))
    d = (d - o) / np.linalg.norm(d - o, axis=1)[:, None]
    return o.astype(np.float32), d.astype(np.float32)


def interpolated(grid, p):
    """Value and gradient of the trilinear interpolant at p (N, 3) in the unit cube, in float64."""
    n = np.array(grid.shape[::-1]) - 1
    q = p * n
    cell = np.clip(np.floor(q).astype(int), 0, n - 1)
    f = q - cell
    value, gradient = 0.0, np.zeros_like(q)
    for corner in np.ndindex(2, 2, 2):
        x, y, z = (cell + corner).T
        share, sign = np.where(corner, f, 1 - f), np.where(corner, 1.0, -1.0)
        value = value + grid[z, y, x] * share.prod(1)
        for a in range(3):
            gradient[:, a] += grid[z, y, x] * sign[a] * np.delete(share, a, 1).prod(1) * n[a]
    return value, gradient


@pytest.mark.parametrize("backend", ["bvh", "embree"])
def test_first_root_of_the_interpolant(backend):
    """In float64, by the interpolant's sign at many places along each ray; beside a mesh, and an instance of one."""
    if (why := refusal(backend)) is not None:
        pytest.skip(why)
    vertices, faces = icosphere(1)
    ball = jaxrt.Mesh(vertices=vertices * 0.2, faces=faces)
    grid = np.random.default_rng(1).normal(size=(5, 7, 6))
    shapes = [
        jaxrt.SdfGrid(grid=ball_of_distances(3), to_world=moved(1.0, (9, 0, 0))),
        jaxrt.Mesh(vertices=vertices * 0.2, faces=faces, to_world=moved(1.0, (0, 9, 0))),
        jaxrt.Instance(group=jaxrt.Group(shapes=[ball]), to_world=moved(1.0, (-9, 0, 0))),
        jaxrt.SdfGrid(grid=grid, to_world=SQUEEZED),
    ]
    scene = jaxrt.Scene.build(shapes)
    o, d = rays_at(SQUEEZED, 300)
    plan = jaxrt.plan(scene, backend=backend)
    x = hits(scene, o, d, plan=plan)
    inverse = np.linalg.inv(SQUEEZED)
    local = lambda p: p @ inverse[:3, :3].T + inverse[:3, 3]
    t = np.linspace(0, 8, 2001)
    negative, within = [], []
    for a, b in zip(o.astype(float), d.astype(float), strict=True):
        p = local(a + t[:, None] * b)
        within.append(((p >= 0) & (p <= 1)).all(1))
        negative.append(interpolated(grid, np.clip(p, 0, 1))[0] < 0)
    negative, within = np.array(negative), np.array(within)
    change = (negative[:, 1:] != negative[:, :-1]) & within[:, 1:] & within[:, :-1]
    want = np.where(change.any(1), t[change.argmax(1)], np.inf)
    near = (x.distance >= want - 1e-5) & (x.distance <= want + 4e-3 + 1e-5)
    same = near | (np.isinf(want) & (x.face < 0))
    earlier = x.distance < want  # two roots between neighbouring places, which steps of 4 mm may miss
    assert same.mean() > 0.95
    assert (same | earlier).all()
    met = x.face >= 0
    p = local(np.stack(list(x.position), 1)[met])
    value, gradient = interpolated(grid, p)
    n = gradient @ inverse[:3, :3]
    steep = np.linalg.norm(n, axis=1)
    assert (np.abs(value) / steep).max() < 5e-6  # m from the surface
    off = np.abs(n / steep[:, None] - np.stack(list(x.normal), 1)[met]).max(1)
    assert np.quantile(off, 0.99) < 1e-4  # but for points at borders of voxels
    if backend == "embree":
        assert (occluded(scene, o, d, 100.0) == met).all()


def test_rays_that_leave_do_not_come_back():
    """From points of a convex grid outwards nothing is met, however flat the ray; inwards the other side is."""
    n = 16
    z, y, x = np.meshgrid(*[np.linspace(-1.0, 1.0, n)] * 3, indexing="ij")
    scene = jaxrt.Scene.build([jaxrt.SdfGrid(grid=x + 2 * y + 0.5 * z, to_world=moved(40.0, (300.0, 5.0, -20.0)))])
    o, d = rays_at(moved(40.0, (300.0, 5.0, -20.0)), 1000)
    u, v = np.random.default_rng(2).random((2, 1000))
    local = np.stack([np.sqrt(1 - u**4) * np.cos(7 * v), np.sqrt(1 - u**4) * np.sin(7 * v), u**2], 1)
    plan = jaxrt.plan(scene)
    x, w, y = helpers.bounces(scene, o, d, local, plan=plan)
    met = x.face >= 0
    assert met.mean() > 0.4
    plane = np.array([1, 2, 0.5]) / np.linalg.norm([1, 2, 0.5])
    np.testing.assert_allclose(np.stack(list(x.normal), 1)[met], np.broadcast_to(plane, (met.sum(), 3)), atol=1e-5)
    middle = moved(40.0, (300.0, 5.0, -20.0))[:3, 3] + 20.0
    want = ((middle - o) @ plane) / (d @ plane)
    np.testing.assert_allclose(x.distance[met], want[met], rtol=1e-5, atol=1e-4)
    assert (y.face[met] < 0).all()


def test_derivatives_of_hits_against_differences():
    """Distance, position and both normals by samples, transform, origin: in float64, forward and reverse."""
    with jax.enable_x64(True):
        scene = jaxrt.Scene.build([jaxrt.SdfGrid(id="ball", grid=ball_of_distances(5, 0.03), to_world=SQUEEZED)])
        o, d = (jnp.asarray(a, float) for a in rays_at(SQUEEZED, 24))
        plan, start = jaxrt.plan(scene, free=()), jaxrt.params(scene)
        rng = np.random.default_rng(0)
        to_world = 0.2 * np.pad(rng.normal(size=(3, 4)), ((0, 1), (0, 0)))
        change = {"ball.grid": jnp.asarray(rng.normal(size=(5, 5, 5))), "ball.to_world": jnp.asarray(to_world)}

        @jax.jit
        def found(step):
            values = {name: start[name] + step * v for name, v in change.items()}
            world = prepare(jaxrt.with_params(scene, values), plan)
            x = jax.vmap(lambda o, d: cast(world, Vec3.of(o) + Vec3(0.1, 0.2, 0.3) * step, Vec3.of(d)))(o, d)
            there = x.face >= 0
            values = [jnp.where(there, x.distance, 0.0), *x.position, *x.normal, *x.shading]
            return jnp.stack([jnp.where(there, v, 0.0) for v in values], 1)

        ours = jax.jvp(found, (0.0,), (1.0,))[1]
        h = 1e-6
        want = (found(h) - found(-h)) / (2 * h)
        there = np.asarray(found(0.0)[:, 0] > 0)
        assert there.sum() > 8
        np.testing.assert_allclose(ours, want, rtol=1e-5, atol=1e-6)
        weight = jnp.asarray(rng.normal(size=ours.shape))
        back = jax.jit(jax.grad(lambda step: (found(step) * weight).sum()))(0.0)
        np.testing.assert_allclose(back, (ours * weight).sum(), rtol=1e-9)


def test_fields_leave_grids_to_paths():
    """For they have no area, and none of their points counts as diffuse."""
    wall = jaxrt.Rectangle(to_world=moved(2.0), bsdf=jaxrt.Diffuse(0.5, id="wall"))
    grid = jaxrt.SdfGrid(id="ball", grid=ball_of_distances(6), to_world=moved(1.0, (-0.5, -0.5, 0.5)))
    scene = jaxrt.Scene.build([wall, grid])
    world = helpers.world_of(scene)
    areas = face_areas(world.geometry, world.blocks)
    assert areas[scene.offset("sdfgrid") :].sum() == 0 < areas.sum()

    def diffuse(o, d):
        x = cast(world, Vec3.of(o), Vec3.of(d))
        return x.face, is_diffuse(world, shading_at(world, x, -Vec3.of(d)))

    # Along an axis, within voxels, at their borders and beside the grid.
    o = np.array([[0.0, 0, 3], [0.1, 0.1, 3], [1.5, 1.5, 3]], np.float32)
    d = np.broadcast_to(np.float32([0, 0, -1]), o.shape)
    face, there = jax.jit(jax.vmap(diffuse))(o, d)
    assert face.tolist() == [scene.offset("sdfgrid")] * 2 + [0]
    assert there.tolist() == [False, False, True]
    with pytest.raises(ValueError, match="grids of distances are not supported"):
        jaxrt.inner(scene, jaxrt.emission(scene), jaxrt.emission(scene))


def test_scenes_without_grids_do_not_trace_them(monkeypatch):
    from jaxrt import grids, surface
    from jaxrt.intersect import dense

    def none(*_):
        raise AssertionError("traced")

    for module in (dense, surface):
        monkeypatch.setattr(module, "meet", none)
    monkeypatch.setattr(grids.Grids, "of", none)
    scene = helpers.box_room(0.5, emission={"ceiling": 1.0}, others=[jaxrt.Sphere(radius=0.2), jaxrt.Cylinder()])
    plan = jaxrt.plan(scene)
    jax.jit(lambda scene: jaxrt.measure(scene, jax.random.key(0), plan=plan, spp=1)).lower(scene)
    with pytest.raises(AssertionError, match="traced"):
        helpers.world_of(jaxrt.Scene.build([jaxrt.SdfGrid(grid=ball_of_distances(4))]))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"grid": np.zeros((3, 1, 3))}, r"ball.grid: has shape \(3, 1, 3\); give"),
        ({"grid": np.ones((3, 3, 3))}, "ball.grid: has samples of one sign only"),
        ({"grid": np.full((3, 3, 3), np.nan)}, "ball.grid: has a sample that is not finite"),
        ({"emission": 1.0}, "ball: emits, which a grid of distances cannot"),
    ],
)
def test_mistakes_are_named(change, problem):
    with pytest.raises(jaxrt.SceneError, match=problem):
        jaxrt.SdfGrid(**({"id": "ball", "grid": ball_of_distances(4)} | change))
