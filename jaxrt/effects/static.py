"""The plan itself, and what it takes for granted."""

from __future__ import annotations

import dataclasses

import jax


@dataclasses.dataclass(frozen=True)
class Assumption:
    """Values of a table of the scene on which an effect was left out; `jaxrt.effects.check` asks whether they hold."""

    effect: str
    leaf: str
    rows: tuple[int, ...] | None  # None: all
    columns: tuple[tuple[int, int], ...] | None  # from, to; None: all
    holds: str  # zero, or grey: the same in all channels
    what: str
    alone: bool  # whether nothing in the table is free to move

    def __str__(self) -> str:
        return f"{self.leaf}: {self.what}"


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Plan:
    """What is compiled. Equal plans share programs; reasons and assumptions do not count for equality.

    A pytree without leaves: as an argument of a jitted function it is static.
    """

    channels: int = 1
    kinds: tuple[str, ...] = ()
    lobes: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    twosided: str = "none"  # none, some or all
    tangents: bool = False  # ∂p/∂u at each hit
    bumps: bool = False  # and ∂p/∂v
    coordinates: bool = False  # on surfaces, for textures and for tangents of curved ones
    textures: tuple[str, ...] = ()  # kinds of them
    stepped: bool = False  # whether one of them jumps from value to value
    nested: int = 0  # how many checkerboards one of them stands in, at most
    nodes: tuple[str, ...] = ()  # kinds of materials made of others
    depth: int = 0  # how many of those stand inside one another, at most
    textured_lights: bool = False
    smooth_normals: bool = False
    smooth_lights: bool = False  # whether a face that emits has vertex normals
    light_kinds: tuple[str, ...] = ()  # kinds of faces that emit
    lamp_kinds: tuple[str, ...] = ()  # of lamps without extent, and the sun
    web: int = 0  # angles of the finest photometric web
    many_lights: bool = False
    solid_angle: bool = False  # whether flat lights are sampled by it
    area_light: bool = False
    enclosure: bool = False
    environment: tuple[int, int] | None = None  # width and height of the enclosure's texture, if sampled as a light
    bounces: bool = False
    hide_emitters: bool = False
    mirrors: bool = False  # whether a material reflects as a mirror or lets light through unscattered
    bent: bool = False  # and is on a curved face, or lets light through
    instances: bool = False
    backend: str = "dense"
    out_channels: int = 1
    cut: tuple[str, ...] = ()  # what the scene's tables have and are to be freed of, see `cut`
    reasons: tuple[tuple[str, bool, str], ...] = dataclasses.field(default=(), compare=False, repr=False)
    assumes: tuple[Assumption, ...] = dataclasses.field(default=(), compare=False, repr=False)
    forced: tuple[tuple[str, bool], ...] = dataclasses.field(default=(), compare=False, repr=False)
    dropped: tuple[str, ...] = dataclasses.field(default=(), compare=False, repr=False)
    """Effects that the scene has and that were forced out: the picture is another without them."""

    @property
    def effects(self) -> frozenset[str]:
        """Names of the effects that are in."""
        return frozenset(name for name, present, _ in self.reasons if present)

    @property
    def storable(self) -> bool:
        """Whether later processes may have its programs: other searches may call back into Python."""
        return self.backend == "dense"

    @property
    def lights(self) -> bool:
        return bool(self.light_kinds or self.lamp_kinds or self.environment)

    @property
    def tilts(self) -> bool:
        """Whether normals are turned."""
        return "normalmap" in self.nodes or "bumpmap" in self.nodes

    @property
    def mapped(self) -> tuple[str, ...]:
        """Fields of materials that have textures."""
        return tuple(f.removeprefix("map:") for f in self.fields if f.startswith("map:"))

    def __str__(self) -> str:
        width = max(len(name) for name, _, _ in self.reasons)
        lines = [f"{name:<{width}}  {'in ' if on else 'out'}  {why}" for name, on, why in self.reasons]
        return "\n".join(lines + [f"assumes {a}" for a in self.assumes])
