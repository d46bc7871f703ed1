"""All effects, in the order of the table. One may look at those before it."""

from __future__ import annotations

from . import lights, reflectance, surfaces, views
from .effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.name: effect for effect in (*reflectance.EFFECTS, *surfaces.EFFECTS, *lights.EFFECTS, *views.EFFECTS)
}
