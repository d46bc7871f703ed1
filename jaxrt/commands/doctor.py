"""`jaxrt doctor`: what this machine has."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from . import cache


def add(commands: Any, scene: argparse.ArgumentParser) -> None:
    parser = commands.add_parser("doctor", help="versions, devices, ray casting, compilation cache")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    import importlib.metadata
    import platform

    from .. import __version__

    def version(package: str) -> str:
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            return "not installed"

    rows = [("jaxrt", __version__), ("python", f"{platform.python_version()}, {sys.platform} {platform.machine()}")]
    rows += [(package, version(package)) for package in ("jax", "jaxlib", "numpy", "equinox", "mitsuba")]
    from ..solver.render import cores, machine_memory

    import jax  # isort: skip

    try:
        devices = ", ".join(str(d) for d in jax.devices())
    except RuntimeError as error:  # a driver that does not start
        devices = f"none: {' '.join(str(error).split())}"
    rows += [("devices", devices), ("cores", str(cores())), ("memory", f"{machine_memory() / 2**30:.1f} GiB")]
    from ..intersect import BACKENDS, refusal

    casting = [f"{name}: {'yes' if (why := refusal(name)) is None else f'no, {why}'}" for name in BACKENDS]
    rows += [("ray casting", "; ".join(casting)), ("cache", cache.state())]
    for name, value in rows:
        print(f"{name:<12} {value}")
