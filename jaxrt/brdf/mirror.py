"""Delta reflection of a smooth conductor: all of ω_o goes to its mirror direction, times Fresnel."""

from __future__ import annotations

from typing import Any

from ..vector import Spectrum, Vec3
from .fresnel import conductor
from .lobe import Lobe


def sample(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Vec3:
    return Vec3(-wo.x, -wo.y, wo.z)


def weight(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    return m.reflectance * conductor(m.eta, m.k, wo.z)


LOBE = Lobe("mirror", 1, ("reflectance", "eta", "k"), sample, weight=weight, delta=True)
