"""The values in a Mitsuba scene file: numbers, strings, vectors, colours, spectra and transforms."""

from __future__ import annotations

import dataclasses
import pathlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from ..parts import SceneError
from . import spectra, transforms
from .mitsuba_nodes import Node


@dataclasses.dataclass
class Value:
    """kind: the XML tag. A spectrum's content is one number, or a pair of wavelengths and values."""

    kind: str
    content: Any
    node: Node
    note: str = ""


def value(node: Node, locate: Callable[[str], pathlib.Path]) -> Value:
    """The value of an element such as <float>; `locate` finds a file. Raises `SceneError` for a wrong one."""
    try:
        return Value(node.tag, _READERS[node.tag](node, locate), node, _note(node))
    except SceneError:
        raise
    except ValueError as problem:
        node.fail(problem)


def _note(node: Node) -> str:
    for operation in node.children:
        length = np.linalg.norm(_xyz(operation, 0.0, ("angle",))) if operation.tag == "rotate" else 1.0
        if abs(length - 1) > 1e-4:
            return f"<rotate> has an axis of length {length:.4g}, by which it also scales and shears, as in Mitsuba"
    return ""


def _text(node: Node) -> str:
    node.only((), ("name", "value"))
    return node.attributes["value"]


def _boolean(node: Node, locate: Any) -> bool:
    text = _text(node).lower()
    if text not in ("true", "false"):
        raise ValueError("is not a boolean; write true or false")
    return text == "true"


def _integer(node: Node, locate: Any) -> int:
    text = _text(node).strip()
    if not re.fullmatch(r"-?[0-9]{1,18}", text):
        raise ValueError("is not an integer; write digits only")
    return int(text)


def _float(node: Node, locate: Any) -> float:
    return _number(_text(node))


def _string(node: Node, locate: Any) -> str:
    return _text(node)


def _vector(node: Node, locate: Any) -> np.ndarray:
    return _xyz(node, None, ("name",))


def _rgb(node: Node, locate: Any) -> np.ndarray:
    text = _text(node)
    if text.strip().startswith("#"):
        raise ValueError("is a hexadecimal colour, which Mitsuba 3 does not know; give three linear numbers")
    numbers = _numbers(text)
    if len(numbers) not in (1, 3):
        raise ValueError(f"has {len(numbers)} numbers; give one or three")
    return np.broadcast_to(np.array(numbers), (3,)).copy()


def _spectrum(node: Node, locate: Callable[[str], pathlib.Path]) -> Any:
    node.only(("value", "filename"), ("name",))
    text, filename = (node.attributes.get(key, "") for key in ("value", "filename"))
    if bool(text) == bool(filename):
        raise ValueError("has neither value nor filename, or both; give one of them")
    if filename:
        path = locate(filename)
        try:
            return spectra.read_spd(path)
        except SceneError as problem:
            node.fail(problem)
    if ":" not in text:
        return _number(text)
    pairs = [token.split(":") for token in _tokens(text)]
    if any(len(pair) != 2 for pair in pairs):
        raise ValueError("is not a list of wavelength:value; write 400:0.1, 700:0.2, with no space after a colon")
    table = np.array([[_number(word) for word in pair] for pair in pairs]).reshape(-1, 2)
    spectra.check(table[:, 0], table[:, 1])
    return table[:, 0], table[:, 1]


def _transform(node: Node, locate: Any) -> np.ndarray:
    node.only((), ("name",))
    total = np.eye(4)
    for operation in node.children:
        try:
            total = _OPERATIONS[operation.tag](operation) @ total  # a later operation is applied after
        except SceneError:
            raise
        except ValueError as problem:
            operation.fail(problem)
    return total


def _rotate(node: Node) -> np.ndarray:
    axis = _xyz(node, 0.0, ("angle",))
    return transforms.rotate(axis, _number(node.attributes["angle"]))


def _look_at(node: Node) -> np.ndarray:
    node.only(("up",), ("origin", "target"))
    origin, target, up = (_numbers(node.attributes.get(key, "")) for key in ("origin", "target", "up"))
    up = up or [0.0, 0.0, 0.0]
    if not len(origin) == len(target) == len(up) == 3:
        raise ValueError("origin, target and up are not three numbers each; correct them")
    return transforms.look_at(origin, target, up)


def _matrix(node: Node) -> np.ndarray:
    node.only((), ("value",))
    return transforms.matrix(_numbers(node.attributes["value"]))


def _xyz(node: Node, missing: float | None, required: tuple[str, ...] = ()) -> np.ndarray:
    """Three numbers: x, y and z (`missing` for one that is not there), or value with one or three."""
    if "value" in node.attributes:
        if {"x", "y", "z"} & node.attributes.keys():
            raise ValueError("has value and also x, y or z; give only one kind")
        node.only(("value",), required)
        numbers = _numbers(node.attributes["value"])
        if len(numbers) not in (1, 3):
            raise ValueError(f"has {len(numbers)} numbers; give one or three")
        return np.broadcast_to(np.array(numbers), (3,)).copy()
    axes = ("x", "y", "z")
    node.only(axes if missing is not None else (), required if missing is not None else (*required, *axes))
    return np.array([_number(node.attributes[axis]) if axis in node.attributes else missing for axis in axes])


def _tokens(text: str) -> list[str]:
    return re.split(r"[,\s]+", text.strip(", \t\r\n")) if text.strip(", \t\r\n") else []


def _numbers(text: str) -> list[float]:
    return [_number(token) for token in _tokens(text)]


def _number(text: str) -> float:
    try:
        return spectra.number(text)
    except ValueError as problem:
        raise ValueError(f"has a value that is {problem}; give a decimal one such as 0.5") from None


_OPERATIONS: dict[str, Callable[[Node], np.ndarray]] = {
    "translate": lambda node: transforms.translate(_xyz(node, 0.0)),
    "scale": lambda node: transforms.scale(_xyz(node, 1.0)),
    "rotate": _rotate,
    "lookat": _look_at,
    "matrix": _matrix,
}
_READERS: dict[str, Callable[[Node, Any], Any]] = {
    "boolean": _boolean,
    "integer": _integer,
    "float": _float,
    "string": _string,
    "vector": _vector,
    "point": _vector,
    "rgb": _rgb,
    "spectrum": _spectrum,
    "transform": _transform,
}
