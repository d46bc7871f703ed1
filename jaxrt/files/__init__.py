"""Scene files in, pictures out: the impure end of jaxrt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..parts import Description, SceneError
from .reading import reading, regular


def load_description(path: str | Path, /, *, sandbox: str | Path | None = None, **defaults: str | float) -> Description:
    """The scene in a Mitsuba 3 .xml, .glb, .gltf, .obj or .ply file, as parts that can be rendered.

    `defaults` fill the `$names` of an XML file. A scene without a camera gets a default view, and,
    unless it is XML (which says all it means), a scene without light gets some; the notes name both.
    `sandbox`: a folder, outside of which nothing is read.
    Raises `SceneError`, one line with the file and the remedy, whatever is wrong with the file.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".xml", ".glb", ".gltf", ".obj", ".ply"):
        raise SceneError(f"{path}: {suffix or 'no suffix'} is not a scene format; give .xml, .glb, .gltf, .obj or .ply")
    if defaults and suffix != ".xml":
        name = next(iter(defaults))
        raise SceneError(f"{path}: {name!r} has no meaning in a {suffix} file; only .xml files take $names")

    with reading(sandbox):
        regular(path)
        return _described(path, suffix, defaults)


def _described(path: str | Path, suffix: str, defaults: dict[str, Any]) -> Description:
    # Imported here: each only costs its start-up time when it is needed.
    from .view import complete

    if suffix == ".xml":
        from . import mitsuba

        found, more = mitsuba.load(Path(path), defaults), {"light": False}
    elif suffix in (".glb", ".gltf"):
        from .gltf import load_gltf

        found, more = load_gltf(path), {}
    else:
        from .obj import load_obj
        from .ply import load_ply

        found, more = load_obj(path) if suffix == ".obj" else load_ply(path), {"orient": True}
    try:
        return complete(found, **more)
    except SceneError as error:  # which knows no file
        raise SceneError(f"{path}: {error}") from error
