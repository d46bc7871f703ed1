"""Scenes in closed form and jitted programs that tests share, so that each shape is compiled once."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import jaxrt
from jaxrt.casting import cast
from jaxrt.vector import Frame, Vec3
from jaxrt.world import prepare

UP = np.array([0.0, 0.0, 1.0])


def moved(scale=1.0, shift=(0.0, 0.0, 0.0), turn=None):
    """A 4x4 matrix: scale, then turn (a 3x3 rotation), then shift."""
    m = np.eye(4)
    m[:3, :3] = (np.eye(3) if turn is None else turn) * scale
    m[:3, 3] = shift
    return m


def rotation(seed):
    """A random rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def look_at(origin, target, up=(0.0, 0.0, 1.0)):
    """A camera's pose: +z of its own space towards the target, +y up, +x left."""
    forward = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    m = np.eye(4)
    m[:3, :3] = np.stack([left, np.cross(forward, left), forward], 1)
    m[:3, 3] = origin
    return m


def frame(n, along):
    """A rotation whose third column is n and whose first is the part of `along` across n."""
    n = np.asarray(n, float) / np.linalg.norm(n)
    s = np.asarray(along, float) - n * np.dot(n, along)
    s /= np.linalg.norm(s)
    return np.stack([s, np.cross(n, s), n], 1)


@functools.cache
def icosphere(level):
    """Vertices on the unit sphere and faces, counter-clockwise from outside."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=level)
    return np.array(mesh.vertices), np.array(mesh.faces)


def ball_of_distances(n, noise=0.0, radius=0.35):
    """Distances (n, n, n) from a sphere in the middle of the unit cube, a little above the middle in z."""
    z, y, x = np.meshgrid(*[np.linspace(0.0, 1.0, n)] * 3, indexing="ij")
    off = noise * np.random.default_rng(0).normal(size=(n, n, n))
    return np.sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.55) ** 2) - radius + off


def edges_of(faces):
    return np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1), axis=0)


def camera(origin, target, width=8, height=8, fov=40.0, up=(0.0, 0.0, 1.0), **more):
    film = jaxrt.Film(width, height, "box")
    return jaxrt.Sensor(to_world=look_at(origin, target, up), fov=fov, film=film, **more)


WALLS = {  # outwards normals of the cube [-1, 1]³
    "floor": (0, 0, -1),
    "ceiling": (0, 0, 1),
    "left": (-1, 0, 0),
    "right": (1, 0, 0),
    "back": (0, -1, 0),
    "front": (0, 1, 0),
}


def wall(name, **more):
    """One face of the room [-1, 1]³, facing inwards."""
    n = np.array(WALLS[name], float)
    along = np.roll(n, 1)
    return jaxrt.Rectangle(id=name, to_world=moved(1.0, n, frame(-n, along)), **more)


def box_room(bsdf=0.5, emission=(), bsdfs=None, others=(), **parts):
    """The closed room [-1, 1]³ of six rectangles. `emission`, `bsdfs`: by wall; `bsdf`: a reflectance, or a BSDF."""
    common = bsdf if not isinstance(bsdf, (int, float, list, tuple)) else jaxrt.Diffuse(bsdf, id="wall")
    emission = dict(emission)
    walls = [wall(k, bsdf=(bsdfs or {}).get(k, common), emission=emission.get(k)) for k in WALLS]
    parts.setdefault("sensors", [camera((0.3, -0.4, 0.2), (-0.5, 0.6, -0.3), 8, 8, 70.0)])
    return jaxrt.Scene.build([*walls, *others], **parts)


# --------------------------------------------------------------------------------------- programs


_prepare = jax.jit(prepare, static_argnames="plan")


def world_of(scene, plan=None):
    """The scene's tables in world space."""
    return _prepare(scene, plan=plan or jaxrt.plan(scene))


search: dict = {}  # `backend="..."` for a test that goes through all of them, see intersect/test_search.py


@functools.partial(jax.jit, static_argnames="plan")
def _cast(scene, o, d, plan, exclude):
    world = prepare(scene, plan)
    return jax.vmap(lambda o, d, e: cast(world, Vec3.of(o), Vec3.of(d), e))(o, d, exclude)


def hits(scene, o, d, exclude=None, plan=None):
    """ψ from points along directions, (N, 3) each: a `SurfacePoint` with numpy leaves."""
    o, d = (np.asarray(a, jnp.result_type(float)) for a in np.broadcast_arrays(o, d))
    x = _cast(scene, o, d, plan or jaxrt.plan(scene, **search), exclude)
    return jax.tree.map(np.asarray, x)


@functools.partial(jax.jit, static_argnames="plan")
def _bounce(scene, o, d, local, plan):
    world = prepare(scene, plan)

    def one(o, d, v):
        x = cast(world, Vec3.of(o), Vec3.of(d))
        w = Frame.around(x.normal).to_world(Vec3.of(v))
        return x, w, cast(world, x, w)

    return jax.vmap(one)(o, d, local)


def bounces(scene, o, d, local, plan=None):
    """First hits x, directions w with local coordinates `local` about x's normal, and what x sees along w."""
    o, d, local = (np.asarray(a, jnp.result_type(float)) for a in np.broadcast_arrays(o, d, local))
    return jax.tree.map(np.asarray, _bounce(scene, o, d, local, plan or jaxrt.plan(scene, **search)))


@functools.partial(jax.jit, static_argnames="plan")
def _occluded(scene, o, d, distance, exclude, plan):
    search = prepare(scene, plan).search
    return jax.vmap(lambda o, d, t, e: search.occluded(Vec3.of(o), Vec3.of(d), t, e))(o, d, distance, exclude)


def occluded(scene, o, d, distance, exclude=None):
    o, d = (np.asarray(a, np.float32) for a in np.broadcast_arrays(o, d))
    distance = np.broadcast_to(np.asarray(distance, np.float32), o.shape[:1])
    return np.asarray(_occluded(scene, o, d, distance, exclude, jaxrt.plan(scene, **search)))


@functools.partial(jax.jit, static_argnames=("plan", "spp", "max_depth", "rr_depth"))
def picture(scene, key, plan, spp=16, max_depth=None, rr_depth=1000):
    """`jaxrt.measure`, compiled once for scenes that share a plan."""
    return jaxrt.measure(scene, key, plan=plan, spp=spp, max_depth=max_depth, rr_depth=rr_depth)


def sphere_directions(n, seed=0):
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def hemisphere_directions(n, seed=0):
    """Cosine-distributed local directions."""
    u, v = np.random.default_rng(seed).random((2, n))
    return np.stack([np.sqrt(u) * np.cos(2 * np.pi * v), np.sqrt(u) * np.sin(2 * np.pi * v), np.sqrt(1 - u)], -1)


def z_of(values, stderr, want):
    """Standard scores of estimates against what they should be."""
    return (np.asarray(values, np.float64) - want) / np.asarray(stderr, np.float64)


def mean_and_error(batches):
    """Mean over the first axis of independent estimates, and its standard error."""
    batches = np.asarray(batches, np.float64)
    return batches.mean(0), batches.std(0, ddof=1) / np.sqrt(len(batches))


def assert_same_picture(peer, sols, most):
    """Pictures of a peer, by seed, and solutions of as many seeds: each value within 4.5 of its standard error (nearly
    all), the mean within that of its own, which is at most `most` of it."""
    theirs, their_error = mean_and_error(peer)
    ours = np.mean([s.image.astype(np.float64) for s in sols], 0)
    our_error = np.sqrt(np.mean([s.stderr.astype(np.float64) ** 2 for s in sols], 0) / len(sols))
    rounding = 1e-5 * theirs + 1e-6 * theirs.mean()
    z = (ours - theirs) / np.sqrt(our_error**2 + their_error**2 + rounding**2)
    assert (np.abs(z) < 4.5).mean() > 0.9975
    means = np.mean(peer, (1, 2, 3)), [s.image.mean(dtype=np.float64) for s in sols]
    spread = np.hypot(*(mean_and_error(m)[1] for m in means))
    assert spread < most * theirs.mean()  # or the next line says nothing
    assert abs(ours.mean() - theirs.mean()) < 4.5 * spread + 1e-4 * theirs.mean()


def uniform_numbers(n, seed=0):
    return jnp.asarray(np.random.default_rng(seed).random((n, 2)).astype(np.float32))
