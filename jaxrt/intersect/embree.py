"""The Embree backend: many triangles and parallelograms on a CPU in float32. Other kinds go to the dense tests.

Embree comes inside the embreex package. A scene is built on the host once for each content of its vertices, by one
callback a call of `measure`, and known to compiled programs by a token, the address of its record. Rays go to it
through an XLA call that `embree_handler` compiles. Faces reach out by the tolerance like those of every backend.

Incoherent closest hits in icospheres of 320 / 5k / 82k / 1.3M triangles, one jitted call on two cores: 14 / 12 / 6.4 /
1.9 Mrays/s, Mitsuba 3 (robust) in the same run 17 / 12 / 6.6 / 1.8. Where numba is missing the tree in JAX takes over,
not embreex's own interface, which knows neither faces to skip nor robust scenes.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from ..vector import Vec3
from .batch import in_a_row
from .dense import Dense, affine, flat_columns, several
from .embree_scene import token as scene_token
from .faces import Faces


class Embree(eqx.Module):
    """Search over the faces (origin, e₁, e₂) of a scene; `token` is the address of Embree's scene in two words."""

    token: UInt32[Array, " 2"]
    rest: Dense
    center: Float[Array, " 3"]
    least: Float[Array, ""]

    @classmethod
    def build(cls, faces: Faces) -> Embree:
        """Builds Embree's scene in a callback, so it works under jit, grad and vmap.

        Faces of groups reach out by what is the tolerance in the world where their smallest instance stands.
        """
        geometry, blocks, instances = faces.geometry, faces.blocks, faces.instances
        o, a, b = geometry[:, :3], geometry[:, 3:6], geometry[:, 6:9]
        reach = faces.epsilon if instances is None else faces.epsilon / instances.smallest_scale()
        s = flat_columns(faces.maps, reach)[:, 12:]
        at = lambda f, g: o + a * f + b * g
        t, q = slice(0, blocks[0]), slice(blocks[0], sum(blocks[:2]))
        triangles = jnp.stack([at(-s, -s), at(1 + 2 * s, -s), at(-s, 1 + 2 * s)], 1)[t]
        quads = jnp.stack([at(-s, -s), at(1 + s, -s), at(1 + s, 1 + s), at(-s, 1 + s)], 1)[q]
        shape = jax.ShapeDtypeStruct((2,), jnp.uint32)
        arrays = [triangles.astype(jnp.float32), quads.astype(jnp.float32), faces.counts[:2], jnp.int32(sum(blocks))]
        if instances is not None:
            arrays += [instances.groups, instances.group, instances.to_world[:-1].astype(jnp.float32)]
        token = jax.pure_callback(scene_token, shape, *jax.lax.stop_gradient(arrays), vmap_method="sequential")
        return cls(token, Dense.build(faces, first_kind=2), faces.center, -0.5 * faces.epsilon)

    def closest(self, o: Vec3, d: Vec3, exclude: Any = None) -> Any:
        """Number of the first face along the ray, −1 if none. `exclude`: faces to skip, one or several numbers."""
        t, face = self._search("closest", o, d, jnp.full_like(d.x, jnp.inf), exclude)
        if sum(self.rest.blocks[2:]) == 0:
            return face
        return self.rest.closest(o, d, exclude, (jnp.where(face < 0, jnp.inf, t + self.least), face))

    def occluded(self, o: Vec3, d: Vec3, distance: Any, exclude: Any = None) -> Any:
        """Whether any face but the excluded ones lies before `distance` (m)."""
        distance = jax.lax.stop_gradient(distance)
        far = jnp.where(distance > 0, distance - self.least, 0.0)
        found = self._search("occluded", o, d, far, exclude)[0] != 0
        if sum(self.rest.blocks[2:]) == 0:
            return found
        return found | self.rest.occluded(o, d, distance, exclude)

    def _search(self, query: str, o: Vec3, d: Vec3, far: Any, exclude: Any) -> Any:
        start()
        o = o - Vec3(*self.center) + d * self.least  # Embree counts distances from 0, we from `least`
        rays = [jnp.asarray(c, jnp.float32).reshape(1) for c in (*o, *d, far)]
        rays += [jnp.asarray(e, jnp.int32).reshape(1) for e in several(exclude)]
        return [a[0] for a in _queries(query)(*jax.lax.stop_gradient((self.token, rays)))]


@functools.cache
def _queries(query: str) -> Any:
    """The XLA call of one query, of n rays: whether any face is met, or distance and number of the first one."""
    kinds = {"closest": (jnp.float32, jnp.int32), "occluded": (jnp.int32,)}[query]

    def call(token: Any, rays: Any) -> Any:
        results = [jax.ShapeDtypeStruct(rays[0].shape, kind) for kind in kinds]
        return jax.ffi.ffi_call(f"jaxrt_embree_{query}", results)(token, *rays)

    return in_a_row(call)


@functools.cache
def start() -> None:
    """Makes the compiled functions known to XLA, once a process."""
    from . import embree_handler

    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype, capsule.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    for name in ("closest", "occluded"):
        address = getattr(embree_handler, name).address
        jax.ffi.register_ffi_target(f"jaxrt_embree_{name}", capsule(address, None, None), platform="cpu")


def _probe(geometry: Any) -> Any:
    """What three rays meet of one triangle: its number twice, and nothing."""
    maps = affine(geometry[:, :3], geometry[:, 3:6], geometry[:, 6:9])
    counts = jnp.asarray([1, 0, 0, 0, 0, 0], jnp.int32)
    center, epsilon = jnp.zeros(3, jnp.float32), jnp.float32(1e-6)
    search = Embree.build(Faces(geometry, maps, counts, center, epsilon, (1, 0, 0, 0, 0, 0)))
    o = Vec3(jnp.asarray([0.2, 0.7, 0.2], jnp.float32), jnp.full(3, 0.2), jnp.zeros(3))
    return jax.vmap(search.closest)(o, Vec3(jnp.zeros(3), jnp.zeros(3), jnp.asarray([1.0, 1.0, -1.0])))


@functools.cache
def refusal() -> str | None:
    """Why this backend cannot be used here, or None: what is missing, or what a test ray did."""
    for package in ("embreex", "numba"):
        if importlib.util.find_spec(package) is None:
            return f"{package} is not installed"
    try:
        faces = jax.jit(_probe)(np.array([[0.0, 0, 1, 1, 0, 0, 0, 1, 0]], np.float32))
        return None if faces.tolist() == [0, 0, -1] else f"a test ray met the wrong face: {faces.tolist()}"
    except Exception as error:  # whatever a foreign library does, there is another backend
        return " ".join(f"{type(error).__name__}: {error}".split())
