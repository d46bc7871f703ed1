"""What accuracy costs in time, in every scene: jaxrt's methods and settings, and Mitsuba 3 in the same run.

    python experiments/work_precision/run.py [--quick] [--seconds S] [scene.xml ...]

`jaxrt workprec` for all scenes, on one page. Errors are √relMSE against Mitsuba's pictures of far more samples, where
it is installed. Writes results/work_precision.html, .png and .svg, .csv (all points), .json (machine, versions, seed).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import jaxrt
from jaxrt.workprec import work_precision
from jaxrt.workprec.table import show
from jaxrt.workprec.write import write

HERE = Path(__file__).parent
SCENES = sorted((HERE.parent.parent / "scenes").glob("*.xml"))
SEED = 0


def main() -> None:
    parser = argparse.ArgumentParser(description="Error against seconds in every scene.")
    parser.add_argument("--quick", action="store_true", help="one small scene, paths and Mitsuba alone")
    parser.add_argument("--seconds", type=float, default=150.0, help="for each scene, about")
    parser.add_argument("scenes", nargs="*", type=Path)
    args = parser.parse_args()
    reports = []
    for file in args.scenes or (SCENES[:1] if args.quick else SCENES):
        scene = jaxrt.load(file)
        few = {"side": 32, "most": 256, "sweeps": ["path", "mitsuba", "depth"]} if args.quick else {}
        seconds = 40.0 if args.quick else args.seconds
        reports.append(work_precision(scene, file.stem, file=file, seconds=seconds, seed=SEED, **few))
        print(file.stem, flush=True)
        show(reports[-1])
        write(reports, HERE / "results", columns=3 if len(reports) > 1 else None)  # what is there so far


if __name__ == "__main__":
    main()
