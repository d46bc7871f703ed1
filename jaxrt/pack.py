"""Tables of materials and textures: each distinct reflectance and texture once, with the names of its parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from .brdf import LOBES, NODES, SPECTRA, MaterialColumns
from .parts import Mesh, PhotometricWeb, SceneError, Shape, Sky, TwoSided
from .parts.textures import LUMINANCE, TEXTURES, Bitmap, Checkerboard, MeshAttribute, Product, Texture
from .scene import Slot
from .texture import table_row


class Names:
    """Unique names and the slots behind them."""

    def __init__(self) -> None:
        self.slots: dict[str, Slot] = {}
        self.taken: set[str] = set()

    def part(self, wanted: str) -> str:
        name, k = wanted, 1
        while name in self.taken:
            name, k = f"{wanted}_{k}", k + 1
        self.taken.add(name)
        return name

    def add(
        self, name: str, leaf: str, row: int | tuple[int, int], columns=None, one: bool = False, shape=None
    ) -> None:
        self.slots[name] = Slot(leaf, row, columns, one, shape)


def spread(value: np.ndarray, channels: int, name: str) -> np.ndarray:
    if value.shape[-1] not in (1, channels):
        raise SceneError(f"{name}: has {value.shape[-1]} channels where the scene has {channels}; give 1 or {channels}")
    return np.broadcast_to(value, (*value.shape[:-1], channels))


class Textures:
    """Rows of the tables of textures; row 0 stands for none."""

    def __init__(self, channels: int, names: Names):
        self.channels, self.names = channels, names
        self.layout, self.to_uv, self.texels = [[0] * 6], [np.eye(3)[:2].ravel()], [np.zeros((0, channels))]
        self._numbers: dict[Any, int] = {}
        self._kept: list[Texture] = []  # so that no other one takes its identity

    def number(self, texture: Texture, name: str, shape: Shape, first: int, single: bool) -> tuple[int, np.ndarray]:
        """Its row, and its mean. `name`: of the parameter that has it, on a shape whose faces count from `first`;
        `single`: whether that is one number, and not a spectrum."""
        key = id(texture), single, id(shape) if texture.of_mesh else 0
        if isinstance(texture, Product):
            return self._product(texture, key, name, shape, first, single)
        inner = [0, 0]
        if isinstance(texture, Checkerboard):
            values = np.zeros((2, self.channels))
            for k, c in enumerate(texture.colors):
                if isinstance(c, Texture):
                    inner[k], values[k] = self.number(c, f"{name}.color{k}", shape, first, single)
                else:
                    values[k] = self._spread(c, f"{name}.color{k}", single)
        else:
            values = self._spread(self._values(texture, name, shape), f"{name}.data", single)
        if key not in self._numbers:
            self._kept.append(texture)
            start = sum(map(len, self.texels))
            self._numbers[key] = len(self.layout)
            on_mesh = isinstance(texture, MeshAttribute)
            self.layout.append(table_row(texture, start - 3 * first if on_mesh else start, inner))
            self.to_uv.append(texture.to_uv.ravel())
            self.texels.append(values)
        number = self._numbers[key]
        start = sum(map(len, self.texels[:number]))
        self._name(texture, name, start, len(values), number)
        return number, texture.average(values)

    def _product(
        self, texture: Product, key: Any, name: str, shape: Shape, first: int, single: bool
    ) -> tuple[int, np.ndarray]:
        """As of `number`; its row names those of its factors in place of texels."""
        (a, left), (b, right) = (
            self.number(factor, f"{name}.{side}", shape, first, single)
            for side, factor in zip(("first", "second"), texture.factors, strict=True)
        )
        if key not in self._numbers:
            self._kept.append(texture)
            self._numbers[key] = len(self.layout)
            self.layout.append([TEXTURES.index(texture.kind), a, b, 0, 0, 0])
            self.to_uv.append(texture.to_uv.ravel())
            self.texels.append(np.zeros((0, self.channels)))
        return self._numbers[key], left * right

    def _spread(self, values: np.ndarray, name: str, single: bool) -> np.ndarray:
        return spread(values @ LUMINANCE[:, None] if single and values.shape[-1] == 3 else values, self.channels, name)

    def _values(self, texture: Texture, name: str, shape: Shape) -> np.ndarray:
        if not isinstance(texture, MeshAttribute):
            return texture.values()
        where = shape.id or "mesh"
        if not isinstance(shape, Mesh):
            raise SceneError(f"{name}: asks for the attribute {texture.name!r} of {where}, which is no mesh")
        return texture.on(shape.attributes, shape.faces, len(shape.vertices), where)

    def _name(self, texture: Texture, name: str, start: int, count: int, number: int) -> None:
        if isinstance(texture, Sky):
            return
        rows = start, start + count
        if isinstance(texture, PhotometricWeb):
            h, v = texture.data.shape[:2]
            self.names.add(f"{name}.data", "texels", (start + v + h, start + count), shape=(h, v, self.channels))
            return
        if isinstance(texture, Checkerboard):
            for k, c in enumerate(texture.colors):
                if not isinstance(c, Texture):
                    self.names.add(f"{name}.color{k}", "texels", start + k)
        elif isinstance(texture, Bitmap):
            self.names.add(f"{name}.data", "texels", rows, shape=(*texture.data.shape[:2], self.channels))
        else:
            self.names.add(f"{name}.data", "texels", rows, shape=(count // 3, 3, self.channels))
        self.names.add(f"{name}.to_uv", "to_uv", number, shape=(2, 3))


class Materials:
    """Rows of the material table; row 0 is black. One row for each distinct reflectance, or for each mesh that it takes
    values from."""

    def __init__(self, channels: int, names: Names, textures: Textures):
        self.columns, self.names, self.textures = MaterialColumns(channels), names, textures
        self.rows, self.row_names = [self.columns.row(LOBES["diffuse"].number)], [""]
        self._index: dict[Any, int] = {}

    def row(self, outer: Any, shape: Shape, first: int, twosided: bool = False) -> int:
        """The row of a shape's reflectance; its faces count from `first`. `twosided`: as part of one that is."""
        inner: Any = outer
        if isinstance(outer, TwoSided):
            twosided, inner = True, outer if outer.back is not None else outer.bsdf
        if not hasattr(inner, "row"):
            raise SceneError(f"{shape.id or 'shape'}: {type(inner).__name__} is not a reflectance that jaxrt knows")
        key = (
            id(outer),
            id(shape) if any(isinstance(v, Texture) and v.of_mesh for _, v in fields_of(inner)) else 0,
            twosided,
        )
        if key in self._index:
            return self._index[key]
        lobe, fields, parameters = inner.row()
        fields = dict(fields)
        for place, part in zip(("first", "second"), parts_of(inner), strict=False):
            fields[place] = float(self.row(part, shape, first, twosided))
        name = self.names.part(outer.id or inner.id or (f"{shape.id}.bsdf" if shape.id else "bsdf"))
        row = self._index[key] = len(self.rows)
        shown = {field: key for key, field in parameters.items()}
        cells: dict[str, Any] = {}
        for field, value in fields.items():
            self._put(cells, field, value, f"{name}.{shown.get(field, field)}", shape, first)
        number = NODES[lobe] if lobe in NODES else LOBES[lobe].number
        self.rows.append(self.columns.row(number, twosided, **cells))
        self.row_names.append(name)
        for key, field in parameters.items():
            if not any(isinstance(v, Texture) for v in _flat([fields[field]])):
                one = field not in SPECTRA and np.ptp(cells[field]) == 0
                self.names.add(f"{name}.{key}", "materials", row, self.columns[field], one)
        return row

    def _put(self, cells: dict[str, Any], field: str, value: Any, name: str, shape: Shape, first: int) -> None:
        """A field's cells, and the numbers of its textures beside their means."""
        single, several = field not in SPECTRA, isinstance(value, list)
        numbers, found = [], []
        for k, v in enumerate(value if several else [value]):
            number = 0
            if isinstance(v, Texture):
                same = several and k == 0 and all(w is v for w in value)
                own = name if same or not several or (k and value[0] is v) else f"{name}_{'uv'[k]}"
                number, v = self.textures.number(v, own, shape, first, single)
                v = v[0] if single else v
            elif not single:
                v = spread(v, self.columns.channels, name)
            numbers.append(number)
            found.append(v)
        cells[field] = found if several else found[0]
        if any(numbers):
            cells[f"map:{field}"] = numbers


def parts_of(bsdf: Any) -> list[Any]:
    """Reflectances that one is made of."""
    return bsdf.parts() if hasattr(bsdf, "parts") else []


def fields_of(bsdf: Any) -> Iterator[tuple[str, Any]]:
    """Names and values of all fields that a reflectance and its parts have."""
    inner: Any = bsdf.bsdf if isinstance(bsdf, TwoSided) and bsdf.back is None else bsdf
    if hasattr(inner, "row"):
        for name, value in inner.row().fields.items():
            yield from ((name, v) for v in _flat([value]))
        for part in parts_of(inner):
            yield from fields_of(part)


def _flat(values: Iterable[Any]) -> Iterable[Any]:
    for v in values:
        yield from v if isinstance(v, list) else [v]
