"""A fit's state on disk: arrays and what they belong to, in one file that is never half written."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..files.writing import replacing
from ..parts import SceneError

_DAMAGE = (OSError, ValueError, KeyError, EOFError, TypeError, AttributeError, NotImplementedError)
_DAMAGE += (zipfile.BadZipFile, zlib.error)
"""What numpy raises for a file that is no archive of arrays, or a damaged one."""


def save(path: str | Path, state: Any, history: dict[str, list[Any]], about: dict[str, Any]) -> None:
    """Writes a state's arrays and a history. Raises `SceneError` where that cannot be."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(state, eqx.is_array))]
    arrays: dict[str, Any] = {f"state_{k}": leaf for k, leaf in enumerate(leaves)}
    arrays |= {f"history_{name}": np.asarray(values) for name, values in history.items()}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, about=json.dumps(about), **arrays)


def about_of(path: str | Path, asked: dict[str, Any]) -> dict[str, Any] | None:
    """What a file says of itself, None if there is none. Raises `SceneError` where it is of another fit than asked."""
    if not Path(path).exists():
        return None
    try:
        with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
    except _DAMAGE:
        raise SceneError(f"{path}: is no checkpoint of a fit, or is damaged; remove it or give another path") from None
    for name, value in asked.items():
        if about.get(name) != value:
            raise SceneError(
                f"{path}: is of a fit with {name} {about.get(name)}, not {value}; remove it, or ask the same"
            )
    return about


def load(path: str | Path, like: Any) -> tuple[Any, dict[str, list[Any]]]:
    """A state with the arrays of a file in the places of `like`'s, and the history."""
    arrays, rest = eqx.partition(like, eqx.is_array)
    leaves, tree = jax.tree.flatten(arrays)
    try:
        with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            kept = [file[f"state_{k}"] for k in range(sum(name.startswith("state_") for name in file.files))]
            history = {n.removeprefix("history_"): list(file[n]) for n in file.files if n.startswith("history_")}
    except _DAMAGE:
        raise SceneError(f"{path}: is a damaged checkpoint; remove it or give another path") from None
    if [(a.shape, a.dtype) for a in kept] != [(a.shape, a.dtype) for a in leaves]:
        raise SceneError(f"{path}: is of a fit with another optimiser; remove it, or give the same one")
    return eqx.combine(jax.tree.unflatten(tree, [jax.numpy.asarray(a) for a in kept]), rest), history
