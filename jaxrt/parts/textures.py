"""Textures: values that vary over a surface, where a parameter would have one."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Literal

import numpy as np

from .checks import LARGEST, SceneError, check, spectrum, varying

TEXTURES = ("bitmap", "checkerboard", "attribute", "product", "sky")
"""Kinds of textures, in the order of their numbers in tables; number 0 stands for none."""

LUMINANCE = np.array([0.212671, 0.71516, 0.072169])
"""Of linear Rec. 709: what a colour is where a texture of it stands for one number."""

FILTERS, WRAPS = ("nearest", "bilinear"), ("repeat", "mirror", "clamp")


def _placed(value: Any, element: str) -> np.ndarray:
    """(2, 3), which takes (u, v, 1) to coordinates of a texture; a matrix (3, 3) or (4, 4) of Mitsuba is cut to it."""
    m = np.asarray(value, np.float64)
    check(m.shape in ((2, 3), (3, 3), (4, 4)), element, f"is a matrix (2, 3), not of shape {m.shape}")
    if m.shape == (4, 4):  # of a transform in space, the part that moves x and y
        m = m[:2][:, [0, 1, 3]]
    check(bool((np.abs(m) <= LARGEST).all()), element, "has an entry that is not finite, or too large")
    return m[:2]


@dataclasses.dataclass(eq=False)
class Texture:
    """What all textures share: `to_uv`, a (2, 3) matrix, takes a surface's coordinates (u, v, 1) to the texture's."""

    kind: ClassVar[str]
    to_uv: Any = dataclasses.field(default_factory=lambda: np.eye(3)[:2], kw_only=True)
    id: str = dataclasses.field(default="", kw_only=True)

    def __post_init__(self):
        self.to_uv = _placed(self.to_uv, f"{self.id or type(self).__name__.lower()}.to_uv")

    @property
    def of_mesh(self) -> bool:
        """Whether its values are a mesh's."""
        return False

    def values(self) -> np.ndarray:
        """All values that it has, (N, 1 or C)."""
        raise NotImplementedError

    def checked(self, element: str, least: float, most: float) -> Texture:
        for v in self.values().min(0), self.values().max(0):
            spectrum(v, f"{element}.data", least=least, most=most)
        return self

    def average(self, values: np.ndarray) -> np.ndarray:
        """The mean of values like its own ones."""
        return values.mean(0)

    def mean(self) -> np.ndarray:
        return self.average(self.values().astype(np.float64))


@dataclasses.dataclass(eq=False)
class Bitmap(Texture):
    """A picture: `data` (H, W) or (H, W, C), linear, its first row at v = 0."""

    kind = "bitmap"
    data: Any
    filter: Literal["nearest", "bilinear"] = "bilinear"
    wrap: Literal["repeat", "mirror", "clamp"] = "repeat"

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "bitmap"
        a = np.asarray(self.data, np.float32)
        a = a[..., None] if a.ndim == 2 else a
        check(a.ndim == 3 and a.size > 0, f"{name}.data", f"has shape {a.shape}; give (H, W) or (H, W, C)")
        check(bool(np.isfinite(a).all()), f"{name}.data", "has a value that is not finite; give finite numbers")
        check(self.filter in FILTERS, f"{name}.filter", f"{self.filter!r} is not {' or '.join(FILTERS)}")
        check(self.wrap in WRAPS, f"{name}.wrap", f"{self.wrap!r} is not one of {', '.join(WRAPS)}")
        self.data = a

    def values(self) -> np.ndarray:
        return self.data.reshape(-1, self.data.shape[-1])


@dataclasses.dataclass(eq=False)
class Checkerboard(Texture):
    """Squares of two colours, two by two to a unit of u and v. Either may be a texture, with a `to_uv` of its own."""

    kind = "checkerboard"
    color0: Any = 0.4
    color1: Any = 0.2

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "checkerboard"
        self.color0, self.color1 = (varying(getattr(self, k), f"{name}.{k}") for k in ("color0", "color1"))

    @property
    def colors(self) -> tuple[Any, Any]:
        return self.color0, self.color1

    @property
    def of_mesh(self) -> bool:
        return any(isinstance(c, Texture) and c.of_mesh for c in self.colors)

    def values(self) -> np.ndarray:
        """Both colours; of a texture, its mean."""
        return np.stack(np.broadcast_arrays(*(c.mean() if isinstance(c, Texture) else c for c in self.colors)))

    def checked(self, element: str, least: float, most: float) -> Texture:
        for k, c in enumerate(self.colors):
            varying(c, f"{element}.color{k}", least=least, most=most)
        return self


@dataclasses.dataclass(eq=False)
class MeshAttribute(Texture):
    """Values that a mesh has at its vertices or faces: `Mesh.attributes[name]`, times `scale`."""

    kind = "attribute"
    name: str
    scale: float = 1.0

    def values(self) -> np.ndarray:
        return np.zeros((1, 1))  # known only with a mesh

    @property
    def of_mesh(self) -> bool:
        return True

    def on(self, attributes: dict[str, np.ndarray], faces: np.ndarray, vertices: int, element: str) -> np.ndarray:
        """Values at the corners of each face, (3 F, k)."""
        found = attributes.get(self.name)
        if found is None:
            there = f"; it has {', '.join(attributes)}" if attributes else ""
            raise SceneError(f"{element}: has no attribute {self.name!r}, which its texture asks for{there}")
        a = np.asarray(found, np.float64)
        a = a[:, None] if a.ndim == 1 else a
        per_face = self.name.startswith("face_") or (len(a) != vertices)
        want = len(faces) if per_face else vertices
        check(len(a) == want, f"{element}.{self.name}", f"has {len(a)} values; give one a face or vertex")
        return self.scale * (np.repeat(a, 3, 0) if per_face else a[faces.reshape(-1)])


@dataclasses.dataclass(eq=False)
class Product(Texture):
    """Two textures, neither a product, multiplied at each point: a picture tinted by colours of vertices, say. Its own
    `to_uv` moves neither."""

    kind = "product"
    first: Any
    second: Any

    def __post_init__(self):
        super().__post_init__()
        for factor in self.factors:
            plain = isinstance(factor, Texture) and not isinstance(factor, Product)
            check(plain, self.id or "product", f"is of two textures, not {type(factor).__name__}; give two")

    @property
    def factors(self) -> tuple[Texture, Texture]:
        return self.first, self.second

    @property
    def of_mesh(self) -> bool:
        return any(factor.of_mesh for factor in self.factors)

    def checked(self, element: str, least: float, most: float) -> Texture:
        for factor in self.factors:
            factor.checked(element, least, most)
        return self

    def values(self) -> np.ndarray:
        first, second = (factor.mean() for factor in self.factors)
        return (first * second)[None]
