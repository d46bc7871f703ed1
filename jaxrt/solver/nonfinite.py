"""Samples that are no numbers: which they are, and where on their way they ceased to be.

Looked for only where a picture holds such a value; the paths are then followed once more, edge by edge.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..compiler import program
from ..scene import Structure
from ..surface import radiance_of, surface_point
from . import path

LANES, EDGES, CALLS = 256, 64, 64
"""Samples that are followed at once, edges up to which they are, and how often that is done for a picture."""

KEPT = 8
"""Samples that are told of."""

EFFECTS = ("", "camera", "geometry", "emission", "light sample", "reflection")


class Edge(NamedTuple):
    """Where an edge of a path ends: shape and number of the face, position (m); throughput and radiance after it."""

    shape: str
    face: int
    position: np.ndarray
    throughput: np.ndarray
    radiance: np.ndarray


@dataclasses.dataclass(frozen=True)
class NonFinite:
    """A sample that is no number. pixel: row and column; effect: camera, geometry, emission, light sample or
    reflection, whichever first gave none; edges: the path up to there."""

    pixel: tuple[int, int]
    sample: int
    effect: str
    edges: tuple[Edge, ...]

    @property
    def face(self) -> int:
        return self.edges[-1].face if self.edges else -1

    def __str__(self) -> str:
        last = f" on {self.edges[-1].shape}, face {self.face}, edge {len(self.edges)}" if self.edges else ""
        return f"pixel ({self.pixel[1]}, {self.pixel[0]}), sample {self.sample}: {self.effect}{last}"

    def report(self) -> str:
        """All of the path, a line for each edge."""
        said = lambda a: ", ".join(f"{v:.6g}" for v in np.ravel(a))
        lines = [f"a sample is not finite: {self}"]
        for k, e in enumerate(self.edges, 1):
            lines.append(
                f"  edge {k}: {e.shape}, face {e.face}, at ({said(e.position)}), "
                f"throughput ({said(e.throughput)}), radiance ({said(e.radiance)})"
            )
        return "\n".join(lines)


class NonFiniteError(FloatingPointError):
    """The first sample that is no number, of a render that was asked to stop there."""


def follow(world: Any, begin: Any, depths: Any, seed: Any, numbers: Any, samples: Any, field: Any) -> Any:
    """Of samples (N,) of pixels (N,): whether each is finite, and by edge (EDGES, ...) face, position, throughput,
    radiance, what was no number after it (of `EFFECTS`), and whether the path was there."""
    begin = begin if field is None else path.Watched(begin)
    none = lambda *parts: ~jnp.isfinite(jnp.concatenate([part.array() for part in parts])).all()

    def one(number: Any, sample: Any) -> Any:
        s = path.sample_stream(seed, number, sample, field)
        state = begin(world, number, s)
        lost = none(state.o, state.d, state.beta)

        def step(carry: Any, _: Any) -> Any:
            state, cause = carry
            face = world.search.closest(state.o, state.d)
            x = surface_point(world, face, state.o, state.d)
            turn = path.bounce_stream(s, state.depth)
            if field is None:
                after = path.bounce(world, depths, state, turn)
            else:
                after = field.bounce(world, depths, state, turn, path.set_of(sample, field))[0]
            shines = none(radiance_of(world, x, -state.d))
            found = jnp.where(none(x.position, x.normal, x.shading), 2, 0)
            found = jnp.where((found == 0) & none(after.radiance) & shines, 3, found)
            found = jnp.where((found == 0) & none(after.beta), 5, found)
            found = jnp.where((found == 0) & none(after.radiance), 4, found)
            found = jnp.where(state.alive & (cause == 0), found, 0)
            edge = face, x.position.array(), after.beta.array(), after.radiance.array(), found, state.alive
            after = jax.tree.map(lambda a, b: jnp.where(state.alive, a, b), after, state)
            return (after, jnp.maximum(cause, found)), edge

        start = state, jnp.where(lost, 1, 0)
        (state, cause), edges = jax.lax.scan(step, start, None, length=EDGES)
        return none(state.radiance) | (cause > 0), lost, edges

    return jax.vmap(one)(numbers, samples)


def located(
    workers: Any, seed: Any, structure: Structure, pixels: np.ndarray, taken: np.ndarray
) -> tuple[int, list[NonFinite]]:
    """How many samples of these pixels are not finite, of as many as are looked at, and the first of them.

    `taken`: samples of each pixel. None may be found: on paths of more than `EDGES` edges, and where the sum of a pixel
    is beyond what its type holds though no sample is.
    """
    world, view, depths = workers.args
    lanes = np.zeros(LANES, np.int32)
    args = world, view, depths, workers.seeded(seed), lanes, lanes, workers.field
    run = program(follow, *args, keep=world.plan.storable)
    count, told = 0, []
    for _, (numbers, samples) in zip(range(CALLS), _batches(pixels, taken), strict=False):
        filled = np.resize(numbers, LANES), np.resize(samples, LANES)
        found = jax.tree.map(np.asarray, run(*args[:4], *filled, workers.field))
        bad = np.flatnonzero(found[0][: len(numbers)])
        count += len(bad)
        for k in bad[: KEPT - len(told)]:
            one = jax.tree.map(lambda a, k=k: a[k], found)
            told.append(_told(one, structure, int(numbers[k]), int(samples[k]), workers.size[0]))
    return count, told


def refuse(workers: Any, seed: Any, structure: Structure, part: tuple[np.ndarray, ...], sums: np.ndarray) -> None:
    """Raises `NonFiniteError` if sums of samples first ... last of pixels, `part`, hold what is not finite."""
    bad = ~np.isfinite(sums).all((1, 2))
    if bad.any():
        first = located(workers, seed, structure, part[0][bad], part[2][bad])[1]
        raise NonFiniteError(first[0].report() if first else f"the sum of pixel {part[0][bad][0]} is not finite")


def _batches(pixels: np.ndarray, taken: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for pixel, n in zip(pixels, taken, strict=True):
        for first in range(0, int(n), LANES):
            samples = np.arange(first, min(first + LANES, int(n)), dtype=np.int32)
            yield np.full(len(samples), pixel, np.int32), samples


def _told(one: Any, structure: Structure, number: int, sample: int, width: int) -> NonFinite:
    _, lost, (face, position, throughput, radiance, found, alive) = one
    last = int(np.argmax(found > 0)) if (found > 0).any() else int(alive.sum()) - 1
    name = functools.partial(_shape, structure)
    edges = [
        Edge(name(int(face[k])), int(face[k]), position[k], throughput[k], radiance[k])
        for k in (() if lost else range(last + 1))
    ]
    effect = "camera" if lost else EFFECTS[int(found.max())] or "sum"
    return NonFinite((number // width, number % width), sample, effect, tuple(edges))


def _shape(structure: Structure, face: int) -> str:
    """The shape to which a face belongs."""
    if face < 0:
        return "enclosure"
    return next((name for name, _, start, stop in structure.shapes if start <= face < stop), "an instance")


__all__ = ["NonFinite", "NonFiniteError", "located", "refuse"]
