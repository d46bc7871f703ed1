"""What options of the command line say: readers of their values, and mistakes in them."""

from __future__ import annotations

import argparse
import contextlib
import math
import re
from collections.abc import Callable
from typing import Any, NoReturn

LARGEST = 1 << 15  # pixels to a side, as `Film` has it


class MistakeError(Exception):
    """A mistake found before the library is imported: one line that names the remedy."""


class Parser(argparse.ArgumentParser):
    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs, allow_abbrev=False)  # so that a new option never breaks an old command

    def error(self, message: str) -> NoReturn:
        raise MistakeError(f"{message}; see {self.prog} --help")


def whole(least: int, most: int = (1 << 31) - 1) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"is {text!r}; give a whole number from {least} to {most}")
        return int(text)

    return read


def sensor_numbers(text: str) -> list[int] | None:
    """Numbers of sensors; None for all."""
    return None if text == "all" else [whole(0)(part) for part in text.split(",")]


def picture_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (0 < width <= LARGEST and 0 < height <= LARGEST):
        raise argparse.ArgumentTypeError(f"is {text!r}; give it as 640x480, with sides from 1 to {LARGEST}")
    return width, height


def stops(text: str) -> float:
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"is {text!r}; give a number of stops")


def tolerance(text: str) -> float:
    """A share, or so many percent."""
    with contextlib.suppress(ValueError):
        value = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        if 0.0 < value < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"is {text!r}; give a relative error, as 1% or 0.01")


def duration(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 < (value := float(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"is {text!r}; give a positive number of seconds")


def definition(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"is {text!r}; give it as name=value")
    return name, value


def scene_options() -> Parser:
    """The options of every command that loads a scene."""
    scene = Parser(add_help=False)
    scene.add_argument("scene", metavar="SCENE", help="a Mitsuba 3 .xml, .glb, .gltf, .obj or .ply file")
    scene.add_argument(
        "-D", dest="defaults", metavar="name=value", type=definition, action="append", default=[],
        help="fill $name of an XML scene; may be repeated",
    )  # fmt: skip
    scene.add_argument(
        "--sandbox", metavar="DIR",
        help="read nothing outside of this folder, whatever the scene names, symbolic links resolved",
    )  # fmt: skip
    scene.add_argument("--no-cache", action="store_true", help="do not keep compiled programs (as JAXRT_CACHE=off)")
    return scene
