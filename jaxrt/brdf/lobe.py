"""What a lobe is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from ..vector import Spectrum, Vec3


def _no_eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    return m.reflectance * 0.0


def _no_pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    return wo.z * 0.0


@dataclasses.dataclass(frozen=True)
class Lobe:
    """A lobe's number in the material table, the fields it reads, and its functions.

    `eval` and `pdf` may assume cosines above 0. A delta lobe has a `weight` (reflected radiance per
    incident radiance) instead of `eval` and `pdf`.
    """

    name: str
    number: int
    fields: tuple[str, ...]
    sample: Callable[[Any, Vec3, tuple[Any, Any]], Vec3]
    eval: Callable[[Any, Vec3, Vec3], Spectrum] = _no_eval
    pdf: Callable[[Any, Vec3, Vec3], Any] = _no_pdf
    weight: Callable[[Any, Vec3, Vec3], Spectrum] = _no_eval
    delta: bool = False
