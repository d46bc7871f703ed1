"""Scenes in which something moves: by a number θ, where derivatives by what is seen are tried, and for fits."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxrt


@dataclasses.dataclass(frozen=True)
class Motion:
    """A scene, the parameters at θ, and how deep to follow light."""

    scene: jaxrt.Scene
    at: Callable[[Any], dict[str, Any]]
    max_depth: int
    step: float = 0.01  # of central differences


def look_at(o: Any, target: Any, up: Any = (0, 1, 0)) -> np.ndarray:
    o, target = np.array(o, float), np.array(target, float)
    f = (target - o) / np.linalg.norm(target - o)
    left = np.cross(up, f)
    left /= np.linalg.norm(left)
    m = np.eye(4)
    m[:3] = np.stack([left, np.cross(f, left), f, o], 1)
    return m


def placed(size: Any, at: Any, normal: str = "y") -> np.ndarray:
    """A square (half its side: `size`) about a point, facing an axis: y, -y, x, -x, z."""
    axes = {
        "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)), "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
        "x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)), "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
        "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    }  # fmt: skip
    a, b, n = (np.array(v, float) for v in axes[normal])
    m = np.eye(4)
    m[:3] = np.stack([a * size, b * size, n, np.array(at, float)], 1)
    return m


def shifted(m: Any, v: Any) -> Any:
    return jnp.asarray(m).at[:3, 3].add(jnp.asarray(v))


def turned(m: Any, angle: Any) -> Any:
    """About the vertical through its own origin."""
    c, s, z, o = jnp.cos(angle), jnp.sin(angle), 0.0 * angle, 0.0 * angle + 1.0
    r = jnp.stack([jnp.stack([c, z, s]), jnp.stack([z, o, z]), jnp.stack([-s, z, c])])
    m = jnp.asarray(m)
    return m.at[:3, :3].set(r @ m[:3, :3])


def icosphere(level: int = 2) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=level)
    return np.asarray(ball.vertices), np.asarray(ball.faces)


CUBE = np.diag([0.45, 0.45, 0.45, 1.0])
CUBE[:3, 3] = (-0.2, 0.9, 0.1)
CUBE[:3, :3] = np.array(turned(CUBE, 0.5))[:3, :3]
ROD = np.diag([1.0, 0.04, 0.04, 1.0])
ROD[:3, 3] = (-0.2, 0.9, 0.1)
ROD[:3, :3] = np.array(turned(ROD, 0.5))[:3, :3]
LAMP = placed(0.5, (0.3, 3.0, 0.2), "-y")
FLOOR = placed(3.0, (0, 0, 0))
CAMERA = look_at((1.2, 2.2, 4.5), (0.0, 0.5, 0.0))
GREY, BLACK = jaxrt.Diffuse(0.7, id="grey"), jaxrt.Diffuse(0.0, id="black")


def film(res: int) -> jaxrt.Film:
    return jaxrt.Film(res, res, "box")


def stage(
    res: int, *more: Any, floor: Any = GREY, lamp: float = 5.0, enclosure: float = 0.0, cube: Any = None, **kw: Any
) -> jaxrt.Scene:
    """A cube that floats over a floor under a lamp."""
    shapes = [
        jaxrt.Rectangle(id="floor", to_world=FLOOR, bsdf=floor),
        jaxrt.Cube(id="cube", to_world=CUBE, bsdf=jaxrt.Diffuse(0.4)) if cube is None else cube,
        *([jaxrt.Rectangle(id="lamp", to_world=LAMP, emission=lamp, bsdf=BLACK)] if lamp else []),
        *more,
    ]  # fmt: skip
    sensor = jaxrt.Sensor("perspective", CAMERA, fov=40, film=film(res), **kw)
    return jaxrt.Scene.build(shapes, sensors=[sensor], enclosure=jaxrt.Enclosure(enclosure))


def room(res: int, *more: Any, **kw: Any) -> jaxrt.Scene:
    """The same inside walls, which send light on."""
    walls = [
        jaxrt.Rectangle(id="back", to_world=placed(3.0, (0, 2, -2.5), "z"), bsdf=jaxrt.Diffuse([0.7])),
        jaxrt.Rectangle(id="left", to_world=placed(3.0, (-2.5, 2, 0), "x"), bsdf=jaxrt.Diffuse([0.8])),
        jaxrt.Rectangle(id="right", to_world=placed(3.0, (2.5, 2, 0), "-x"), bsdf=jaxrt.Diffuse([0.5])),
    ]
    return stage(res, *walls, *more, **kw)


def motions(res: int = 48) -> dict[str, Callable[[], Motion]]:
    cube = lambda v: lambda t: {"cube.to_world": shifted(CUBE, jnp.asarray(v) * t)}
    v, f = icosphere()
    ball = jaxrt.Mesh(id="ball", vertices=v * 0.5 + [-0.2, 0.9, 0.1], faces=f, bsdf=jaxrt.Diffuse(0.4))
    sphere = jaxrt.Sphere(id="ball", center=(-0.2, 0.9, 0.1), radius=0.5, bsdf=jaxrt.Diffuse(0.4))
    disk = jaxrt.Disk(id="disk", to_world=placed(0.4, (1.0, 1.2, 0.3), "y"), bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.6)))
    tube = jaxrt.Cylinder(
        id="tube", p0=(-1.5, 0.6, 0.3), p1=(-0.9, 0.8, 1.4), radius=0.25, bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.6))
    )
    mirror = jaxrt.Rectangle(
        id="mirror", to_world=placed(1.2, (0.0, 1.3, -1.2), "z"), bsdf=jaxrt.Conductor(0.0, id="m")
    )
    screen = jaxrt.Rectangle(
        id="screen", to_world=placed(0.8, (0.3, 2.3, 0.2), "y"), bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5))
    )

    rod = jaxrt.Cube(id="cube", to_world=ROD, bsdf=jaxrt.Diffuse(0.4))
    small = jaxrt.Rectangle(id="small", to_world=placed(0.15, (-1.2, 2.5, 0.6), "-y"), emission=40.0, bsdf=BLACK)
    rough = jaxrt.Principled(base_color=[0.6], roughness=0.4, id="rough")

    def everything(t: Any) -> dict[str, Any]:
        return {
            "cube.to_world": turned(shifted(CUBE, jnp.array([0.5, 0.2, 0.1]) * t), 0.5 * t),
            "floor.to_world": shifted(FLOOR, jnp.array([0.0, 0.4, 0.0]) * t),
            "lamp.to_world": shifted(LAMP, jnp.array([-0.5, 0.3, 0.4]) * t),
            "sensor.to_world": shifted(CAMERA, jnp.array([0.3, -0.2, 0.2]) * t),
        }

    return {
        "occluder moved": lambda: Motion(stage(res), cube([1.0, 0.0, 0.3]), 2),
        "occluder turned": lambda: Motion(stage(res), lambda t: {"cube.to_world": turned(CUBE, t)}, 2),
        "receiver lifted": lambda: Motion(
            stage(res), lambda t: {"floor.to_world": shifted(FLOOR, jnp.array([0, 1.0, 0]) * t)}, 2
        ),
        "lamp moved": lambda: Motion(
            stage(res), lambda t: {"lamp.to_world": shifted(LAMP, jnp.array([1.0, 0.5, 0.3]) * t)}, 2
        ),
        "camera moved": lambda: Motion(
            stage(res), lambda t: {"sensor.to_world": shifted(CAMERA, jnp.array([1.0, 0.3, -0.5]) * t)}, 2
        ),
        "field of view": lambda: Motion(stage(res), lambda t: {"sensor.fov": 40.0 + 20.0 * t}, 2),
        "all at once": lambda: Motion(stage(res), everything, 2),
        "under the sky": lambda: Motion(stage(res, lamp=0.0, enclosure=1.0), cube([1.0, 0.3, 0.3]), 2),
        "glossy floor": lambda: Motion(stage(res, floor=jaxrt.Conductor(0.3, id="gloss")), cube([1.0, 0.0, 0.3]), 3),
        "ball of facets": lambda: Motion(
            stage(res, cube=ball),
            lambda t: {"ball.vertices": jnp.asarray(v * 0.5 + [-0.2, 0.9, 0.1]) + jnp.array([1.0, 0.2, 0.3]) * t},
            2,
        ),
        "sphere, disk, tube": lambda: Motion(
            stage(res, disk, tube, cube=sphere),
            lambda t: {
                "ball.center": jnp.array([-0.2, 0.9, 0.1]) + jnp.array([1.0, 0.2, 0.3]) * t,
                "disk.to_world": shifted(placed(0.4, (1.0, 1.2, 0.3), "y"), jnp.array([-0.5, 0.5, 0.8]) * t),
                "tube.p0": jnp.array([-1.5, 0.6, 0.3]) + jnp.array([0.3, 1.0, 0.0]) * t,
            },
            2,
        ),
        "indirect, occluder": lambda: Motion(room(res), cube([1.0, 0.0, 0.3]), 4),
        "indirect, all": lambda: Motion(room(res), everything, 4),
        "hidden lamp": lambda: Motion(
            room(res, screen),
            lambda t: {"screen.to_world": shifted(placed(0.8, (0.3, 2.3, 0.2), "y"), jnp.array([1.0, 0.2, 0.0]) * t)},
            4,
        ),
        "rod, two lamps": lambda: Motion(
            stage(res, small, floor=rough, cube=rod),
            lambda t: {
                "cube.to_world": turned(shifted(ROD, jnp.array([0.5, 0.2, 0.1]) * t), 0.5 * t),
                "small.to_world": shifted(placed(0.15, (-1.2, 2.5, 0.6), "-y"), jnp.array([0.8, 0.0, 0.3]) * t),
            },
            3,
        ),
        "mirror, lamp turned": lambda: Motion(
            stage(res, mirror),
            lambda t: {
                "mirror.to_world": turned(placed(1.2, (0.0, 1.3, -1.2), "z"), 0.3 * t),
                "cube.to_world": shifted(CUBE, jnp.array([1.0, 0.0, 0.3]) * t),
                "lamp.to_world": turned(LAMP, t),
            },
            3,
            step=0.03,
        ),
        "mirror, occluder": lambda: Motion(stage(res, mirror), cube([1.0, 0.0, 0.3]), 4),
        "mirror moved": lambda: Motion(
            stage(res, mirror),
            lambda t: {"mirror.to_world": shifted(placed(1.2, (0.0, 1.3, -1.2), "z"), jnp.array([0.3, 0.0, 1.0]) * t)},
            4,
            step=0.06,  # noise of differences falls with its square root; by those of .1 and .2 its own error is .8 %
        ),
    }
