"""Lambertian reflection: f_r = R/π (notes, 1.3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..sampling.warp import cosine_hemisphere
from ..vector import Spectrum, Vec3
from .lobe import Lobe

_INV_PI = 1.0 / np.pi


def eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    return m.reflectance * _INV_PI


def sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    return cosine_hemisphere(u[:2])


def pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    return wi.z * _INV_PI


LOBE = Lobe("diffuse", 0, ("reflectance",), sample, eval, pdf)
