"""Compiled programs: what XLA has to be told about loops over lanes, and how programs are kept."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import platform
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .files.writing import write_bytes
from .parts import SceneError

F = TypeVar("F", bound=Callable[..., Any])

CPU_OPTIONS: dict[str, str | bool] = {"xla_cpu_prefer_vector_width": "512"}
"""XLA keeps to vectors of 256 bits, which leaves a fifth of the speed of wide cores unused."""

folder: Path | None = None
"""Where finished programs are kept from process to process; None keeps none. The command line sets it.

JAX's own cache keeps what XLA made of a program, but the program is traced and lowered before it is found,
which for a path tracer takes longer than many a picture.
"""


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


REMEMBERED = 8
"""Results of a `remembered` function that one argument keeps."""

_programs: dict[Any, Callable[..., Any]] = {}
_spent = [0.0]


def programs() -> int:
    """How many programs this process has made or loaded."""
    return len(_programs)


def seconds_spent() -> float:
    """How long this process has been making or loading programs."""
    return _spent[0]


def program(f: Callable[..., Any], *like: Any, static: tuple[Any, ...] = (), keep: bool = True) -> Callable[..., Any]:
    """f compiled for arguments like these (arrays or shapes); equal structures and shapes share one program.

    `static`: f's last arguments, which are not arrays; the program is called without them. `keep`: whether later
    processes may have it, which programs that call back into Python do not allow.
    """
    leaves, tree = jax.tree.flatten(like)
    shapes = tuple((tuple(leaf.shape), str(leaf.dtype)) for leaf in leaves)
    key = (f, tree, shapes, static)
    if key not in _programs:
        began = time.perf_counter()
        _programs[key] = _make(f, leaves, tree, static, _file(f, tree, (shapes, static)) if keep else None)
        _spent[0] += time.perf_counter() - began
    return _programs[key]


def _make(
    f: Callable[..., Any], leaves: list[Any], tree: Any, static: tuple[Any, ...], file: Path | None
) -> Callable[..., Any]:
    from jax.experimental import serialize_executable

    compiled, out = None, None
    if file is not None and file.exists():
        try:
            data = file.read_bytes()
            if b"lapack_" in data:
                _lapack()
            kept, example = pickle.loads(data)
            compiled, out = serialize_executable.deserialize_and_load(*kept), jax.tree.structure(example)
        except Exception:  # a damaged or foreign file: made anew below
            compiled = None
    if compiled is None:
        trees: list[Any] = []

        def flat(*leaves: Any) -> list[Any]:
            values, structure = jax.tree.flatten(f(*jax.tree.unflatten(tree, leaves), *static))
            trees.append(structure)
            return values

        options = CPU_OPTIONS if jax.default_backend() == "cpu" else {}
        compiled = jax.jit(flat).lower(*leaves).compile(options)
        out = trees[0]
        if file is not None:
            example = jax.tree.unflatten(out, range(out.num_leaves))  # modules can be pickled, their structure cannot
            _keep(file, pickle.dumps((serialize_executable.serialize(compiled), example)))
    run = compiled
    return lambda *args: jax.tree.unflatten(out, run(*jax.tree.leaves(args)))


@functools.cache
def _lapack() -> None:
    """Have jax find LAPACK, which it does when it lowers a call: a kept program would call what is not there yet."""
    jax.jit(jnp.linalg.inv).lower(jnp.eye(1))


def _keep(file: Path, data: bytes) -> None:
    with contextlib.suppress(OSError, SceneError):  # a full disk costs time, not the picture
        file.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(file, data)


@functools.cache
def _circumstances() -> str:
    """What a kept program depends on besides its arguments: our source, jax, and the processor."""
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        source.update(path.read_bytes())
    flags = ""
    if Path("/proc/cpuinfo").exists():
        flags = next((line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags")), "")
    device = jax.devices()[0]
    parts = (
        jax.local_device_count(),
        source.hexdigest(),
        jax.__version__,
        device.client.platform_version,
        device.device_kind,
        flags,
    )
    return repr((*parts, platform.machine(), jax.config.jax_enable_x64))  # pyright: ignore[reportAttributeAccessIssue]


def _file(f: Callable[..., Any], tree: Any, shapes: Any) -> Path | None:
    if folder is None:
        return None
    text = repr((f.__module__, f.__qualname__, str(tree), shapes, CPU_OPTIONS, _circumstances()))
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()}.program"


def remembered(f: F) -> F:
    """f, which keeps what it gave for as long as its first argument lives: arrays of JAX do not change.

    What comes of the first argument must not hold it. Other arguments are told apart by value, modules by identity;
    and so is the precision that JAX works in.
    """
    kept: dict[int, tuple[Any, dict[Any, Any]]] = {}
    name = lambda a: ("module", id(a)) if isinstance(a, eqx.Module) else a

    @functools.wraps(f)
    def call(first: Any, *rest: Any) -> Any:
        number, key = id(first), (jax.dtypes.canonicalize_dtype(float), *map(name, rest))
        if number not in kept or kept[number][0]() is not first:
            kept[number] = weakref.ref(first, lambda _: kept.pop(number, None)), {}
        found = kept[number][1]
        if key not in found:
            if len(found) >= REMEMBERED:
                found.pop(next(iter(found)), None)
            found[key] = f(first, *rest), rest  # these live on, so that no other module takes their place
        return found[key][0]

    return cast(F, call)


def chunks(numbers: Any, lanes: int) -> Any:
    """Numbers in rows of at most `lanes`, the last row filled up from the start."""
    n = numbers.shape[0]
    lanes = min(lanes, n)
    return numbers[jnp.arange(-(-n // lanes) * lanes) % n].reshape(-1, lanes)


def over_devices(f: Any, rows: Any, *whole: Any) -> Any:
    """f(*whole, row) for each of `rows`, one after another on each device of this process."""
    devices, n = jax.local_devices(), rows.shape[0]
    each = lambda rows, *whole: jax.lax.map(lambda row: f(*whole, row), rows)
    if len(devices) == 1 or n == 1 or jax.sharding.get_abstract_mesh().axis_names:  # the last: sharded by the caller
        return each(rows, *whole)
    rows = rows[np.resize(np.arange(n), -(-n // len(devices)) * len(devices))]
    split, same = jax.sharding.PartitionSpec("device"), jax.sharding.PartitionSpec()
    mesh, specs = jax.sharding.Mesh(np.array(devices), ("device",)), (split, *(same for _ in whole))
    found = jax.shard_map(each, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)(rows, *whole)
    return jax.tree.map(lambda a: a[:n], found)


def one_function(f: Callable[..., Any]) -> Callable[..., Any]:
    """f compiled for the CPU into one function on one thread, where XLA would queue each of its kernels.

    A bounce is some hundred short kernels over the lanes; queueing them doubles the time on jax 0.10. XLA does
    this by itself for small loops (its `small_call`); we ask for it, and use cores by running several programs.
    What it does outside of loops should be small: XLA fails where it wants to split that over threads. And it
    aborts where it could take the call apart beforehand, where it is to pass a constant (as in a scene that
    a caller's jit closes over), or where an argument comes out as unused: so a zero made of all of them goes
    into the first array that f returns, which the caller has to use.
    """

    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        leaves = [jnp.asarray(leaf) for leaf in leaves]
        empty = {k: leaf for k, leaf in enumerate(leaves) if leaf.size == 0}  # which XLA takes for constants

        structures = []

        def inner(given: dict[int, Any]) -> Any:
            whole = given | {k: jnp.zeros_like(leaf) for k, leaf in empty.items()}
            values = f(*jax.tree.unflatten(tree, [whole[k] for k in range(len(leaves))]))
            (first, *others), structure = jax.tree.flatten(values)
            structures.append(structure)
            zero = _zero(given)
            first = first.at[(0,) * first.ndim].add(zero.astype(first.dtype))
            return [first, *others, zero]  # never one array: XLA would split it over threads

        given = {k: leaf for k, leaf in enumerate(leaves) if k not in empty}
        *values, _ = jax.jit(inner)(jax.lax.optimization_barrier(given))
        try:
            from jax.experimental.xla_metadata import set_xla_metadata

            values[0] = set_xla_metadata(values[0], inlineable="false", xla_cpu_small_call="true")
        except (ImportError, TypeError):  # a hint only: other versions of jax run without it
            pass
        return jax.tree.unflatten(structures[-1], values)

    return call


def _zero(tree: Any) -> Any:
    """0, in a way that XLA does not see through, made of every array in the tree."""
    one = lambda a: jax.lax.slice(a, (0,) * a.ndim, (1,) * a.ndim).reshape(()) if a.ndim else a
    total = sum(one(leaf).astype(jnp.float32) for leaf in jax.tree.leaves(tree))
    return jax.lax.clz(jax.lax.bitcast_convert_type(total, jnp.int32)) >> 6
