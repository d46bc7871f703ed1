"""The one door through which files are written: whole, or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from ..parts import SceneError

unfinished: set[str] = set()
"""Files that are being written, by their temporary names."""


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[str]:
    """A temporary name beside `path`, which takes its place at the end: never a half-written file, and what was there
    stays until then, whatever happens.

    Mistakes of the user (no such folder, no permission, no space) become `SceneError`.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.name[:64]}.{secrets.token_hex(4)}.part")
    try:
        if target.exists() and not target.is_file():  # a device must not be replaced
            raise SceneError(f"{path}: is not a file; give the name of one")
        if not target.parent.is_dir():
            raise SceneError(f"{path}: the folder {target.parent} does not exist; make it or give another path")
        unfinished.add(str(temporary))
        temporary.touch()  # says what the user cannot do more clearly than OpenEXR does
        yield str(temporary)
        with open(temporary, "rb+") as file:  # a disk may say only now that it is full
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except SceneError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # OpenEXR raises RuntimeError, an odd name ValueError
        why = getattr(error, "strerror", None) or str(error)
        raise SceneError(
            f"{path}: cannot be written ({why}); check permissions and space, or give another path"
        ) from error
    finally:
        with contextlib.suppress(OSError, ValueError):
            temporary.unlink()
        unfinished.discard(str(temporary))


def write_bytes(path: str | Path, data: bytes) -> None:
    """A file of these bytes. Raises `SceneError` as `replacing`."""
    with replacing(path) as temporary:
        Path(temporary).write_bytes(data)
