"""How paths begin: at a sensor's pixels, along given rays, at irradiance meters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from .. import emitter
from ..rules import balance
from ..sampling.sobol import Drawn, Stream
from ..sampling.warp import cosine_hemisphere
from ..scene import SensorStructure
from ..sensor import camera, film
from ..vector import Frame, Vec3, dot, normalise
from ..world import World
from .path import PathState, hidden, start


class View(eqx.Module):
    """Paths of a sensor's pixels (row · width + column, and the same again from height · width on). What is compiled of
    it is static."""

    to_world: Any
    lens: Any
    width: Any
    height: Any
    window: Any  # where on a film of which size the picture lies, in pixels: x, y, width, height
    sensor: SensorStructure = eqx.field(static=True)
    searches: ClassVar[bool] = False

    def __call__(self, world: World, number: Any, s: Stream | Drawn) -> PathState:
        column, row = (k.astype(self.lens.dtype) for k in (number % self.width, number // self.width % self.height))
        pixel = film.pixel(self.sensor.film, column, row, self.width, self.height)
        at = world.settle(film.sample(self.sensor.film, pixel, s.pair_at(0)))
        u = s.pair_at(1) if camera.uses_lens(self.sensor) else None
        return start(world, *camera.ray(self.sensor, self.to_world, self.lens, self.window, at, u))


class Rays(eqx.Module):
    """Paths along given rays, (N, 3) each."""

    points: Any
    directions: Any
    searches: ClassVar[bool] = False

    def __call__(self, world: World, number: Any, s: Stream) -> PathState:
        return start(world, Vec3.of(self.points[number]), normalise(Vec3.of(self.directions[number])))


class Meters(eqx.Module):
    """Paths that end at irradiance meters: β = π by cosine sampling, and a light sample already counted."""

    points: Any
    normals: Any
    searches: ClassVar[bool] = True

    def frame(self, world: World, number: Any) -> tuple[Vec3, Frame]:
        frame = Frame.around(normalise(Vec3.of(self.normals[number])))
        return Vec3.of(self.points[number]) + frame.n * world.epsilon, frame

    def __call__(self, world: World, number: Any, s: Stream) -> PathState:
        at, frame = self.frame(world, number)
        local = cosine_hemisphere(s.pair_at(0))
        w = sg(frame.to_world(local))
        cos = dot(frame.n, w)
        begun = start(world, at, w)
        beta = begun.beta * (np.pi * cos / sg(cos))
        begun = replace(begun, beta=beta, pdf=sg(cos) / np.pi, delta=begun.delta & False)
        if not world.plan.lights:
            return begun
        light = emitter.sample(world, at, s.child(3), 1, frame.n)
        cos = dot(frame.n, light.w)
        ok = (light.pdf > 0) & (cos > 0)
        ok = ok & ~hidden(world, at, light, ok)
        share = sg(balance(light.known, jnp.maximum(cos, 0.0) / np.pi))
        scale = jnp.where(ok, cos * light.jacobian * share / jnp.where(ok, light.pdf, 1.0), 0.0)
        return replace(begun, radiance=light.radiance * scale)
