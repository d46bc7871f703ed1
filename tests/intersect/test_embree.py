"""The Embree backend's own matters: scenes by content, scenes let go, batches of geometries, no Embree at all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import icosphere, sphere_directions

import jaxrt
from jaxrt import intersect
from jaxrt.intersect import embree, embree_scene
from jaxrt.vector import Vec3

pytestmark = pytest.mark.skipif(intersect.refusal("embree") is not None, reason=str(intersect.refusal("embree")))


def ball(radius=1.0):
    v, f = icosphere(2)
    return jaxrt.Scene.build([jaxrt.Mesh(id="ball", vertices=radius * v, faces=f)])


def distance(vertices, o, d):
    """Distance along a ray to the ball with these vertices."""
    scene = ball()
    moved = jaxrt.with_params(scene, {"ball.vertices": vertices})
    psi = jaxrt.psi(jaxrt.world.world_of(moved, jaxrt.plan(scene, backend="embree")))
    return jax.vmap(lambda o, d: psi(Vec3.of(o), Vec3.of(d)).distance)(o, d)


START, W = np.zeros((64, 3), np.float32), sphere_directions(64).astype(np.float32)


def test_equal_geometry_is_built_once():
    plan = jaxrt.plan(ball(), backend="embree")
    tokens = [np.asarray(jaxrt.world.world_of(ball(r), plan).search.token) for r in (1.0, 1.0, 2.0)]
    np.testing.assert_array_equal(tokens[0], tokens[1])
    assert (tokens[0] != tokens[2]).any()


def test_vertices_move_under_jit_grad_and_vmap():
    v = jnp.asarray(ball().vertices[: len(icosphere(2)[0])])
    radii = jnp.asarray([1.0, 2.0, 0.5])
    many = jax.jit(jax.vmap(lambda r: distance(r * v, START, W)))(radii)
    np.testing.assert_allclose(many, np.asarray(radii)[:, None] * np.asarray(many[0]), rtol=1e-5)
    slope = jax.jit(jax.grad(lambda r: distance(r * v, START, W).mean()))(1.0)
    np.testing.assert_allclose(slope, many[0].mean(), rtol=1e-5)
    both = jax.vmap(lambda o: jax.vmap(lambda r: distance(r * v, o[None], W[:1])[0])(radii))(jnp.asarray(START[:3]))
    np.testing.assert_allclose(both, np.broadcast_to(many[:, 0], (3, 3)), rtol=1e-5)


def test_a_scene_that_was_let_go_is_an_error_not_a_crash(monkeypatch):
    plan = jaxrt.plan(ball(), backend="embree")
    cast = jax.jit(lambda world: jax.vmap(lambda o, d: jaxrt.psi(world)(Vec3.of(o), Vec3.of(d)).face)(START, W))
    world = jaxrt.world.world_of(ball(3.0), plan)
    assert (np.asarray(cast(world)) >= 0).all()
    monkeypatch.setattr(embree_scene, "BUDGET", 0)
    others = [jaxrt.world.world_of(ball(r), plan) for r in (4.0, 5.0, 6.0)]
    assert (np.asarray(cast(others[-1])) >= 0).all()
    with pytest.raises(Exception, match="let go"):
        jax.block_until_ready(cast(world))
    assert (np.asarray(cast(jaxrt.world.world_of(ball(3.0), plan))) >= 0).all()


def test_without_embree_there_is_a_tree(monkeypatch):
    monkeypatch.setattr(embree, "refusal", lambda: "embreex is not installed")
    v, f = icosphere(3)
    big = jaxrt.Scene.build([jaxrt.Mesh(vertices=v, faces=f)])
    plan = jaxrt.plan(big)
    assert plan.backend == "bvh" and "embreex is not installed" in str(plan)
    assert jaxrt.plan(ball()).backend == "dense"
    with pytest.raises(jaxrt.SceneError, match="embreex is not installed"):
        jaxrt.plan(big, backend="embree")
    with pytest.raises(jaxrt.SceneError, match="dense, bvh, embree"):
        jaxrt.plan(big, backend="octree")


def test_the_plan_takes_embree_from_many_faces_on():
    plan = jaxrt.plan(ball())
    assert plan.backend == "embree" and "rays:embree" in plan.effects


def test_one_call_of_many_rays_on_all_cores():
    """Calls from `MANY` rays on are shared among threads: the same faces as in small calls, also from several callers."""
    from concurrent.futures import ThreadPoolExecutor

    from jaxrt.intersect.embree_handler import MANY

    scene = ball()
    world = jaxrt.world.world_of(scene, jaxrt.plan(scene, backend="embree"))
    n = 2 * MANY + 77
    d = np.random.default_rng(0).normal(size=(3, n)).astype(np.float32)
    d /= np.linalg.norm(d, axis=0)
    o = np.where(np.arange(n) % 3, 0.0, 5.0).astype(np.float32)
    ask = jax.jit(lambda o, d: jax.vmap(lambda x, *d: cast_both(world, x, Vec3(*d)))(o, *d))
    parts = [np.asarray(ask(o[k : k + 1000], d[:, k : k + 1000])) for k in (0, MANY // 2, n - 1000)]
    with ThreadPoolExecutor(3) as pool:
        for whole in pool.map(lambda _: np.asarray(ask(o, d)), range(3)):
            for part, k in zip(parts, (0, MANY // 2, n - 1000), strict=True):
                np.testing.assert_array_equal(whole[k : k + 1000], part)
            assert (whole[np.arange(n) % 3 > 0, 0] >= 0).all() and (whole[:, 1] != 0).any()


def cast_both(world, x, d):
    o = Vec3(x, x * 0, x * 0)
    return jnp.stack([world.search.closest(o, d), world.search.occluded(o, d, 9.0, 0).astype(jnp.int32)])
