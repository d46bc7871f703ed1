"""Mitsuba 3 XML, read into a tree of elements: `$names`, includes, aliases and values are worked out here.

The meaning is that of Mitsuba's own parser: a `<default>` holds from where it stands, the first one wins
and arguments win over it; an `<include>` is searched beside the file it stands in, then where the
including file searches; references may point forward. Entities are refused, so a small file stays small.
"""

from __future__ import annotations

import dataclasses
import difflib
import pathlib
import re
from collections.abc import Iterable, Mapping
from typing import NoReturn

from ..parts import SceneError
from .mesh import listed
from .mitsuba_nodes import DEEPEST, OBJECTS, OPERATIONS, VALUES, Node, parse
from .mitsuba_values import Value, value
from .reading import find, take

_REQUIRED = {
    "include": ("filename",),
    "path": ("value",),
    "ref": ("id",),
    "alias": ("id", "as"),
    "default": ("name", "value"),
}
_ALLOWED = {"include": ("name",), "ref": ("name",)}

# a scene is flat and its values are short; these stop files made to fill the memory
_MOST_INCLUDES, _MOST_PATHS, _MOST_DEFAULTS, _LONGEST = 1000, 100, 1000, 1 << 16


@dataclasses.dataclass(eq=False)
class Reference:
    """A `<ref>`: it stands for the element of that id, which may come later in the file."""

    id: str
    node: Node


@dataclasses.dataclass(eq=False)
class Element:
    """An object of the scene: its plugin, its values by name, and the objects nested or referenced in it."""

    node: Node
    values: dict[str, Value] = dataclasses.field(default_factory=dict)
    children: list[tuple[str, Element | Reference]] = dataclasses.field(default_factory=list)
    names: set[str] = dataclasses.field(default_factory=set)

    @property
    def tag(self) -> str:
        return self.node.tag

    @property
    def plugin(self) -> str:
        return self.node.attributes.get("type", "scene")

    @property
    def id(self) -> str:
        return self.node.attributes.get("id", "")

    def fail(self, problem: object) -> NoReturn:
        self.node.fail(problem)


@dataclasses.dataclass
class Document:
    """A file and all it includes. `search`: the folders where meshes are looked for, first one first."""

    root: Element
    ids: dict[str, Element]
    search: list[pathlib.Path]
    notes: list[str]


def read(path: pathlib.Path, defaults: Mapping[str, str | float | int]) -> Document:
    """The scene in `path`. Raises `SceneError` for anything that is missing, malformed or not closed."""
    return _Reader(defaults).document(path)


class _Reader:
    def __init__(self, defaults: Mapping[str, str | float | int]):
        self.parameters: dict[str, str] = {}
        for name, given in defaults.items():
            self.parameters[name] = str(given).lower() if isinstance(given, bool) else str(given)
        self.arguments = set(defaults)
        self.used: set[str] = set()
        self.ids: dict[str, Element] = {}
        self.references: list[Reference] = []
        self.notes: list[str] = []
        self.open: list[pathlib.Path] = []
        self.includes = 0

    def document(self, path: pathlib.Path) -> Document:
        if not find(path.name, [path.parent]) or path.is_dir():
            raise SceneError(f"{path}: no such file; check the path")
        node, search = parse(path), [path.parent]
        if node.tag != "scene":
            node.fail("is the outermost element; put it into a <scene>")
        root = Element(node)
        self.open.append(path.resolve())
        self.fill(root, node, search, 0)
        for reference in self.references:
            if reference.id not in self.ids:
                close = difflib.get_close_matches(reference.id[:80], [*self.ids][:1000], 3, 0.4)
                advice = f"did you mean {' or '.join(close)}?" if close else "add it or remove the reference"
                reference.node.fail(f"no element has id {reference.id[:80]!r}; {advice}")
        self.heights(root, [], {})
        unused = sorted(self.arguments - self.used)
        if unused:
            names = sorted(set(self.parameters) - self.arguments | self.used)
            close = difflib.get_close_matches(unused[0], names, 3, 0.4)
            advice = f"did you mean {' or '.join(close)}?" if close else f"it uses: {', '.join(names) or 'none'}"
            raise SceneError(f"{path}: no ${unused[0]} in this scene; {advice}")
        return Document(root, self.ids, search, self.notes)

    def heights(self, element: Element, inside: list[Element], found: dict[Element, int]) -> int:
        """How deep objects stand in one another, references followed: refuses what is endless, or too deep."""
        if element in inside:
            element.fail("stands in itself, by a reference; break the cycle")
        if element not in found:
            within = [self.ids[c.id] if isinstance(c, Reference) else c for _, c in element.children]
            below = [0] if len(inside) > DEEPEST else [self.heights(e, [*inside, element], found) for e in within]
            found[element] = 1 + max(below, default=0)
        if len(inside) + found[element] > DEEPEST:
            element.fail(f"is nested deeper than {DEEPEST} elements, references followed; make the scene flatter")
        return found[element]

    def fill(self, parent: Element, node: Node, search: list[pathlib.Path], depth: int) -> None:
        """Read the children of `node` into `parent`. `search` is the file's, to which a <path> adds."""
        for child in node.children:
            self.child(parent, child, search, depth + 1)

    def child(self, parent: Element, node: Node, search: list[pathlib.Path], depth: int) -> None:
        if depth > DEEPEST:
            node.fail(f"is nested deeper than {DEEPEST} elements; make the scene flatter")
        self.substitute(node)
        if node.text:
            self.notes.append(f"{node.label}: holds text, which has no effect")
        tag, attributes = node.tag, node.attributes
        if tag in OBJECTS or (tag == "spectrum" and "type" in attributes):
            self.object(parent, node, search, depth)
        elif tag in VALUES:
            for inner in self.below(node):
                self.substitute(inner)
            given = value(node, lambda name: node.locate(name, search))
            parent.values[self.only_once(parent, node)] = given
            if given.note:
                self.notes.append(f"{node.label}: {given.note}")
        elif tag in _REQUIRED:
            node.only(_ALLOWED.get(tag, ()), _REQUIRED[tag])
            if node.children:
                node.children[0].fail(f"cannot stand in <{tag}>; move it out")
            if tag == "include":
                self.include(parent, node, search, depth)
            elif tag == "ref":
                self.references.append(Reference(attributes["id"], node))
                self.attach(parent, node, self.references[-1])
            elif tag == "alias":
                if attributes["id"] not in self.ids:
                    node.fail(f"no id {attributes['id'][:80]!r} before it; move it after that element")
                self.register(attributes["as"], self.ids[attributes["id"]], node)
            elif tag == "default":
                if not attributes["name"]:
                    node.fail("has an empty name; give one")
                if len(self.parameters) >= _MOST_DEFAULTS:
                    node.fail(f"is one of more than {_MOST_DEFAULTS} defaults; write their values out")
                self.parameters.setdefault(attributes["name"], attributes["value"])
            else:
                self.path(node, parent, search)
        elif tag in OPERATIONS:
            node.fail("stands outside a <transform>; move it into one")
        else:
            node.fail("is not an element of Mitsuba 3; remove it or correct its name")

    def object(self, parent: Element, node: Node, search: list[pathlib.Path], depth: int) -> None:
        node.only(("id", "name"), ("type",))
        if node.tag == "scene":
            node.fail("stands inside a scene; use <include> or remove it")
        element = Element(node)
        self.attach(parent, node, element)
        if element.id:
            self.register(element.id, element, node)
        self.fill(element, node, search, depth)

    def attach(self, parent: Element, node: Node, child: Element | Reference) -> None:
        name = self.only_once(parent, node) if node.attributes.get("name") else ""
        parent.children.append((name, child))

    def only_once(self, parent: Element, node: Node) -> str:
        name = node.attribute("name")
        if name in parent.names:
            node.fail(f"{name[:80]!r} is given twice; remove one")
        parent.names.add(name)
        return name

    def register(self, id: str, element: Element, node: Node) -> None:
        if id in self.ids:
            other = self.ids[id].node
            node.fail(f"id {id[:80]!r} is already used at {other.file.name}:{other.line}; choose another")
        self.ids[id] = element

    def include(self, parent: Element, node: Node, search: list[pathlib.Path], depth: int) -> None:
        path = node.locate(node.attributes["filename"], search)
        self.includes += 1
        if path.resolve() in self.open:
            node.fail(f"includes {path.name}, in which it stands itself; break the cycle")
        if self.includes > _MOST_INCLUDES:
            node.fail(f"is one of more than {_MOST_INCLUDES} includes; put the files together")
        inner = parse(path)
        self.open.append(path.resolve())
        inner_search = [path.parent, *search]
        if inner.tag == "scene":
            self.substitute(inner)
            self.fill(parent, inner, inner_search, depth)
        else:
            inner.attributes.pop("version")
            if "name" in node.attributes:
                inner.attributes["name"] = node.attributes["name"]
            self.child(parent, inner, inner_search, depth + 1)
        self.open.pop()

    def path(self, node: Node, parent: Element, search: list[pathlib.Path]) -> None:
        if parent.tag != "scene":
            node.fail("stands inside an object; move it to the top of the scene")
        folder = node.find(node.attributes["value"], search)
        if len(search) >= _MOST_PATHS:
            node.fail(f"is one of more than {_MOST_PATHS} folders; put their files together")
        if folder is None or not folder.is_dir():
            node.fail("no such folder; check its value")
        search.insert(0, folder)

    def below(self, node: Node) -> Iterable[Node]:
        """The elements inside a value: operations in a <transform>, nothing else."""
        for inner in node.children:
            if node.tag != "transform" or inner.tag not in OPERATIONS:
                advice = "write <lookat>" if inner.tag.lower() in ("lookat", "look_at") else "remove it"
                inner.fail(f"cannot stand in <{node.tag}>; {advice}")
            if inner.children:
                inner.children[0].fail(f"cannot stand in <{inner.tag}>; move it out")
            yield inner

    def substitute(self, node: Node) -> None:
        """Put parameters for $names, the longest first; `\\$` is a dollar sign."""
        for key, text in node.attributes.items():
            if "$" not in text:
                continue
            for name in sorted(self.parameters, key=len, reverse=True):
                if "$" + name not in text:
                    continue
                pattern, new = r"(?<!\\)\$" + re.escape(name), self.parameters[name]
                count = len(re.findall(pattern, text))
                if len(text) + count * len(new) > _LONGEST:
                    node.fail(f"{key} grows beyond {_LONGEST} characters by ${name[:80]}; shorten it")
                if count:
                    take(node.file, 16 * count * len(new), "write shorter values, or fewer")
                    self.used.add(name)
                    text = re.sub(pattern, lambda _, new=new: new, text)
            missing = re.search(r"(?<!\\)\$([A-Za-z0-9_]*)", text)
            if missing:
                known = listed(sorted(self.parameters)) or "none"
                name = missing[1][:80]
                node.fail(f'${name} is not defined (defined: {known}); give {name}, or add a <default name="{name}">')
            node.attributes[key] = text.replace("\\$", "$")
