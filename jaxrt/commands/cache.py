"""Where compiled programs are kept between runs."""

from __future__ import annotations

import os
from pathlib import Path


def folder() -> Path:
    """Where compiled programs are kept: $XDG_CACHE_HOME/jaxrt, by default ~/.cache/jaxrt."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path("~/.cache").expanduser()) / "jaxrt"


def refusal() -> str | None:
    """Why compiled programs are not kept, or None. Makes the folder."""
    if os.environ.get("JAXRT_CACHE", "").lower() in ("off", "0", "no", "false"):
        return "off, by JAXRT_CACHE"
    try:
        at = folder()
        at.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home
        return f"off: {error}"
    return None if os.access(at, os.W_OK) else f"off: {at} cannot be written"


def use() -> None:
    """Keep compiled programs, unless switched off; a render never fails for it."""
    if refusal():
        return
    from .. import compiler

    compiler.folder = folder() / "programs"


def state() -> str:
    if why := refusal():
        return why
    files = [f for f in folder().rglob("*") if f.is_file()]
    return f"{folder()}, {len(files)} files, {sum(f.stat().st_size for f in files) / 1e6:.1f} MB"
