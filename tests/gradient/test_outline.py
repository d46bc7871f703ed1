"""Where edges lie before flat faces, against rays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrt
from jaxrt.gradient.edges import Cone, arc_of
from jaxrt.gradient.outline import Outline
from jaxrt.scene import in_working_precision
from jaxrt.vector import Vec3
from jaxrt.world import prepare


@pytest.mark.parametrize("kind", ["triangle", "parallelogram"])
def test_the_part_of_an_edge_before_a_face(kind):
    """Directions along 512 edges all around are in the range that is found, if and only if they meet the face."""
    vertices, faces = [[0.3, -0.2, 1.0], [1.2, 0.1, 1.3], [1.0, 0.9, 0.8], [0.1, 0.6, 0.5]], [[0, 1, 2]]
    face = jaxrt.Mesh(vertices=vertices[:3], faces=faces, emission=1.0)
    if kind == "parallelogram":
        face = jaxrt.Rectangle(
            to_world=np.array([[0.7, 0.1, 0, 0.5], [0.2, 0.6, 0, 0.4], [0.3, -0.2, 1, 0.9], [0, 0, 0, 1]]), emission=1.0
        )
    scene = in_working_precision(jaxrt.Scene.build([face]))
    world = prepare(scene, jaxrt.plan(scene))
    x, cone = Vec3(0.1, 0.2, -0.1), Cone(Vec3(0.0, 0.0, 1.0), 2.0)
    number = world.light_rows[0, 14 + world.plan.channels].astype(int)

    def one(p, q, shares):
        arc = arc_of((Vec3(*p), Vec3(*q)), x, None)
        low, high = arc.towards(Cone(cone.axis, cone.sine, Outline.of(world, number, x, world.plan.kinds)))
        phi = arc.half * (2 * shares - 1)
        hit = jax.vmap(lambda phi: world.search.closest(x, arc.direction(phi)) == number)(phi)
        near = jnp.minimum(jnp.abs(phi - low), jnp.abs(phi - high)) < 1e-3
        return hit, (phi > low) & (phi < high), near

    random = np.random.default_rng(1)
    ends = jnp.asarray(random.uniform(-1.5, 1.5, (2, 512, 3)), jnp.float32)
    shares = jnp.asarray(random.uniform(size=(512, 64)), jnp.float32)
    hit, inside, near = jax.vmap(one)(ends[0], ends[1], shares)
    assert hit.sum() > 300
    np.testing.assert_array_equal(hit[~near], inside[~near])
