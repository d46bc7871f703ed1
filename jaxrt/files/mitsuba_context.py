"""What all parts of the Mitsuba loader share: typed parameters, nested objects, names and notes."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from ..parts import SceneError
from .mitsuba_values import Value
from .mitsuba_xml import Document, Element, Reference

T = TypeVar("T")


class Context:
    """A document on its way to a `Description`. Whatever is not asked for is noted or refused by `finish`."""

    def __init__(self, document: Document):
        self.ids, self.search = document.ids, document.search
        self.notes = [*document.notes]
        self.referenced: set[Element] = set()
        self._built: dict[Element, Any] = {}
        self._names = set(document.ids)
        self._taken: dict[Element, set[str | int]] = {}

    # ------------------------------------------------------------------------------ parameters

    def get(self, element: Element, name: str, *kinds: str) -> Value | None:
        """The parameter of that name, of one of the kinds, or None where the element does not have it."""
        found = element.values.get(name)
        if found is None:
            return None
        self._taken.setdefault(element, set()).add(name)
        if found.kind not in kinds:
            found.node.fail(f"is of the wrong kind; write it as <{kinds[0]}>")
        return found

    def number(self, element: Element, name: str, default: float | None = None) -> float:
        found = self.get(element, name, "float", "integer")
        if found is None and default is None:
            element.fail(f'has no {name}; add <float name="{name}" value="..."/>')
        return default if found is None else float(found.content)  # type: ignore[return-value]

    def integer(self, element: Element, name: str, default: int) -> int:
        found = self.get(element, name, "integer")
        return default if found is None else found.content

    def boolean(self, element: Element, name: str, default: bool) -> bool:
        found = self.get(element, name, "boolean")
        return default if found is None else found.content

    def string(self, element: Element, name: str, default: str = "") -> str:
        found = self.get(element, name, "string")
        return default if found is None else found.content

    def point(self, element: Element, name: str, default: tuple[float, float, float]) -> np.ndarray:
        found = self.get(element, name, "point", "vector")
        return np.array(default) if found is None else found.content

    def transform(self, element: Element, name: str = "to_world") -> np.ndarray:
        found = self.get(element, name, "transform")
        if found is None:
            return np.eye(4)
        if not np.isfinite(found.content).all():
            found.node.fail("has entries too large for a number; scale the scene down")
        return found.content

    def file(self, element: Element) -> pathlib.Path:
        """The file named by `filename`, searched as Mitsuba does: from the main file, not from an included one."""
        return element.node.locate(self.string(element, "filename"), self.search)

    # ----------------------------------------------------------------------------- nested objects

    def resolve(self, child: Element | Reference) -> Element:
        if not isinstance(child, Reference):
            return child
        self.referenced.add(self.ids[child.id])
        return self.ids[child.id]

    def children(self, element: Element, *tags: str) -> list[Element]:
        """The objects with one of those tags, nested or referenced, in the order of the file."""
        found = []
        for index, (_, child) in enumerate(element.children):
            target = self.resolve(child)
            if target.tag in tags:
                self._taken.setdefault(element, set()).add(index)
                found.append(target)
        return found

    def child(self, element: Element, tag: str) -> Element | None:
        """The object with that tag, or None; more than one is an error."""
        found = self.children(element, tag)
        if len(found) > 1:
            element.fail(f"has {len(found)} <{tag}>; keep one")
        return found[0] if found else None

    def named(self, element: Element, name: str) -> Element | None:
        """The object which stands for a parameter, as a texture does for a colour."""
        for index, (given, child) in enumerate(element.children):
            if given == name:
                self._taken.setdefault(element, set()).add(index)
                return self.resolve(child)
        return None

    # ------------------------------------------------------------------------------------ building

    def name(self, element: Element, place: str) -> str:
        """The element's id, or a name from its place which no other part has."""
        if element.id:
            return element.id
        while place in self._names:
            place += "_"
        self._names.add(place)
        return place

    def part(self, element: Element, make: Callable[..., T], /, **fields: Any) -> T:
        """`make(**fields)`; what it finds wrong is said with the file and the element."""
        try:
            return make(**fields)
        except SceneError as problem:
            element.fail(problem)

    def once(self, element: Element, build: Callable[[], T]) -> T:
        """`build()`, the same object each time an element is referenced."""
        if element not in self._built:
            self._built[element] = build()
        return self._built[element]

    def finish(self, element: Element, ignored: Mapping[str, str] | None = None) -> None:
        """Note every parameter and refuse every object that nothing asked for.

        `ignored`: parameters that Mitsuba knows, with why they have no effect here; an empty reason
        (a matter of sampling or of files, not of what light does) is not worth a note.
        """
        ignored, taken = ignored or {}, self._taken.get(element, set())
        for name, given in element.values.items():
            reason = ignored.get(name, f"is not a parameter of {element.plugin[:80]}, and is ignored")
            if name not in taken and reason:
                self.notes.append(f"{given.node.label}: {reason}")
        for index, (_, child) in enumerate(element.children):
            if index not in taken:
                target = self.resolve(child)
                what = f'<{target.tag} type="{target.plugin[:80]}"> ' if isinstance(child, Reference) else ""
                child.node.fail(f'{what}is not supported in <{element.tag} type="{element.plugin[:80]}">; remove it')
