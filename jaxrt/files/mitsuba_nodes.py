"""The XML of a Mitsuba scene file as a tree of nodes which know their file and line. Entities are refused."""

from __future__ import annotations

import dataclasses
import io
import pathlib
import re
import xml.sax
import xml.sax.handler
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

import defusedxml
import defusedxml.sax

from ..parts import SceneError
from .reading import ELEMENT, find, read_bytes, take

OBJECTS = frozenset(
    "bsdf emitter field film integrator medium phase rfilter sampler scene sensor shape texture volume".split()
)
VALUES = frozenset("boolean integer float string point vector spectrum rgb transform".split())
OPERATIONS = frozenset("translate rotate scale lookat matrix".split())

DEEPEST = 64
"""Most elements inside one another: enough for any scene, and little enough for Python's stack."""


@dataclasses.dataclass(eq=False)
class Node:
    """An XML element as it stands in a file."""

    tag: str
    attributes: dict[str, str]
    file: pathlib.Path
    line: int
    children: list[Node] = dataclasses.field(default_factory=list)
    text: bool = False

    @property
    def label(self) -> str:
        keys = ("type", "id") if self.tag in OBJECTS else ("name",) if self.tag in VALUES else ()
        words = [self.tag, *(f'{key}="{self.attributes[key][:80]}"' for key in keys if self.attributes.get(key))]
        return f"{self.file}:{self.line}: <{' '.join(words)}>"

    def fail(self, problem: object) -> NoReturn:
        raise SceneError(f"{self.label}: {problem}")

    def find(self, name: str, search: Sequence[pathlib.Path]) -> pathlib.Path | None:
        """The first regular file or folder of that name, which stands here, in the folders of `search`, or None."""
        try:
            return find(name, search)
        except SceneError as refused:
            self.fail(refused)

    def locate(self, name: str, search: Sequence[pathlib.Path]) -> pathlib.Path:
        """As `find`, a file that has to be there."""
        found = self.find(name, search)
        if not name or found is None or not found.is_file():
            self.fail(f"no such file: {name[:80]!r}; check its filename, or give its folder by <path>")
        return found

    def attribute(self, name: str) -> str:
        if name not in self.attributes:
            self.fail(f'has no {name}; add {name}="..."')
        return self.attributes[name]

    def only(self, allowed: Iterable[str], required: Iterable[str] = ()) -> None:
        """Fail for an attribute that is not allowed, or required and missing; Mitsuba is as strict."""
        for name in required:
            self.attribute(name)
        wrong = [name for name in self.attributes if name not in (*allowed, *required)]
        if wrong:
            self.fail(f"has no attribute {wrong[0][:80]!r}; it has {', '.join((*required, *allowed))}")


def parse(path: pathlib.Path) -> Node:
    """The elements of one file, whose format is checked to be Mitsuba 3's."""
    data, handler = read_bytes(path), _Handler(path)
    parser = defusedxml.sax.make_parser()
    parser.setContentHandler(handler)
    try:
        parser.parse(io.BytesIO(data))
    except defusedxml.EntitiesForbidden:
        raise SceneError(f"{path}: defines an XML entity, which is refused; write its text out") from None
    except defusedxml.DefusedXmlException:
        raise SceneError(f"{path}: refers to a file by XML, which is refused; use <include>") from None
    except xml.sax.SAXParseException as problem:
        raise SceneError(
            f"{path}:{problem.getLineNumber()}: not well-formed XML ({problem.getMessage()}); mend it there"
        ) from None
    except (ValueError, LookupError) as problem:
        if isinstance(problem, SceneError):
            raise
        raise SceneError(f"{path}: is in an encoding that is not supported; save it as UTF-8") from None
    root = handler.root
    assert root is not None  # expat refuses a file without an element
    if root.tag not in OBJECTS:  # it may be any file, of which nothing is quoted
        raise SceneError(f"{path}:{root.line}: is not a scene or an object of one; put it into a <scene>")
    _check_version(root)
    root.only(("id", "name"), ("version", "type") if root.tag != "scene" else ("version",))
    return root


class _Handler(xml.sax.handler.ContentHandler):
    """Builds the tree of nodes with the line each starts in."""

    def __init__(self, path: pathlib.Path):
        super().__init__()
        self.path = path
        self.root: Node | None = None
        self.stack: list[Node] = []
        self.locator: Any = None

    def setDocumentLocator(self, locator: Any) -> None:
        self.locator = locator

    def startElement(self, name: str, attrs: Any) -> None:
        node = Node(name[:80], dict(attrs.items()), self.path, self.locator.getLineNumber())
        if len(self.stack) > DEEPEST:
            where = f"{self.path}:{node.line}"
            raise SceneError(f"{where}: an element is nested deeper than {DEEPEST}; make the scene flatter")
        take(self.path, ELEMENT, "include fewer files, or each fewer times")
        if self.stack:
            self.stack[-1].children.append(node)
        else:
            self.root = node
        self.stack.append(node)

    def endElement(self, name: str) -> None:
        self.stack.pop()

    def characters(self, content: str) -> None:
        if content.strip():
            self.stack[-1].text = True


def _check_version(root: Node) -> None:
    text = root.attribute("version")
    match = re.fullmatch(r"\s*(\d{1,4})\.(\d{1,4})\.(\d{1,4})\s*", text, re.ASCII)
    if not match:
        root.fail('has a version that is not three numbers; write version="3.0.0"')
    if int(match[1]) < 2:
        root.fail(
            f"is in the old format {match[0].strip()}; upgrade it to 3.0.0: "
            'parameters are in snake_case (toWorld is to_world, lookAt is lookat), then write version="3.0.0"'
        )
