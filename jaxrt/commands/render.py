"""`jaxrt render`: a scene to an EXR and a PNG."""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import BEGAN
from .options import MistakeError, duration, picture_size, sensor_numbers, stops, tolerance, whole
from .shared import load, progress_bar, tell_costs, writable

if TYPE_CHECKING:
    from ..solver.solution import Solution


def add(commands: Any, scene: argparse.ArgumentParser) -> None:
    parser = commands.add_parser("render", parents=[scene], help="render a scene to an EXR and a PNG")
    add = parser.add_argument
    add("-o", "--output", metavar="out.exr", help="the EXR, or the PNG beside it; default: the scene's name, here")
    add("--spp", metavar="N", type=whole(1), help="samples a pixel; default: what the scene asks")
    add(
        "--rtol",
        metavar="R",
        type=tolerance,
        help="instead of --spp: samples until the relative error is below, as 1%%",
    )
    add(
        "--seconds",
        metavar="S",
        type=duration,
        help="the best picture in so many seconds, start and compiling included",
    )
    add("--max-depth", metavar="D", type=whole(-1), help="1: emission only, 2: direct light, ..., -1: no end")
    add("--method", choices=("auto", "path", "field"), default="auto", help="how the equation is solved")
    add("--seed", metavar="S", type=whole(0, (1 << 62)), default=0, help="the same seed gives the same picture")
    add("--size", metavar="WxH", type=picture_size, help="size of the picture in pixels")
    add(
        "--sensor", metavar="I", type=sensor_numbers, default=[0],
        help="number of the scene's sensor, from 0; several (0,2) or all write out-I.exr and share one field",
    )  # fmt: skip
    add("--memory", metavar="MB", type=whole(1), help="what the render may take; default: a quarter of the machine's")
    add(
        "--aov", metavar="NAMES", type=lambda text: text.split(",") if text else [],
        help="put into the EXR what pixels see first: any of depth,normal,geo_normal,albedo,uv,position,face, or "
        "name:depth, ...; default: what the scene asks",
    )  # fmt: skip
    add("--debug", action="store_true", help="stop at the first sample that is not finite, and show its path")
    add("--exposure", metavar="E", type=stops, default=0.0, help="brightness of the PNG in stops")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    for name in ("rtol", "seconds"):
        if getattr(args, name) is not None and args.spp is not None:
            raise MistakeError(f"--{name}: is given beside --spp; give one of them")
    exr, png = _outputs(args.scene, args.output)
    scene = load(args)
    from ..solver.nonfinite import NonFiniteError
    from ..solver.render import render, resized

    sensors = range(len(scene.structure.sensors)) if args.sensor is None else args.sensor
    for sensor in sensors if args.size else ():
        scene = resized(scene, sensor, *args.size)
    try:
        with progress_bar() as progress:
            found = render(
                scene,
                args.spp,
                args.seed,
                rtol=args.rtol,
                seconds=None if args.seconds is None else max(args.seconds - (time.perf_counter() - BEGAN), 0.1),
                foretold=tell_costs,
                method=args.method,
                max_depth=args.max_depth,
                sensor=list(sensors),
                memory=args.memory * 1e6 if args.memory else None,
                aov=args.aov,
                debug=args.debug,
                progress=progress,
            )
    except NonFiniteError as error:
        print(f"jaxrt: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    for sensor, sol in zip(sensors, found, strict=True):
        files = [f if len(found) == 1 else f.with_stem(f"{f.stem}-{sensor}") for f in (exr, png)]
        sol.save(files[0])
        sol.save(files[1], args.exposure)
        if "unsolved" in sol.stats:
            print(
                f"jaxrt: {files[0]}: is not right, for the field was not found: {sol.stats['unsolved']}",
                file=sys.stderr,
            )
        if sol.stats["nonfinite"]:
            print(
                f"jaxrt: {sol.stats['nonfinite']} values are not finite; they are magenta in {files[1]}{_first(sol)}",
                file=sys.stderr,
            )
        print(f"{files[0]}, {files[1]}: {_closing(sol)}")


def _first(sol: Solution) -> str:
    """The first sample that is not finite."""
    return "".join(f"; the first: {one}" for one in sol.stats["nonfinite_at"][:1])


def _closing(sol: Solution) -> str:
    height, width = sol.image.shape[:2]
    s, error, asked = sol.stats, sol.error, sol.header["rtol"]
    solved = f"solved in {s['seconds_solve']:.1f} s, " if s["method"] == "field" else ""
    done = (
        f"{width}x{height}, {s['spp']} samples a pixel by {s['method']}, compiled in {s['seconds_compile']:.1f} s, "
        f"{solved}ran {s['seconds_run']:.1f} s, relative error "
    )
    if math.isnan(error.total):
        return done + "unknown"
    parts = {name: getattr(error, name) for name in ("statistical", "truncation", "discretisation")}
    parts = {name: part for name, part in parts.items() if part > 0}
    said = f" ({', '.join(f'{name} {part:.2%}' for name, part in parts.items())})" if len(parts) > 1 else ""
    if asked is None:
        return done + f"{error.total:.2%}{said}"
    missed = "; more samples do not help: take --method path" if error.claim > asked and s["method"] == "field" else ""
    return done + f"asked {asked:.2%}, below {error.claim:.2%} in 95 of 100 renders{said}{missed}"


def _outputs(scene: str, output: str | None) -> tuple[Path, Path]:
    """The EXR and the PNG beside it; a folder or suffix that will not do is found before anything is rendered."""
    out = Path(output) if output is not None else Path(Path(scene).stem + ".exr")
    if out.suffix.lower() not in (".exr", ".png"):
        raise MistakeError(f"{out}: a picture is written as .exr or .png; change the suffix")
    if not out.parent.is_dir():
        raise MistakeError(f"{out}: the folder {out.parent} does not exist; make it or give another path")
    pair = [out if out.suffix.lower() == suffix else out.with_suffix(suffix) for suffix in (".exr", ".png")]
    for path in pair:
        if path.exists() and not path.is_file():
            raise MistakeError(f"{path}: is not a file; give another name")
    writable(out.parent, "give another path by -o")
    return pair[0], pair[1]
