"""What a search is built from, the same for every backend."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Float, Int32

from ..grids import Grids
from ..instances import Instances


class Faces(eqx.Module):
    """Faces (origin, e₁, e₂) by kind in `blocks`, and instances of groups of them.

    All about the scene's centre, groups about their own; `epsilon`: how far rounding may move a surface point, m.
    """

    geometry: Float[Array, "P 9"]
    maps: Float[Array, "P 12"]  # `affine` maps of the flat ones
    counts: Int32[Array, " 6"]
    center: Float[Array, " 3"]
    epsilon: Float[Array, ""]
    blocks: tuple[int, ...] = eqx.field(static=True)
    instances: Instances | None = None
    grids: Grids | None = None
    copies: int = eqx.field(static=True, default=0)  # padded number of triangles that instances stand for
