"""Work-precision diagrams: what accuracy costs in time."""

from .curve import Curve, Row, slope
from .report import Report, work_precision

__all__ = ["Curve", "Report", "Row", "slope", "work_precision"]
