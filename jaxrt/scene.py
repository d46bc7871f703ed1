"""A scene: a pytree of a few packed tables, with its names and its plan as static structure.

Named parameters are slices of the tables' rows, never a leaf each: a leaf a material costs seconds
of tracing at a thousand. `build` (in `build.py`) makes a scene from parts.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import weakref
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int32

from .parts import LUMINANCE, Film, Integrator, SceneError

if TYPE_CHECKING:
    from .effects import Plan

KINDS = ("triangle", "parallelogram", "disk", "sphere", "cylinder", "sdfgrid")
"""Kinds of faces, in the order in which faces are numbered. A face is a surface that a ray meets in one piece."""


FACE = {"n": 0, "height": 3, "side": 4, "finish": 5, "density": 6, "u": 7, "v": 11, "extra": 15}
"""Columns of `World.faces`. Of a curved face: n is its centre (or foot), height its radius, u its axis."""

CAMERAS = ("perspective", "thinlens", "orthographic")
METERS = ("radiancemeter", "irradiancemeter", "distant")
SENSORS = (*CAMERAS, *METERS, "batch")


@dataclasses.dataclass(frozen=True)
class Slot:
    """Where a parameter lives: `leaf[row]`, columns start:stop; `one`: a single number, the same in all of them."""

    leaf: str
    row: int | tuple[int, int]
    columns: tuple[int, int] | None = None
    one: bool = False
    shape: tuple[int, ...] | None = None  # how its value is shown, where not as it is stored

    @property
    def index(self) -> tuple[Any, ...]:
        rows = slice(*self.row) if isinstance(self.row, tuple) else self.row
        return (rows,) if self.columns is None else (rows, slice(*self.columns))


@dataclasses.dataclass(frozen=True)
class SensorStructure:
    """The part of a sensor that decides what is compiled."""

    kind: str
    fov_axis: str
    film: tuple[Any, ...]  # width, height, and those of `sensor.film.Filter`
    window: tuple[float, float, float, float]  # the picture's corner on the film it is cut from, and that film's size
    row: int = 0  # of tables of sensors
    area: tuple[str, str, int, int] | None = None  # what it measures over: table, kind of faces, first, past the last
    parts: tuple[SensorStructure, ...] = ()  # side by side in a batch
    grey: bool = False  # whether the picture is luminance alone

    def sized(self, width: int, height: int) -> SensorStructure:
        """The same view in other pixels."""
        across, down = width / self.film[0], height / self.film[1]
        x, y, w, h = self.window
        window = (x * across, y * down, w * across, h * down)
        views = len(self.parts) or 1
        if width % views:
            raise SceneError(f"size: {width} pixels across are not {views} views side by side; give a multiple")
        parts = tuple(part.sized(width // views, height) for part in self.parts)
        return dataclasses.replace(self, film=(width, height, *self.film[2:]), window=window, parts=parts)

    def compiled(self) -> SensorStructure:
        """What a program depends on: sizes are run-time numbers."""
        return SensorStructure(self.kind, self.fov_axis, (0, 0, *self.film[2:]), (0.0, 0.0, 0.0, 0.0))

    def tones(self, channels: int) -> np.ndarray | None:
        """What turns the scene's channels (..., C) into the picture's, (C, 1); None where they are the same."""
        return LUMINANCE[:, None] if self.grey and channels == 3 else None

    def as_film(self) -> Film:
        return Film(*self.film)


@dataclasses.dataclass(frozen=True)
class Structure:
    """Everything static about a scene: names of parameters, sensors, and what the file asked of the method."""

    slots: tuple[tuple[str, Slot], ...] = ()
    shapes: tuple[tuple[str, str, int, int], ...] = ()  # id, kind of its faces, first face, past the last
    materials: tuple[str, ...] = ()  # names of the rows of that table
    emitters: tuple[str, ...] = ()  # and of radiance
    sensors: tuple[SensorStructure, ...] = ()
    sensor_ids: tuple[str, ...] = ()
    integrator: tuple[Any, ...] = dataclasses.astuple(Integrator())
    source: str = ""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # where in the world all is counted from, m

    def asked(self) -> Integrator:
        return Integrator(*self.integrator)

    def slot(self, name: str) -> Slot:
        for key, slot in self.slots:
            if key == name:
                return slot
        close = difflib.get_close_matches(name, [k for k, _ in self.slots], 3, 0.4)
        raise SceneError(
            f"{name}: no such parameter; "
            + (f"closest: {', '.join(close)}" if close else "jaxrt.params(scene) lists them all")
        )


class Scene(eqx.Module):
    """Surfaces, reflectances, emitters and sensors. Make one with `jaxrt.load` or `Scene.build`.

    Tables are padded to a few sizes, so that scenes share compiled programs. World positions are
    `to_world` applied to positions in a shape's own space (m).
    """

    vertices: Float[Array, "V 3"]  # of all meshes, each in its shape's own space
    normals: Float[Array, "V 3"]  # zero where a mesh has flat faces
    uvs: Float[Array, "V 2"]
    triangles: Int32[Array, "F 3"]
    patches: Float[Array, "K 9"]  # all other kinds of faces, in their shapes' own space
    face_shape: Int32[Array, " P"]
    counts: Int32[Array, " 6"]  # faces of each kind; the rest of each block is padding
    to_world: Float[Array, "S 4 4"]
    flip: Float[Array, " S"]  # -1 where the front side is turned
    shape_finish: Int32[Array, " S"]
    finishes: Int32[Array, "Q 2"]  # (row of materials, row of radiance)
    materials: Float[Array, "M columns"]
    radiance: Float[Array, "E channels"]  # row 0: none, row 1: the enclosure, then area lights
    radiance_map: Int32[Array, " E"]  # the texture of each, 0 for none
    texels: Float[Array, "T channels"]  # values of all textures
    textures: Int32[Array, "X 6"]  # see `texture.LAYOUT`; row 0 is none
    to_uv: Float[Array, "X 6"]
    distances: Float[Array, " D"]  # samples of all grids of signed distances, in their own space, x fastest
    grids: Int32[Array, "G 5"]  # see `grids.Grids.layout`
    instances: Float[Array, "I 4 4"]  # places of groups in the world
    instance_group: Int32[Array, " I"]  # -1 for padding
    groups: Int32[Array, "G 2"]  # first triangle and how many; they follow those that `counts` counts
    lights: Int32[Array, " L"]  # faces that emit, -1 for padding
    around_to_world: Float[Array, "1 4 4"]  # turns the enclosure's texture
    # Without extent: position, direction, angles of cutoff and beam (radians), kind, up; see `row` of each part. Where
    # the cutoff stands a goniometric one has the number of its web.
    lamps: Float[Array, "D 12"]
    lamp_radiance: Int32[Array, " D"]  # row of radiance, where their intensity is; 0 for padding
    sensor_to_world: Float[Array, "N 4 4"]
    lens: Float[Array, "N 5"]  # fov (degrees), near, far, aperture radius, focus distance
    targets: Float[Array, "T 10"]  # of sensors, beside the scene's surfaces: rows of `World.geometry`, and the side
    blocks: tuple[int, ...] = eqx.field(static=True)  # padded number of faces of each kind
    copies: int = eqx.field(static=True)  # padded number of triangles that instances stand for
    structure: Structure = eqx.field(static=True)
    plan: Plan | None = eqx.field(static=True, default=None)

    @classmethod
    def build(cls, shapes: Sequence[Any], **parts: Any) -> Scene:
        """A scene from parts: `shapes`, `sensors=`, `enclosure=`, ...; see `jaxrt.build.build`."""
        from .build import build

        with jax.ensure_compile_time_eval():  # also under jit
            return build(shapes, **parts)

    @property
    def channels(self) -> int:
        return self.radiance.shape[-1]

    @property
    def origin(self) -> np.ndarray:
        """The point of the world from which parameters, points and positions are counted, (3,) float64, m."""
        return np.array(self.structure.origin)

    def offset(self, kind: str) -> int:
        """Number of the first face of a kind."""
        return sum(self.blocks[: KINDS.index(kind)])

    @property
    def faces(self) -> int:
        """Number of faces, padding included; also the row of the enclosure in tables of faces."""
        return sum(self.blocks)

    def __repr__(self) -> str:
        shapes = [f"{name} ({stop - start} {kind})" for name, kind, start, stop in self.structure.shapes]
        more = [f"and {len(shapes) - 8} more"] if len(shapes) > 8 else []
        return f"Scene({self.structure.source or 'from parts'}: {', '.join(shapes[:8] + more)})"


def in_working_precision(tree: Any) -> Any:
    """A tree whose floats are all of JAX's default type: float32, or float64 under `jax_enable_x64`."""
    real = jnp.result_type(float)
    floating = lambda a: eqx.is_array(a) and jnp.issubdtype(a.dtype, jnp.floating) and a.dtype != real
    return jax.tree.map(lambda a: a.astype(real) if floating(a) else a, tree)


def params(scene: Scene) -> dict[str, Array]:
    """Every parameter of the scene by name: what can be moved and differentiated.

    `red.reflectance` (C,), `light.radiance` (C,), `box.vertices` (V, 3) in the shape's own space,
    `box.to_world` (4, 4), `sensor.to_world` (4, 4), ... The values are slices of the scene's tables.
    """
    out = {}
    for name, slot in scene.structure.slots:
        value = getattr(scene, slot.leaf)[slot.index]
        out[name] = value[..., 0] if slot.one else value if slot.shape is None else value.reshape(slot.shape)
    return out


_moved: dict[int, tuple[Any, set[str]]] = {}


def moved(table: Any) -> set[str] | None:
    """Parameters whose traced values are in a table, as far as `with_params` put them there; None if unknown."""
    if not isinstance(table, Tracer):
        return set()
    kept, names = _moved.get(id(table), (lambda: None, set()))
    return set(names) if kept() is table else None


def with_params(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """A new scene with the named parameters set; pure, so values may be traced.

    Raises `SceneError` (a ValueError) for an unknown name, with the closest ones, and for a wrong shape.
    """
    leaves: dict[str, Any] = {}
    traced: dict[str, set[str] | None] = {}
    for name, value in values.items():
        slot = scene.structure.slot(name)
        leaf = leaves.get(slot.leaf, getattr(scene, slot.leaf))
        known = traced.setdefault(slot.leaf, moved(leaf))
        if known is not None and isinstance(value, Tracer):
            known.add(name)
        value = jnp.asarray(value, leaf.dtype)
        want = slot.shape or leaf[slot.index].shape
        if slot.one:
            if value.shape != ():
                raise SceneError(f"{name}: has shape {value.shape}; give one number")
        elif value.shape != want and not (value.ndim == 0 and len(want) == 1):
            raise SceneError(f"{name}: has shape {value.shape}; give {want}")
        value = value if slot.shape is None else jnp.broadcast_to(value, want).reshape(leaf[slot.index].shape)
        leaves[slot.leaf] = leaf.at[slot.index].set(value)
    for name, leaf in leaves.items():
        if isinstance(leaf, Tracer) and (known := traced[name]) is not None:
            forget = functools.partial(_moved.pop, id(leaf))
            _moved[id(leaf)] = weakref.ref(leaf, lambda _, forget=forget: forget(None)), known
    names = list(leaves)
    return eqx.tree_at(lambda s: [getattr(s, n) for n in names], scene, [leaves[n] for n in names]) if names else scene
