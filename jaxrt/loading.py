"""From a file to a scene."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from .build import build
from .files import load_description
from .parts import Description, Mesh
from .scene import Scene


def load(path: str | Path, /, **defaults: Any) -> Scene:
    """A scene from a Mitsuba 3 `.xml`, or a `.glb`, `.gltf`, `.obj` or `.ply`; `defaults` fill $names of an XML.

    Colours become linear RGB, three channels. What a loader had to replace or ignore is said on stderr.
    Raises `SceneError` (a ValueError) with one line that names the file, the element and the remedy.
    """
    description = load_description(path, **defaults)
    for note in (*description.notes, *_beyond(description)):
        print(note if str(path) in note else f"{path}: {note}", file=sys.stderr)
    return build(
        description.shapes,
        sensors=description.sensors,
        enclosure=description.enclosure,
        integrator=description.integrator,
        channels=3,
        source=str(path),
    )


def _beyond(description: Description) -> list[str]:
    """Sensors whose far end would cut something off: it is drawn all the same, and said."""
    corners = np.array([[x, y, z, 1.0] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = []
    for shape in description.shapes:
        local = corners
        if isinstance(shape, Mesh):
            low, high = shape.vertices.min(0), shape.vertices.max(0)
            local = np.column_stack([np.where(corners[:, :3] > 0, high, low), corners[:, 3]])
        points.append(local @ shape.to_world.T)
    world = np.concatenate(points)
    notes = []
    for sensor in description.sensors:
        depth = float((world @ np.linalg.inv(sensor.to_world).T)[:, 2].max())
        if depth > sensor.far:
            name = sensor.id or "sensor"
            notes.append(f"{name}: far_clip {sensor.far:g} is ignored; the scene reaches to {depth:.4g}, all is drawn")
    return notes
