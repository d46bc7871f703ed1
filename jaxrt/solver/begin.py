"""How paths begin: at a sensor's pixels, along given rays, at irradiance meters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient as sg

from .. import emitter
from ..effects import plan as make_plan
from ..rules import balance
from ..sampling.sobol import Drawn, Stream
from ..sampling.warp import cosine_hemisphere
from ..scene import Scene, SensorStructure
from ..sensor import camera, film, meter
from ..vector import Frame, Vec3, dot, normalise, where
from ..world import World, bounding_sphere, front_and_faces
from .path import PathState, hidden, start


class Begin(eqx.Module):
    """How path `number` begins: (world, number, stream) -> PathState."""

    @property
    def searches(self) -> bool:
        """Whether that takes a search of its own, as a light sample does."""
        return False

    def before(self, world: World, number: Any, s: Stream, d: Vec3) -> tuple[Vec3, Vec3]:
        """The point that reflected before the ray along d, and its `slope`, as derivatives need them: none."""
        none = Vec3(*(0.0 * c for c in d))
        return none, none

    def weight(self, world: World, number: Any, s: Stream) -> Any:
        """What the radiance of a path counts, which a filter may make negative; None for 1."""
        return None

    def meter(self, world: World, number: Any, s: Stream) -> tuple[Vec3, Vec3, Any] | None:
        """The point that takes in all light above it, the normal there, and what it is worth, where that is so."""
        return None


class Picture(Begin):
    """Paths of a sensor's pixels (row · width + column, and the same again from height · width on). What is compiled of
    it is static."""

    width: Any
    height: Any
    sensor: SensorStructure = eqx.field(static=True)

    def position(self, world: World, number: Any, s: Stream | Drawn) -> tuple[Any, Any]:
        """Where on the film, in pixels."""
        return world.settle(film.sample(self.sensor.film, self._pixel(world, number), s.pair_at(0)))

    def _pixel(self, world: World, number: Any) -> film.Pixel:
        column, row = (k.astype(world.faces.dtype) for k in (number % self.width, number // self.width % self.height))
        return film.pixel(self.sensor.film, column, row, self.width, self.height)

    def weight(self, world: World, number: Any, s: Stream | Drawn) -> Any:
        if not film.Filter(*self.sensor.film[2:]).signed:
            return None
        return film.weight(self.sensor.film, self._pixel(world, number), self.position(world, number, s))

    def __call__(self, world: World, number: Any, s: Stream | Drawn) -> PathState:
        return self.through(world, self.position(world, number, s), s)

    def through(self, world: World, at: tuple[Any, Any], s: Any) -> PathState:
        """A path through a position on the film. The stream's first pair is taken."""
        raise NotImplementedError

    def before(self, world: World, number: Any, s: Stream, d: Vec3) -> tuple[Vec3, Vec3]:
        return self.behind(world, self.position(world, number, s), s, d)

    def behind(self, world: World, at: tuple[Any, Any], s: Stream, d: Vec3) -> tuple[Vec3, Vec3]:
        """`before` for a position on the film."""
        none = Vec3(*(0.0 * c for c in d))
        return none, none


class View(Picture):
    """A camera's."""

    to_world: Any
    lens: Any
    window: Any  # where on a film of which size the picture lies, in pixels: x, y, width, height

    def through(self, world: World, at: tuple[Any, Any], s: Any) -> PathState:
        u = s.pair_at(1) if camera.uses_lens(self.sensor) else None
        return start(world, *camera.ray(self.sensor, self.to_world, self.lens, self.window, at, u))


class RadianceMeter(Picture):
    """All pixels measure along one ray, which begins just off a surface that it may stand on."""

    to_world: Any

    def through(self, world: World, at: tuple[Any, Any], s: Any) -> PathState:
        o, d = meter.single(self.to_world)
        return start(world, o + d * world.epsilon, d)


class Distant(Picture):
    """All pixels measure what leaves the scene, or goes through `target`, in one direction."""

    to_world: Any
    sphere: Any
    target: meter.Area | None

    def through(self, world: World, at: tuple[Any, Any], s: Any) -> PathState:
        o, d, weight = meter.from_afar(self.to_world, self.sphere, self.target, s.pair_at(1), _choice(s, self.target))
        begun = start(world, o, d)
        return replace(begun, beta=begun.beta * weight)


class IrradianceMeter(Picture):
    """Pixels measure the mean irradiance of the parts of a shape that they lie over: a single one, of all of it."""

    area: meter.Area
    window: Any

    @property
    def searches(self) -> bool:
        return True

    def frame(self, world: World, at: tuple[Any, Any], s: Any) -> tuple[Vec3, Frame, Any]:
        left, top, width, height = (self.window[k] for k in range(4))
        p, n, weight = self.area.point(((at[0] + left) / width, (at[1] + top) / height), _choice(s, self.area))
        return p + n * world.epsilon, Frame.around(n), weight

    def through(self, world: World, at: tuple[Any, Any], s: Any) -> PathState:
        o, frame, weight = self.frame(world, at, s)
        return metered(world, o, frame, s.pair_at(1), s, weight)

    def behind(self, world: World, at: tuple[Any, Any], s: Stream, d: Vec3) -> tuple[Vec3, Vec3]:
        o, frame, _ = self.frame(world, at, s)
        return o, _slope(frame, d)

    def meter(self, world: World, number: Any, s: Stream) -> tuple[Vec3, Vec3, Any]:
        o, frame, weight = self.frame(world, self.position(world, number, s), s)
        return o, frame.n, weight


def _choice(s: Any, area: meter.Area | None) -> Any:
    """A number to choose one of several faces by."""
    return s.pair_at(1)[0] if area is None or len(area.ends) == 1 else s.child(4).pair_at(0)[0]


class Batch(Picture):
    """Views side by side in one picture: view k is row `place[k]` of the stack `groups[group[k]]`."""

    groups: tuple[Picture, ...]
    group: Any
    place: Any

    @classmethod
    def of(cls, width: Any, height: Any, sensor: SensorStructure, views: list[Picture]) -> Batch:
        alike: dict[Any, list[int]] = {}
        for k, view in enumerate(views):
            shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(view))
            alike.setdefault((jax.tree.structure(view), shapes), []).append(k)
        group, place = np.zeros(len(views), np.int32), np.zeros(len(views), np.int32)
        for g, members in enumerate(alike.values()):
            group[members], place[members] = g, range(len(members))
        stack = lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves])
        groups = tuple(jax.tree.map(stack, *(views[k] for k in members)) for members in alike.values())
        return cls(width, height, sensor, groups, jnp.asarray(group), jnp.asarray(place))

    @property
    def searches(self) -> bool:
        return any(view.searches for view in self.groups)

    def _chosen(self, at: tuple[Any, Any], f: Callable[[Picture, tuple[Any, Any]], Any]) -> Any:
        """f of the view that a position lies in, and of the position in that one's picture."""
        n = len(self.group)
        each = self.width / n
        k = jnp.clip(jnp.floor(at[0] / each).astype(jnp.int32), 0, n - 1)
        at = (at[0] - k * each, at[1])
        found = None
        for g, stack in enumerate(self.groups):
            one = f(jax.tree.map(lambda a: a[self.place[k]], stack), at)
            found = one if found is None else where(self.group[k] == g, one, found)
        return found

    def through(self, world: World, at: tuple[Any, Any], s: Any) -> PathState:
        return self._chosen(at, lambda view, at: view.through(world, at, s))

    def behind(self, world: World, at: tuple[Any, Any], s: Stream, d: Vec3) -> tuple[Vec3, Vec3]:
        return self._chosen(at, lambda view, at: view.behind(world, at, s, d))


class Rays(Begin):
    """Paths along given rays, (N, 3) each."""

    points: Any
    directions: Any

    def __call__(self, world: World, number: Any, s: Stream) -> PathState:
        return start(world, Vec3.of(self.points[number]), normalise(Vec3.of(self.directions[number])))


class Meters(Begin):
    """Paths that end at irradiance meters at given points."""

    points: Any
    normals: Any

    @property
    def searches(self) -> bool:
        return True

    def frame(self, world: World, number: Any) -> tuple[Vec3, Frame]:
        frame = Frame.around(normalise(Vec3.of(self.normals[number])))
        return Vec3.of(self.points[number]) + frame.n * world.epsilon, frame

    def __call__(self, world: World, number: Any, s: Stream) -> PathState:
        return metered(world, *self.frame(world, number), s.pair_at(0), s)

    def before(self, world: World, number: Any, s: Stream, d: Vec3) -> tuple[Vec3, Vec3]:
        at, frame = self.frame(world, number)
        return at, _slope(frame, d)

    def meter(self, world: World, number: Any, s: Stream) -> tuple[Vec3, Vec3, Any]:
        at, frame = self.frame(world, number)
        return at, frame.n, 1.0


def _slope(frame: Frame, d: Vec3) -> Vec3:
    """A meter reflects like white paint."""
    return sg(frame.n * (1.0 / dot(frame.n, d)))


def metered(world: World, at: Vec3, frame: Frame, u: tuple[Any, Any], s: Stream, weight: Any = 1.0) -> PathState:
    """A path that ends at an irradiance meter: β = π by cosine sampling, and a light sample already counted."""
    local = cosine_hemisphere(u)
    w = sg(frame.to_world(local))
    cos = dot(frame.n, w)
    begun = start(world, at, w)
    beta = begun.beta * (weight * np.pi * cos / sg(cos))
    begun = replace(begun, beta=beta, pdf=sg(cos) / np.pi, delta=begun.delta & False)
    if not world.plan.lights:
        return begun
    light = emitter.sample(world, at, s.child(3), 1, frame.n)
    cos = dot(frame.n, light.w)
    ok = (light.pdf > 0) & (cos > 0)
    ok = ok & ~hidden(world, at, light, ok)
    share = sg(balance(light.known, jnp.maximum(cos, 0.0) / np.pi))
    scale = jnp.where(ok, weight * cos * light.jacobian * share / jnp.where(ok, light.pdf, 1.0), 0.0)
    return replace(begun, radiance=light.radiance * scale)


# -------------------------------------------------------------------------------------- of a scene


def picture_of(scene: Scene, structure: SensorStructure) -> Picture:
    """The sensor of a scene that has this structure, as the loop sees it."""
    return PICTURES.get(structure.kind, _view)(scene, structure)


def _size(structure: SensorStructure) -> tuple[Any, Any, SensorStructure]:
    return structure.film[0], structure.film[1], structure.compiled()


def _view(scene: Scene, structure: SensorStructure) -> View:
    row = structure.row
    return View(*_size(structure), scene.sensor_to_world[row], scene.lens[row], _window(scene, structure))


def _window(scene: Scene, structure: SensorStructure) -> np.ndarray:
    return np.array(structure.window, scene.lens.dtype)


def _radiancemeter(scene: Scene, structure: SensorStructure) -> RadianceMeter:
    return RadianceMeter(*_size(structure), scene.sensor_to_world[structure.row])


def _distant(scene: Scene, structure: SensorStructure) -> Distant:
    target = None if structure.area is None else _area(scene, structure.area)
    return Distant(*_size(structure), scene.sensor_to_world[structure.row], _sphere(scene), target)


def _irradiancemeter(scene: Scene, structure: SensorStructure) -> IrradianceMeter:
    assert structure.area is not None
    return IrradianceMeter(*_size(structure), _area(scene, structure.area), _window(scene, structure))


def _batch(scene: Scene, structure: SensorStructure) -> Batch:
    views = [picture_of(scene, part) for part in structure.parts]
    return Batch.of(*_size(structure), [replace(view, width=0, height=0) for view in views])


@eqx.filter_jit
def _sphere(scene: Scene) -> Any:
    return bounding_sphere(scene, scene.plan or make_plan(scene))


@eqx.filter_jit
def _area(scene: Scene, area: tuple[str, str, int, int]) -> meter.Area:
    table, kind, first, stop = area
    rows = scene.targets if table == "targets" else front_and_faces(scene, scene.plan or make_plan(scene))
    return meter.Area.of(rows[first:stop], kind)


PICTURES: dict[str, Callable[..., Picture]] = {
    "radiancemeter": _radiancemeter,
    "irradiancemeter": _irradiancemeter,
    "distant": _distant,
    "batch": _batch,
}
"""What is no camera."""
