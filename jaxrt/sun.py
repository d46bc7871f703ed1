"""The sun of a scene: a disc infinitely far away, which rays that leave the scene meet, and light samples look for.

Its directions are drawn evenly over the disc's solid angle. Whether a direction lies in the disc is told by its
distance from the axis: a cosine in float32 would know the rim of a disc of half a degree to half a percent only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from . import parts
from .sampling.warp import uniform_cone
from .vector import Frame, Spectrum, Vec3, dot, normalise

if TYPE_CHECKING:
    from .scene import Scene


BLACK = parts.Sun(radiance=0.0).row()
"""A lamp's row of a scene into which a plan forces a sun."""


class Sun(eqx.Module):
    """`axis` towards its middle; `up`: of the disc only directions within 90° of it count, of all if it is 0; `height`,
    1 − cos of the disc's half angle; its radiance, and the chance that a light sample looks for it."""

    axis: Vec3
    up: Vec3
    height: Any
    light: Spectrum
    chance: Any

    @classmethod
    def of(cls, scene: Scene, channels: int, chances: Any) -> Sun:
        """`chances`: of each lamp of the scene. One without a sun has a black one."""
        here = (scene.lamps[:, 8] == parts.LAMPS.index("sun")) & (scene.lamp_radiance > 0)
        below = lambda table, last: jnp.concatenate([table, jnp.asarray(last, scene.lamps.dtype)[None]])
        k = jnp.argmax(jnp.append(here, True))
        row = sg(below(scene.lamps, BLACK)[k])
        light = below(scene.radiance[scene.lamp_radiance], np.zeros(scene.radiance.shape[1]))[k, :channels]
        chance = sg(below(chances, 0.0)[k])
        return cls(normalise(-Vec3.of(row[3:6])), Vec3.of(row[9:12]), row[6], Spectrum.of(light), chance)

    def sample(self, u: tuple[Any, Any]) -> Vec3:
        """A direction into the disc."""
        return Frame.around(self.axis).to_world(uniform_cone(u, self.height))

    def radiance(self, w: Vec3) -> Spectrum:
        """What comes from direction ω (W·m⁻²·sr⁻¹)."""
        there = self._within(w) & (dot(w, self.up) >= 0)
        return self.light.map(lambda c: jnp.where(there, c, 0.0))

    def density(self, w: Vec3) -> Any:
        """Density (sr⁻¹) with which light samples take direction ω."""
        return jnp.where(self._within(w), self.chance / (2.0 * np.pi * self.height), 0.0)

    def _within(self, w: Vec3) -> Any:
        off = w - self.axis
        return dot(off, off) <= 2.0 * self.height
