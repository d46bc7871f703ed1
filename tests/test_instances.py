"""Groups and their instances against the same shapes written out; what is stored once; what is refused."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera, frame, hits, icosphere, moved, rotation, world_of

import jaxrt
from jaxrt import Group, Instance
from jaxrt.casting import Psi, cast
from jaxrt.world import prepare

BACKENDS = ["dense", "bvh", "embree"]
SQUASHED = moved(np.array([0.5, 0.7, 0.3])[:, None], (-1.0, 0.2, 0.1), rotation(1))
MIRRORED = moved(0.4, (0.8, 0.3, -0.2), rotation(2) @ np.diag([1.0, 1.0, -1.0]))
PLACES = [SQUASHED, MIRRORED, moved(0.3, (0.1, 0.0, 0.9))]


def group(level=2):
    v, f = icosphere(level)
    ball = jaxrt.Mesh(id="ball", vertices=v, faces=f, normals=v, bsdf=jaxrt.TwoSided(jaxrt.Diffuse([0.7, 0.4, 0.2])))
    tilt = moved(1.2, (0.0, 0.0, -0.4), rotation(4))
    plate = jaxrt.Mesh(
        id="plate",
        vertices=[[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]],
        faces=[[0, 1, 2], [0, 2, 3]],
        uvs=[[0, 0], [1, 0], [1, 1], [0, 1]],
        to_world=tilt,
        bsdf=jaxrt.TwoSided(jaxrt.Conductor(alpha=[0.1, 0.4])),
    )
    return Group(id="toy", shapes=[ball, plate])


def scenes(places=PLACES, level=2, **parts):
    """The same scene with instances and written out, with a floor and a lamp that are not in the group."""
    toy = group(level)
    others = [
        jaxrt.Rectangle(id="floor", to_world=moved(3.0, (0.0, 0.0, -1.2))),
        jaxrt.Sphere(id="lamp", center=(1.0, 1.0, 3.0), radius=0.3, emission=[20.0, 18.0, 15.0]),
    ]
    instances = [Instance(id="toy", group=toy, to_world=m) for m in places]
    written = [shape for instance in instances for shape in instance.written_out()]
    parts.setdefault("enclosure", jaxrt.Enclosure([0.1, 0.2, 0.3]))
    return jaxrt.Scene.build([*others, *instances], **parts), jaxrt.Scene.build([*others, *written], **parts)


@functools.cache
def pair():
    return scenes()


def rays(n=4000):
    rng = np.random.default_rng(0)
    o = rng.normal(size=(n, 3))
    o *= 3.0 / np.linalg.norm(o, axis=1)[:, None]
    d = rng.uniform([-1.5, -0.5, -1.0], [1.2, 0.7, 1.2], (n, 3)) - o
    return o, d / np.linalg.norm(d, axis=1)[:, None]


def none_of(o):
    """No face to skip, for each ray."""
    return np.full(len(o), -1, np.int32)


def columns(v):
    return np.stack([np.asarray(c) for c in v], 1)


@pytest.mark.parametrize("backend", BACKENDS)
def test_hits_are_those_of_shapes_written_out(backend):
    one, other = pair()
    o, d = rays()
    plan = lambda s: jaxrt.plan(s, backend=backend)
    a, b = (hits(s, o, d, none_of(o), plan=plan(s)) for s in (one, other))
    missed = (a.face < 0) & (b.face < 0)
    same = ~missed & np.isclose(a.distance, b.distance, atol=1e-4)
    assert (same | missed).mean() > 0.999  # but for rays at silhouettes
    within = same & (a.face >= one.faces)
    assert within.sum() > 1000
    np.testing.assert_array_equal(a.finish[same], b.finish[same])
    assert np.percentile(np.abs(columns(a.position) - columns(b.position))[within], 99.9) < 2e-4
    place = ((a.face - one.faces) // 322)[within]
    for name in ("normal", "shading"):
        got, want = (columns(getattr(x, name))[within] for x in (a, b))
        off = np.abs(got - want).max(1)  # instances interpolate before they are squashed
        assert np.percentile(off[place > 0] if name == "shading" else off, 99) < 2e-4 and off.max() < 0.1
    along = lambda x: columns(x.tangent) / np.linalg.norm(columns(x.tangent), axis=1)[:, None]
    plates = within & ((a.face - one.faces) % 322 >= 320)
    assert plates.sum() > 50
    np.testing.assert_allclose(along(a)[plates], along(b)[plates], atol=1e-4)


def test_backends_name_the_same_faces_and_skip_them():
    scene = pair()[0]
    o, d = rays()
    faces = [hits(scene, o, d, none_of(o), plan=jaxrt.plan(scene, backend=b)).face for b in BACKENDS]
    assert max((f != faces[0]).mean() for f in faces) < 1e-3
    behind = [hits(scene, o, d, faces[0], plan=jaxrt.plan(scene, backend=b)).face for b in BACKENDS]
    met = faces[0] >= 0
    for f in behind:
        assert (f != behind[0]).mean() < 1e-3
        assert not (f == faces[0])[met].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_shadow_rays_meet_instances(backend):
    scene = pair()[0]
    psi = Psi(world_of(scene, jaxrt.plan(scene, backend=backend)))
    o, d = (jnp.asarray(a[:512], jnp.float32) for a in rays())
    first = jax.jit(jax.vmap(psi))(o, d)
    far = jnp.where(jnp.isfinite(first.distance), first.distance, 9.0)
    blocked = jax.jit(jax.vmap(psi.occluded))
    assert (np.asarray(blocked(o, d, far * 1.001)) == np.isfinite(np.asarray(first.distance))).all()
    assert not np.asarray(blocked(o, d, far * 0.999)).any()


def test_pictures_are_those_of_shapes_written_out(short_loops):
    one, other = scenes([MIRRORED, PLACES[2]], level=1, sensors=[camera((0, -4, 1), (0, 0, 0), 24, 18, 45.0)])
    a, b = (jaxrt.render(s, 16, 0, max_depth=4).image for s in (one, other))
    close = np.abs(a - b) < 1e-3 * (1 + b)  # a path that rounding sends elsewhere counts for little
    assert close.mean() > 0.98
    np.testing.assert_allclose(a.mean((0, 1)), b.mean((0, 1)), rtol=5e-3)


def test_triangles_are_stored_once():
    few, many = (scenes([moved(0.1, (0.3 * k, 0, 0)) for k in range(n)], level=3)[0] for n in (1, 40))
    assert many.triangles.shape == few.triangles.shape == (1536, 3)
    assert world_of(many, jaxrt.plan(many, backend="embree")).faces.shape[0] == few.faces + 1
    assert "40 of 51280 triangles" in str(jaxrt.plan(many))
    assert jaxrt.plan(many).backend == "embree" and jaxrt.plan(scenes(level=0)[0]).backend == "dense"


@pytest.mark.parametrize("backend", BACKENDS)
def test_derivatives_of_places_are_those_of_meshes_written_out(backend):
    """The distance along rays changes with an instance's transform as with that of a mesh."""
    v, f = icosphere(1)
    ball = jaxrt.Mesh(id="ball", vertices=v, faces=f)
    one = jaxrt.Scene.build([Instance(id="toy", group=Group(shapes=[ball]), to_world=SQUASHED)])
    other = jaxrt.Scene.build([dataclasses.replace(ball, id="toy", to_world=SQUASHED)])
    o = np.array([-1.0, -4.0, 0.1]) + 0.1 * np.random.default_rng(0).normal(size=(16, 3))
    d = np.tile([0.0, 1.0, 0.0], (16, 1))

    def moves(scene):
        plan = jaxrt.plan(scene, backend=backend)

        def distance(m):
            world = prepare(jaxrt.with_params(scene, {"toy.to_world": m}), plan)
            at = lambda o, d: cast(world, jaxrt.Vec3(*o), jaxrt.Vec3(*d))
            x = jax.vmap(at)(jnp.asarray(o, jnp.float32), jnp.asarray(d, jnp.float32))
            return x.distance + x.shading.x

        return np.asarray(jax.jit(jax.jacfwd(distance))(jnp.asarray(SQUASHED, jnp.float32)))

    want = moves(other)
    assert np.abs(want[:, :3]).max() > 1
    np.testing.assert_allclose(moves(one)[:, :3], want[:, :3], atol=2e-3 * np.abs(want).max())


def test_moved_instances_need_no_new_program():
    scene = pair()[0]
    plan = jaxrt.plan(scene, backend="embree")
    traces = []

    @jax.jit
    def seen(m):
        traces.append(0)
        world = prepare(jaxrt.with_params(scene, {"toy.to_world": m}), plan)
        look = lambda x: cast(world, jaxrt.Vec3(x, -4.0, 0.0), jaxrt.Vec3(0.0, 1.0, 0.0)).face
        return jax.vmap(look)(jnp.linspace(-3, 3, 64))

    at = lambda x: moved(0.5, (x, 0.0, 0.0)).astype(np.float32)
    count = lambda found: ((found >= scene.faces) & (found < scene.faces + 322)).nonzero()[0].mean()
    left, right = count(np.asarray(seen(at(-2.4)))), count(np.asarray(seen(at(2.4))))
    assert left < 16 and right > 48 and len(traces) == 1
    both = np.asarray(jax.vmap(seen)(jnp.stack([at(-2.4), at(2.4)])))
    np.testing.assert_array_equal(both, [np.asarray(seen(at(x))) for x in (-2.4, 2.4)])


def test_cubes_and_rectangles_in_a_group():
    """They become triangles that face the same way, also under a mirror."""
    turned = moved(0.6, (0.1, 0.2, 0.3), frame([1, 2, 3], [1, 0, 0]))
    for m in (turned, turned @ np.diag([1.0, -1.0, 1.0, 1.0])):
        shapes = [jaxrt.Cube(to_world=m), jaxrt.Rectangle(to_world=moved(2.0, (0, 0, -2.0)))]
        one = jaxrt.Scene.build([Instance(group=Group(shapes=shapes))])
        other = jaxrt.Scene.build(shapes)
        a, b = (hits(s, *rays(500), plan=jaxrt.plan(s, backend="dense")) for s in (one, other))
        met = b.face >= 0
        np.testing.assert_array_equal(a.face >= 0, met)
        np.testing.assert_allclose(columns(a.normal)[met], columns(b.normal)[met], atol=1e-5)


@pytest.mark.slow
def test_groups_of_curved_shapes_are_written_out():
    """Each shape is one of the scene then, with its own transform; a mesh beside it faces as in an instance."""
    ball, toy = jaxrt.Sphere(id="ball", radius=0.3, center=(0, 0, 2)), group(level=1)
    mixed = Group(id="toy", shapes=[ball, *toy.shapes])
    scene = jaxrt.Scene.build([Instance(id=f"toy_{k}", group=mixed, to_world=m) for k, m in enumerate(PLACES[1:])])
    assert not jaxrt.plan(scene).instances
    assert {"ball.to_world", "ball_1.to_world"} <= set(jaxrt.params(scene)) and "toy_0.to_world" not in jaxrt.params(
        scene
    )
    only = jaxrt.Scene.build([Instance(group=toy, to_world=m) for m in PLACES[1:]])
    o, d = rays(1000)
    a, b = (hits(s, o, d, plan=jaxrt.plan(s, backend="dense")) for s in (scene, only))
    same = (b.face >= 0) & np.isclose(a.distance, b.distance, atol=1e-4)
    assert same.sum() > 100
    np.testing.assert_allclose(columns(a.normal)[same], columns(b.normal)[same], atol=1e-4)
    np.testing.assert_allclose(columns(a.shading)[same], columns(b.shading)[same], atol=1e-3)
    for m in PLACES[1:]:
        middle = (m @ [0, 0, 2, 1])[:3]
        x = hits(scene, middle + 4 * d[:64], -d[:64], plan=jaxrt.plan(scene, backend="dense"))
        off = np.linalg.norm(columns(x.position) - middle, axis=1)
        met = np.isclose(off, 0.3 * np.cbrt(abs(np.linalg.det(m[:3, :3]))), atol=1e-5) & (
            x.face >= scene.offset("sphere")
        )
        assert met.mean() > 0.8  # but where something else stands before it


def test_what_cannot_be_an_instance_is_refused():
    v, f = icosphere(0)
    with pytest.raises(jaxrt.SceneError, match=r"toy.lamp: emits; take it out"):
        Group(id="toy", shapes=[jaxrt.Mesh(id="lamp", vertices=v, faces=f, emission=1.0)])
    with pytest.raises(jaxrt.SceneError, match=r"toy.inner: cannot be in a group"):
        Group(id="toy", shapes=[Group(id="inner", shapes=[jaxrt.Sphere()])])
    with pytest.raises(jaxrt.SceneError, match=r"ball.to_world: scales unevenly"):
        Instance(group=Group(shapes=[jaxrt.Sphere(id="ball")]), to_world=SQUASHED)
    with pytest.raises(jaxrt.SceneError, match="toy: has no shapes"):
        Group(id="toy", shapes=[])
    with pytest.raises(jaxrt.SceneError, match=r"toy.to_world: is singular"):
        Instance(id="toy", group=group(), to_world=np.zeros((4, 4)) + np.diag([0, 0, 0, 1.0]))
    with pytest.raises(jaxrt.SceneError, match=r"toy.group: is not a Group"):
        Instance(id="toy", group=jaxrt.Mesh(vertices=v, faces=f))
    with pytest.raises(jaxrt.SceneError, match=r"toy: is not in the scene by itself"):
        jaxrt.Scene.build([group()])
    late = group()
    late.shapes[0].emission = np.ones(1)
    with pytest.raises(jaxrt.SceneError, match=r"toy.ball: emits"):
        jaxrt.Scene.build([Instance(group=late)])
    with pytest.raises(ValueError, match="instances are not supported"):
        jax.eval_shape(lambda scene: jaxrt.norm(scene, jaxrt.emission(scene)), pair()[0])


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_groups_of_any_size_stay_exact_away_from_the_origin(backend, scale):
    """A group modelled `scale` times smaller and enlarged by its place, in a scene that is off the origin."""
    v, f = icosphere(2)
    shift = np.array([0.3, -0.2, 0.5]) / scale
    ball = jaxrt.Mesh(id="ball", vertices=v / scale + 40 * shift, faces=f)
    place = moved(scale, (7.0, 5.0, 3.0)) @ moved(1.0, -40 * shift)
    scene = jaxrt.Scene.build([Instance(group=Group(shapes=[ball]), to_world=place), wall_at(11.0)])
    o, d = rays(1000)
    x = hits(scene, 0.5 * o + [7.0, 5.0, 3.0], -o / 3.0, plan=jaxrt.plan(scene, backend=backend))
    assert (x.face >= scene.faces).all()
    center = columns(x.position) - [7.0, 5.0, 3.0]
    np.testing.assert_allclose(np.linalg.norm(center, axis=1), 0.99, atol=0.011)  # between a face and its corners
    depth = (columns(x.normal) * center).sum(1)
    n = np.cross(v[f][:, 1] - v[f][:, 0], v[f][:, 2] - v[f][:, 0])
    planes = np.abs((n / np.linalg.norm(n, axis=1)[:, None] * v[f][:, 0]).sum(1))
    np.testing.assert_allclose(depth, planes[x.face - scene.faces], atol=4e-6)


def wall_at(x):
    return jaxrt.Rectangle(to_world=moved(0.5, (x, 5.0, 3.0)))
