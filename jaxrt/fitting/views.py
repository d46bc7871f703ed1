"""Views of a scene with their target pictures, and how far from these the scene's own pictures are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32

from ..parts import SceneError
from ..scene import CAMERAS, Scene
from ..solver.measure import measure, view_of
from ..solver.render import resized
from .losses import Loss


class Views(eqx.Module):
    """Sensors that are alike but for place and lens, so that one program measures them one after another."""

    targets: Float[Array, "V H W C"]
    levels: Float[Array, " V"]  # root mean square of each
    rows: Int32[Array, " V"]  # of tables of sensors
    sensor: int = eqx.field(static=True)  # one of them

    def view(self, scene: Scene, k: Any) -> Scene:
        """The scene whose sensor `sensor` is view k, in the targets' size."""
        _, height, width, _ = self.targets.shape
        if scene.structure.sensors[self.sensor].film[:2] != (width, height):
            scene = resized(scene, self.sensor, width, height)
        if len(self.rows) == 1:
            return scene
        row, lens, place = scene.structure.sensors[self.sensor].row, scene.lens, scene.sensor_to_world
        place, lens = (a.at[row].set(a[self.rows[k]]) for a in (place, lens))
        return dataclasses.replace(scene, sensor_to_world=place, lens=lens)


def checked(scene: Scene, targets: Any, sensor: int | Sequence[int]) -> list[tuple[int, np.ndarray]]:
    """Numbers of sensors and their targets. Raises `SceneError` for targets that are not pictures of theirs."""
    one = isinstance(sensor, (int, np.integer))
    sensors, targets = ([sensor], [targets]) if one else (list(sensor), list(targets))
    if not sensors or len(targets) != len(sensors):
        raise SceneError(f"targets: are {len(targets)} pictures for {len(sensors)} sensors; give one for each")
    found = []
    for k, target in zip(sensors, targets, strict=True):
        view_of(scene, k)
        structure, target = scene.structure.sensors[k], np.asarray(target, float)
        channels = scene.channels if structure.tones(scene.channels) is None else 1
        want = (structure.film[1], structure.film[0], channels)
        if target.shape != want:
            raise SceneError(f"targets: that of sensor {k} has shape {target.shape}; give {want}, or resize the sensor")
        if not np.isfinite(target).all():
            raise SceneError(f"targets: that of sensor {k} has values that are not finite; mend these pixels")
        found.append((k % len(scene.structure.sensors), target))
    return found


def views_of(scene: Scene, pairs: list[tuple[int, np.ndarray]], factor: int = 1) -> tuple[Views, ...]:
    """Targets averaged over squares of `factor` pixels, those of sensors that are alike together."""
    alike: dict[Any, list[tuple[int, np.ndarray]]] = {}
    for k, target in pairs:
        structure = scene.structure.sensors[k]
        height, width, channels = target.shape
        if height % factor or width % factor:
            raise SceneError(f"coarse: {factor} does not divide a picture of {width}x{height}; give a divisor of both")
        small = target.reshape(height // factor, factor, width // factor, factor, channels).mean((1, 3))
        kind = dataclasses.replace(structure, row=0) if structure.kind in CAMERAS else k
        alike.setdefault(kind, []).append((k, small))
    made = []
    for members in alike.values():
        stack = np.stack([small for _, small in members])
        rows = [scene.structure.sensors[k].row for k, _ in members]
        levels = np.sqrt((stack**2).mean((1, 2, 3)))
        stack, levels = jnp.asarray(stack, float), jnp.asarray(levels, float)
        made.append(Views(stack, levels, jnp.asarray(rows, jnp.int32), members[0][0]))
    return tuple(made)


@dataclasses.dataclass(frozen=True)
class Measuring:
    """How views are measured: `loss`, samples a pixel, the number of pixels of each (None: all), and how `measure` is
    called. Static."""

    loss: Loss
    spp: int
    pixels: int | None
    plan: Any
    max_depth: int
    boundary: bool

    def residuals(self, scene: Scene, views: Views, key: Any, takes: int = 1) -> Array:
        """Of each view, from `takes` independent pictures of the same pixels: (V, takes, ...)."""
        count, height, width, channels = views.targets.shape
        some = None if self.pixels is None or self.pixels >= height * width else self.pixels

        def one(number: Any) -> Any:
            k, own = number // takes, jax.random.fold_in(key, number)
            target, chosen = views.targets[k], None
            if some is not None:
                chosen = scattered(jax.random.fold_in(jax.random.fold_in(key, 0x7069), k), some, height * width)
                target = target.reshape(-1, channels)[chosen]
            image = measure(
                views.view(scene, k), own, plan=self.plan, spp=self.spp, max_depth=self.max_depth,
                sensor=views.sensor, boundary=self.boundary, pixels=chosen,
            )  # fmt: skip
            return self.loss.residuals(image, target, views.levels[k])

        if count * takes == 1:
            return one(0)[None, None]
        found = jax.lax.map(one, jnp.arange(count * takes))
        return found.reshape(count, takes, *found.shape[1:])


def scattered(key: Any, some: int, n: int) -> Int32[Array, " some"]:
    """Numbers below n, one at random from each of `some` parts of equal size: each as likely as any other."""
    at = (np.arange(some) + jax.random.uniform(key, (some,))) * (n / some)
    return jnp.minimum(at.astype(jnp.int32), n - 1)
