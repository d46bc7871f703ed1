"""From a file to a scene."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

from .build import build
from .effects import plan
from .files import load_description
from .scene import Scene


def load(path: str | Path, **defaults: Any) -> Scene:
    """A scene from a Mitsuba 3 `.xml`, or a `.glb`, `.gltf`, `.obj` or `.ply`; `defaults` fill $names of an XML.

    Colours become linear RGB, three channels. What a loader had to replace or ignore is said on stderr.
    Raises `SceneError` (a ValueError) with one line that names the file, the element and the remedy.
    """
    description = load_description(path, **defaults)
    for note in description.notes:
        print(f"{Path(path).name}: {note}", file=sys.stderr)
    scene = build(
        description.shapes,
        sensors=description.sensors,
        enclosure=description.enclosure,
        integrator=description.integrator,
        channels=3,
        source=str(path),
    )
    return dataclasses.replace(scene, plan=plan(scene))
