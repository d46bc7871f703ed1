"""A scene as a plan sees it: host arrays, names of its parts, and which values may be relied on."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from ..brdf import LOBES, MAPPED, NODES, MaterialColumns
from ..parts.textures import FILTERS, TEXTURES
from ..scene import KINDS, Scene
from ..texture import inner_numbers
from .static import Assumption


class Facts:
    """Made once a plan. `free`: as `plan` takes it; `backend`: of the ray search, and why."""

    def __init__(self, scene: Scene, free: str | Iterable[str] | None, backend: tuple[str, str] = ("dense", "")):
        self.scene, self.structure, self.backend = scene, scene.structure, backend
        self.materials, self.radiance = np.asarray(scene.materials), np.asarray(scene.radiance)
        self.radiance_map, self.layout = np.asarray(scene.radiance_map), np.asarray(scene.textures)
        self.counts, self.columns = np.asarray(scene.counts), MaterialColumns(scene.channels)
        lights = np.asarray(scene.lights)
        self.lights = lights[lights >= 0]
        finishes, shape_finish = np.asarray(scene.finishes), np.asarray(scene.shape_finish)
        self.light_rows = sorted(set(finishes[shape_finish[np.asarray(scene.face_shape)[self.lights]], 1].tolist()))
        self.lamp_rows, self.lamps = np.asarray(scene.lamp_radiance), np.asarray(scene.lamps)
        used = finishes[np.unique(shape_finish)]
        self.material_rows, self.depth = self._rows({int(r) for r in used[:, 0]} - {0})
        self.radiance_rows = sorted({int(r) for r in (*used[:, 1], *self.lamp_rows)} | {1})
        self._free = self._free_rows(free)

    def _rows(self, rows: set[int]) -> tuple[list[int], int]:
        """Rows of materials that are used, those of which others are made included, and how deep these stand."""
        inner, depth = rows, -1
        while inner:  # level by level
            rows, depth = rows | inner, depth + 1
            made = [r for r in inner if self.materials[r, self.columns["lobe"][0]] > 99.5]
            inner = {int(self.materials[r, self.columns[k][0]]) for r in made for k in ("first", "second")} - {0}
        return sorted(rows), max(depth, 0)

    def _free_rows(self, free: str | Iterable[str] | None) -> dict[str, set[Any]]:
        slots = self.structure.slots
        if free != ():
            names, patterns = (
                [name for name, _ in slots],
                [] if free is None else [free] if isinstance(free, str) else free,
            )
            found = set()
            for pattern in patterns:
                matching = fnmatch.filter(names, pattern)
                found.update(matching)
                if not matching:
                    self.structure.slot(pattern)  # raises with the closest names
            slots = [(name, slot) for name, slot in slots if name in found]
        rows: dict[str, set[Any]] = {}
        for _, slot in slots:
            rows.setdefault(slot.leaf, set()).add(slot.row)
        return rows

    def fixed(self, leaf: str, row: int | None = None) -> bool:
        """Whether no free parameter lives in a table (or in one of its rows)."""
        free = self._free.get(leaf, set())
        return not free if row is None else row not in free

    def assume(
        self, effect: str, leaf: str, rows: Iterable[int] | None, fields: Iterable[str] | None, holds: str, what: str
    ) -> Assumption:
        columns = None if fields is None else tuple(self.columns[f] for f in fields)
        return Assumption(effect, leaf, None if rows is None else tuple(rows), columns, holds, what, self.fixed(leaf))

    def field(self, name: str) -> np.ndarray:
        """A field of all materials in use, (rows, cells)."""
        return self.materials[self.material_rows, slice(*self.columns[name])]

    @cached_property
    def numbers(self) -> np.ndarray:
        """Which lobe, or kind of node, each material in use is."""
        return self.field("lobe")[:, 0].astype(int)

    def of_materials(self, mask: Any) -> list[str]:
        """Names of the materials in use for which `mask` is true."""
        names = self.structure.materials
        return [names[self.material_rows[k]] for k in np.flatnonzero(mask)]

    def of_lights(self, rows: Iterable[int]) -> list[str]:
        return [self.structure.emitters[r] for r in rows]

    def dark(self, row: int) -> bool:
        """Whether a row of radiance is 0 for certain."""
        return self.fixed("radiance", row) and not self.radiance[row].any() and self.radiance_map[row] == 0

    @cached_property
    def maps(self) -> dict[str, np.ndarray]:
        """Numbers of textures of each field that has some, for the materials in use."""
        found = {f: self.field(f"map:{f}").astype(int) for f in MAPPED}
        return {f: numbers for f, numbers in found.items() if numbers.any()}

    def textured(self, kind: str) -> tuple[set[str], bool, list[str]]:
        """What has textures of a kind, alone or in others: fields of materials, whether lights do, and names of the
        parameters."""
        own = self.layout[:, 0] == TEXTURES.index(kind)
        rows = np.array([k for k in range(1, len(self.layout)) if own[self._within(k)].any()], int)
        if not rows.size:
            return set(), False, []
        fields = {f for f, numbers in self.maps.items() if np.isin(numbers, rows).any()}
        lit = bool(np.isin(self.radiance_map[self.radiance_rows], rows).any())
        slots = self.structure.slots if fields or lit else ()
        at = np.flatnonzero(own)
        return fields, lit, [name.removesuffix(".to_uv") for name, s in slots if s.leaf == "to_uv" and s.row in at]

    def _within(self, number: int) -> list[int]:
        """A texture, and all that it is made of."""
        found = [number]
        for k in found:
            found += inner_numbers(self.layout, np.array([k])).tolist()
        return found

    @cached_property
    def nested(self) -> int:
        """How many checkerboards a texture in use stands in, at most."""
        numbers = [self.radiance_map[self.radiance_rows].ravel(), *(n.ravel() for n in self.maps.values())]

        def depth(k: int) -> int:
            inner = [depth(j) for j in inner_numbers(self.layout, np.array([k])).tolist()]
            is_board = self.layout[k, 0] == TEXTURES.index("checkerboard")
            return max(inner) + int(is_board) if inner else 0

        return max((depth(int(k)) for k in np.unique(np.concatenate(numbers)) if k > 0), default=0)

    @property
    def web(self) -> int:
        """Angles of the finest photometric web."""
        webs = self.radiance_map[self.radiance_rows]
        return int(self.layout[webs[self.layout[webs, 0] < 0], 2:4].max(initial=0))

    @cached_property
    def light_kinds(self) -> tuple[str, ...]:
        """Kinds of the faces that emit."""
        return tuple(KINDS[k] for k in np.unique(np.searchsorted(np.cumsum(self.scene.blocks), self.lights, "right")))

    @cached_property
    def smooth_lights(self) -> list[str]:
        """Names of the emitters of faces that have vertex normals."""
        scene, faces = self.scene, self.lights[self.lights < self.scene.blocks[0]]
        bent = np.abs(np.asarray(scene.normals)[np.asarray(scene.triangles)[faces]]).any((1, 2))
        finish = np.asarray(scene.shape_finish)[np.asarray(scene.face_shape)[faces[bent]]]
        return self.of_lights(np.unique(np.asarray(scene.finishes)[finish, 1]).tolist())

    @property
    def nearest(self) -> bool:
        """Whether a bitmap is looked up without interpolation."""
        bitmaps = self.layout[(self.layout[:, 0] == TEXTURES.index("bitmap")) & (self.layout[:, 2] > 0)]  # not padding
        return bool((bitmaps[:, 4] == FILTERS.index("nearest")).any())

    @property
    def bent_mirrors(self) -> bool:
        """Whether a material with a delta part is on a curved face or one that shades so, or has its normals turned."""
        numbers = [lobe.number for lobe in LOBES.values() if lobe.delta]
        deltas: set[int] = {r for r, n in zip(self.material_rows, self.numbers.tolist(), strict=True) if n in numbers}
        made = self._rows_of(deltas)
        scene = self.scene
        of_shape = np.asarray(scene.finishes)[np.asarray(scene.shape_finish), 0]
        face_shape, flat = np.asarray(scene.face_shape), sum(scene.blocks[:3])
        curved: set[int] = set(face_shape[flat:].tolist()) if self.counts[3:].any() else set()
        smooth = np.flatnonzero(np.abs(np.asarray(scene.normals)[np.asarray(scene.triangles)]).any(axis=(1, 2)))
        curved |= set(face_shape[smooth].tolist())
        tilted = bool(deltas) and any(NODES[k] in self.numbers for k in ("normalmap", "bumpmap"))
        return tilted or any(int(of_shape[k]) in made for k in curved)

    def _rows_of(self, rows: set[int]) -> set[int]:
        """Rows of materials, and of those that are made of them."""
        parts = [self.columns[k][0] for k in ("first", "second")]
        for _ in range(self.depth):
            nodes = [r for r in self.material_rows if self.materials[r, self.columns["lobe"][0]] > 99.5]
            rows = rows | {r for r in nodes if set(self.materials[r, parts].astype(int)) & rows}
        return rows

    @property
    def curved(self) -> bool:
        return bool(self.counts[2:].any())
