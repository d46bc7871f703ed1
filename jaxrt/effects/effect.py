"""What an effect is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from .facts import Facts
from .static import Assumption

Chosen = Mapping[str, bool]
"""Effects that stand before one in the registry, and whether they are in."""


@dataclasses.dataclass(frozen=True)
class Found:
    """Whether a scene has an effect, why, and which values that relies on, if it has not."""

    on: bool
    why: str
    assumes: tuple[Assumption, ...] = ()


@dataclasses.dataclass(frozen=True)
class Effect:
    """One effect: `find` says whether a scene has it, `sets` which fields of the plan it sets where it is in.

    Fields of several effects are joined: tuples one after another, sets united, of flags and numbers the largest.
    `needs`: effects without which it is out ("texture:" stands for any of that name). `able`: whether it could be
    forced into a scene. `fixed`: why it can be forced neither in nor out, with a remedy; `stays`: why not out.
    `changes`: whether the picture, in the mean, is another without it. `cut`: whether leaving it out means to change
    the scene's tables.
    """

    name: str
    find: Callable[[Facts, Chosen], Found]
    sets: Callable[[Facts, Chosen], Mapping[str, Any]] = lambda facts, chosen: {}
    needs: tuple[str, ...] = ()
    able: Callable[[Facts, Chosen], bool] = lambda facts, chosen: True
    fixed: str = ""
    stays: str = ""
    changes: bool = True
    cut: bool = False

    def lacks(self, chosen: Chosen) -> str | None:
        """The first of its needs that is out."""
        for need in self.needs:
            if not any(on and (n == need or (need[-1] == ":" and n.startswith(need))) for n, on in chosen.items()):
                return need
        return None


def named(names: Any, one: str = "", most: int = 3) -> str:
    """A few names in a row: `materials glass, steel and 2 more`, with `one` for a single thing."""
    names = list(dict.fromkeys(n for n in names if n))
    said = ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
    return f"{one}{'s' * (len(names) > 1 and bool(one))} {said}".strip()
