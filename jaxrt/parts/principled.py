"""Disney's principled surfaces, with the parameters that artists know."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .checks import check, scalar, varying
from .reflectances import Row
from .textures import Texture

_COATED = np.ones(1)
"""Value of the field `specular`: these surfaces reflect some light even if `base_color` is black."""


def _check(part: Principled | PrincipledThin, name: str, *single: str, **ranges: tuple[float, float]) -> None:
    """`single`: what takes no texture."""
    part.base_color = varying(part.base_color, f"{name}.base_color", most=1.0)
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if field.name not in ("base_color", "id") and value is not None:
            least, most = ranges.get(field.name, (0.0, 1.0))
            checked = varying if isinstance(value, Texture) and field.name not in single else scalar
            setattr(part, field.name, checked(value, f"{name}.{field.name}", least=least, most=most))


def _row(lobe: str, part: Principled | PrincipledThin, eta: float) -> Row:
    own = {"base_color", "eta", "specular", "id"}
    names = [field.name for field in dataclasses.fields(part) if field.name not in own]
    fields = {name: getattr(part, name) for name in names}
    fields |= {"reflectance": part.base_color, "ior": eta, "specular": _COATED}
    return Row(lobe, fields, {"base_color": "reflectance", "eta": "ior", **{name: name for name in names}})


@dataclasses.dataclass
class Principled:
    """Paint, metal or rough glass below a clear coat (Burley 2012; 2015), every parameter but `eta` from 0 to 1.

    `eta`: index of refraction inside over outside. Or `specular`, which stands for those from 1 to 1.8; 0.5 by default.
    With `spec_trans` above 0 some light goes through: shapes of it have to be closed.
    All but `eta` and `specular` may be textures.
    """

    base_color: Any = 0.5
    roughness: Any = 0.5
    anisotropic: Any = 0.0
    metallic: Any = 0.0
    spec_trans: Any = 0.0
    eta: float | None = None
    specular: float | None = None
    spec_tint: Any = 0.0
    sheen: Any = 0.0
    sheen_tint: Any = 0.0
    flatness: Any = 0.0
    clearcoat: Any = 0.0
    clearcoat_gloss: Any = 0.0
    id: str = ""

    def __post_init__(self):
        name = self.id or "principled"
        check(
            self.eta is None or self.specular is None, name, "has both eta and specular, which are the same; give one"
        )
        _check(self, name, "eta", "specular", eta=(1e-3, 1e3))

    @property
    def transmits(self) -> bool:
        return isinstance(self.spec_trans, Texture) or self.spec_trans > 0

    def row(self) -> Row:
        specular = 0.5 if self.specular is None else self.specular
        return _row("principled", self, self.eta or 2.0 / (1.0 - np.sqrt(0.08 * specular)) - 1.0)


@dataclasses.dataclass
class PrincipledThin:
    """Paint or rough glass as a thin sheet (Burley 2015), alike from both sides; every parameter from 0 to 1, but for
    `eta`, the index of refraction, and `diff_trans`: 0 if all diffuse light stays on its side, 2 if all goes through.
    All may be textures.
    """

    base_color: Any = 0.5
    roughness: Any = 0.5
    anisotropic: Any = 0.0
    spec_trans: Any = 0.0
    eta: Any = 1.5
    spec_tint: Any = 0.0
    sheen: Any = 0.0
    sheen_tint: Any = 0.0
    flatness: Any = 0.0
    diff_trans: Any = 0.0
    id: str = ""

    def __post_init__(self):
        _check(self, self.id or "principledthin", eta=(1e-3, 1e3), diff_trans=(0.0, 2.0))

    @property
    def transmits(self) -> bool:
        return True

    def row(self) -> Row:
        return _row("principled_thin", self, self.eta)
