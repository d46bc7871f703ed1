"""Effects of pictures: sensors, films, hidden emitters, and the search for what rays meet."""

from __future__ import annotations

from ..intersect import BACKENDS
from ..parts.sensors import FILM_FILTERS
from ..scene import SENSORS
from .effect import Chosen, Effect, Found, named
from .facts import Facts


def _hide(facts: Facts, chosen: Chosen) -> Found:
    asked = facts.structure.asked().hide_emitters
    return Found(asked, "from the camera, as the integrator asks" if asked else "the integrator does not ask")


def _backend(name: str) -> Effect:
    find = lambda facts, chosen: Found(name == facts.backend[0], facts.backend[1] if name == facts.backend[0] else "")
    sets = lambda facts, chosen: {"backend": name}
    return Effect(f"rays:{name}", find, sets, fixed=f'is chosen otherwise; give backend="{name}"', changes=False)


def _sensor(kind: str) -> Effect:
    def find(facts: Facts, chosen: Chosen) -> Found:
        ids = zip(facts.structure.sensor_ids, facts.structure.sensors, strict=True)
        names = [name for name, s in ids if kind in (s.kind, *(part.kind for part in s.parts))]
        return Found(bool(names), named(names, "sensor") if names else "no sensor")

    return Effect(f"sensor:{kind}", find, fixed="belongs to the sensors; give sensor= to choose one")


def _film(kind: str) -> Effect:
    def find(facts: Facts, chosen: Chosen) -> Found:
        ids = zip(facts.structure.sensor_ids, facts.structure.sensors, strict=True)
        names = [name for name, s in ids if s.film[2] == kind]
        return Found(bool(names), named(names, "sensor") if names else "no film")

    return Effect(f"film:{kind}", find, fixed="belongs to the sensors; build them with another film")


EFFECTS = (
    Effect("hide_emitters", _hide, lambda facts, chosen: {"hide_emitters": True}),
    *(_backend(name) for name in BACKENDS),
    *(_sensor(kind) for kind in SENSORS),
    *(_film(kind) for kind in FILM_FILTERS),
)
