"""Textures looked up at a point: bitmaps, checkerboards, values of meshes, products of two, skies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from . import sky
from .parts.sky import Sky
from .parts.textures import FILTERS, TEXTURES, WRAPS, Bitmap, Texture
from .parts.web import PhotometricWeb
from .vector import Spectrum, where

if TYPE_CHECKING:
    from .scene import Scene

SKY_SIZE = (512, 256)
"""Cells of the grid by which a sky is sampled."""

LAYOUT = ("kind", "offset", "width", "height", "filter", "wrap")
"""Columns of the table of whole numbers that a texture has. A checkerboard has the numbers of the textures in its
squares, 0 for a colour, where a bitmap has its filter and how it goes on."""


class Place(eqx.Module):
    """Where on a surface a texture is looked up: coordinates, the face's row, and coordinates on the face."""

    uv: tuple[Any, Any]
    row: Any
    on_face: tuple[Any, Any]


class Textures(eqx.Module):
    """The textures of a world. `texels` (T, C); `layout`, see `LAYOUT`; `to_uv`; kinds that there are; how many
    checkerboards a texture stands in, at most."""

    texels: Any
    layout: Any
    to_uv: Any
    kinds: tuple[str, ...] = eqx.field(static=True)
    nested: int = eqx.field(static=True)

    @classmethod
    def of(cls, scene: Scene, channels: int, kinds: tuple[str, ...], nested: int) -> Textures:
        texels = scene.texels[:, :channels]
        if not len(texels):  # a plan may have textures that the scene has not
            texels = jnp.zeros((1, channels), texels.dtype)
        return cls(texels, scene.textures, scene.to_uv, kinds, nested)

    def at(self, index: Any, place: Place) -> Spectrum:
        """The value of texture `index` (1 or more; anything for less) at a place."""
        index = self._inner(index, place)
        value = self._plain(index, place)
        if "product" in self.kinds:
            layout = _row(self.layout, jnp.maximum(index, 0))
            first, second = (self._plain(self._inner(layout[k], place), place) for k in (1, 2))
            value = where(layout[0] == TEXTURES.index("product"), first * second, value)
        return value

    def _inner(self, index: Any, place: Place) -> Any:
        """From a checkerboard to the texture of the square."""
        for _ in range(self.nested):
            layout, u, v = self._place(index, place)
            inner = jnp.where(_is_first(u, v), layout[4], layout[5])
            index = jnp.where((layout[0] == TEXTURES.index("checkerboard")) & (inner > 0), inner, index)
        return index

    def _plain(self, index: Any, place: Place) -> Spectrum:
        """The value of a texture that is made of no others."""
        layout, u, v = self._place(index, place)
        value = None
        for kind in (kind for kind in self.kinds if kind in _LOOK_UP):
            one = _LOOK_UP[kind](self.texels, layout, u, v, place)
            value = one if value is None else where(layout[0] == TEXTURES.index(kind), one, value)
        assert value is not None
        return value

    def _place(self, index: Any, place: Place) -> tuple[Any, Any, Any]:
        """A texture's row of `layout`, and the coordinates of a place in it."""
        layout, m = (_row(table, jnp.maximum(index, 0)) for table in (self.layout, self.to_uv))
        u, v = (m[k] * place.uv[0] + m[k + 1] * place.uv[1] + m[k + 2] for k in (0, 3))
        return layout, u, v

    def slope(self, index: Any, place: Place) -> tuple[Any, Any]:
        """Derivatives of a bitmap's first channel with respect to u and v of the surface; 0 of other textures."""
        layout, u, v = self._place(index, place)
        m = _row(self.to_uv, jnp.maximum(index, 0))
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


def _is_first(u: Any, v: Any) -> Any:
    """Whether a point lies in a square of the first colour of a checkerboard."""
    return (u - jnp.floor(u) > 0.5) == (v - jnp.floor(v) > 0.5)


def _checkerboard(texels: Any, layout: Any, u: Any, v: Any, place: Place) -> Spectrum:
    return where(_is_first(u, v), _texel(texels, layout[1]), _texel(texels, layout[1] + 1))


def _attribute(texels: Any, layout: Any, u: Any, v: Any, place: Place) -> Spectrum:
    first = layout[1] + 3 * place.row  # the offset counts from the first face of all
    a, b, c = (_texel(texels, first + k) for k in range(3))
    s, t = place.on_face
    return a * (1.0 - s - t) + b * s + c * t


def sky_rows(texels: Any, first: Any) -> list[Spectrum]:
    """What `sky.look_up` takes, of a sky whose texels begin at `first`."""
    return [_texel(texels, first + k) for k in range(13)]


def _sky(texels: Any, layout: Any, u: Any, v: Any, place: Place) -> Spectrum:
    return sky.look_up(sky_rows(texels, layout[1]), u, v)


_LOOK_UP = {"bitmap": _bitmap, "checkerboard": _checkerboard, "attribute": _attribute, "sky": _sky}


def table_row(texture: Texture, offset: int, inner: Sequence[int]) -> list[int]:
    """The row of a texture in the table of whole numbers; `offset`: of its first texel; `inner`: numbers of the
    textures of a checkerboard."""
    if isinstance(texture, PhotometricWeb):  # which no surface has; see emitter.goniometric
        return [-1, offset, len(texture.vertical), len(texture.horizontal), 0, 0]
    kind = TEXTURES.index(texture.kind)
    if isinstance(texture, Sky):
        return [kind, offset, *SKY_SIZE, 0, 0]
    if not isinstance(texture, Bitmap):
        return [kind, offset, 1, 1, *inner]
    height, width = texture.data.shape[:2]
    return [kind, offset, width, height, FILTERS.index(texture.filter), WRAPS.index(texture.wrap)]


def inner_numbers(layout: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """The numbers of textures in the squares of checkerboards, and of the factors of products, among `numbers`."""
    of_kind = lambda kind: layout[numbers[layout[numbers, 0] == TEXTURES.index(kind)]]
    inner = np.unique(np.concatenate([of_kind("checkerboard")[:, 4:].ravel(), of_kind("product")[:, 1:3].ravel()]))
    return inner[inner > 0]


__all__ = ["LAYOUT", "Place", "Textures", "inner_numbers", "sky_rows", "table_row"]
