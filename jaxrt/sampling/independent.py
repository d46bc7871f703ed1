"""Independent samples: every sample has numbers of its own, beside which those of Sobol points are seen to be even."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from .sobol import Stream, combine


class Independent(eqx.Module):
    """A seed whose samples know nothing of one another: error falls as N^(−1/2) whatever is integrated.

    It takes the place of a plain seed, so that which of both it is belongs to the structure of a program's arguments.
    """

    seed: Any

    def stream(self, pixel: Any, i: Any) -> Stream:
        """The numbers of sample i of a pixel: one point of sequences that are its own."""
        return Stream(i, combine(combine(self.seed, pixel), i))


SAMPLERS = {"sobol": lambda seed: seed, "independent": Independent}
"""Seeds of pictures by the name of a sampler."""
