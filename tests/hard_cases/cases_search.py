"""Where rays land: self-hits, cracks, scale and place, frames, and faces that are none."""

from __future__ import annotations

import functools

import helpers
import jax
import jax.numpy as jnp
import numpy as np
from cases import Fact, plate

import jaxrt
from jaxrt.vector import Frame, Vec3


def searched(backend: str, shapes: list, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Faces that rays meet."""
    scene = jaxrt.Scene.build(shapes)
    return helpers.hits(scene, o, d, plan=jaxrt.plan(scene, backend=backend)).face


def ball(level: int, scale: float = 1.0, shift: float = 0.0, inwards: bool = False) -> jaxrt.Mesh:
    v, f = helpers.icosphere(level)
    return jaxrt.Mesh(vertices=v * scale + shift, faces=f[:, ::-1] if inwards else f, id="ball")


def leaks(backend: str, level: int, count: int) -> float:
    """Of rays from within an icosphere through its edges and vertices, those that escape."""
    v, f = helpers.icosphere(level)
    e = helpers.edges_of(f)
    random = np.random.default_rng(0)
    pick, t = e[random.integers(len(e), size=count)], random.random((count, 1))
    t[: count // 8] = 0.0  # vertices
    o = np.array([0.01, 0.02, 0.03])
    return float((searched(backend, [ball(level)], o, v[pick[:, 0]] * (1 - t) + v[pick[:, 1]] * t - o) < 0).sum())


def returns(backend: str, scale: float, shift: float) -> float:
    """Of rays that leave an icosphere outwards, those that meet it again."""
    d = helpers.sphere_directions(4096)
    scene = jaxrt.Scene.build([ball(2, scale, shift)])
    local = helpers.hemisphere_directions(4096, 1)
    plan = jaxrt.plan(scene, backend=backend)
    x, _, y = helpers.bounces(scene, shift + 3.0 * scale * d, -d, local, plan)
    return float((x.face < 0).sum() + (y.face >= 0).sum())


def junction(backend: str) -> float:
    """Rays onto a square whose halves meet in a T: one edge is two on the other side. Those that fall through."""
    v = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]])
    f = np.array([[0, 1, 4], [1, 2, 4], [0, 2, 3]])
    t = np.linspace(0.0, 1.0, 4096)[1:-1, None]
    mesh = jaxrt.Mesh(vertices=v, faces=f, id="floor")
    return float(
        (searched(backend, [mesh], np.array([0.3, 0.9, 1.0]), v[2] * t + v[0] * (1 - t) - [0.3, 0.9, 1.0]) < 0).sum()
    )


def sliver(backend: str) -> float:
    """Rays onto a triangle 1e6 times as long as wide, along its middle: those that miss."""
    v = np.array([[0.0, 0, 0], [1e3, 0, 0], [1e3, 1e-3, 0], [0, 1e-3, 0]])
    x = np.linspace(0.1, 999.0, 512)
    o = np.stack([x, np.full(512, 0.25e-3), np.full(512, 1.0)], 1)
    return float(
        (searched(backend, [jaxrt.Mesh(vertices=v, faces=np.array([[0, 1, 2], [0, 2, 3]]))], o, [0, 0, -1.0]) < 0).sum()
    )


def degenerate(backend: str) -> float:
    """Faces of no area, duplicates, inside-out ones and a vertex that is no number, which nobody uses: rays that do not
    land on the floor behind them."""
    v = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1], [0, 0, 1], [0.5, 0, 1], [np.nan] * 3])
    f = np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 1, 2], [4, 5, 6], [4, 4, 4], [4, 6, 5]])
    o = np.stack([*(a.ravel() for a in np.meshgrid(*[np.linspace(-0.9, 0.9, 21)] * 2)), np.full(441, 2.0)], 1)
    face = searched(backend, [jaxrt.Mesh(vertices=v, faces=f)], o, [0, 0, -1.0])
    return float(((face < 0) | (face > 3)).sum())


def frames() -> float:
    """How far frames about the poles and beside them are from orthonormal."""
    z = np.array([1.0, -1.0, -1.0 + 1e-7, -1.0 + 1e-6, 1.0 - 1e-7])
    n = np.stack([np.sqrt(np.maximum(1 - z * z, 0)), np.zeros(5), z], 1)
    real = jnp.result_type(float)

    def one(n: jax.Array) -> jax.Array:
        frame = Frame.around(Vec3.of(n))
        m = jnp.stack([frame.s.array(), frame.t.array(), frame.n.array()])
        return jnp.abs(jnp.matmul(m, m.T, precision="highest") - jnp.eye(3, dtype=m.dtype)).max()

    return float(jax.vmap(one)(jnp.asarray(n, real)).max())


def solid_angle(corners: np.ndarray, o: np.ndarray) -> float:
    """4π times the share of directions that a polygon covers, of 2²⁰."""
    d = helpers.sphere_directions(1 << 18, 5)
    n = len(corners)
    mesh = jaxrt.Mesh(vertices=corners, faces=np.array([[0, k, k + 1] for k in range(1, n - 1)]))
    return 4 * np.pi * float((searched("dense", [mesh], o, d) >= 0).mean())


def misses() -> float:
    """The largest value in the derivative, by all that a scene has, of a picture that sees nothing but the sky: by all
    but the sky it is 0, and nowhere infinite or no number."""
    v, f = helpers.icosphere(1)
    scene = jaxrt.Scene.build([jaxrt.Mesh(vertices=v, faces=f, id="ball")], enclosure=jaxrt.Enclosure(1.0))
    o = np.array([[3.0, 0, 0], [0, 3, 0]])

    def total(values: dict) -> jax.Array:
        return jaxrt.radiance(jaxrt.with_params(scene, values), o, [0, 0, 1.0], spp=4, max_depth=3).sum()

    found = jax.jit(jax.grad(total))({k: v for k, v in jaxrt.params(scene).items() if k != "enclosure.radiance"})
    return float(max(np.abs(np.nan_to_num(a, nan=np.inf)).max() for a in found.values()))


def camera_on_a_surface() -> float:
    """The one pixel of a camera that stands on a floor and looks up to a lamp of radiance 2; its near plane is off it."""
    floor, lamp = plate((0, 0, 0), [1, 0, 0], [0, 1, 0]), plate((0, 0, 1), [0, 1, 0], [1, 0, 0], emission=2.0)
    view = helpers.camera((0, 0, 0), (0, 0, 1), 1, 1, 10.0, up=(0, 1.0, 0))
    scene = jaxrt.Scene.build([floor, lamp], sensors=[view])
    return float(jaxrt.render(scene, 16, max_depth=1, method="path").image[0, 0, 0])


_SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
_sigma = lambda omega: 4.5 * np.sqrt(omega * (4 * np.pi - omega) / (1 << 18))
BACKENDS = ("dense", "bvh", "embree")

CASES = [
    *(Fact(f"rays from within an icosphere, {b}", functools.partial(leaks, b, 2 if b == "dense" else 4, 1 << 17), 0.0,
           "closed", quick=b != "embree", double=b != "embree") for b in BACKENDS),
    *(Fact(f"no ray meets the ball it left: scale {scale:g}, moved by {shift:g}, {b}", functools.partial(returns, b, scale, shift), 0.0,
           "convex", quick=b == "dense", double=b != "embree") for b in BACKENDS for scale, shift in ((1e-3, 0.0), (1.0, 0.0), (1e3, 0.0), (1.0, 1e4))),
    *(Fact(f"a T-junction, {b}", functools.partial(junction, b), 0.0, "closed", quick=True, double=b != "embree") for b in BACKENDS),
    *(Fact(f"a sliver of 1 to 1e6, {b}", functools.partial(sliver, b), 0.0, "on it", quick=b == "dense", double=b != "embree") for b in BACKENDS),
    *(Fact(f"faces without area, duplicates, inside out, {b}", functools.partial(degenerate, b), 0.0, "a floor behind them",
           quick=b == "dense", double=b != "embree") for b in BACKENDS),
    Fact("frames about the poles", frames, 0.0, "orthonormal", 1e-6, method="frame", quick=True),
    Fact("solid angle of a unit square at 1", functools.partial(solid_angle, _SQUARE, np.array([0, 0, 1.0])), 0.805431683,
         "radiometry", _sigma(0.8)),
    Fact("solid angle of a unit square at .5", functools.partial(solid_angle, _SQUARE, np.array([0, 0, 0.5])), 2 * np.pi / 3,
         "radiometry", _sigma(2.1)),
    Fact("solid angle of an octant", functools.partial(solid_angle, np.eye(3) * 1.0, np.zeros(3)), np.pi / 2, "Girard",
         _sigma(1.6)),
    Fact("a camera on a surface, one pixel", camera_on_a_surface, 2.0, "its radiance", 1e-5, method="path", quick=True),
    Fact("cotangents of rays that miss", misses, 0.0, "nothing is seen", method="path", quick=True),
]  # fmt: skip
