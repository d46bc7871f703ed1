"""The compiled side of the Embree backend: XLA calls it with a batch of rays, it calls Embree 16 rays at a time.

XLA's foreign function interface wants a C function. numba makes one here without a compiler at hand and without
Python's lock. Scenes come as the address of a record of eight int64 words (`RECORD`), so nothing of one process
is compiled in, and numba may keep the machine code from run to run.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

RECORD = {"scene": 0, "intersect": 1, "occluded": 2, "filter": 3, "first_quad": 4, "alive": 5, "message": 6}
"""Words of a scene's record: Embree's scene, its functions, our filter, where the quads' numbers start, whether
the scene still exists, and the text of the error where it does not."""

RAY, HIT = 12, 9  # words of a ray and of a hit; a packet holds 16 of each word in turn
TFAR, ID, FLAGS, PRIMITIVE, GEOMETRY = 8, 10, 11, 17, 18
FILTER_BY_ARGUMENT = 2  # RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER


def _memory(of: Any, type_: Any) -> tuple[Any, Any]:
    """load(address) and store(address, value) of one type."""

    @intrinsic
    def load(typing: Any, address: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.load(builder.inttoptr(args[0], of.as_pointer()))

        return type_(types.int64), code

    @intrinsic
    def store(typing: Any, address: Any, value: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.store(args[1], builder.inttoptr(args[0], of.as_pointer()))
            return context.get_dummy_value()

        return types.void(types.int64, type_), code

    return load, store


load_i64, store_i64 = _memory(ir.IntType(64), types.int64)
load_i32, store_i32 = _memory(ir.IntType(32), types.int32)
load_f32, store_f32 = _memory(ir.FloatType(), types.float32)


@intrinsic
def call4(typing: Any, f: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Calls the function at an address with four pointers."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [word] * 4)
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(*(types.int64,) * 5), code


@intrinsic
def call1(typing: Any, f: Any, a: Any) -> Any:
    """Calls the function at an address with one pointer; it returns one."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(64)
        return builder.call(builder.inttoptr(args[0], ir.FunctionType(word, [word]).as_pointer()), args[1:])

    return types.int64(types.int64, types.int64), code


@numba.njit(nogil=True, cache=True)
def _data(buffers: int, k: int) -> int:
    """Address of the numbers in buffer k of a call."""
    return load_i64(load_i64(buffers + 8 * k) + 24)


@numba.njit(nogil=True, cache=True)
def _size(buffers: int, k: int) -> int:
    """How many numbers there are in buffer k."""
    buffer = load_i64(buffers + 8 * k)
    rank, dims, size = load_i64(buffer + 32), load_i64(buffer + 40), 1
    for j in range(rank):
        size *= load_i64(dims + 8 * j)
    return size


@numba.njit(nogil=True, cache=True)
def _keep(arguments: int) -> None:
    """Embree's filter: refuses hits on the faces that a ray excludes."""
    valid, context = load_i64(arguments), load_i64(arguments + 16)
    ray, hit, n = load_i64(arguments + 24), load_i64(arguments + 32), load_i32(arguments + 40)
    buffers, excluded, first_quad = load_i64(context + 8), load_i64(context + 16), load_i64(context + 24)
    for j in range(n):
        if load_i32(valid + 4 * j) != 0:
            lane = load_i32(ray + 4 * (ID * n + j))
            face = load_i32(hit + 4 * ((PRIMITIVE - RAY) * n + j))
            if load_i32(hit + 4 * ((GEOMETRY - RAY) * n + j)) == 1:
                face += first_quad
            for k in range(excluded):
                if load_i32(_data(buffers, 8 + k) + 4 * lane) == face:
                    store_i32(valid + 4 * j, np.int32(0))


@numba.njit(nogil=True, cache=True)
def _trace(n: int, buffers: int, excluded: int, results: int, occluded: bool) -> int:
    """Traces n rays; returns 0, or the record of a scene that is gone."""
    room = np.empty((RAY + HIT) * 16 + 96, np.int32)
    start = room.ctypes.data
    packet = (start + 63) // 64 * 64
    valid = packet + 64 * (RAY + HIT)
    words, floats, at = room, room.view(np.float32), (packet - start) // 4
    mask = (valid - start) // 4
    context, arguments = np.empty(4, np.int64), np.zeros(8, np.int64)
    tokens, far = _data(buffers, 0), _data(buffers, 7)
    ox, oy, oz = _data(buffers, 1), _data(buffers, 2), _data(buffers, 3)
    dx, dy, dz = _data(buffers, 4), _data(buffers, 5), _data(buffers, 6)
    found, faces = _data(results, 0), _data(results, 0 if occluded else 1)
    context[0] = -1
    context[1], context[2] = buffers, excluded
    arguments[0] = np.int64(-1) << 32  # all features
    if excluded > 0:
        arguments[0] |= FILTER_BY_ARGUMENT
    arguments[1] = context.ctypes.data
    lane = 0
    while lane < n:
        record = load_i64(tokens + 8 * lane)
        if load_i64(record + 40) == 0:
            return record
        first, count = lane, 0
        for j in range(16):
            words[mask + j] = 0
        while lane < n and count < 16 and load_i64(tokens + 8 * lane) == record:
            byte, to = 4 * lane, at + count
            floats[to], floats[to + 16], floats[to + 32] = load_f32(ox + byte), load_f32(oy + byte), load_f32(oz + byte)
            floats[to + 64], floats[to + 80], floats[to + 96] = (
                load_f32(dx + byte),
                load_f32(dy + byte),
                load_f32(dz + byte),
            )
            floats[to + 16 * 3] = 0.0
            floats[to + 16 * 7] = 0.0
            floats[to + 16 * TFAR] = load_f32(far + byte)
            words[to + 16 * 9] = -1
            words[to + 16 * ID] = lane
            words[to + 16 * FLAGS] = 0
            words[to + 16 * PRIMITIVE] = -1
            words[to + 16 * GEOMETRY] = -1
            words[to + 16 * 19] = -1
            words[mask + count] = -1 if load_f32(far + byte) > 0 else 0
            lane, count = lane + 1, count + 1
        first_quad = load_i64(record + 32)
        context[3] = first_quad
        arguments[2] = load_i64(record + 24) if excluded > 0 else 0
        function = load_i64(record + 16) if occluded else load_i64(record + 8)
        call4(function, valid, load_i64(record), packet, arguments.ctypes.data)  # pyright: ignore[reportCallIssue]
        for j in range(count):
            t = floats[at + 16 * TFAR + j]
            if occluded:
                store_i32(found + 4 * (first + j), np.int32(t < 0))
            else:
                face = words[at + 16 * PRIMITIVE + j]
                if words[at + 16 * GEOMETRY + j] == 1:
                    face += first_quad
                store_f32(found + 4 * (first + j), t)
                store_i32(faces + 4 * (first + j), np.int32(face))
    return 0


@numba.njit(nogil=True, cache=True)
def _handle(frame: int, occluded: bool) -> int:
    """One call by XLA; `frame` is its XLA_FFI_CallFrame (xla/ffi/api/c_api.h)."""
    extension = load_i64(frame + 8)
    if extension != 0 and load_i32(extension + 8) == 1:  # it asks which version and traits we have
        metadata = load_i64(extension + 24)
        store_i32(metadata + 24, np.int32(0))
        store_i32(metadata + 28, np.int32(3))
        store_i32(metadata + 32, np.int32(0))
        return 0
    if load_i32(frame + 32) != 3:  # only the stage in which programs run
        return 0
    operands, buffers, results = load_i64(frame + 56), load_i64(frame + 72), load_i64(frame + 112)
    gone = _trace(_size(results, 0), buffers, operands - 8, results, occluded)
    if gone == 0:
        return 0
    error = np.zeros(4, np.int64)
    error[0], error[2], error[3] = 32, load_i64(gone + 48), 9  # FAILED_PRECONDITION
    return call1(load_i64(load_i64(frame + 16) + 48), error.ctypes.data)  # pyright: ignore[reportCallIssue]


@numba.cfunc(types.int64(types.int64), cache=True)
def closest(frame: int) -> int:
    return _handle(frame, False)


@numba.cfunc(types.int64(types.int64), cache=True)
def occluded(frame: int) -> int:
    return _handle(frame, True)


@numba.cfunc(types.void(types.int64), cache=True)
def keep(arguments: int) -> None:
    _keep(arguments)
