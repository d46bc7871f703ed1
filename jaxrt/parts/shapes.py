"""Shapes, groups of them and their instances."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from .checks import LARGEST, check, matrix, scalar, varying
from .reflectances import Bsdf, Diffuse


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
            self.emission = varying(self.emission, f"{self.emission_id or name + '.emitter'}.radiance")


@dataclasses.dataclass(kw_only=True)
class Mesh(Shape):
    """Triangles. vertices (V, 3) in the shape's own space, faces (F, 3) counter-clockwise from outside.

    `normals` (V, 3): interpolated shading normals, or None for flat faces. `uvs` (V, 2) or None.
    `attributes`: values for `MeshAttribute` by name, (V,), (V, k), (F,) or (F, k).
    """

    vertices: Any
    faces: Any
    normals: Any = None
    uvs: Any = None
    attributes: dict[str, Any] = dataclasses.field(default_factory=dict)

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
        check(
            s[0] - s[2] <= 1e-4 * s[0],
            f"{name}.to_world",
            "scales unevenly; a sphere needs an even scale, or take a mesh",
        )


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
        check(
            s[0] - s[2] <= 1e-4 * s[0],
            f"{name}.to_world",
            "scales unevenly; a cylinder needs an even scale, or take a mesh",
        )


@dataclasses.dataclass(kw_only=True)
class SdfGrid(Shape):
    """Where signed distances are 0: trilinear between samples (Z, Y, X) that fill the cube [0, 1]³, facing to where
    they grow. `smooth_normals`: shading normals that are continuous across voxels, as Mitsuba's `smooth`. It may not
    emit.
    """

    grid: Any
    smooth_normals: bool = True

    def __post_init__(self):
        super().__post_init__()
        name = self.id or "sdfgrid"
        g = np.asarray(self.grid, np.float64)
        g = g[..., 0] if g.ndim == 4 and g.shape[-1] == 1 else g
        check(
            g.ndim == 3 and min(g.shape, default=0) >= 2,
            f"{name}.grid",
            f"has shape {g.shape}; give (Z, Y, X), each 2 or more",
        )
        check(
            bool((np.abs(g) <= LARGEST).all()),
            f"{name}.grid",
            f"has a sample that is not finite, or beyond {LARGEST:g}",
        )
        check(
            bool((g < 0).any() and (g >= 0).any()),
            f"{name}.grid",
            "has samples of one sign only, so no surface; shift them",
        )
        check(self.emission is None, name, "emits, which a grid of distances cannot; take a mesh")
        self.grid = g


@dataclasses.dataclass(kw_only=True)
class Group:
    """Shapes that instances place in the scene; by itself it is not in it. None may emit."""

    shapes: Sequence[Shape]
    id: str = ""

    @property
    def flat(self) -> bool:
        """Whether it is all triangles, or can be written as such."""
        return all(isinstance(shape, (Mesh, Rectangle, Cube)) for shape in self.shapes)

    def __post_init__(self):
        name, self.shapes = self.id or "group", list(self.shapes)
        check(len(self.shapes) > 0, name, "has no shapes; give it some")
        for shape in self.shapes:
            member = getattr(shape, "id", "") or type(shape).__name__.lower()
            check(isinstance(shape, Shape), f"{name}.{member}", "cannot be in a group; put the shapes themselves there")
            check(shape.emission is None, f"{name}.{member}", "emits; take it out of the group")


@dataclasses.dataclass(kw_only=True)
class Instance:
    """A group placed in the scene by `to_world`; its triangles and their tables are stored once for all instances.

    Where a group has disks, spheres, cylinders or grids of distances, its instances are written out: shapes of the
    scene by themselves.
    """

    group: Group
    to_world: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    id: str = ""

    def __post_init__(self):
        name = self.id or "instance"
        check(isinstance(self.group, Group), f"{name}.group", "is not a Group; put the shapes into one")
        self.to_world = matrix(self.to_world, f"{name}.to_world")
        if not self.group.flat:
            self.written_out()  # which says what cannot be placed so

    def written_out(self) -> list[Shape]:
        """The group's shapes where this instance has them, and with their fronts where it has those."""
        placed, mirrored = [], bool(np.linalg.det(self.to_world[:3, :3]) < 0)
        for s in self.group.shapes:
            more: dict[str, Any] = {"to_world": self.to_world @ s.to_world}
            if isinstance(s, Mesh) and mirrored:  # whose front turns with the order of its vertices
                more |= {"flip_normals": not s.flip_normals, "normals": None if s.normals is None else -s.normals}
            placed.append(dataclasses.replace(s, **more))
        return placed
