"""The plan: which effects a scene calls for. Static and hashable; what it leaves out is not compiled.

An effect is one entry of a table here (`registry` lists the tables): whether the scene has it and because of which
part, which fields of the plan it sets, and whether it may be forced in or out.
"""

from .check import fitting
from .cut import without
from .make import plan
from .static import Assumption, Plan

__all__ = ["Assumption", "Plan", "fitting", "plan", "without"]
