"""Scenes fitted to pictures: losses on `measure`, gradient descent and least squares."""

from .fit import fit
from .result import Fit
from .transforms import Shift, Smooth

__all__ = ["Fit", "Shift", "Smooth", "fit"]
