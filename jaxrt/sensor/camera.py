"""Cameras: a position on the film and on the lens → a ray. Own space looks along +z, +y up, +x left."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from ..sampling.warp import uniform_disk
from ..scene import SensorStructure
from ..vector import Vec3, normalise, transform_point, transform_vector


def half_width(fov_axis: str, fov: Any, aspect: Any) -> Any:
    """Half the width of the picture at distance 1, for a field of view in degrees along an axis."""
    t = jnp.tan(jnp.deg2rad(0.5 * fov))
    if fov_axis == "diagonal":
        return t * aspect / jnp.sqrt(1.0 + aspect * aspect)
    if fov_axis == "x":
        return t
    if fov_axis == "y":
        return t * aspect
    wide = aspect >= 1
    return jnp.where(wide if fov_axis == "larger" else ~wide, t, t * aspect)


def _perspective(x: Any, y: Any, lens: Any, u: Any) -> tuple[Vec3, Vec3]:
    d = normalise(Vec3(x, y, jnp.ones_like(x)))
    return d * (lens[1] / d.z), d


def _thinlens(x: Any, y: Any, lens: Any, u: Any) -> tuple[Vec3, Vec3]:
    a, b = uniform_disk(u)
    on_lens = Vec3(a * lens[3], b * lens[3], jnp.zeros_like(a))
    d = normalise(Vec3(x, y, jnp.ones_like(x)) * lens[4] - on_lens)
    return on_lens + d * (lens[1] / d.z), d


def _orthographic(x: Any, y: Any, lens: Any, u: Any) -> tuple[Vec3, Vec3]:
    one = jnp.ones_like(x)
    return Vec3(x, y, one * lens[1]), Vec3(0.0 * one, 0.0 * one, one)


CAMERAS: dict[str, Callable[..., tuple[Vec3, Vec3]]] = {
    "perspective": _perspective,
    "thinlens": _thinlens,
    "orthographic": _orthographic,
}


def ray(
    sensor: SensorStructure, to_world: Any, lens: Any, window: Any, at: tuple[Any, Any], u: Any
) -> tuple[Vec3, Vec3]:
    """Origin (on the near plane) and unit direction through a position `at` of the picture, in pixels.

    `lens`: fov (degrees), near, far, aperture radius, focus distance (m); `window`: the picture's corner on the film
    that it is cut from, and that film's width and height, in pixels; `u`: a pair in [0, 1) for the lens.
    """
    left, top, width, height = (window[k] for k in range(4))
    aspect = width / height
    half = jnp.ones_like(lens[0]) if sensor.kind == "orthographic" else half_width(sensor.fov_axis, lens[0], aspect)
    x = (1.0 - 2.0 * (at[0] + left) / width) * half
    y = (1.0 - 2.0 * (at[1] + top) / height) * (half / aspect)
    o, d = CAMERAS[sensor.kind](x, y, lens, u)
    return transform_point(to_world, o), normalise(transform_vector(to_world, d))


def position(
    sensor: SensorStructure, to_local: Any, lens: Any, window: Any, p: Vec3, u: Any
) -> tuple[tuple[Any, Any], Any]:
    """Where on the picture (pixels) a point of the world lies, seen through the place u of the lens, and how far in
    front of the camera (m). The inverse of `ray`; `to_local` that of the sensor's `to_world`."""
    left, top, width, height = (window[k] for k in range(4))
    aspect = width / height
    p = transform_point(to_local, p)
    z = jnp.where(p.z == 0, 1.0, p.z)
    if sensor.kind == "orthographic":
        half, x, y = jnp.ones_like(lens[0]), p.x, p.y
    else:
        half, x, y = half_width(sensor.fov_axis, lens[0], aspect), p.x / z, p.y / z
        if uses_lens(sensor) and u is not None:
            a, b = uniform_disk(u)
            back = 1.0 / lens[4] - 1.0 / z
            x, y = x + a * lens[3] * back, y + b * lens[3] * back
    return (0.5 * (1.0 - x / half) * width - left, 0.5 * (1.0 - y * aspect / half) * height - top), p.z


def uses_lens(sensor: SensorStructure) -> bool:
    return sensor.kind == "thinlens"


__all__ = ["CAMERAS", "half_width", "position", "ray", "uses_lens"]
