"""The commands of the command line, one a file: its options, and what it does."""

import time

BEGAN = time.perf_counter()
"""When this process began, nearly."""

from . import compare, doctor, explain, render, workprec  # noqa: E402  # after the clock

COMMANDS = render, explain, compare, workprec, doctor
"""Each has `add(commands, scene)`: the parser of the command line gets its own; `scene` has the options of a scene."""
