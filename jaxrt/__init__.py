"""jaxrt: how light settles in a scene, how wrong the answer is, and how it changes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from . import radiometry
    from .effects import Plan, plan
    from .effects.costs import effect_costs
    from .files.ies import load_ies
    from .fitting import Fit, Shift, Smooth, fit, uniform_adam
    from .gradient.replicate import replicate
    from .loading import load
    from .operators import (
        D,
        G,
        K,
        T,
        add,
        adjoint,
        compose,
        emission,
        estimate,
        inner,
        neumann,
        norm,
        psi,
        sub,
    )
    from .parts import (
        Bitmap,
        Blend,
        BumpMap,
        Checkerboard,
        Conductor,
        Cube,
        Cylinder,
        Dielectric,
        Diffuse,
        Directional,
        Disk,
        Enclosure,
        Film,
        Goniometric,
        Group,
        Instance,
        Integrator,
        Mask,
        Mesh,
        MeshAttribute,
        NormalMap,
        Null,
        PhotometricWeb,
        Plastic,
        Point,
        Principled,
        PrincipledThin,
        Product,
        Projector,
        Rectangle,
        SceneError,
        SdfGrid,
        Sensor,
        Sphere,
        Spot,
        Sun,
        TwoSided,
    )
    from .rules import BrdfRule, LightRule, MisRule, QuadratureRule
    from .sampling.sobol import Stream
    from .scene import Scene, params, with_params
    from .solver.field import Field, elements_of, solve
    from .solver.measure import irradiance, measure, radiance
    from .solver.render import forecast, render, resized
    from .solver.solution import Solution, relative_mse
    from .surface import SurfacePoint
    from .vector import Spectrum, Vec3

# Names are imported when they are first used: `jaxrt --help` and mistakes in a command come without jax.
_HOMES = {
    "effects": "Plan plan",
    "effects.costs": "effect_costs",
    "files.ies": "load_ies",
    "fitting": "Fit Shift Smooth fit uniform_adam",
    "gradient.replicate": "replicate",
    "loading": "load",
    "operators": "D G K T add adjoint compose emission estimate inner neumann norm psi sub",
    "parts": "Bitmap Blend BumpMap Checkerboard Conductor Cube Cylinder Dielectric Diffuse Directional Disk"
    " Enclosure Film Goniometric Group Instance Integrator Mask Mesh MeshAttribute NormalMap Null PhotometricWeb"
    " Plastic Point Principled PrincipledThin Product Projector Rectangle SceneError SdfGrid Sensor Sphere Spot"
    " Sun TwoSided",
    "rules": "BrdfRule LightRule MisRule QuadratureRule",
    "sampling.sobol": "Stream",
    "scene": "Scene params with_params",
    "solver.field": "Field elements_of solve",
    "solver.measure": "irradiance measure radiance",
    "solver.render": "forecast render resized",
    "solver.solution": "Solution relative_mse",
    "surface": "SurfacePoint",
    "vector": "Spectrum Vec3",
}
_HOME = {name: module for module, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name == "radiometry":
        return importlib.import_module(".radiometry", __name__)
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    return __all__


__all__ = [
    "Bitmap",
    "Blend",
    "BrdfRule",
    "BumpMap",
    "Checkerboard",
    "Conductor",
    "Cube",
    "Cylinder",
    "D",
    "Dielectric",
    "Diffuse",
    "Directional",
    "Disk",
    "Enclosure",
    "Field",
    "Film",
    "Fit",
    "G",
    "Goniometric",
    "Group",
    "Instance",
    "Integrator",
    "K",
    "LightRule",
    "Mask",
    "Mesh",
    "MeshAttribute",
    "MisRule",
    "NormalMap",
    "Null",
    "PhotometricWeb",
    "Plan",
    "Plastic",
    "Point",
    "Principled",
    "PrincipledThin",
    "Product",
    "Projector",
    "QuadratureRule",
    "Rectangle",
    "Scene",
    "SceneError",
    "SdfGrid",
    "Sensor",
    "Shift",
    "Smooth",
    "Solution",
    "Spectrum",
    "Sphere",
    "Spot",
    "Stream",
    "Sun",
    "SurfacePoint",
    "T",
    "TwoSided",
    "Vec3",
    "add",
    "adjoint",
    "compose",
    "effect_costs",
    "elements_of",
    "emission",
    "estimate",
    "fit",
    "forecast",
    "inner",
    "irradiance",
    "load",
    "load_ies",
    "measure",
    "neumann",
    "norm",
    "params",
    "plan",
    "psi",
    "radiance",
    "radiometry",
    "relative_mse",
    "render",
    "replicate",
    "resized",
    "solve",
    "sub",
    "uniform_adam",
    "with_params",
]
