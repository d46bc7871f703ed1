"""Hard cases: does every one hold, by which method and in which precision, and how far is it from its limit?

    python experiments/hard_cases/run.py [--quick] [--float32] [NAME ...]

The cases are those of tests/hard_cases. Writes results/hard_cases.csv and .md, a line for each case,
method, precision and quantity (a value, or its derivative), with what was found and expected, the error and its limit;
and .json (machine, versions). With names, only cases whose names hold one of these.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
TESTS = HERE.parent.parent / "tests"
sys.path[:0] = [str(TESTS / "hard_cases"), str(TESTS), str(HERE.parent)]

import cases  # noqa: E402
from peer import results_of  # noqa: E402

from jaxrt.intersect import dense  # noqa: E402

dense.UNROLL = 1  # compiles twice as fast


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--quick", action="store_true", help="only cases that the README's tests run")
    parser.add_argument("--float32", action="store_true", help="leave float64 out")
    args = parser.parse_args()
    named = lambda case: not args.names or any(name in case.name for name in args.names)
    asked = [case for case in cases.every() if (case.quick or not args.quick) and named(case)]
    rows, failing = [], {c.name: c.fails for c in asked if c.fails}
    for k, case in enumerate(asked):
        for double in (False, True)[: 1 if args.float32 else 2]:
            began = time.perf_counter()
            for row in cases.rows_of(case, double):
                rows.append(row)
                mark = "" if row.holds else "  <-- FAILS" + (", as known" if case.fails else "")
                print(
                    f"{row.case}: {row.method}, {row.precision}, {row.quantity}: {row.found:.7g}, "
                    f"expected {row.expected}, off {row.error:.2g}, limit {row.limit:.2g}{mark}"
                )
            print(f"    [{k + 1} of {len(asked)}] {time.perf_counter() - began:.1f} s", flush=True)
    results = results_of(HERE)
    head = (*cases.Row._fields, "holds")
    cells = [[*(f"{v:.6g}" if isinstance(v, float) else v for v in row), "yes" if row.holds else "no"] for row in rows]
    with open(results / "hard_cases.csv", "w", newline="") as file:
        csv.writer(file).writerows([head, *cells])
    table = [" | ".join(line) for line in [head, ["---"] * len(head), *cells]]
    notes = [f"\n{name}: {why}" for name, why in failing.items()]
    (results / "hard_cases.md").write_text("\n".join(f"| {line} |" for line in table) + "\n" + "\n".join(notes))
    wrong = [row for row in rows if not row.holds]
    print(f"{len(asked)} cases, {len(rows)} lines, {len(wrong)} beyond their limits")


if __name__ == "__main__":
    main()
