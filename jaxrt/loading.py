"""From a file to a scene."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from .build import build
from .files import load_description
from .files.view import scene_points
from .parts import Description
from .parts.checks import printable
from .recentre import coarse, recentred
from .scene import CAMERAS, Scene


def load(path: str | Path, /, *, sandbox: str | Path | None = None, **defaults: Any) -> Scene:
    """A scene from a Mitsuba 3 `.xml`, or a `.glb`, `.gltf`, `.obj` or `.ply`; `defaults` fill $names of an XML.

    `sandbox`: a folder, outside of which nothing is read, symbolic links resolved; for files from strangers.
    Colours become linear RGB, three channels. What a loader had to replace or ignore is said on stderr.
    A scene far from the origin is counted from `Scene.origin`: its parameters, points and positions are.
    Raises `SceneError` (a ValueError) with one line that names the file, the element and the remedy.
    """
    given = load_description(path, sandbox=sandbox, **defaults)
    points = scene_points(given.shapes)
    description, origin = recentred(given, points)
    for note in (*description.notes, *coarse(given), *_beyond(given, points)):
        print(printable(note if str(path) in note else f"{path}: {note}"), file=sys.stderr)
    return build(
        description.shapes,
        sensors=description.sensors,
        enclosure=description.enclosure,
        lamps=description.lamps,
        integrator=description.integrator,
        channels=3,
        source=str(path),
        origin=tuple(origin.tolist()),
    )


def _beyond(description: Description, points: np.ndarray) -> list[str]:
    """Sensors whose far end would cut something off: it is drawn all the same, and said."""
    world = np.insert(points, 3, 1.0, axis=1)
    notes = []
    for sensor in (part for s in description.sensors for part in (s.sensors or [s])):
        if sensor.kind not in CAMERAS:
            continue
        depth = float((world @ np.linalg.inv(sensor.to_world).T)[:, 2].max())
        if depth > sensor.far:
            name = sensor.id or "sensor"
            notes.append(f"{name}: far_clip {sensor.far:g} is ignored; the scene reaches to {depth:.4g}, all is drawn")
    return notes
