"""How elements are made, on the host: faces cut into graded cells, or small faces brought together."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..brdf import LOBES, NODES, MaterialColumns
from ..scene import KINDS, Scene
from ..world import AREA, FACE, World
from .elements import Elements

EVERYWHERE = 0.25
"""The share of all faces' area from which on emitters are met by links rather than sampled."""

FINER = 4
"""Into so many parts along each side a cell is cut on which another surface stands."""


def spaced(t: np.ndarray) -> np.ndarray:
    """The inverse of `graded`. Symmetric, so that the long side of a triangle goes through corners of cells."""
    return np.where(t < 0.5, 2.0 * t * t, 1.0 - 2.0 * (1.0 - t) ** 2)


def bucket(n: int) -> int:
    """The least size of a few (eight an octave) that holds n."""
    step = 1 << max(int(n - 1).bit_length() - 4, 3)
    return -(-n // step) * step


def areas_of_faces(world: World) -> np.ndarray:
    """Of one side of each, m². In numpy, for JAX would be started op by op."""
    geometry = np.asarray(world.geometry, np.float64)
    area = np.linalg.norm(np.cross(geometry[:, 3:6], geometry[:, 6:9]), axis=1)
    return area * np.repeat([AREA[k] for k in KINDS], world.blocks)


def diffuse_sides(world: World, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """For each side of a face: whether it is diffuse, and whether it is black: neither reflects nor transmits."""
    plan, faces, rows = world.plan, sum(world.blocks), np.asarray(world.faces)
    counts = np.asarray(scene.counts)
    used = np.concatenate([np.arange(n) < counts[k] for k, n in enumerate(world.blocks)])
    finish = rows[:faces, FACE["finish"]].astype(int)
    columns, table = MaterialColumns(plan.channels, plan.fields), np.asarray(world.finishes)
    field = lambda name: table[finish, columns[name][0]] if name in plan.fields else None
    lobe, two = field("lobe"), field("twosided")
    diffuse = np.full(faces, plan.lobes == ("diffuse",)) if lobe is None else lobe == LOBES["diffuse"].number
    two = np.full(faces, plan.twosided == "all") if two is None else two > 0.5
    through = [LOBES[name].number for name in plan.lobes if LOBES[name].transmits]
    through = np.isin(lobe, [*through, *NODES.values()]) if lobe is not None else np.full(faces, bool(through))
    if (maps := field("map:reflectance")) is not None:  # what varies within an element is followed, not stored
        diffuse &= maps == 0
    diffuse, reflects = diffuse & used, np.concatenate([used, used & two])
    return np.concatenate([diffuse, diffuse]) & reflects, ~(reflects | np.concatenate([used & through] * 2))


@dataclasses.dataclass
class _Sides:
    """The sides of faces that are cut into elements: number and face of each, cells along both of its coordinates, the
    corner from which those count, the lengths (m) along them, and whether they are smaller than an element."""

    number: np.ndarray
    face: np.ndarray
    triangle: np.ndarray
    nu: np.ndarray
    nv: np.ndarray
    corner: np.ndarray
    legs: tuple[np.ndarray, np.ndarray]
    small: np.ndarray
    h: float

    @classmethod
    def of(cls, world: World, number: np.ndarray, area: np.ndarray, resolution: int) -> _Sides:
        geometry, face = np.asarray(world.geometry, np.float64), number % max(len(area), 1)
        kind = np.searchsorted(np.cumsum(world.blocks), face, side="right")
        h = float(np.sqrt(area[face].sum() / max(resolution, 1))) or 1.0
        l1, l2 = (np.linalg.norm(geometry[face, k : k + 3], axis=1) for k in (3, 6))
        ball, tube = kind == KINDS.index("sphere"), kind == KINDS.index("cylinder")
        l1 = np.where(ball, 2 * l1, l1)
        around = np.where((kind == KINDS.index("disk")) | ball, np.pi * l1, l2)
        l2 = np.where(tube, 2 * np.pi * l2, around)
        nu, nv = (np.maximum(np.round(v / h), 1).astype(int) for v in (l1, l2))
        triangle = kind == KINDS.index("triangle")
        n = np.maximum(nu, nv)
        nu, nv = np.where(triangle, n, nu), np.where(triangle, n, nv)
        # A triangle counts from the corner opposite to its longest side, which is most often no edge of a wall:
        # opposite to o lies e2 − e1, to o + e1 lies e2.
        l3 = np.linalg.norm(geometry[face, 6:9] - geometry[face, 3:6], axis=1)
        corner = np.where(triangle, np.argmax([l3, l2, l1], 0), 0)
        one, other = np.where(corner == 0, (l1, l2), np.where(corner == 1, (l3, l1), (l2, l3)))
        return cls(number, face, triangle, nu, nv, corner, (one, other), (l1 < 0.75 * h) & (l2 < 0.75 * h), h)


@dataclasses.dataclass
class _Cells:
    """Cells of all sides, one after another: side, row and column, into how many parts each is cut along both, whether
    it is the half at the long side of a triangle, and how many pieces come before it."""

    side: np.ndarray
    i: np.ndarray
    j: np.ndarray
    level: np.ndarray
    half: np.ndarray
    first: np.ndarray  # cell of each side
    before: np.ndarray

    @classmethod
    def of(cls, sides: _Sides, levels: np.ndarray | None, clustered: bool) -> _Cells:
        first = np.concatenate([[0], np.cumsum(sides.nu * sides.nv)])
        s = np.repeat(np.arange(len(sides.face)), sides.nu * sides.nv)
        i, j = np.divmod(np.arange(first[-1]) - first[s], sides.nv[s])
        outside, half = (sides.triangle[s] & test for test in (i + j > sides.nu[s] - 1, i + j == sides.nu[s] - 1))
        level = np.ones(len(s), int)
        if levels is not None:
            level[: len(levels)] = levels  # the last cells may be outside of a triangle, and nobody asked for theirs
        level = np.where(clustered & sides.small[s], 1, level)
        parts = np.where(outside, 0, np.where(half, level * (level + 1) // 2, level * level))
        return cls(s, i, j, level, half, first[:-1], np.concatenate([[0], np.cumsum(parts)]))


def _pieces(sides: _Sides, cells: _Cells, area: np.ndarray, faces: int) -> tuple[np.ndarray, ...]:
    """Pieces, row by row in each cell: cell, row of `Elements.rectangle`, area and longer extent of each."""
    cell = np.repeat(np.arange(len(cells.side)), np.diff(cells.before))
    within, k, half = np.arange(cells.before[-1]) - cells.before[cell], cells.level[cell], cells.half[cell]
    a = np.where(half, _row_of_triangle(within, k), within // k)
    b = within - np.where(half, _before_row(a, k), a * k)
    s, cut = cells.side[cell], half & (a + b == k - 1)
    at_u, at_v = (cells.i[cell] * k + a) / (sides.nu[s] * k), (cells.j[cell] * k + b) / (sides.nv[s] * k)
    start_u, start_v = spaced(at_u), spaced(at_v)
    extent = spaced(at_u + 1.0 / (sides.nu[s] * k)) - start_u, spaced(at_v + 1.0 / (sides.nv[s] * k)) - start_v
    front = np.where(sides.number[s] < faces, 1.0, -1.0)
    rectangle = np.stack([start_u, start_v, *extent, cut, front, sides.corner[s]], -1)
    share = extent[0] * extent[1] * np.where(sides.triangle[s], 2.0, 1.0) * np.where(cut, 0.5, 1.0)
    longer = np.maximum(extent[0] * sides.legs[0][s], extent[1] * sides.legs[1][s])
    return cell, rectangle, area[sides.face[s]] * share, longer


def _grids(sides: _Sides, cells: _Cells, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Grids of sides as fine as their finest cells (`most` parts): the first place of each and the last one's end, and
    the piece at each place."""
    fu, fv = sides.nu * most, sides.nv * most
    first = np.concatenate([[0], np.cumsum(fu * fv)])
    s = np.repeat(np.arange(len(sides.face)), fu * fv)
    i, j = np.divmod(np.arange(first[-1]) - first[s], fv[s])
    m = most[s]
    row, column = i // m, j // m
    beyond = sides.triangle[s] & (row + column > sides.nu[s] - 1)
    column = np.where(beyond, np.maximum(sides.nu[s] - 1 - row, 0), column)
    c = cells.first[s] + row * sides.nv[s] + column
    k, half = cells.level[c], cells.half[c]
    a, b = (i % m) * k // m, (j % m) * k // m
    b = np.where(half, np.minimum(b, k - 1 - a), b)
    return first, cells.before[c] + np.where(half, _before_row(a, k), a * k) + b


def partition(
    world: World, scene: Scene, resolution: int, levels: np.ndarray | None = None
) -> tuple[Elements, np.ndarray, np.ndarray]:
    """About `resolution` elements, each cell cut further into `levels`² parts; element and cell of each piece."""
    faces, area = sum(world.blocks), areas_of_faces(world)
    diffuse, black = diffuse_sides(world, scene)
    sides = _Sides.of(world, np.flatnonzero(diffuse & np.tile(area > 0, 2)), area, resolution)
    clustered = bool(sides.small.sum() > resolution / 2)
    cells = _Cells.of(sides, levels, clustered)
    cell, rectangle, piece_area, longer = _pieces(sides, cells, area, faces)
    s = cells.side[cell]

    # Elements: a piece each, but small faces of one shape that lie together and look the same way share one.
    element = np.arange(len(cell))
    if clustered:
        geometry = np.asarray(world.geometry, np.float64)
        element = _clusters(scene, element, sides.small[s], sides.face[s], rectangle[:, 5], geometry, sides.h)
    order = np.argsort(element, kind="stable")
    members = np.bincount(element, minlength=element.max(initial=-1) + 1)
    most = np.ones(len(sides.face), int)
    np.maximum.at(most, cells.side, cells.level)
    first_place, piece = _grids(sides, cells, most)
    place = element[np.minimum(piece, max(len(element) - 1, 0))] + 1 if len(element) else np.zeros(0, int)
    grid = np.zeros((2 * faces + 1, 4), np.int32)
    grid[:-1][black] = (0, 1, 1, 0)  # the cell of the black element
    grid[sides.number] = np.stack([first_place[:-1] + 1, sides.nu * most, sides.nv * most, sides.corner], -1)
    span = np.ones(len(members), int)
    span[element] = np.where(members[element] > 1, 0, most[s] // cells.level[cell])

    # Tables, with the black element first, filled up to one of a few sizes.
    real = len(members) + 1
    total, pieces = bucket(real), bucket(len(cell) + 1)
    first = np.full(total + 1, len(cell) + 1)
    first[:real] = np.concatenate([[0], 1 + np.concatenate([[0], np.cumsum(members)[:-1]])])[:real]
    areas = np.bincount(element, piece_area, len(members)) if len(element) else np.zeros(0)
    size = np.sqrt(areas) if clustered else longer
    table, plan = np.asarray(world.finishes), world.plan
    emits = np.any(table[:, table.shape[1] - plan.textured_lights - plan.channels :][:, : plan.channels] > 0, axis=-1)
    emits = emits[np.asarray(world.faces)[:faces, FACE["finish"]].astype(int)] & (area > 0)
    everywhere = bool(area[emits].sum() > EVERYWHERE * area.sum()) and not world.plan.lamp_kinds
    fill = lambda a, size, value=0: np.concatenate([a, np.full((size - len(a), *a.shape[1:]), value, a.dtype)])
    black_first = lambda a: np.concatenate([np.zeros((1, *a.shape[1:]), a.dtype), a])
    dtype = np.asarray(world.faces).dtype
    as_float = lambda a, size: fill(black_first(a).astype(dtype), size)
    arrays: dict[str, Any] = dict(
        grid=grid,
        cells=fill(black_first(place).astype(np.int32), bucket(len(place) + 1)),
        first=np.minimum(first, pieces - 1).astype(np.int32),
        face=fill(black_first(sides.face[s][order]).astype(np.int32), pieces),
        rectangle=as_float(rectangle[order], pieces),
        ends=np.cumsum(as_float(piece_area[order], pieces)),
        span=fill(black_first(span).astype(np.int32), total),
        size=as_float(size, total),
        area=as_float(areas, total),
    )
    return Elements(**arrays, clustered=clustered, everywhere=everywhere), element + 1, cell


def _before_row(a: np.ndarray, k: np.ndarray) -> np.ndarray:
    """How many come before row a, in rows of length k, k − 1, ..."""
    return a * k - a * (a - 1) // 2


def _row_of_triangle(within: np.ndarray, k: np.ndarray) -> np.ndarray:
    """The row of number `within` in rows of length k, k − 1, ..."""
    a = np.floor((2 * k + 1 - np.sqrt(np.maximum((2 * k + 1.0) ** 2 - 8 * within, 0))) / 2).astype(int)
    a = np.where(_before_row(a, k) > within, a - 1, a)
    return np.where(_before_row(a + 1, k) <= within, a + 1, a)


def _clusters(
    scene: Scene, element: np.ndarray, small: np.ndarray, face: np.ndarray, front: np.ndarray,
    geometry: np.ndarray, h: float,
) -> np.ndarray:  # fmt: skip
    """Numbers of elements in which small faces of one shape, one box of side h, one axis and one side come together."""
    rows = geometry[face]
    n = np.cross(rows[:, 3:6], rows[:, 6:9]) * front[:, None]
    axis = np.abs(n).argmax(-1)
    axis = 2 * axis + (np.take_along_axis(n, axis[:, None], 1)[:, 0] < 0)
    middle = rows[:, :3] + (rows[:, 3:6] + rows[:, 6:9]) / 3
    box = np.floor((middle - middle.min(0)) / h).astype(np.int64)
    shape = np.asarray(scene.face_shape)[face]
    keys = np.stack([shape, *box.T, axis, front], -1).astype(np.int64)
    keys[~small] = 0
    keys = np.concatenate([keys, np.where(small, 0, 1 + element)[:, None]], -1)
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
