"""Scenes fitted to pictures: losses on `measure`, gradient descent and least squares."""

from .fit import fit
from .result import Fit
from .transforms import Smooth

__all__ = ["Fit", "Smooth", "fit"]
