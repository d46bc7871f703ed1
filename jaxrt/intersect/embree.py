"""The Embree backend: many triangles and parallelograms on a CPU in float32. Other kinds go to the dense tests.

Embree comes inside the embreex package. A scene is built on the host once for each content of its vertices, by one
callback a call of `measure`, and known to compiled programs by a token, the address of its record. Rays go to it
through an XLA call that `embree_handler` compiles. Faces reach out by the tolerance like those of every backend.
"""

from __future__ import annotations

import collections
import ctypes
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import threading
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from ..compiler import cores
from ..instances import Instances
from ..vector import Vec3
from .batch import in_a_row
from .dense import Dense, affine, flat_columns, several

ROBUST, FILTERED = 4, 8  # RTC_SCENE_FLAG_ROBUST and _FILTER_FUNCTION_IN_ARGUMENTS
TRIANGLE, INSTANCE = 0, 121  # RTC_GEOMETRY_TYPE_*
INDEX, VERTEX = 0, 1  # RTC_BUFFER_TYPE_INDEX and _VERTEX
UINT3, FLOAT3, FLOAT3X4 = 0x5003, 0x9003, 0x9134  # RTC_FORMAT_*, matrices by rows
FACE_BYTES = 250  # Embree's own share of a face, about
BUDGET = 1 << 30  # bytes that scenes may take together; the two last ones stay in any case
GRACE = 30.0  # seconds after which nothing can still be tracing a scene that was let go
GONE = b"the search structure of this geometry was let go; make the scene's psi or world again"


class Embree(eqx.Module):
    """Search over the faces (origin, e₁, e₂) of a scene; `token` is the address of Embree's scene in two words."""

    token: UInt32[Array, " 2"]
    rest: Dense
    center: Float[Array, " 3"]
    least: Float[Array, ""]

    @classmethod
    def build(
        cls,
        geometry: Any,
        maps: Any,
        counts: Any,
        blocks: tuple[int, ...],
        center: Any,
        epsilon: Any,
        copies: tuple[Instances, Any] | None = None,
    ) -> Embree:
        """As `Dense.build`; builds Embree's scene in a callback, so it works under jit, grad and vmap.

        `copies`: instances, about the centre, and their groups, in which faces reach out by the same in the world.
        """
        o, a, b = geometry[:, :3] - center[None], geometry[:, 3:6], geometry[:, 6:9]
        reach = epsilon if copies is None else epsilon / copies[0].smallest_scale(copies[1])
        s = flat_columns(maps, reach)[:, 12:]
        at = lambda f, g: o + a * f + b * g
        t, q = slice(0, blocks[0]), slice(blocks[0], sum(blocks[:2]))
        triangles = jnp.stack([at(-s, -s), at(1 + 2 * s, -s), at(-s, 1 + 2 * s)], 1)[t]
        quads = jnp.stack([at(-s, -s), at(1 + s, -s), at(1 + s, 1 + s), at(-s, 1 + s)], 1)[q]
        shape = jax.ShapeDtypeStruct((2,), jnp.uint32)
        rest = Dense.build(geometry, maps, counts, blocks, center, epsilon, first_kind=2)
        arrays = [triangles.astype(jnp.float32), quads.astype(jnp.float32), counts[:2], jnp.int32(sum(blocks))]
        if copies is not None:
            instances, _ = copies
            arrays += [instances.first, instances.counts, instances.to_world[:-1].astype(jnp.float32)]
        token = jax.pure_callback(_token, shape, *jax.lax.stop_gradient(arrays), vmap_method="sequential")
        return cls(token, rest, center, -0.5 * epsilon)

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


# ------------------------------------------------------------------------------------------ the library


@functools.cache
def _library() -> Any:
    """Embree's C interface with its signatures. Raises where embreex is missing."""
    files = importlib.metadata.files("embreex") or ()
    path = next((str(f.locate()) for f in files if "embree4" in f.name), None)
    if path is None:
        raise ImportError("embreex has no Embree library inside")
    library, pointer, word = ctypes.CDLL(path), ctypes.c_void_p, ctypes.c_uint
    number, size = ctypes.c_int, ctypes.c_size_t
    for name, result, *arguments in (
        ("rtcNewDevice", pointer, ctypes.c_char_p),
        ("rtcNewScene", pointer, pointer),
        ("rtcSetSceneFlags", None, pointer, number),
        ("rtcNewGeometry", pointer, pointer, number),
        ("rtcSetNewGeometryBuffer", pointer, pointer, number, word, number, size, size),
        ("rtcSetGeometryInstancedScene", None, pointer, pointer),
        ("rtcSetGeometryTransform", None, pointer, word, number, pointer),
        ("rtcCommitGeometry", None, pointer),
        ("rtcAttachGeometryByID", None, pointer, pointer, word),
        ("rtcReleaseGeometry", None, pointer),
        ("rtcCommitScene", None, pointer),
        ("rtcReleaseScene", None, pointer),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


@functools.cache
def _device() -> int:
    device = _library().rtcNewDevice(b"")
    if not device:
        raise OSError("Embree does not start on this processor")
    return device


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
    counts = jnp.asarray([1, 0, 0, 0, 0], jnp.int32)
    search = Embree.build(geometry, maps, counts, (1, 0, 0, 0, 0), jnp.zeros(3, jnp.float32), jnp.float32(1e-6))
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


# ------------------------------------------------------------------------------------------- scenes by content


class _Kept:
    """A scene of Embree's with its record; the record stays for good, so that a late ray finds `alive` 0."""

    def __init__(self, scene: int, faces: int, record: np.ndarray):
        self.scene, self.bytes, self.record, self.let_go = scene, faces * FACE_BYTES, record, 0.0


_scenes: collections.OrderedDict[bytes, _Kept] = collections.OrderedDict()
_records: list[Any] = []
_leaving: list[_Kept] = []
_lock = threading.Lock()


def _token(triangles: Any, quads: Any, counts: Any, rows: Any, *copies: Any) -> np.ndarray:
    """The address of the record of a scene with these corners, (T, 3, 3) and (Q, 4, 3), of which `counts` are used.

    `rows`: of the tables, behind which the numbers of instances start. `copies`: the first triangle of each
    instance, how many it has, and its matrix.
    """
    triangles, quads, counts = np.asarray(triangles), np.asarray(quads), np.asarray(counts)
    first, sizes, places = map(np.asarray, copies or (np.zeros(0, int), np.zeros(0, int), np.zeros((0, 12))))
    groups = [np.ascontiguousarray(triangles[a : a + n]) for a, n in sorted(set(zip(first, sizes, strict=True))) if n]
    used = [np.ascontiguousarray(a[:n]) for a, n in zip((triangles, quads), counts, strict=True)]
    content = hashlib.blake2b(np.asarray([len(triangles), int(rows), *counts], np.int64).tobytes(), digest_size=16)
    for a in (*used, *groups, *map(np.ascontiguousarray, (first, sizes, places))):
        content.update(a.data)
    with _lock:
        kept = _scenes.get(content.digest())
        if kept is None:
            kept = _build(used[0], used[1], len(triangles), int(rows), groups, first, sizes, places)
            _scenes[content.digest()] = kept
            _let_go()
        _scenes.move_to_end(content.digest())
    return np.array([kept.record.ctypes.data], np.int64).view(np.uint32)


def _let_go() -> None:
    """Least recently used scenes go while all take more than the budget; their memory a little later."""
    from .embree_handler import ALIVE

    while len(_scenes) > 2 and sum(k.bytes for k in _scenes.values()) > BUDGET:
        kept = _scenes.popitem(last=False)[1]
        kept.record[ALIVE], kept.let_go = 0, time.monotonic()
        _leaving.append(kept)
    for kept in [k for k in _leaving if time.monotonic() - k.let_go > GRACE]:
        _library().rtcReleaseScene(kept.scene)
        _leaving.remove(kept)


def _mesh(scene: int, corners: np.ndarray) -> None:
    """Adds triangles (n, 3, 3) to a scene, as its first geometry."""
    library = _library()
    geometry = library.rtcNewGeometry(_device(), TRIANGLE)
    numbers = np.arange(3 * len(corners), dtype=np.uint32)
    for use, form, values in ((VERTEX, FLOAT3, corners), (INDEX, UINT3, numbers)):
        place = library.rtcSetNewGeometryBuffer(geometry, use, 0, form, 12, values.nbytes // 12)
        ctypes.memmove(place, values.ctypes.data, values.nbytes)
    _attach(scene, geometry, 0)


def _attach(scene: int, geometry: int, number: int) -> None:
    library = _library()
    library.rtcCommitGeometry(geometry)
    library.rtcAttachGeometryByID(scene, geometry, number)
    library.rtcReleaseGeometry(geometry)


def _scene() -> int:
    scene = _library().rtcNewScene(_device())
    _library().rtcSetSceneFlags(scene, ROBUST | FILTERED)
    return scene


def _build(
    triangles: np.ndarray,
    quads: np.ndarray,
    first_quad: int,
    rows: int,
    groups: list[np.ndarray],
    first: np.ndarray,
    sizes: np.ndarray,
    places: np.ndarray,
) -> _Kept:
    """Quads go in as two triangles each: a second kind of geometry would be a second search for every ray."""
    from .embree_handler import PACKET, RECORD, keep, share

    library, count = _library(), len(triangles)
    triangles = np.concatenate([triangles, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 3)])
    scene = _scene()
    _mesh(scene, triangles)
    inner = {}
    for key, corners in zip([k for k in sorted(set(zip(first, sizes, strict=True))) if k[1]], groups, strict=True):
        inner[key] = _scene()
        _mesh(inner[key], corners)
        library.rtcCommitScene(inner[key])
    for k, key in enumerate(zip(first, sizes, strict=True)):
        if key in inner:
            geometry = library.rtcNewGeometry(_device(), INSTANCE)
            library.rtcSetGeometryInstancedScene(geometry, inner[key])
            library.rtcSetGeometryTransform(geometry, 0, FLOAT3X4, np.ascontiguousarray(places[k]).ctypes.data)
            _attach(scene, geometry, k + 1)
    library.rtcCommitScene(scene)
    for group in inner.values():
        library.rtcReleaseScene(group)  # the instances hold it
    address = lambda f: ctypes.cast(f, ctypes.c_void_p).value or 0
    system = ctypes.CDLL(None) if os.name == "posix" else None
    message = ctypes.create_string_buffer(GONE)
    starts = rows + np.cumsum(np.concatenate([[0], sizes])).astype(np.int64)
    words = {
        "scene": scene,
        "closest": address(getattr(library, f"rtcIntersect{PACKET}")),
        "occluded": address(getattr(library, f"rtcOccluded{PACKET}")),
        "filter": keep.address,
        "triangles": count,
        "first_quad": first_quad,
        "instances": starts.ctypes.data,
        "alive": 1,
        "message": ctypes.addressof(message),
        "cores": cores() if system else 1,
        "spawn": address(system.pthread_create) if system else 0,
        "join": address(system.pthread_join) if system else 0,
        "share": share.address,
    }
    record = np.array([words[name] for name in RECORD], np.int64)
    _records.append((record, message, starts))
    return _Kept(scene, len(triangles) + sum(map(len, groups)) + 4 * len(first), record)
