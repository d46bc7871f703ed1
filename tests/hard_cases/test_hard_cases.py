"""Every hard case holds, by all methods that it asks for; the whole table is experiments/hard_cases'."""

import pytest
from cases import every, rows_of

from jaxrt.intersect import refusal

pytestmark = pytest.mark.usefixtures("short_loops")


def _marked(case):
    marks = [] if case.quick else [pytest.mark.slow]
    if case.fails:
        marks.append(pytest.mark.xfail(reason=case.fails, strict=True))
    if ("embree" in case.name or "embree" in getattr(case, "backends", ())) and refusal("embree"):
        marks.append(pytest.mark.skip(reason="embree is not installed"))
    return pytest.param(case, id=case.name, marks=marks)


def holds(case, double):
    assert not [row for row in rows_of(case, double) if not row.holds]


@pytest.mark.parametrize("case", [_marked(case) for case in every()])
def test_in_float32(case):
    holds(case, False)


@pytest.mark.slow
@pytest.mark.parametrize("case", [_marked(case) for case in every()])
def test_in_float64(case):
    holds(case, True)
