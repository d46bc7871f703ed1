"""The compiled side of the Embree backend: XLA calls it with a batch of rays, it calls Embree a packet at a time.

XLA's foreign function interface wants a C function. numba makes one here without a compiler at hand and without
Python's lock. Scenes come as the address of a record of int64 words (`RECORD`), so nothing of one process
is compiled in, and numba may keep the machine code from run to run.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

RECORD = (
    *("scene", "closest", "occluded", "filter", "triangles", "first_quad", "instances", "alive", "message"),
    *("cores", "spawn", "join", "share"),
)
"""Words of a scene's record: Embree's scene, its functions, our filter, how many of Embree's triangles are
triangles of ours (the others are halves of quads), the number of our first quad, the table of the first number of
each instance, whether the scene still exists, the text of the error where it does not; and for calls of many rays
the number of cores, `pthread_create`, `pthread_join` and what each thread does."""
SCENE, CLOSEST, OCCLUDED, FILTER, TRIANGLES, FIRST_QUAD, INSTANCES, ALIVE, MESSAGE = range(9)
CORES, SPAWN, JOIN, SHARE = range(9, 13)

MANY = 1 << 15
"""Rays from which a call takes threads of its own; programs of a picture, one a core, stay below."""

PACKET = 8
"""Rays that Embree takes at once: 131 ns for both queries of a bounce in a room with a mesh of 69k triangles,
against 195 ns one by one, 143 by four and 156 by sixteen. Sorting them by direction and place gained nothing."""

RAY, HIT = 12, 9  # words of a ray and of a hit; a packet holds `PACKET` of each word in turn
TFAR, MASK, ID, PRIMITIVE, INSTANCE = 8, 9, 10, 17, 19  # distance, mask, the lane it belongs to, what was met
FILTER_BY_ARGUMENT = 2  # RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER
FAILED_PRECONDITION = 9  # XLA_FFI_Error_Code


@intrinsic
def _pointer(typing: Any, address: Any) -> Any:
    """An address as what `carray` takes."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), code


def _calls(result: Any, count: int) -> Any:
    """call(f, ...): calls the function at address f with `count` pointers."""
    word = ir.IntType(64)

    @intrinsic
    def call(typing: Any, f: Any, arguments: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.FunctionType(word if result is types.int64 else ir.VoidType(), [word] * count)
            pointers = [builder.extract_value(args[1], j) for j in range(count)]
            value = builder.call(builder.inttoptr(args[0], kind.as_pointer()), pointers)
            return value if result is types.int64 else context.get_dummy_value()

        return result(types.int64, types.UniTuple(types.int64, count)), code

    return call


query, report = _calls(types.void, 4), _calls(types.int64, 1)
start, wait = _calls(types.int64, 4), _calls(types.int64, 2)


@numba.njit(nogil=True, cache=True)
def _words(address: int, count: int) -> Any:
    return carray(_pointer(address), count, np.int64)  # pyright: ignore[reportCallIssue]


@numba.njit(nogil=True, cache=True)
def _integers(address: int, count: int) -> Any:
    return carray(_pointer(address), count, np.int32)  # pyright: ignore[reportCallIssue]


@numba.njit(nogil=True, cache=True)
def _floats(address: int, count: int) -> Any:
    return carray(_pointer(address), count, np.float32)  # pyright: ignore[reportCallIssue]


@numba.njit(nogil=True, cache=True)
def _data(buffers: int, k: int) -> int:
    """Address of the numbers in buffer k of a call."""
    return _words(_words(buffers, k + 1)[k], 4)[3]


@numba.njit(nogil=True, cache=True)
def _size(buffers: int, k: int) -> int:
    """How many numbers there are in buffer k."""
    buffer = _words(_words(buffers, k + 1)[k], 6)
    size = 1
    for extent in _words(buffer[5], buffer[4]):
        size *= extent
    return size


@numba.njit(nogil=True, cache=True)
def _face(record: Any, primitive: int, instance: int) -> int:
    """Our number of the face to which a triangle of Embree's belongs. Instances are geometries 1, 2, ... of a scene."""
    if instance > 0:
        return _words(record[INSTANCES], instance)[instance - 1] + primitive
    if primitive < record[TRIANGLES]:
        return primitive
    return record[FIRST_QUAD] + (primitive - record[TRIANGLES]) // 2


@numba.njit(nogil=True, cache=True)
def _keep(arguments: int) -> None:
    """Embree's filter: refuses hits on the faces that a ray excludes. Its context: record, buffers, how many."""
    given = _words(arguments, 6)
    n = given[5] & 0xFFFFFFFF
    valid, lanes, hit = _integers(given[0], n), _integers(given[3] + 4 * ID * n, n), given[4]
    primitives, instances = _integers(hit + 4 * (PRIMITIVE - RAY) * n, n), _integers(hit + 4 * (INSTANCE - RAY) * n, n)
    _, record, buffers, excluded = _words(given[2], 4)
    for j in range(n):
        if valid[j] != 0:
            face = _face(_words(record, len(RECORD)), primitives[j], instances[j])
            for k in range(excluded):
                if _integers(_data(buffers, 8 + k), lanes[j] + 1)[lanes[j]] == face:
                    valid[j] = 0


@numba.njit(nogil=True, cache=True)
def _trace(token: int, buffers: int, excluded: int, results: int, occluded: bool, begin: int, n: int) -> None:
    """Traces the rays from `begin` to n − 1. Rays that end where they start meet nothing."""
    record = _words(token, len(RECORD))
    room = np.zeros(4 * (RAY + HIT + 1) * PACKET + 64, np.uint8)
    start = (room.ctypes.data + 63) // 64 * 64
    floats, words = _floats(start, RAY * PACKET), _integers(start, (RAY + HIT + 1) * PACKET)
    valid = start + 4 * (RAY + HIT) * PACKET
    ox, oy, oz = _floats(_data(buffers, 1), n), _floats(_data(buffers, 2), n), _floats(_data(buffers, 3), n)
    dx, dy, dz = _floats(_data(buffers, 4), n), _floats(_data(buffers, 5), n), _floats(_data(buffers, 6), n)
    far = _floats(_data(buffers, 7), n)
    distances, faces = _floats(_data(results, 0), n), _integers(_data(results, 0 if occluded else 1), n)
    context, arguments = np.zeros(4, np.int64), np.zeros(8, np.int64)
    context[0], context[1], context[2], context[3] = -1, token, buffers, excluded
    arguments[0], arguments[1] = np.int64(-1) << 32, context.ctypes.data  # all features
    if excluded > 0:
        arguments[0] |= FILTER_BY_ARGUMENT
        arguments[2] = record[FILTER]
    function, scene = record[OCCLUDED] if occluded else record[CLOSEST], record[SCENE]
    for j in range(PACKET):
        words[MASK * PACKET + j] = -1
    if occluded:
        faces[begin:] = 0
    else:
        distances[begin:], faces[begin:] = np.inf, -1
    count = 0
    for lane in range(begin, n):  # a ray of no length is overwritten by the next
        floats[count], floats[PACKET + count], floats[2 * PACKET + count] = ox[lane], oy[lane], oz[lane]
        floats[4 * PACKET + count], floats[5 * PACKET + count] = dx[lane], dy[lane]
        floats[6 * PACKET + count], floats[TFAR * PACKET + count] = dz[lane], far[lane]
        words[ID * PACKET + count] = lane
        count += np.int64(far[lane] > 0)
        if count < PACKET and lane + 1 < n:
            continue
        for j in range(PACKET):
            words[(RAY + HIT) * PACKET + j] = -1 if j < count else 0
            words[PRIMITIVE * PACKET + j] = words[(PRIMITIVE + 1) * PACKET + j] = -1
            words[(PRIMITIVE + 2) * PACKET + j] = -1
        query(function, (valid, scene, start, arguments.ctypes.data))
        for j in range(count):
            at = words[ID * PACKET + j]
            if occluded:
                faces[at] = floats[TFAR * PACKET + j] < 0
            else:
                primitive = words[PRIMITIVE * PACKET + j]
                if primitive >= 0:
                    distances[at], faces[at] = (
                        floats[TFAR * PACKET + j],
                        _face(record, primitive, words[INSTANCE * PACKET + j]),
                    )
        count = 0


@numba.cfunc(types.int64(types.int64), cache=True)
def share(job: int) -> int:
    """A thread's share of a call: the arguments of `_trace`."""
    token, buffers, excluded, results, occluded, begin, end = _words(job, 7)
    _trace(token, buffers, excluded, results, occluded != 0, begin, end)
    return 0


@numba.njit(nogil=True, cache=True)
def _shared(token: int, buffers: int, excluded: int, results: int, occluded: bool, n: int) -> None:
    """Traces n rays on all cores, this thread among them."""
    record = _words(token, len(RECORD))
    cores = record[CORES]
    jobs, threads = np.empty((cores, 7), np.int64), np.zeros(cores, np.int64)
    for k in range(cores):
        job = jobs[k]
        job[0], job[1], job[2], job[3], job[4] = token, buffers, excluded, results, np.int64(occluded)
        job[5], job[6] = n * k // cores, n * (k + 1) // cores
        if k > 0 and start(record[SPAWN], (threads[k:].ctypes.data, 0, record[SHARE], job.ctypes.data)) & 0xFFFFFFFF:
            job[6] = -1  # no thread to be had
    _trace(token, buffers, excluded, results, occluded, 0, n // cores)
    for k in range(1, cores):
        if jobs[k, 6] < 0:
            _trace(token, buffers, excluded, results, occluded, jobs[k, 5], n * (k + 1) // cores)
        else:
            wait(record[JOIN], (threads[k], 0))


@numba.njit(nogil=True, cache=True)
def _handle(frame: int, occluded: bool) -> int:
    """One call by XLA; `frame` is its XLA_FFI_CallFrame (xla/ffi/api/c_api.h)."""
    call = _words(frame, 15)
    extension = call[1]
    if extension != 0 and _integers(extension + 8, 1)[0] == 1:  # it asks which version and traits we have
        metadata = _integers(_words(extension + 24, 1)[0] + 24, 3)
        metadata[0], metadata[1], metadata[2] = 0, 3, 0
        return 0
    if _integers(frame + 32, 1)[0] != 3:  # only the stage in which programs run
        return 0
    operands, buffers, results = call[7], call[9], call[14]
    token, n = _words(_data(buffers, 0), 1)[0], _size(results, 0)
    record = _words(token, len(RECORD))
    if record[ALIVE] != 0:
        if n >= MANY and record[CORES] > 1:
            _shared(token, buffers, operands - 8, results, occluded, n)
        else:
            _trace(token, buffers, operands - 8, results, occluded, 0, n)
        return 0
    error = np.zeros(4, np.int64)
    error[0], error[2], error[3] = 32, record[MESSAGE], FAILED_PRECONDITION
    return report(_words(call[2], 7)[6], (error.ctypes.data,))


@numba.cfunc(types.int64(types.int64), cache=True)
def closest(frame: int) -> int:
    return _handle(frame, False)


@numba.cfunc(types.int64(types.int64), cache=True)
def occluded(frame: int) -> int:
    return _handle(frame, True)


@numba.cfunc(types.void(types.int64), cache=True)
def keep(arguments: int) -> None:
    _keep(arguments)
