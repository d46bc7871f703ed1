"""4x4 matrices of the operations in a Mitsuba `<transform>`, in float64. Points are columns: p' = M p."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def translate(offset: ArrayLike) -> np.ndarray:
    m = np.eye(4)
    m[:3, 3] = offset
    return m


def scale(factors: ArrayLike) -> np.ndarray:
    return np.diag(np.append(factors, 1.0))


def rotate(axis: ArrayLike, angle: float) -> np.ndarray:
    """Rodrigues' formula, `angle` in degrees, counter-clockwise seen against `axis`.

    The axis is not normalised, for Mitsuba 3 does not do so in scene files either: an axis that is
    not a unit vector also scales and shears. Raises `ValueError` for the zero axis.
    """
    a = np.asarray(axis, np.float64)
    if not a.any():
        raise ValueError("rotation axis is zero; give x, y or z")
    s, c = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    m = np.eye(4)
    m[:3, :3] = c * np.eye(3) + s * cross + (1 - c) * np.outer(a, a)
    return m


def look_at(origin: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """From a camera's space (+z to `target`, +y upwards, so +x to its left) to the world.

    Without `up` (zero) some perpendicular is taken, the one that Mitsuba takes. Raises `ValueError`
    where origin and target coincide or `up` is along the view.
    """
    o, t, u = (np.asarray(v, np.float64) for v in (origin, target, up))
    forward = _unit(t - o, "origin and target coincide")
    if not u.any():
        u = perpendicular(forward)
    left = _unit(np.cross(u, forward), "up is along the view")
    m = np.eye(4)
    m[:3, 0], m[:3, 1], m[:3, 2], m[:3, 3] = left, np.cross(forward, left), forward, o
    return m


def matrix(values: Sequence[float]) -> np.ndarray:
    """9 (linear part) or 16 numbers, row by row. Raises `ValueError` for another count."""
    if len(values) not in (9, 16):
        raise ValueError(f"a matrix has 9 or 16 numbers, not {len(values)}")
    n = 3 if len(values) == 9 else 4
    m = np.eye(4)
    m[:n, :n] = np.reshape(values, (n, n))
    return m


def _unit(v: np.ndarray, otherwise: str) -> np.ndarray:
    length = np.linalg.norm(v)
    if not (np.isfinite(length) and length > 0):
        raise ValueError(f"{otherwise}; move one of them")
    return v / length


def perpendicular(n: np.ndarray) -> np.ndarray:
    """T. Duff et al., Building an orthonormal basis, revisited, JCGT 2017: the first tangent."""
    sign = np.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    return np.array([1.0 + sign * n[0] ** 2 * a, sign * n[0] * n[1] * a, -sign * n[0]])
