"""The command line: render, explain, compare, doctor.

Each command imports what it needs when it runs: `--help` and mistakes in the command come without jax.
A mistake of the user's is one line on stderr and exit code 2; Ctrl-C is exit code 130.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    import numpy as np

    from .effects import Plan
    from .solver.solution import Solution

_LARGEST = 1 << 15  # pixels to a side, as `Film` has it
_BLOCK = 8  # pixels to a side of the blocks that `compare` averages


class _MistakeError(Exception):
    """A mistake found before the library is imported: one line that names the remedy."""


class _Parser(argparse.ArgumentParser):
    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs, allow_abbrev=False)  # so that a new option never breaks an old command

    def error(self, message: str) -> NoReturn:
        raise _MistakeError(f"{message}; see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command (by default that of the process) and return its exit code: 0, 2 for mistakes, 130 for Ctrl-C."""
    try:
        args = _parser().parse_args(argv)
        args.run(args)
        sys.stdout.flush()
        return 0
    except SystemExit as done:  # --help and --version
        return int(done.code or 0)
    except KeyboardInterrupt:
        return _fail("interrupted; nothing was written", 130)
    except BrokenPipeError:  # the reader went away: nobody is left to be told
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        told = _told(error)
        if told is None:
            raise
        return _fail(*told)


def process() -> NoReturn:
    """`main` as a process of its own. It ends at once, for taking jax apart piece by piece would cost .3 s; so does
    Ctrl-C, which inside an import or a callback of jax would be swallowed or crash."""
    signal.signal(signal.SIGINT, _interrupted)
    code = main()
    with contextlib.suppress(OSError, ValueError):  # a closed pipe
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _interrupted(*_: Any) -> NoReturn:
    image = sys.modules.get("jaxrt.files.image")
    for part in list(image.unfinished) if image is not None else ():
        with contextlib.suppress(OSError):
            os.unlink(part)
    cursor = "\x1b[?25h\n" if sys.stderr.isatty() else ""  # the progress bar hides it
    with contextlib.suppress(OSError):
        os.write(2, f"{cursor}jaxrt: interrupted; what was being written is not there\n".encode())
    os._exit(130)


def _told(error: Exception) -> tuple[str, int] | None:
    """What to say of an error in one line, and the exit code; None for a fault of jaxrt's own."""
    if isinstance(error, _MistakeError):
        return str(error), 2
    from .parts import SceneError

    if isinstance(error, SceneError):
        return str(error), 2
    if isinstance(error, MemoryError) or re.search("RESOURCE_EXHAUSTED|[Oo]ut of memory", str(error)):
        return "out of memory; give a smaller --size or a scene with fewer faces", 1
    return None


def _fail(message: str, code: int = 2) -> int:
    print("jaxrt:", " ".join(message.split()), file=sys.stderr)
    return code


# ------------------------------------------------------------------------------------------ options


def _whole(least: int, most: int = (1 << 31) - 1) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"is {text!r}; give a whole number from {least} to {most}")
        return int(text)

    return read


def _sensors(text: str) -> list[int] | None:
    """Numbers of sensors; None for all."""
    return None if text == "all" else [_whole(0)(part) for part in text.split(",")]


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (0 < width <= _LARGEST and 0 < height <= _LARGEST):
        raise argparse.ArgumentTypeError(f"is {text!r}; give it as 640x480, with sides from 1 to {_LARGEST}")
    return width, height


def _stops(text: str) -> float:
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"is {text!r}; give a number of stops")


def _definition(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"is {text!r}; give it as name=value")
    return name, value


class _Version(argparse.Action):
    """--version, which reads the version only when asked."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any):
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from . import __version__

        print(f"jaxrt {__version__}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="jaxrt", description="How light settles in a scene, and how wrong the answer is.")
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    scene = _Parser(add_help=False)
    scene.add_argument("scene", metavar="SCENE", help="a Mitsuba 3 .xml, .glb, .gltf, .obj or .ply file")
    scene.add_argument(
        "-D", dest="defaults", metavar="name=value", type=_definition, action="append", default=[],
        help="fill $name of an XML scene; may be repeated",
    )  # fmt: skip
    scene.add_argument("--no-cache", action="store_true", help="do not keep compiled programs (as JAXRT_CACHE=off)")

    render = commands.add_parser("render", parents=[scene], help="render a scene to an EXR and a PNG")
    add = render.add_argument
    add("-o", "--output", metavar="out.exr", help="the EXR, or the PNG beside it; default: the scene's name, here")
    add("--spp", metavar="N", type=_whole(1), help="samples a pixel; default: what the scene asks")
    add("--max-depth", metavar="D", type=_whole(-1), help="1: emission only, 2: direct light, ..., -1: no end")
    add("--method", choices=("auto", "path", "field"), default="auto", help="how the equation is solved")
    add("--seed", metavar="S", type=_whole(0, (1 << 62)), default=0, help="the same seed gives the same picture")
    add("--size", metavar="WxH", type=_size, help="size of the picture in pixels")
    add(
        "--sensor", metavar="I", type=_sensors, default=[0],
        help="number of the scene's sensor, from 0; several (0,2) or all write out-I.exr and share one field",
    )  # fmt: skip
    add("--memory", metavar="MB", type=_whole(1), help="what the render may take; default: a quarter of the machine's")
    add(
        "--aov", metavar="NAMES", type=lambda text: text.split(",") if text else [],
        help="put into the EXR what pixels see first: any of depth,normal,geo_normal,albedo,uv,position,face, or "
        "name:depth, ...; default: what the scene asks",
    )  # fmt: skip
    add("--exposure", metavar="E", type=_stops, default=0.0, help="brightness of the PNG in stops")
    render.set_defaults(run=_render)

    explain = commands.add_parser("explain", parents=[scene], help="which effects a scene calls for, and why")
    add = explain.add_argument
    add("--measure", action="store_true", help="time a small picture with and without each effect")
    for flag, what in (("without", "out"), ("with", "in")):
        text = f"force effects {what}, and measure what a small picture loses; see the table for names"
        add(
            f"--{flag}",
            metavar="NAMES",
            type=lambda text: text.split(","),
            default=[],
            dest=f"{what}_forced",
            help=text,
        )
    explain.set_defaults(run=_explain)
    compare = commands.add_parser("compare", help="how far two pictures are apart")
    compare.add_argument("a", metavar="A.exr")
    compare.add_argument("b", metavar="B.exr", help="the reference")
    compare.set_defaults(run=_compare)
    doctor = commands.add_parser("doctor", help="versions, devices, ray casting, compilation cache")
    doctor.set_defaults(run=_doctor)
    return parser


# ----------------------------------------------------------------------------------------- commands


def _render(args: argparse.Namespace) -> None:
    exr, png = _outputs(args.scene, args.output)
    scene = _load(args)
    from .solver.render import render, resized

    sensors = range(len(scene.structure.sensors)) if args.sensor is None else args.sensor
    for sensor in sensors if args.size else ():
        scene = resized(scene, sensor, *args.size)
    with _progress() as progress:
        found = render(
            scene,
            args.spp,
            args.seed,
            method=args.method,
            max_depth=args.max_depth,
            sensor=list(sensors),
            memory=args.memory * 1e6 if args.memory else None,
            aov=args.aov,
            progress=progress,
        )
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
                f"jaxrt: {sol.stats['nonfinite']} values are not finite; they are magenta in {files[1]}",
                file=sys.stderr,
            )
        print(f"{files[0]}, {files[1]}: {_closing(sol)}")


def _closing(sol: Solution) -> str:
    height, width = sol.image.shape[:2]
    s, error = sol.stats, sol.relative_error
    solved = f"solved in {s['seconds_solve']:.1f} s, " if s["method"] == "field" else ""
    return (
        f"{width}x{height}, {s['spp']} samples a pixel by {s['method']}, compiled in {s['seconds_compile']:.1f} s, "
        f"{solved}ran {s['seconds_run']:.1f} s, relative error {'unknown' if math.isnan(error) else f'{error:.2%}'}"
    )


def _explain(args: argparse.Namespace) -> None:
    scene = _load(args)
    from .effects import plan
    from .effects.table import show

    forced: dict[str, Any] = dict.fromkeys(args.in_forced, True) | dict.fromkeys(args.out_forced, False)
    fixed, free, costs = plan(scene, free=None, **forced), plan(scene, **forced), None
    if args.measure:
        from .effects.costs import effect_costs

        with _progress() as progress:
            say = progress and (lambda name, share: progress(share))
            costs = effect_costs(scene, progress=say, **forced)
    show(fixed, costs)
    changes = [("in", free.effects - fixed.effects), ("out", fixed.effects - free.effects)]
    said = [f"{', '.join(sorted(names))} would be {where}" for where, names in changes if names]
    print(f"with every parameter free: {'; '.join(said) or 'the same effects'}")
    if forced:
        from .effects.costs import dropped_radiance

        mean, lost, error = dropped_radiance(scene, forced)
        share = f", {lost / mean:.2%} of {mean:.3g}" if mean else ""
        print(f"the mean of a small picture loses {lost:.3g} ± {error:.1g}{share}; {_dropped(fixed)}")


def _dropped(plan: Plan) -> str:
    return f"left out: {', '.join(plan.dropped)}" if plan.dropped else "nothing that the scene has is left out"


def _compare(args: argparse.Namespace) -> None:
    for path in (args.a, args.b):
        _existing(path)
    import numpy as np

    from .files.image import read_exr
    from .solver.solution import relative_mse

    (a, a_error, _), (b, b_error, _) = read_exr(args.a), read_exr(args.b)
    if a.shape != b.shape:
        sizes = [f"{path} is {im.shape[1]}x{im.shape[0]}" for path, im in ((args.a, a), (args.b, b))]
        raise _MistakeError(f"{' and '.join(sizes)}; render both at one size")
    a, b = a.astype(np.float64), b.astype(np.float64)
    finite = np.asarray(np.isfinite(a + b).all(-1))
    if not finite.all():
        print(f"not finite       {int((~finite).sum())} pixels, left out")
        a[~finite] = b[~finite] = 0.0
    scale = b.mean() or 1.0
    worst, at = _worst_block(a, b)
    print(f"mean offset      {(a.mean() - b.mean()) / scale:+.3%}")
    print(f"relMSE           {relative_mse(a, b):.3e}")
    print(f"|z| < 4.5        {_share_of_z(a - b, a_error, b_error, scale, finite)}")
    print(f"worst {_BLOCK}x{_BLOCK} block  {worst / abs(scale):.2%} of the mean, at x {at[0]}, y {at[1]}")


def _share_of_z(
    off: np.ndarray, a_error: np.ndarray | None, b_error: np.ndarray | None, scale: float, finite: np.ndarray
) -> str:
    """The share of values whose difference is below 4.5 of its standard error, as text."""
    import numpy as np

    known = [e.astype(np.float64) ** 2 for e in (a_error, b_error) if e is not None and np.isfinite(e).any()]
    if not known:
        return "unknown: neither picture has standard errors"
    z = off / np.sqrt(np.nan_to_num(sum(known)) + (1e-6 * scale) ** 2)
    return f"{(np.abs(z[finite]) < 4.5).mean():.3%}" if finite.any() else "unknown: no pixel is finite"


def _worst_block(a: np.ndarray, b: np.ndarray) -> tuple[float, tuple[int, int]]:
    """The largest difference of block means in any channel, and the block's first column and row."""
    import numpy as np

    off = a - b
    count = np.ones((*off.shape[:2], 1))
    for axis in (0, 1):
        starts = np.arange(0, off.shape[axis], _BLOCK)
        off, count = np.add.reduceat(off, starts, axis), np.add.reduceat(count, starts, axis)
    means = np.abs(off / count).max(-1)
    row, column = np.unravel_index(means.argmax(), means.shape)
    return float(means.max()), (int(column) * _BLOCK, int(row) * _BLOCK)


def _doctor(args: argparse.Namespace) -> None:
    import importlib.metadata
    import platform

    from . import __version__

    def version(package: str) -> str:
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            return "not installed"

    rows = [("jaxrt", __version__), ("python", f"{platform.python_version()}, {sys.platform} {platform.machine()}")]
    rows += [(package, version(package)) for package in ("jax", "jaxlib", "numpy", "equinox", "mitsuba")]
    from .solver.render import cores, machine_memory

    import jax  # isort: skip

    try:
        devices = ", ".join(str(d) for d in jax.devices())
    except RuntimeError as error:  # a driver that does not start
        devices = f"none: {' '.join(str(error).split())}"
    rows += [("devices", devices), ("cores", str(cores())), ("memory", f"{machine_memory() / 2**30:.1f} GiB")]
    from .intersect import BACKENDS, refusal

    casting = [f"{name}: {'yes' if (why := refusal(name)) is None else f'no, {why}'}" for name in BACKENDS]
    rows += [("ray casting", "; ".join(casting)), ("cache", _cache_state())]
    for name, value in rows:
        print(f"{name:<12} {value}")


# ------------------------------------------------------------------------------------------ helpers


def _existing(path: str) -> None:
    if not os.path.isfile(path):
        raise _MistakeError(f"{path}: no such file; check the path")


def _load(args: argparse.Namespace) -> Any:
    _existing(args.scene)
    if not args.no_cache:
        _use_cache()
    from .loading import load

    return load(args.scene, **dict(args.defaults))


def _outputs(scene: str, output: str | None) -> tuple[Path, Path]:
    """The EXR and the PNG beside it; a folder or suffix that will not do is found before anything is rendered."""
    out = Path(output) if output is not None else Path(Path(scene).stem + ".exr")
    if out.suffix.lower() not in (".exr", ".png"):
        raise _MistakeError(f"{out}: a picture is written as .exr or .png; change the suffix")
    if not out.parent.is_dir():
        raise _MistakeError(f"{out}: the folder {out.parent} does not exist; make it or give another path")
    pair = [out if out.suffix.lower() == suffix else out.with_suffix(suffix) for suffix in (".exr", ".png")]
    for path in pair:
        if path.exists() and not path.is_file():
            raise _MistakeError(f"{path}: is not a file; give another name")
    if not os.access(out.parent, os.W_OK):
        raise _MistakeError(f"{out}: the folder {out.parent} cannot be written; give another path")
    return pair[0], pair[1]


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[float], None] | None]:
    """A callback that draws a progress bar with the time left on stderr; None where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=None)
        yield lambda share: bar.update(task, description="rendering", total=1.0, completed=share)


def _cache_folder() -> Path:
    """Where compiled programs are kept: $XDG_CACHE_HOME/jaxrt, by default ~/.cache/jaxrt."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path("~/.cache").expanduser()) / "jaxrt"


def _cache_refusal() -> str | None:
    """Why compiled programs are not kept, or None. Makes the folder."""
    if os.environ.get("JAXRT_CACHE", "").lower() in ("off", "0", "no", "false"):
        return "off, by JAXRT_CACHE"
    try:
        folder = _cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home
        return f"off: {error}"
    return None if os.access(folder, os.W_OK) else f"off: {folder} cannot be written"


def _use_cache() -> None:
    """Keep compiled programs, unless switched off; a render never fails for it."""
    if _cache_refusal():
        return
    from . import compiler

    compiler.folder = _cache_folder() / "programs"


def _cache_state() -> str:
    refusal = _cache_refusal()
    if refusal:
        return refusal
    files = [f for f in _cache_folder().rglob("*") if f.is_file()]
    return f"{_cache_folder()}, {len(files)} files, {sum(f.stat().st_size for f in files) / 1e6:.1f} MB"
