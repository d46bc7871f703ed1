"""The one door through which scenes read files: where these may lie, of what kind they are, and how much memory what
they hold may take. A scene file may come from anywhere, and name any file.
"""

from __future__ import annotations

import contextlib
import contextvars
import dataclasses
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..parts import SceneError

FREE, EACH = 1 << 30, 384
"""Bytes of memory that any scene may take, and that it may take more for each byte of its files: files of 1 MB stay
below 2 GB, the program itself included. Photographs in JPEG, the densest of what is usual, take 100 to 300."""

TRIANGLE, VALUE, ELEMENT, COPY = 450, 20, 5000, 5000
"""Bytes that a triangle, a number in a picture, an element of XML, and a copy of a mesh take at most while a scene is
made: peaks of whole loads, measured."""


class RefusedError(SceneError):
    """A file that a scene may not read, or not hold. Readers that can do without some files pass this on."""


@dataclasses.dataclass
class _Reading:
    """What is known of one scene while it is read: the folder that it must not leave, and its account of memory."""

    sandbox: Path | None
    spent: int = 0
    allowed: int = FREE
    seen: set[Path] = dataclasses.field(default_factory=set)


_now: contextvars.ContextVar[_Reading | None] = contextvars.ContextVar("reading", default=None)


@contextlib.contextmanager
def reading(sandbox: str | Path | None = None) -> Iterator[None]:
    """While a scene is read: no file outside of `sandbox` is opened, symbolic links resolved, and `take` keeps account.

    Raises `SceneError` where `sandbox` is no folder.
    """
    if sandbox is not None and not os.path.isdir(sandbox):
        raise SceneError(f"sandbox: there is no folder {sandbox}; give one that holds all that the scene reads")
    token = _now.set(_Reading(None if sandbox is None else Path(sandbox).resolve()))
    try:
        yield
    finally:
        _now.reset(token)


def allowed(path: str | Path) -> bool:
    """Whether a path, which need not exist, lies in the sandbox, if there is one."""
    now = _now.get()
    return now is None or now.sandbox is None or Path(path).resolve().is_relative_to(now.sandbox)


def outside(path: str | Path) -> RefusedError:
    """The refusal of what is not `allowed`, the same whether there is such a file or not."""
    return RefusedError(f"{path}: lies outside of the sandbox; move it there, or render without --sandbox")


def regular(path: str | Path) -> int:
    """The size of a file that may be read. Raises `SceneError` where it is not there, a folder, a device or a pipe,
    which could be endless, or outside of the sandbox."""
    try:
        if not allowed(path):
            raise outside(path)
        if not os.path.isfile(path):
            raise SceneError(f"{path}: no such file; check the path")
        return os.stat(path).st_size
    except (OSError, ValueError, RuntimeError) as error:  # a name that no file can have, a loop of links
        raise error if isinstance(error, SceneError) else _unreadable(path, error) from None


def read_bytes(path: str | Path) -> bytes:
    """The content of a regular file, no more than its size says; `SceneError` as `regular`, or if it cannot be read."""
    size = regular(path)
    try:
        with open(path, "rb") as file:
            data = file.read(size)  # of /proc's files nothing, for they say 0
    except (OSError, ValueError, OverflowError) as error:
        raise _unreadable(path, error) from None
    except MemoryError:
        raise SceneError(f"{path}: has {size} bytes, which do not fit into memory; make it smaller") from None
    credit(path, len(data))
    return data


def _unreadable(path: str | Path, error: Exception) -> SceneError:
    why = getattr(error, "strerror", None) or "a name that no file has"
    return SceneError(f"{path}: cannot be read ({why}); check the path and its permissions")


def find(name: str, search: Sequence[Path]) -> Path | None:
    """The first regular file or folder of that name in the folders of `search`, or None. Raises `RefusedError` where
    there is none but one might lie outside of the sandbox."""
    refused = None
    for folder in search:
        try:
            if not allowed(folder / name):
                refused = refused or folder / name
            elif (folder / name).is_file() or (folder / name).is_dir():
                return folder / name
        except (OSError, ValueError, RuntimeError):  # a name that no file can have
            continue
    if refused:
        raise outside(name)
    return None


def credit(path: str | Path, size: int) -> None:
    """Bytes of a file count once, however often it is read."""
    now = _now.get()
    if now is not None and (place := Path(path).resolve()) not in now.seen:
        now.seen.add(place)
        now.allowed += EACH * size


def take(path: str | Path, cost: int, remedy: str, size: int | None = None) -> None:
    """Put `cost` bytes of memory on the account of the scene that is being read; `RefusedError` beyond what it is
    allowed. `size`: the file's, which decides alone where no scene is being read."""
    now = _now.get()
    if now is None:
        now = _Reading(None, allowed=FREE + EACH * size) if size is not None else _Reading(None, allowed=1 << 62)
    now.spent += int(cost)
    if now.spent > now.allowed:
        raise RefusedError(
            f"{path}: makes the scene larger than {now.allowed / 1e9:.1f} GB, far more than its files hold; {remedy}"
        )
