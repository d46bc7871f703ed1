"""Scenes fitted to pictures: losses on `measure`, gradient descent and least squares."""

from .fit import fit
from .result import Fit
from .transforms import Shift, Smooth
from .uniform import uniform_adam

__all__ = ["Fit", "Shift", "Smooth", "fit", "uniform_adam"]
