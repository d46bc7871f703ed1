"""The command line: render, explain, compare, workprec, doctor.

Each command imports what it needs when it runs: `--help` and mistakes in the command come without jax.
A mistake of the user's is one line on stderr and exit code 2; Ctrl-C is exit code 130.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from .commands import COMMANDS
from .commands.options import MistakeError, Parser, scene_options


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
    writing = sys.modules.get("jaxrt.files.writing")  # perhaps while it is being imported, and without its names
    for part in list(getattr(writing, "unfinished", ())):
        with contextlib.suppress(OSError):
            os.unlink(part)
    cursor = "\x1b[?25h\n" if sys.stderr.isatty() else ""  # the progress bar hides it
    with contextlib.suppress(OSError):
        os.write(2, f"{cursor}jaxrt: interrupted; what was being written is not there\n".encode())
    os._exit(130)


def _told(error: Exception) -> tuple[str, int] | None:
    """What to say of an error in one line, and the exit code; None for a fault of jaxrt's own."""
    if isinstance(error, MistakeError):
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


class _Version(argparse.Action):
    """--version, which reads the version only when asked."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any):
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from . import __version__

        print(f"jaxrt {__version__}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="jaxrt", description="How light settles in a scene, and how wrong the answer is.")
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    scene = scene_options()
    for command in COMMANDS:
        command.add(commands, scene)
    return parser
