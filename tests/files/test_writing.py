"""What is written is there whole, or not at all: on a full disk, in folders that cannot be written, and where a process
is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from jaxrt import cli
from jaxrt.files.image import read_exr, write_exr
from jaxrt.files.writing import write_bytes
from jaxrt.fitting.checkpoint import about_of, load, save
from jaxrt.parts import SceneError

ROOT = Path(__file__).parents[2]

WRITERS = {
    "a.exr": "from jaxrt.files.image import write_exr; write_exr(path, noise, noise)",
    "a.png": "from jaxrt.files.image import write_png; write_png(path, noise)",
    "a.csv": "from jaxrt.files.writing import write_bytes; write_bytes(path, noise.tobytes())",
    "a.npz": "from jaxrt.fitting.checkpoint import save; save(path, {'a': jnp.asarray(noise)}, {'loss': [1.0]}, {})",
}
"""What makes files, each of more than 64 kB."""

CHILD = """
import resource, sys
import numpy as np
path, code, limit = sys.argv[1], sys.argv[2], int(sys.argv[3])
noise = np.random.default_rng(0).random((200, 200, 3), np.float32)
if "jnp" in code:
    import jax.numpy as jnp
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
from jaxrt.parts import SceneError
try:
    exec(code)
except SceneError as error:
    print(error)
"""


def child(path, code, limit=0):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-c", CHILD, str(path), code, str(limit)]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_a_file_that_grows_too_large_leaves_the_old_one(tmp_path, name):
    (tmp_path / name).write_text("old")
    done = child(tmp_path / name, WRITERS[name], 1 << 15)
    assert done.stdout.count("\n") == 1 and f"{name}: cannot be written (" in done.stdout, done
    assert "; check permissions and space" in done.stdout
    assert os.listdir(tmp_path) == [name] and (tmp_path / name).read_text() == "old"


@pytest.fixture
def full(tmp_path):
    """A disk of 64 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)], capture_output=True)
    if made.returncode:
        pytest.skip("no disk can be mounted here")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_a_full_disk_leaves_the_old_file(full, name):
    (full / name).write_text("old")
    done = child(full / name, WRITERS[name])
    assert done.stdout.count("\n") == 1 and f"{name}: cannot be written (" in done.stdout, done
    assert os.listdir(full) == [name] and (full / name).read_text() == "old"


class Rendered:
    """Stands for a solution: saves noise."""

    def save(self, file, exposure=0.0):
        write_exr(file, np.random.default_rng(0).random((64, 64, 3), np.float32))


def test_a_full_disk_on_the_command_line(full, capsys, monkeypatch):
    monkeypatch.setenv("JAXRT_CACHE", "off")
    monkeypatch.setattr("jaxrt.solver.render.render", lambda *_, **__: [Rendered()])
    (full / "fill").write_bytes(b"x" * 60_000)
    assert cli.main(["render", str(ROOT / "scenes" / "furnace.xml"), "-o", str(full / "a.exr")]) == 2
    err = capsys.readouterr().err
    assert "a.exr: cannot be written (" in err and err.count("\n") == 1
    assert os.listdir(full) == ["fill"]


def test_folders_that_cannot_be_written(tmp_path, capsys, monkeypatch):
    """Found before anything is rendered; root may write where permissions forbid it, but not into /proc."""
    monkeypatch.chdir(tmp_path)
    scene = str(ROOT / "scenes" / "furnace.xml")
    (tmp_path / "taken.exr").mkdir()
    monkeypatch.setattr("jaxrt.loading.load", None)
    for command, output, said in (
        ("render", "/proc/a.exr", "/proc: cannot be written ("),
        ("render", "taken.exr", "taken.exr: is not a file; give another name"),
        ("render", "taken.exr/b.png/a.exr", "does not exist; make it"),
        ("workprec", "/proc/work", "/proc: cannot be written ("),
    ):
        assert cli.main([command, scene, "-o", output]) == 2
        assert said in capsys.readouterr().err
    with pytest.raises(SceneError, match="cannot be written"):
        write_bytes("/proc/a", b"x")
    assert os.listdir(tmp_path) == ["taken.exr"]


def test_a_name_without_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_bytes("a.csv", b"x")
    assert os.listdir(tmp_path) == ["a.csv"]


@pytest.mark.parametrize("name", ["a.exr", "a.npz"])
def test_a_killed_process_leaves_a_whole_file(tmp_path, name):
    """It writes without end, two pictures by turns; whenever it is killed, one of them is there."""
    code = "while True:\n    " + WRITERS[name].replace("; ", "\n    ") + "\n    noise = 1 - noise"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    for wait in (0.0, 0.013, 0.027):
        job = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path / name), code, "0"], env=environment)
        for _ in range(600):
            time.sleep(0.05)
            if (tmp_path / name).exists():
                break
        time.sleep(wait)
        job.send_signal(signal.SIGKILL)
        job.wait()
        if name == "a.exr":
            noise = read_exr(tmp_path / name)[0]
        else:
            with np.load(tmp_path / name) as file:
                noise = file["state_0"]
        first = np.random.default_rng(0).random((200, 200, 3), np.float32)
        assert (noise == first).all() or np.allclose(noise, 1 - first, atol=1e-6)
        (tmp_path / name).unlink()


@pytest.mark.parametrize("content", [b"", b"x", b"PK\3\4", b"\x93NUMPY\1\0"])
def test_checkpoints_that_are_none(tmp_path, content):
    save(tmp_path / "a.npz", {"a": np.arange(3000.0)}, {"loss": [1.0]}, {"spp": 1})
    whole = (tmp_path / "a.npz").read_bytes()
    for data in (content, whole[: len(whole) // 2]):
        (tmp_path / "b.npz").write_bytes(data)
        with pytest.raises(SceneError, match="is no checkpoint of a fit"):
            about_of(tmp_path / "b.npz", {"spp": 1})
    damaged = bytearray(whole)
    damaged[2000:2008] = b"\xff" * 8
    (tmp_path / "b.npz").write_bytes(damaged)
    with pytest.raises(SceneError, match="checkpoint"):
        load(tmp_path / "b.npz", {"a": np.arange(3000.0)})
