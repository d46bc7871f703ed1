"""What every test shares: strict rank promotion, keys, and no deadlines for programs that compile on first use."""

import gc
import itertools
import pathlib
from collections.abc import Callable, Iterator

import hypothesis
import jax
import pytest

from jaxrt import compiler
from jaxrt.intersect import dense

jax.config.update("jax_numpy_rank_promotion", "raise")
hypothesis.settings.register_profile(
    "jaxrt", deadline=None, derandomize=True, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("jaxrt")


@pytest.fixture
def getkey() -> Callable[[], jax.Array]:
    """A function that gives another key each time it is called, and the same ones in every run."""
    counter = itertools.count()
    return lambda: jax.random.key(next(counter))


@pytest.fixture
def short_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches of one face at a time: programs compile twice as fast. For tests that are not about the search."""
    monkeypatch.setattr(dense, "UNROLL", 1)


MAPPINGS = 25000
"""Of memory, that a process may have after a file of tests; Linux gives it 65530, and XLA ends without a word there."""


@pytest.fixture(autouse=True, scope="module")
def room_for_programs() -> Iterator[None]:
    """Compiled programs are let go where those of the tests before have taken much of what a process may map."""
    yield
    mapped = pathlib.Path("/proc/self/maps")
    if mapped.exists() and mapped.read_bytes().count(b"\n") > MAPPINGS:
        compiler._programs.clear()
        jax.clear_caches()
        gc.collect()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The solvers' tests first: they take longest, and no worker should be left alone with them at the end."""
    items.sort(key=lambda item: "solver" not in item.path.parts)
