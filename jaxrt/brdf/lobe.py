"""What a lobe is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from ..vector import Spectrum, Vec3


def _no_eval(m: Any, wi: Vec3, wo: Vec3) -> Spectrum:
    return m.reflectance * 0.0


def _no_pdf(m: Any, wi: Vec3, wo: Vec3) -> Any:
    return wo.z * 0.0


def _every(m: Any, wo: Vec3, u: tuple[Any, ...]) -> Any:
    return jnp.ones(jnp.shape(wo.z), bool)


@dataclasses.dataclass(frozen=True)
class Lobe:
    """A lobe's number in the material table, the fields it reads, and its functions.

    `eval` and `pdf` may assume cosines above 0, unless the lobe is `translucent`: it scatters light through the
    surface, and has a value for directions on either side. A lobe with a delta part has its `weight`
    (radiance per incident radiance, over the chance of that direction), and says which samples are the delta's: all
    of them, where it has nothing else. Densities are the chance of the rest times its density. `u` are two uniform
    numbers for a direction, and one more where a lobe of the plan `chooses`. `transmits`: some light goes through.
    `straight`: all that goes through does so unturned. `derive`: of a row, the fields in `DERIVED` that the lobe reads.
    """

    name: str
    number: int
    fields: tuple[str, ...]
    sample: Callable[[Any, Vec3, tuple[Any, ...]], Vec3]
    eval: Callable[[Any, Vec3, Vec3], Spectrum] = _no_eval
    pdf: Callable[[Any, Vec3, Vec3], Any] = _no_pdf
    weight: Callable[[Any, Vec3, Vec3], Spectrum] = _no_eval
    delta: bool = False
    is_delta: Callable[[Any, Vec3, tuple[Any, ...]], Any] = _every
    transmits: bool = False
    straight: bool = False
    translucent: bool = False
    chooses: bool = False
    derive: Callable[[Any], dict[str, Any]] | None = None
