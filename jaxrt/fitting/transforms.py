"""From numbers without bounds, which optimisers move, to values of parameters that stay what they may be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..parts import SceneError
from ..scene import Scene, params

INSIDE = 1e-3
"""How far inside its bounds a parameter starts, as a share of their distance: on them nothing would move it."""

UNIT = {
    "reflectance", "specular_reflectance", "specular_transmittance", "diffuse_reflectance", "base_color", "roughness",
    "alpha", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat", "clearcoat_gloss",
    "weight", "opacity",
}  # fmt: skip
POSITIVE = {"radiance", "intensity", "irradiance", "eta", "k"}
"""Parameters that have bounds where none are given, by the last parts of their names."""


class Transform(eqx.Module):
    """values = transform(z); `start`: the z of the scene's own values."""

    start: Array

    def __call__(self, z: Array) -> Array:
        return z


class Positive(Transform):
    """value₀ eᶻ: above 0; z is a relative change."""

    value: Array

    @classmethod
    def of(cls, scene: Scene, name: str, value: np.ndarray) -> Positive:
        if not (value >= 0).all() or not value.any():
            raise SceneError(
                f"{name}: starts at {value.min():g}, which a positive parameter cannot leave; start above 0"
            )
        return cls(jnp.zeros(value.shape), jnp.asarray(np.maximum(value, INSIDE * value.max())))

    def __call__(self, z: Array) -> Array:
        return self.value * jnp.exp(z)


class Between(Transform):
    """lower + (upper − lower) / (1 + e⁻ᶻ)."""

    lower: Array
    upper: Array

    @classmethod
    def of(cls, scene: Scene, name: str, value: np.ndarray, lower: Any = 0.0, upper: Any = 1.0) -> Between:
        low, high = (np.broadcast_to(np.asarray(a, float), value.shape) for a in (lower, upper))
        if not (high > low).all():
            raise SceneError(f"{name}: bounds {lower} and {upper} leave no room; give (lower, upper)")
        if not ((value >= low - 1e-6) & (value <= high + 1e-6)).all():
            raise SceneError(
                f"{name}: starts at {value.min():g} to {value.max():g}, outside its bounds ({low.min():g}, "
                f"{high.max():g}); give others, or start between them"
            )
        share = np.clip((value - low) / (high - low), INSIDE, 1 - INSIDE)
        return cls(jnp.asarray(np.log(share / (1 - share)), float), jnp.asarray(low), jnp.asarray(high))

    def __call__(self, z: Array) -> Array:
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(z)


def extent(scene: Scene, name: str, value: np.ndarray) -> tuple[np.ndarray, Any]:
    """The middle and the size of what a `to_world` places: half the diagonal of its vertices' box, or what `to_world`
    makes of a unit; of a sensor, its distance from the middle of the scene."""
    if value.shape != (4, 4):
        raise SceneError(f"{name}: has shape {value.shape}; a rigid motion is one of a to_world")
    owner, found = name.rpartition(".")[0], params(scene)
    middle, size = value[:3, 3], np.linalg.norm(value[:3, :3], axis=0).max()
    if f"{owner}.vertices" in found:
        corners = np.asarray(found[f"{owner}.vertices"]) @ value[:3, :3].T + value[:3, 3]
        middle, size = (corners.min(0) + corners.max(0)) / 2, np.linalg.norm(np.ptp(corners, 0)) / 2
    elif owner in scene.structure.sensor_ids:
        places = np.asarray(scene.to_world)[np.unique(np.asarray(scene.face_shape)), :3, 3]
        size = max(np.linalg.norm(places.mean(0) - middle), size)
    return middle, size


class Rigid(Transform):
    """A rigid motion of a `to_world` about the shape's middle: exp of a twist (se(3)), of 6 numbers.

    z: rotation vector (radians) and velocity, in units of the shape's size (`extent`).
    """

    to_world: Float[Array, "4 4"]
    middle: Float[Array, " 3"]
    size: Float[Array, ""]

    @classmethod
    def of(cls, scene: Scene, name: str, value: np.ndarray) -> Rigid:
        middle, size = extent(scene, name, value)
        return cls(jnp.zeros(6), jnp.asarray(value), jnp.asarray(middle), jnp.asarray(size))

    def __call__(self, z: Array) -> Array:
        a, b, c = z[0], z[1], z[2]
        none = jnp.zeros_like(a)
        turn = jnp.stack([none, -c, b, c, none, -a, -b, a, none]).reshape(3, 3)
        twist = jnp.zeros((4, 4), z.dtype).at[:3, :3].set(turn).at[:3, 3].set(self.size * z[3:])
        motion = jax.scipy.linalg.expm(twist)
        about = motion.at[:3, 3].add(self.middle - motion[:3, :3] @ self.middle)
        return (about @ self.to_world).at[3].set(self.to_world[3])


class Shifted(Transform):
    """A `to_world` moved along directions (K, 3): z has a number for each, in units of their length times the size."""

    to_world: Float[Array, "4 4"]
    along: Float[Array, "K 3"]

    def __call__(self, z: Array) -> Array:
        return self.to_world.at[:3, 3].add(z @ self.along)


class Shift(eqx.Module):
    """A `to_world` is moved and not turned, along `directions`, each (x, y, z): by default the axes."""

    directions: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def __call__(self, scene: Scene, name: str, value: np.ndarray) -> Shifted:
        along = np.asarray(self.directions, float)
        if along.ndim != 2 or along.shape[1] != 3 or np.linalg.matrix_rank(along) < len(along):
            raise SceneError(f"{name}: {along.tolist()} are no directions; give up to three independent (x, y, z)")
        _, size = extent(scene, name, value)
        return Shifted(jnp.zeros(len(along)), jnp.asarray(value), jnp.asarray(along * size))


class Displaced(Transform):
    """vertices₀ + size (1 + λ L)⁻¹ z, L the mesh's combinatorial Laplacian: steps that are smooth.

    B. Nicolet, A. Jacobson, W. Jakob, Large Steps in Inverse Rendering of Geometry, 2021. Vertices at one place move
    as one: normals and texture coordinates may part them. z (U, 3) in units of half the diagonal of the vertices' box.
    """

    vertices: Float[Array, "V 3"]
    place: Array  # of each vertex among those that differ
    pairs: Array  # (E, 2) of places that an edge joins
    size: Float[Array, ""]
    weight: float

    def __call__(self, z: Array) -> Array:
        a, b = self.pairs.T

        def system(v: Array) -> Array:
            along = v[a] - v[b]
            return v + self.weight * jnp.zeros_like(v).at[a].add(along).at[b].add(-along)

        smooth = jax.scipy.sparse.linalg.cg(system, z, tol=1e-6)[0]
        return self.vertices + self.size * smooth[self.place]


class Smooth(eqx.Module):
    """A mesh's vertices are displaced smoothly, the more so the larger `weight` (λ of `Displaced`)."""

    weight: float = 19.0

    def __call__(self, scene: Scene, name: str, value: np.ndarray) -> Displaced:
        owner = name.rpartition(".")[0]
        span = next((s[1:] for s in scene.structure.shapes if s[0] == owner), None)
        slot = scene.structure.slot(name)
        if not name.endswith(".vertices") or span is None or span[0] != "triangle" or not isinstance(slot.row, tuple):
            raise SceneError(f"{name}: has no Laplacian; smooth displacements are of a mesh's vertices")
        places, place = np.unique(value, axis=0, return_inverse=True)
        place = place.reshape(-1)
        corners = place[np.asarray(scene.triangles)[span[1] : span[2]] - slot.row[0]]
        pairs = np.unique(np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        size = np.linalg.norm(np.ptp(value, 0)) / 2
        start = jnp.zeros((len(places), 3))
        return Displaced(
            start, jnp.asarray(value), jnp.asarray(place), jnp.asarray(pairs), jnp.asarray(size), self.weight
        )


def _plain(scene: Scene, name: str, value: np.ndarray) -> Transform:
    return Transform(jnp.asarray(value))


NAMED: dict[str, Callable[..., Transform]] = {
    "plain": _plain,
    "positive": Positive.of,
    "unit": Between.of,
    "rigid": Rigid.of,
    "shift": Shift(),
    "smooth": Smooth(),
}


def transform_of(scene: Scene, name: str, given: Any) -> Transform:
    """The transform of a parameter as `fit` is given it: a name, (lower, upper), a callable, or None: by its name."""
    value = np.asarray(params(scene)[name], float)
    if given is None:
        parts = set(name.split(".")[1:])
        given = "rigid" if "to_world" in parts else "smooth" if "vertices" in parts else None
        given = given or ("unit" if parts & UNIT else "positive" if parts & POSITIVE else "plain")
    if isinstance(given, str):
        if given not in NAMED:
            raise SceneError(f"{name}: {given!r} is not known; give {', '.join(NAMED)} or (lower, upper)")
        return NAMED[given](scene, name, value)
    if isinstance(given, (tuple, list)) and len(given) == 2:
        return Between.of(scene, name, value, *given)
    if callable(given):
        made: Any = given
        return made(scene, name, value)
    raise SceneError(f"{name}: {given!r} is no transform; give {', '.join(NAMED)} or (lower, upper)")
