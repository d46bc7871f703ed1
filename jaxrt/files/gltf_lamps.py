"""Lamps of a glTF scene, by the extension that nodes have them from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..parts import Directional, Goniometric, Lamp, Point, Spot
from .gltf_document import Document
from .ies import read_ies

_WEB = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
"""From the space of a `Goniometric` lamp to a node's, where vertical angle 0 is −z and horizontal angle 0 is +x."""


def _light(file: Document, extension: str, entry: dict[str, Any], name: str) -> tuple[dict[str, Any], str]:
    """The light that a node's entry refers to, and what errors call it."""
    table = file.table(file.extension(file.json, extension), "lights")
    index = file.integer(entry, "light", where=f"{name}.")
    if index >= len(table) or not isinstance(table[index], dict):
        file.fail(f"there is no light {index} among {len(table)}; export it again")
    return table[index], f"light {index}"


def _punctual(file: Document, entry: dict[str, Any], name: str, to_world: np.ndarray) -> Lamp:
    """A light of KHR_lights_punctual, which shines along −z. Candela and lux are taken as W/sr and W/m², as nits are
    as radiance."""
    light, where = _light(file, "KHR_lights_punctual", entry, name)
    bright = file.numbers(light, "color", [1.0, 1.0, 1.0], where) * file.numbers(light, "intensity", 1.0, where)
    along, position, kind = -to_world[:3, 2], to_world[:3, 3], light.get("type")
    if kind == "directional":
        return Directional(along, bright, id=name)
    if kind == "point":
        return Point(position, bright, id=name)
    if kind != "spot":
        file.fail(f"{where} is of type {str(kind)[:20]!r}, not directional, point or spot; export it again")
    cone = file.entry(light, "spot")
    inner, outer = (
        math.degrees(float(file.numbers(cone, key, default, where)))
        for key, default in (("innerConeAngle", 0.0), ("outerConeAngle", math.pi / 4))
    )
    return Spot(position, bright, direction=along, cutoff_angle=outer, beam_width=inner, id=name)


def _measured(file: Document, entry: dict[str, Any], name: str, to_world: np.ndarray) -> Lamp:
    """A light of EXT_lights_ies. Its vertical angle 0 is −z; its planes of horizontal angles begin over +x."""
    light, where = _light(file, "EXT_lights_ies", entry, name)
    if "bufferView" in light:
        content = file.view(light["bufferView"], where)[0]
    elif isinstance(light.get("uri"), str):
        content = file.uri(light["uri"], where)
    else:
        file.fail(f"{where} has no data; export it again")
    color = np.clip(file.numbers(entry, "color", [1.0, 1.0, 1.0], name), 0.0, 1.0)
    scale = color * file.numbers(entry, "multiplier", 1.0, name)
    return Goniometric(read_ies(bytes(content), f"{file.path}: {where}", scale), to_world @ _WEB, id=name)


LAMPS = {"KHR_lights_punctual": _punctual, "EXT_lights_ies": _measured}
