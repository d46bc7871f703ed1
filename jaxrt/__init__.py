"""jaxrt: how light settles in a scene, how wrong the answer is, and how it changes."""

__version__ = "0.1.0"

from . import radiometry
from .effects import Plan, plan
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
    Conductor,
    Cube,
    Cylinder,
    Diffuse,
    Disk,
    Enclosure,
    Film,
    Integrator,
    Mesh,
    Rectangle,
    SceneError,
    Sensor,
    Sphere,
    TwoSided,
)
from .rules import BrdfRule, LightRule, MisRule, QuadratureRule
from .sampling.sobol import Stream
from .scene import Scene, params, with_params
from .solver.measure import irradiance, measure, radiance
from .solver.render import render, resized
from .solver.solution import Solution, relative_mse
from .surface import SurfacePoint
from .vector import Spectrum, Vec3

__all__ = [
    "BrdfRule",
    "Conductor",
    "Cube",
    "Cylinder",
    "D",
    "Diffuse",
    "Disk",
    "Enclosure",
    "Film",
    "G",
    "Integrator",
    "K",
    "LightRule",
    "Mesh",
    "MisRule",
    "Plan",
    "QuadratureRule",
    "Rectangle",
    "Scene",
    "SceneError",
    "Sensor",
    "Solution",
    "Spectrum",
    "Sphere",
    "Stream",
    "SurfacePoint",
    "T",
    "TwoSided",
    "Vec3",
    "add",
    "adjoint",
    "compose",
    "emission",
    "estimate",
    "inner",
    "irradiance",
    "load",
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
    "resized",
    "sub",
    "with_params",
]
