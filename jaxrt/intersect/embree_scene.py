"""Embree's library and its scenes, built on the host once for each content and known by the address of a record."""

from __future__ import annotations

import collections
import ctypes
import functools
import hashlib
import importlib.metadata
import os
import threading
import time
from typing import Any

import numpy as np

from ..compiler import cores

ROBUST, FILTERED = 4, 8  # RTC_SCENE_FLAG_ROBUST and _FILTER_FUNCTION_IN_ARGUMENTS
TRIANGLE, INSTANCE = 0, 121  # RTC_GEOMETRY_TYPE_*
INDEX, VERTEX = 0, 1  # RTC_BUFFER_TYPE_INDEX and _VERTEX
UINT3, FLOAT3, FLOAT3X4 = 0x5003, 0x9003, 0x9134  # RTC_FORMAT_*, matrices by rows
FACE_BYTES = 250  # Embree's own share of a face, about
BUDGET = 1 << 30  # bytes that scenes may take together; the two last ones stay in any case
GRACE = 30.0  # seconds after which nothing can still be tracing a scene that was let go
GONE = b"the search structure of this geometry was let go; make the scene's psi or world again"


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


class _Kept:
    """A scene of Embree's with its record; the record stays for good, so that a late ray finds `alive` 0."""

    def __init__(self, scene: int, faces: int, record: np.ndarray):
        self.scene, self.bytes, self.record, self.let_go = scene, faces * FACE_BYTES, record, 0.0


_scenes: collections.OrderedDict[bytes, _Kept] = collections.OrderedDict()
_records: list[Any] = []
_leaving: list[_Kept] = []
_lock = threading.Lock()


def token(triangles: Any, quads: Any, counts: Any, rows: Any, *copies: Any) -> np.ndarray:
    """The address of the record of a scene with these corners, (T, 3, 3) and (Q, 4, 3), of which `counts` are used.

    `rows`: of the tables, behind which the numbers of instances start. `copies`: the groups (first triangle, how
    many), the group of each instance, −1 for none, and its matrix.
    """
    triangles, quads, counts = np.asarray(triangles), np.asarray(quads), np.asarray(counts)
    ranges, group, places = map(np.asarray, copies or (np.zeros((0, 2), int), np.zeros(0, int), np.zeros((0, 12))))
    groups = [np.ascontiguousarray(triangles[a : a + n]) for a, n in ranges]
    used = [np.ascontiguousarray(a[:n]) for a, n in zip((triangles, quads), counts, strict=True)]
    content = hashlib.blake2b(np.asarray([len(triangles), int(rows), *counts], np.int64).tobytes(), digest_size=16)
    for a in (*used, *groups, *map(np.ascontiguousarray, (ranges, group, places))):
        content.update(a.data)
    with _lock:
        kept = _scenes.get(content.digest())
        if kept is None:
            kept = _build(used[0], used[1], len(triangles), int(rows), groups, group, places)
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
    group: np.ndarray,
    places: np.ndarray,
) -> _Kept:
    """Quads go in as two triangles each: a second kind of geometry would be a second search for every ray."""
    from .embree_handler import PACKET, RECORD, keep, share

    library, count = _library(), len(triangles)
    triangles = np.concatenate([triangles, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 3)])
    scene = _scene()
    _mesh(scene, triangles)
    inner = [_scene() for _ in groups]
    for within, corners in zip(inner, groups, strict=True):
        _mesh(within, corners)
        library.rtcCommitScene(within)
    for k in np.flatnonzero(group >= 0):
        geometry = library.rtcNewGeometry(_device(), INSTANCE)
        library.rtcSetGeometryInstancedScene(geometry, inner[group[k]])
        library.rtcSetGeometryTransform(geometry, 0, FLOAT3X4, np.ascontiguousarray(places[k]).ctypes.data)
        _attach(scene, geometry, int(k) + 1)
    library.rtcCommitScene(scene)
    for within in inner:
        library.rtcReleaseScene(within)  # the instances hold it
    address = lambda f: ctypes.cast(f, ctypes.c_void_p).value or 0
    system = ctypes.CDLL(None) if os.name == "posix" else None
    message = ctypes.create_string_buffer(GONE)
    sizes = [len(groups[g]) if g >= 0 else 0 for g in group]
    starts = rows + np.cumsum([0, *sizes]).astype(np.int64)
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
    return _Kept(scene, len(triangles) + sum(map(len, groups)) + 4 * len(group), record)
