"""Does any file make jaxrt crash, hang or take more memory than it should?

Each format is fuzzed from a small whole file, in a process of its own with limits of memory and time for each input:
by atheris where it is installed (`pip install atheris`), which looks for inputs that reach new code, else by the damage
that the tests do. A finding is whatever is neither a scene nor a `SceneError` of one line; it is kept in `results/`.

    python experiments/fuzz/run.py [--quick] [--seconds 600] [--formats a.xml ...] [--whole]
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "files"), str(HERE.parent)]

from peer import results_of  # noqa: E402

ATHERIS = importlib.util.find_spec("atheris") is not None
if ATHERIS:
    import atheris  # pyright: ignore[reportMissingImports]
with atheris.instrument_imports(include=["jaxrt.files"]) if ATHERIS else contextlib.nullcontext():
    import hostile

    import jaxrt

MEMORY, SECONDS = 3 << 30, 20
"""Of an input: address space, most of which is libraries, and time."""


class HangError(Exception):
    pass


def one(name: str, folder: Path, data: bytes, whole: bool) -> bool:
    """Whether an input is read, or refused as it should be; raises, and keeps the input, else."""
    path = folder / name
    path.write_bytes(data)
    signal.alarm(SECONDS)
    try:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(nowhere):
            jaxrt.load(path) if whole else hostile.read(path)
        return True
    except jaxrt.SceneError as error:
        if str(error).isprintable() and name in str(error):
            return False
        keep(name, data, error)
        raise
    except BaseException as error:
        keep(name, data, error)
        raise
    finally:
        signal.alarm(0)


def keep(name: str, data: bytes, error: BaseException) -> None:
    kept = HERE / "results" / f"{type(error).__name__}-{zlib.crc32(data):08x}-{name}"
    kept.parent.mkdir(exist_ok=True)
    kept.write_bytes(data)
    print(f"{kept.name}: {str(error)[:200]}", flush=True)


def child(name: str, seconds: float, whole: bool, seed: int) -> None:
    """Fuzz one format for so long; prints how many inputs there were, and how many were read."""

    def late(*_: object) -> None:
        raise HangError(f"takes more than {SECONDS} s")

    signal.signal(signal.SIGALRM, late)
    with tempfile.TemporaryDirectory() as there:
        folder, counts = Path(there), [0, 0]
        seeds = hostile.seeds(folder)
        corpus = [seeds[name]]
        if name == "a.xml":
            corpus += [path.read_bytes() for path in sorted(hostile.SCENES.glob("*.xml"))]
            for path in (hostile.SCENES / "meshes").iterdir():
                (folder / "meshes").mkdir(exist_ok=True)
                (folder / "meshes" / path.name).write_bytes(path.read_bytes())
        for data in corpus:
            one(name, folder, data, whole)
        if not whole:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        end = time.monotonic() + seconds

        def test(data: bytes) -> None:
            counts[0] += 1
            with contextlib.suppress(Exception):  # kept above: go on
                counts[1] += one(name, folder, data, whole)
            if time.monotonic() > end:
                print(f"{name}: {counts[0]} inputs, {counts[1]} of them read", flush=True)
                os._exit(0)

        if ATHERIS and not whole:
            guided(name, corpus, test, folder)
        numbers = random.Random(seed)
        while True:
            data, number = numbers.choice(corpus), numbers.randrange(1 << 60)
            xml = name == "a.xml" and number % 4
            test(hostile.altered(data.decode(), number).encode() if xml else hostile.damaged(data, number))


def guided(name: str, corpus: list[bytes], test: object, folder: Path) -> None:
    (folder / "corpus").mkdir()
    for k, data in enumerate(corpus):
        (folder / "corpus" / str(k)).write_bytes(data)

    def mutated(data: bytes, most: int, seed: int) -> bytes:
        if name == "a.xml" and seed % 4:
            with contextlib.suppress(UnicodeDecodeError, IndexError):
                return hostile.altered(data.decode(), seed).encode()[:most]
        changed = hostile.damaged(data, seed) if seed % 2 and data else atheris.Mutate(data, most)
        return changed[:most]

    quiet = ["-verbosity=0", "-max_len=20000", f"-rss_limit_mb={MEMORY >> 20}", str(folder / "corpus")]
    atheris.Setup([sys.argv[0], *quiet], test, custom_mutator=mutated)
    atheris.Fuzz()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    with tempfile.TemporaryDirectory() as there:
        names = list(hostile.seeds(Path(there)))
    parser.add_argument("--quick", action="store_true", help="30 seconds")
    parser.add_argument("--seconds", type=float, default=600, help="for all formats together")
    parser.add_argument("--formats", nargs="*", default=names)
    parser.add_argument(
        "--whole", action="store_true", help="make whole scenes, which is slower, and not only read files"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    each = (30.0 if args.quick else args.seconds) / len(args.formats)
    if args.child:
        child(args.formats[0], args.seconds, args.whole, args.seed)
    results_of(HERE, args.seed, atheris=ATHERIS, seconds=args.seconds)
    print("by atheris" if ATHERIS and not args.whole else "without atheris", flush=True)
    for name in args.formats:
        command = [
            sys.executable,
            __file__,
            "--child",
            "--formats",
            name,
            "--seconds",
            str(each),
            "--seed",
            str(args.seed),
        ]
        try:
            done = subprocess.run(command + ["--whole"] * args.whole, timeout=each + 10 * SECONDS)
        except subprocess.TimeoutExpired:
            print(f"{name}: hangs")
            continue
        if done.returncode:
            print(f"{name}: ends with code {done.returncode}")


if __name__ == "__main__":
    main()
