"""Textures looked up at a point: bitmaps, checkerboards, and values of a mesh's vertices or faces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp

from .parts.textures import FILTERS, TEXTURES, WRAPS, Bitmap, Texture
from .vector import Spectrum, where

if TYPE_CHECKING:
    from .scene import Scene

LAYOUT = ("kind", "offset", "width", "height", "filter", "wrap")
"""Columns of the table of whole numbers that a texture has."""


class Place(eqx.Module):
    """Where on a surface a texture is looked up: coordinates, the face's row, and coordinates on the face."""

    uv: tuple[Any, Any]
    row: Any
    on_face: tuple[Any, Any]


class Textures(eqx.Module):
    """The textures of a world. `texels` (T, C); `layout`, see `LAYOUT`; `to_uv`; kinds that there are."""

    texels: Any
    layout: Any
    to_uv: Any
    kinds: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, scene: Scene, channels: int, kinds: tuple[str, ...]) -> Textures:
        texels = scene.texels[:, :channels]
        if not len(texels):  # a plan may have textures that the scene has not
            texels = jnp.zeros((1, channels), texels.dtype)
        return cls(texels, scene.textures, scene.to_uv, kinds)

    def at(self, index: Any, place: Place) -> Spectrum:
        """The value of texture `index` (1 or more; anything for less) at a place."""
        layout, m = (_row(table, jnp.maximum(index, 0)) for table in (self.layout, self.to_uv))
        u, v = (m[k] * place.uv[0] + m[k + 1] * place.uv[1] + m[k + 2] for k in (0, 3))
        value = None
        for kind in self.kinds:
            one = _LOOK_UP[kind](self.texels, layout, u, v, place)
            value = one if value is None else where(layout[0] == TEXTURES.index(kind), one, value)
        assert value is not None
        return value

    def slope(self, index: Any, place: Place) -> tuple[Any, Any]:
        """Derivatives of a bitmap's first channel with respect to u and v of the surface; 0 of other textures."""
        layout, m = (_row(table, jnp.maximum(index, 0)) for table in (self.layout, self.to_uv))
        u, v = (m[k] * place.uv[0] + m[k + 1] * place.uv[1] + m[k + 2] for k in (0, 3))
        (a, b), (c, d), fu, fv = _four(self.texels[:, :1], layout, u, v)
        low, high = b.channels[0] - a.channels[0], d.channels[0] - c.channels[0]
        left, right = c.channels[0] - a.channels[0], d.channels[0] - b.channels[0]
        du = (low + (high - low) * fv) * layout[2]
        dv = (left + (right - left) * fu) * layout[3]
        flat = layout[0] != TEXTURES.index("bitmap")
        return jnp.where(flat, 0.0, du * m[0] + dv * m[3]), jnp.where(flat, 0.0, du * m[1] + dv * m[4])


def _row(table: Any, index: Any) -> Any:
    return table.at[index].get(mode="clip", wrap_negative_indices=False)


def _texel(texels: Any, at: Any) -> Spectrum:
    row = _row(texels, at)
    return Spectrum(tuple(row[c] for c in range(texels.shape[1])))


def _wrapped(k: Any, n: Any, mode: Any) -> Any:
    """The texel of a row of n that stands at k, which may lie outside."""
    around = jnp.mod(k, n)
    back = jnp.mod(k, 2 * n)
    mirrored = jnp.where(back < n, back, 2 * n - 1 - back)
    return jnp.where(mode == 0, around, jnp.where(mode == 1, mirrored, jnp.clip(k, 0, n - 1)))


def _four(texels: Any, layout: Any, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
    """The four texels around a point, by rows, and how far it lies between them."""
    offset, width, height, smooth, wrap = (layout[k] for k in range(1, 6))
    half = jnp.where(smooth == 1, 0.5, 0.0)
    x, y = u * width - half, v * height - half
    x0, y0 = jnp.floor(x), jnp.floor(y)
    fx, fy = (jnp.where(smooth == 1, a, 0.0) for a in (x - x0, y - y0))
    columns = [_wrapped(x0.astype(jnp.int32) + k, width, wrap) for k in (0, 1)]
    rows = [offset + width * _wrapped(y0.astype(jnp.int32) + k, height, wrap) for k in (0, 1)]
    first, second = ([_texel(texels, row + column) for column in columns] for row in rows)
    return first, second, fx, fy


def _bitmap(texels: Any, layout: Any, u: Any, v: Any, place: Place) -> Spectrum:
    (a, b), (c, d), fx, fy = _four(texels, layout, u, v)
    low, high = a + (b - a) * fx, c + (d - c) * fx
    return low + (high - low) * fy


def _checkerboard(texels: Any, layout: Any, u: Any, v: Any, place: Place) -> Spectrum:
    same = (u - jnp.floor(u) > 0.5) == (v - jnp.floor(v) > 0.5)
    return where(same, _texel(texels, layout[1]), _texel(texels, layout[1] + 1))


def _attribute(texels: Any, layout: Any, u: Any, v: Any, place: Place) -> Spectrum:
    first = layout[1] + 3 * place.row  # the offset counts from the first face of all
    a, b, c = (_texel(texels, first + k) for k in range(3))
    s, t = place.on_face
    return a * (1.0 - s - t) + b * s + c * t


_LOOK_UP = {"bitmap": _bitmap, "checkerboard": _checkerboard, "attribute": _attribute}


def table_row(texture: Texture, offset: int) -> list[int]:
    """The row of a texture in the table of whole numbers; `offset`: of its first texel."""
    kind = TEXTURES.index(texture.kind)
    if not isinstance(texture, Bitmap):
        return [kind, offset, 1, 1, 0, 0]
    height, width = texture.data.shape[:2]
    return [kind, offset, width, height, FILTERS.index(texture.filter), WRAPS.index(texture.wrap)]


__all__ = ["LAYOUT", "Place", "Textures", "table_row"]
