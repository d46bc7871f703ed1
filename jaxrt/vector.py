"""Vectors and spectra as components, so that a batch of rays is a structure of arrays.

A `Vec3` holds three scalars of one ray; `jax.vmap` turns each into one long array. XLA then fuses
whole kernels over rays; arrays of shape (3,) in the same place cost 45 times as much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

Scalar = Float[Array, "*batch"]


class Vec3(eqx.Module):
    """A point (m), a direction (unit length) or a difference of points, as three components."""

    x: Any
    y: Any
    z: Any

    @classmethod
    def of(cls, a: ArrayLike | Vec3) -> Vec3:
        """From an array of shape (..., 3)."""
        if isinstance(a, Vec3):
            return a
        a = jnp.asarray(a)
        if a.shape[-1:] != (3,):
            raise ValueError(f"a vector has three components on its last axis, not shape {a.shape}")
        return cls(a[..., 0], a[..., 1], a[..., 2])

    def array(self) -> Float[Array, "*batch 3"]:
        return jnp.stack(jnp.broadcast_arrays(self.x, self.y, self.z), -1)

    __jax_array__ = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        import numpy as np

        return np.asarray(self.array(), dtype)

    def __iter__(self) -> Iterator[Any]:
        return iter((self.x, self.y, self.z))

    def __add__(self, o: Vec3) -> Vec3:
        return Vec3(self.x + o.x, self.y + o.y, self.z + o.z)

    def __sub__(self, o: Vec3) -> Vec3:
        return Vec3(self.x - o.x, self.y - o.y, self.z - o.z)

    def __mul__(self, k: Any) -> Vec3:
        return Vec3(self.x * k, self.y * k, self.z * k)

    __rmul__ = __mul__

    def __neg__(self) -> Vec3:
        return Vec3(-self.x, -self.y, -self.z)


class Spectrum(eqx.Module):
    """Values at the scene's channels: a tuple of scalars, for the same reason as `Vec3`."""

    channels: tuple[Any, ...]

    @classmethod
    def of(cls, a: Any) -> Spectrum:
        """From an array whose last axis is the channels."""
        return a if isinstance(a, Spectrum) else cls(tuple(a[..., k] for k in range(a.shape[-1])))

    @classmethod
    def full(cls, channels: int, value: Any) -> Spectrum:
        return cls((value,) * channels)

    def array(self) -> Float[Array, "*batch channels"]:
        return jnp.stack(jnp.broadcast_arrays(*self.channels), -1)

    __jax_array__ = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        import numpy as np

        return np.asarray(self.array(), dtype)

    def map(self, f: Callable[..., Any], *others: Any) -> Spectrum:
        rows = [o.channels if isinstance(o, Spectrum) else (o,) * len(self.channels) for o in others]
        return Spectrum(tuple(f(*c) for c in zip(self.channels, *rows, strict=True)))

    def __add__(self, o: Any) -> Spectrum:
        return self.map(lambda a, b: a + b, o)

    def __sub__(self, o: Any) -> Spectrum:
        return self.map(lambda a, b: a - b, o)

    def __mul__(self, o: Any) -> Spectrum:
        return self.map(lambda a, b: a * b, o)

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, o: Any) -> Spectrum:
        return self.map(lambda a, b: a / b, o)

    def max(self) -> Any:
        m = self.channels[0]
        for c in self.channels[1:]:
            m = jnp.maximum(m, c)
        return m


def where(condition: Any, a: Any, b: Any) -> Any:
    """`jnp.where` over two equal pytrees."""
    return jax.tree.map(lambda p, q: jnp.where(condition, p, q), a, b)


def dot(a: Vec3, b: Vec3) -> Any:
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec3, b: Vec3) -> Vec3:
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def safe_sqrt(x: Any) -> Any:
    """√max(x, 0), with derivative 0 (not infinite) where x ≤ 0."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def length(a: Vec3) -> Any:
    return safe_sqrt(dot(a, a))


def normalise(a: Vec3) -> Vec3:
    """Unit vector along `a`; +z where `a` is 0, with derivative 0 there."""
    n = dot(a, a)
    ok = n > 0
    k = jax.lax.rsqrt(jnp.where(ok, n, 1.0))
    return Vec3(jnp.where(ok, a.x * k, 0.0), jnp.where(ok, a.y * k, 0.0), jnp.where(ok, a.z * k, 1.0))


class Frame(eqx.Module):
    """Orthonormal right-handed axes s, t, n. Local coordinates are along (s, t, n); cosθ is the third."""

    s: Vec3
    t: Vec3
    n: Vec3

    @classmethod
    def around(cls, n: Vec3) -> Frame:
        """A frame around a unit normal, orthonormal to rounding for every n (Duff et al. 2017)."""
        sign = jnp.where(n.z >= 0, 1.0, -1.0)
        a = -1.0 / (sign + n.z)
        b = n.x * n.y * a
        return cls(Vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3(b, sign + n.y * n.y * a, -n.y), n)

    @classmethod
    def along(cls, n: Vec3, tangent: Vec3) -> Frame:
        """A frame around n whose s axis is the part of `tangent` across n."""
        s = normalise(tangent - n * dot(n, tangent))
        return cls(s, cross(n, s), n)

    def to_local(self, v: Vec3) -> Vec3:
        return Vec3(dot(v, self.s), dot(v, self.t), dot(v, self.n))

    def to_world(self, v: Vec3) -> Vec3:
        return self.s * v.x + self.t * v.y + self.n * v.z


def transform_point(m: Any, p: Vec3) -> Vec3:
    """An affine 4x4 matrix applied to a point."""
    return transform_vector(m, p) + Vec3(m[0, 3], m[1, 3], m[2, 3])


def transform_vector(m: Any, v: Vec3) -> Vec3:
    return Vec3(*(m[i, 0] * v.x + m[i, 1] * v.y + m[i, 2] * v.z for i in range(3)))
