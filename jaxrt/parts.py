"""The parts a scene is described with: plain numpy on the host, checked when they are made.

A loader turns a file into these parts and `Scene.build` packs them into tables, so a scene made in
Python and one read from a file take the same way. Angles are in degrees, lengths in metres, colours
linear. A wrong value raises `SceneError`, which says what is wrong and what to do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np


class SceneError(ValueError):
    """A mistake in a scene: one line that names the file (if any), the element and the remedy."""


LARGEST = 1e30
"""Numbers in a scene end here: float32 reaches to 3e38, and products of them have to fit."""


def check(ok: bool, element: str, problem: str) -> None:
    if not ok:
        raise SceneError(f"{element}: {problem}" if element else problem)


def spectrum(value: Any, element: str, *, most: float = np.inf, least: float = 0.0) -> np.ndarray:
    """A finite spectrum, shape (1,) or (C,), float64, with every value in [least, most]."""
    try:
        a = np.atleast_1d(np.asarray(value, np.float64))
    except (TypeError, ValueError):
        raise SceneError(f"{element}: {str(value)[:80]!r} is no number") from None
    check(a.ndim == 1, element, f"a spectrum is one number or a list of numbers, not shape {a.shape}")
    check(bool(np.isfinite(a).all()), element, "has a value that is not finite; give finite numbers")
    check(bool((np.abs(a) <= LARGEST).all()), element, f"has a value beyond {LARGEST:g}; give smaller numbers")
    check(bool((a >= least).all()), element, f"is {a.min():g}; give a value of at least {least:g}")
    check(bool((a <= most).all()), element, f"is {a.max():g}; give a value of at most {most:g}")
    return a


def scalar(value: Any, element: str, *, least: float = -np.inf, most: float = np.inf) -> float:
    a = spectrum(value, element, least=least, most=most)
    check(a.size == 1, element, "is one number")
    return float(a[0])


def matrix(value: Any, element: str) -> np.ndarray:
    m = np.asarray(value, np.float64)
    check(m.shape == (4, 4), element, f"is a 4x4 matrix, not shape {m.shape}")
    check(bool((np.abs(m) <= LARGEST).all()), element, f"has an entry that is not finite, or beyond {LARGEST:g}")
    check(
        bool(np.allclose(m[3], [0, 0, 0, 1])) or not m.any(),
        element,
        "has a perspective part; give an affine transform",
    )
    check(abs(float(np.linalg.det(m[:3, :3]))) > 0, element, "is singular; give an invertible transform")
    return m


# ------------------------------------------------------------------------------------ reflectance


class Row(NamedTuple):
    """What a reflectance puts into the material table: its lobe, values of fields, and parameters (name: field)."""

    lobe: str
    fields: dict[str, Any]
    parameters: dict[str, str]


@dataclasses.dataclass
class Diffuse:
    """Lambertian reflection, f_r = reflectance / π (notes, 1.3)."""

    reflectance: Any = 0.5
    id: str = ""

    def __post_init__(self):
        self.reflectance = spectrum(self.reflectance, f"{self.id or 'diffuse'}.reflectance", most=1.0)

    def row(self) -> Row:
        return Row("diffuse", {"reflectance": self.reflectance}, {"reflectance": "reflectance"})


@dataclasses.dataclass
class Conductor:
    """A metal: a smooth mirror (alpha 0) or microfacets of roughness `alpha` = (α_u, α_v).

    `eta`, `k`: complex index of refraction, relative to the outside. eta 0 and k 1 reflect everything.
    `distribution`: ggx (height-correlated masking, Heitz 2014), or ggx_separable and beckmann as Mitsuba has them.
    """

    alpha: Any = 0.0
    eta: Any = 0.0
    k: Any = 1.0
    specular_reflectance: Any = 1.0
    distribution: Literal["ggx", "ggx_separable", "beckmann"] = "ggx"
    id: str = ""

    def __post_init__(self):
        name = self.id or "conductor"
        known = ("ggx", "ggx_separable", "beckmann")
        check(self.distribution in known, f"{name}.distribution", f"{self.distribution!r} is not {' or '.join(known)}")
        a = spectrum(self.alpha, f"{name}.alpha", most=1.0)
        check(a.size <= 2, f"{name}.alpha", "is one roughness or two")
        self.alpha = np.broadcast_to(a, (2,)).copy()
        self.eta = spectrum(self.eta, f"{name}.eta")
        self.k = spectrum(self.k, f"{name}.k")
        self.specular_reflectance = spectrum(self.specular_reflectance, f"{name}.specular_reflectance", most=1.0)

    def row(self) -> Row:
        rough = bool(self.alpha.max() >= 1e-3)  # below, float32 cannot resolve the lobe (oracles, GGX furnace)
        fields = {"reflectance": self.specular_reflectance, "eta": self.eta, "k": self.k}
        names = {"specular_reflectance": "reflectance", "eta": "eta", "k": "k"}
        if not rough:
            return Row("mirror", fields, names)
        return Row(self.distribution, {**fields, "alpha": np.maximum(self.alpha, 1e-3)}, {**names, "alpha": "alpha"})


def _check_boundary(part: Dielectric | Plastic, name: str, *albedos: str) -> None:
    for key in ("int_ior", "ext_ior"):
        n = scalar(getattr(part, key), f"{name}.{key}")
        check(0 < n <= 1e3, f"{name}.{key}", f"is {n:g}; give an index of refraction above 0, and at most 1000")
        setattr(part, key, n)
    for key in albedos:
        setattr(part, key, spectrum(getattr(part, key), f"{name}.{key}", most=1.0))


@dataclasses.dataclass
class Dielectric:
    """A smooth boundary between two media, as of glass: it reflects and transmits. Shapes of it have to be closed.

    `int_ior`, `ext_ior`: indices of refraction behind and before the front side. `thin`: both faces of a thin sheet
    at once, which does not bend light.
    """

    int_ior: float = 1.5046
    ext_ior: float = 1.000277
    specular_reflectance: Any = 1.0
    specular_transmittance: Any = 1.0
    thin: bool = False
    id: str = ""

    def __post_init__(self):
        _check_boundary(self, self.id or "dielectric", "specular_reflectance", "specular_transmittance")

    def row(self) -> Row:
        fields = {"reflectance": self.specular_reflectance, "transmittance": self.specular_transmittance}
        names = {"specular_reflectance": "reflectance", "specular_transmittance": "transmittance", "eta": "ior"}
        return Row("thin_glass" if self.thin else "glass", {**fields, "ior": self.int_ior / self.ext_ior}, names)


@dataclasses.dataclass
class Plastic:
    """Diffuse paint below a smooth clear coat. `nonlinear`: colours shift as light is reflected inside many times."""

    diffuse_reflectance: Any = 0.5
    specular_reflectance: Any = 1.0
    int_ior: float = 1.49
    ext_ior: float = 1.000277
    nonlinear: bool = False
    id: str = ""

    def __post_init__(self):
        _check_boundary(self, self.id or "plastic", "diffuse_reflectance", "specular_reflectance")

    def row(self) -> Row:
        fields = {"reflectance": self.diffuse_reflectance, "specular": self.specular_reflectance}
        fields |= {"ior": self.int_ior / self.ext_ior, "nonlinear": float(self.nonlinear)}
        names = {"diffuse_reflectance": "reflectance", "specular_reflectance": "specular", "eta": "ior"}
        return Row("plastic", fields, names)


@dataclasses.dataclass
class Null:
    """A surface that light passes as if it were not there. It still counts as one reflection."""

    id: str = ""

    def row(self) -> Row:
        return Row("nothing", {"transmittance": np.ones(1)}, {})


@dataclasses.dataclass
class TwoSided:
    """The same reflection on both sides of the surface."""

    bsdf: Bsdf
    id: str = ""

    def __post_init__(self):
        opaque = not isinstance(self.bsdf, (Dielectric, Null, TwoSided))
        check(opaque, self.id or "twosided", "holds what transmits, or another twosided; leave out this one")


Bsdf = Diffuse | Conductor | Dielectric | Plastic | Null | TwoSided


# ----------------------------------------------------------------------------------------- shapes


@dataclasses.dataclass(kw_only=True)
class Shape:
    """What all shapes share. `emission`: radiance of an area light on the front side, or None."""

    id: str = ""
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    bsdf: Bsdf = dataclasses.field(default_factory=Diffuse)
    emission: Any = None
    emission_id: str = ""
    flip_normals: bool = False

    def __post_init__(self):
        name = self.id or type(self).__name__.lower()
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        if self.emission is not None:
            self.emission = spectrum(self.emission, f"{self.emission_id or name + '.emitter'}.radiance")


@dataclasses.dataclass(kw_only=True)
class Mesh(Shape):
    """Triangles. vertices (V, 3) in the shape's own space, faces (F, 3) counter-clockwise from outside.

    `normals` (V, 3): interpolated shading normals, or None for flat faces. `uvs` (V, 2) or None.
    """

    vertices: Any
    faces: Any
    normals: Any = None
    uvs: Any = None

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "mesh"
        v, f = np.asarray(self.vertices, np.float64), np.asarray(self.faces)
        check(v.ndim == 2 and v.shape[1] == 3, f"{name}.vertices", f"have shape {v.shape}; give (V, 3)")
        check(f.ndim == 2 and f.shape[1] == 3, f"{name}.faces", f"have shape {f.shape}; give (F, 3)")
        check(np.issubdtype(f.dtype, np.integer), f"{name}.faces", "are not integers")
        check(len(f) > 0, name, "has no faces; remove it or give it some")
        bad = np.flatnonzero(((f < 0) | (f >= len(v))).any(1))
        check(bad.size == 0, name, f"face {bad[:1]} names a vertex outside 0..{len(v) - 1}; repair the mesh")
        used = np.zeros(len(v), bool)
        used[f] = True
        bad = np.flatnonzero(~np.isfinite(v).all(1) & used)
        check(bad.size == 0, name, f"vertex {bad[:1]} is not finite; repair the mesh")
        self.vertices = v if np.isfinite(v).all() else np.where(np.isfinite(v), v, 0.0)
        self.faces = np.asarray(f, np.int32)
        for key, width in (("normals", 3), ("uvs", 2)):
            a = getattr(self, key)
            if a is not None:
                a = np.asarray(a, np.float64)
                check(a.shape == (len(v), width), f"{name}.{key}", f"have shape {a.shape}; give {(len(v), width)}")
                bad = np.flatnonzero(~np.isfinite(a).all(1) & used)
                check(bad.size == 0, f"{name}.{key}", f"number {bad[:1]} is not finite; repair the mesh")
                setattr(self, key, a if np.isfinite(a).all() else np.where(np.isfinite(a), a, 0.0))


@dataclasses.dataclass(kw_only=True)
class Rectangle(Shape):
    """The square [-1, 1]² in the plane z = 0, facing +z."""


@dataclasses.dataclass(kw_only=True)
class Cube(Shape):
    """The cube [-1, 1]³, facing outwards."""


@dataclasses.dataclass(kw_only=True)
class Disk(Shape):
    """The unit disc in the plane z = 0, facing +z."""


@dataclasses.dataclass(kw_only=True)
class Sphere(Shape):
    """A sphere, facing outwards. `to_world` may rotate, move, mirror and scale evenly."""

    center: Any = (0.0, 0.0, 0.0)
    radius: float = 1.0

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "sphere"
        c = np.asarray(self.center, np.float64)
        check(c.shape == (3,) and bool(np.isfinite(c).all()), f"{name}.center", "is not three finite numbers")
        self.center = c
        self.radius = scalar(self.radius, f"{name}.radius")
        check(self.radius > 0, f"{name}.radius", f"is {self.radius:g}; give a positive one")
        s = np.linalg.svd(self.to_world[:3, :3], compute_uv=False)
        check(s[0] - s[2] <= 1e-4 * s[0], f"{name}.to_world", "scales unevenly; a sphere needs an even scale")


@dataclasses.dataclass(kw_only=True)
class Cylinder(Shape):
    """An open cylinder from `p0` to `p1`, facing outwards. `to_world` may not shear or scale unevenly."""

    p0: Any = (0.0, 0.0, 0.0)
    p1: Any = (0.0, 0.0, 1.0)
    radius: float = 1.0

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "cylinder"
        self.p0, self.p1 = np.asarray(self.p0, np.float64), np.asarray(self.p1, np.float64)
        check(self.p0.shape == (3,) and self.p1.shape == (3,), name, "p0 and p1 are not points")
        finite = bool((np.abs([self.p0, self.p1]) <= LARGEST).all())
        check(finite, name, f"p0 or p1 is not finite, or beyond {LARGEST:g}; give finite points")
        self.radius = scalar(self.radius, f"{name}.radius")
        check(self.radius > 0, f"{name}.radius", f"is {self.radius:g}; give a positive one")
        check(float(np.linalg.norm(self.p1 - self.p0)) > 0, name, "p0 and p1 coincide; give it a length")
        s = np.linalg.svd(self.to_world[:3, :3], compute_uv=False)
        check(s[0] - s[2] <= 1e-4 * s[0], f"{name}.to_world", "scales unevenly; a cylinder needs an even scale")


@dataclasses.dataclass(kw_only=True)
class Group:
    """Meshes, rectangles and cubes that instances place in the scene; by itself it is not in it. None may emit."""

    shapes: Sequence[Shape]
    id: str = ""

    def __post_init__(self):
        name, self.shapes = self.id or "group", list(self.shapes)
        check(len(self.shapes) > 0, name, "has no shapes; give it some")
        for shape in self.shapes:
            member = getattr(shape, "id", "") or type(shape).__name__.lower()
            flat = isinstance(shape, (Mesh, Rectangle, Cube))
            check(flat, f"{name}.{member}", "cannot be in a group; put a mesh, a rectangle or a cube there")
            check(shape.emission is None, f"{name}.{member}", "emits; take it out of the group")


@dataclasses.dataclass(kw_only=True)
class Instance:
    """A group placed in the scene by `to_world`; its triangles and their tables are stored once for all instances."""

    group: Group
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    id: str = ""

    def __post_init__(self):
        name = self.id or "instance"
        check(isinstance(self.group, Group), f"{name}.group", "is not a Group; put the shapes into one")
        self.to_world = matrix(self.to_world, f"{name}.to_world")

    def written_out(self) -> list[Shape]:
        """The group's shapes where this instance has them."""
        return [dataclasses.replace(s, to_world=self.to_world @ s.to_world) for s in self.group.shapes]


# ---------------------------------------------------- lamps without extent, enclosure, sensors, integrator


LAMPS = ("point", "spot", "directional")
"""Kinds of lamps without extent, in the order of their numbers in tables."""


def _unit(value: Any, element: str) -> np.ndarray:
    v = np.asarray(value, np.float64)
    good = v.shape == (3,) and bool(np.isfinite(v).all()) and bool(v.any())
    check(good, element, "is no direction; give three finite numbers, not all 0")
    return v / np.linalg.norm(v)


@dataclasses.dataclass
class Point:
    """A lamp at a point, of `intensity` (W·sr⁻¹) in all directions."""

    position: Any = (0.0, 0.0, 0.0)
    intensity: Any = 1.0
    id: str = ""

    def __post_init__(self):
        name = self.id or "point"
        self.position = np.asarray(self.position, np.float64)
        good = self.position.shape == (3,) and bool((np.abs(self.position) <= LARGEST).all())
        check(good, f"{name}.position", "is no point; give three finite numbers")
        self.intensity = spectrum(self.intensity, f"{name}.intensity")

    def row(self) -> np.ndarray:
        return np.array([*self.position, 0, 0, 1, 0, 0, LAMPS.index("point")], float)


@dataclasses.dataclass
class Spot(Point):
    """A point lamp that shines into a cone around `direction`: `intensity` up to `beam_width` (degrees from its axis),
    from there on less, in proportion to the angle, to nothing at `cutoff_angle`."""

    direction: Any = (0.0, 0.0, 1.0)
    cutoff_angle: float = 20.0
    beam_width: float | None = None

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "spot"
        self.direction = _unit(self.direction, f"{name}.direction")
        self.cutoff_angle = scalar(self.cutoff_angle, f"{name}.cutoff_angle", least=0.0, most=180.0)
        width = 0.75 * self.cutoff_angle if self.beam_width is None else self.beam_width
        self.beam_width = scalar(width, f"{name}.beam_width", least=0.0, most=self.cutoff_angle)

    def row(self) -> np.ndarray:
        cutoff, beam = np.radians(self.cutoff_angle), np.radians(self.beam_width or 0.0)
        return np.array([*self.position, *self.direction, cutoff, beam, LAMPS.index("spot")], float)


@dataclasses.dataclass
class Directional:
    """Light from infinitely far away along `direction`, of `irradiance` (W·m⁻²) on a surface across it."""

    direction: Any = (0.0, 0.0, 1.0)
    irradiance: Any = 1.0
    id: str = ""

    def __post_init__(self):
        name = self.id or "directional"
        self.direction = _unit(self.direction, f"{name}.direction")
        self.irradiance = spectrum(self.irradiance, f"{name}.irradiance")

    def row(self) -> np.ndarray:
        return np.array([0, 0, 0, *self.direction, 0, 0, LAMPS.index("directional")], float)


Lamp = Point | Spot | Directional


@dataclasses.dataclass
class Enclosure:
    """The surface around the scene on which every ray lands: it emits `radiance` and reflects nothing."""

    radiance: Any = 0.0
    id: str = ""

    def __post_init__(self):
        self.radiance = spectrum(self.radiance, f"{self.id or 'enclosure'}.radiance")


@dataclasses.dataclass
class Film:
    """width x height pixels; `filter` is box, tent or gaussian; `radius` in pixels, `stddev` for gaussian.

    `crop`: the picture is the part of a larger film that starts so many pixels (x, y) from its upper left corner, and
    that film's width and height.
    """

    width: int = 768
    height: int = 576
    filter: Literal["box", "tent", "gaussian"] = "gaussian"
    radius: float | None = None
    stddev: float = 0.5
    crop: tuple[int, int, int, int] | None = None

    def __post_init__(self):
        for key in ("width", "height"):
            n = getattr(self, key)
            check(int(n) == n and 0 < n <= 1 << 15, f"film.{key}", f"is {n}; give a whole number from 1 to 32768")
            setattr(self, key, int(n))
        if self.crop is not None:
            x, y, w, h = self.crop
            inside = 0 <= x and x + self.width <= w and 0 <= y and y + self.height <= h
            check(inside, "film.crop", f"goes beyond the film of {w} x {h} pixels; make it smaller or move it")
        known = self.filter in ("box", "tent", "gaussian")
        check(known, "film.filter", f"{self.filter!r} is not box, tent or gaussian")
        check(np.isfinite(self.stddev) and self.stddev > 0, "film.stddev", f"is {self.stddev}; give a positive number")
        if self.radius is None:
            self.radius = {"box": 0.5, "tent": 1.0, "gaussian": 4 * self.stddev}[self.filter]
        check(np.isfinite(self.radius) and self.radius > 0, "film.radius", f"is {self.radius}; give a positive number")


@dataclasses.dataclass
class Sensor:
    """A camera at the origin of its own space, looking along +z with +y up (so +x is left in the picture).

    kind: perspective, thinlens or orthographic. `fov` in degrees along `fov_axis` (x, y, smaller,
    larger or diagonal); `aperture_radius` and `focus_distance` for thinlens. An orthographic camera
    sees [-1, 1] along x of its own space. `principal_point`: what the film is shifted by, in its widths and heights.
    """

    kind: Literal["perspective", "thinlens", "orthographic"] = "perspective"
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    fov: float = 50.0
    fov_axis: str = "x"
    near: float = 1e-2
    far: float = 1e4
    aperture_radius: float = 0.0
    focus_distance: float = 1.0
    principal_point: tuple[float, float] = (0.0, 0.0)
    film: Film = dataclasses.field(default_factory=Film)
    id: str = ""

    def __post_init__(self):
        name = self.id or "sensor"
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        check(self.kind in ("perspective", "thinlens", "orthographic"), name, f"unknown kind {self.kind!r}")
        axes = ("x", "y", "smaller", "larger", "diagonal")
        check(self.fov_axis in axes, f"{name}.fov_axis", f"{self.fov_axis!r} is not one of {', '.join(axes)}")
        self.fov = scalar(self.fov, f"{name}.fov")
        check(0 < self.fov < 180, f"{name}.fov", f"is {self.fov:g}; give an angle between 0 and 180 degrees")
        self.near, self.far = scalar(self.near, f"{name}.near_clip"), scalar(self.far, f"{name}.far_clip")
        check(0 < self.near < self.far, f"{name}.near_clip", "is not between 0 and far_clip")
        self.aperture_radius = scalar(self.aperture_radius, f"{name}.aperture_radius", least=0.0)
        self.focus_distance = scalar(self.focus_distance, f"{name}.focus_distance", least=0.0)
        check(self.focus_distance > 0, f"{name}.focus_distance", "is not positive")
        shift = np.asarray(self.principal_point, float)
        check(
            shift.shape == (2,) and bool(np.isfinite(shift).all()), f"{name}.principal_point", "is two finite numbers"
        )


@dataclasses.dataclass
class Integrator:
    """What a scene file asks of the method: depth as Mitsuba counts it (1: emission only; -1: no end)."""

    max_depth: int = -1
    rr_depth: int = 5
    hide_emitters: bool = False
    spp: int = 16

    def __post_init__(self):
        check(self.max_depth >= -1, "integrator.max_depth", f"is {self.max_depth}; give -1 or more")
        check(self.rr_depth >= 1, "integrator.rr_depth", f"is {self.rr_depth}; give 1 or more")
        check(self.spp >= 1, "sampler.sample_count", f"is {self.spp}; give 1 or more")


@dataclasses.dataclass
class Description:
    """A whole scene as parts. `notes`: what the loader wants said on stderr (fallbacks it took)."""

    shapes: Sequence[Shape | Instance]
    sensors: Sequence[Sensor] = ()
    enclosure: Enclosure | None = None
    lamps: Sequence[Lamp] = ()
    integrator: Integrator = dataclasses.field(default_factory=Integrator)
    notes: Sequence[str] = ()
