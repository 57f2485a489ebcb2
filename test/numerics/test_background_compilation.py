"""Kernels that several processes ask for at a time are compiled one after the other, each once."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rb_dynamics.numerics import background_compilation, compilation

pytest.importorskip("numba")
fcntl = pytest.importorskip("fcntl")

HELPER = [sys.executable, "-m", "rb_dynamics", "compile", "--beside"]


@pytest.fixture
def folder(tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the empty folder of kernels of the processes that a test starts."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(root))
    made = tmp_path / "rb_dynamics" / compilation.cache_folder().name
    made.mkdir(parents=True)
    return made


@contextmanager
def asking(name: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that compiles what it is asked for, and ask, as a run that goes on for as long as the block."""
    with subprocess.Popen(HELPER, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as helper:
        assert helper.stdin is not None
        helper.stdin.write(f"{name}\n".encode())
        helper.stdin.flush()
        yield helper


def wait_for(path: Path) -> None:
    """Wait until there is a file at `path`."""
    end = time.monotonic() + 300.0
    while not path.exists():
        assert time.monotonic() < end, f"{path.name} does not come"
        time.sleep(0.02)


@pytest.mark.slow
def test_a_process_that_has_compiled_and_waits_for_more_keeps_nobody_from_compiling(folder: Path) -> None:
    with asking("_no_strides") as first:
        wait_for(folder / "_no_strides.kernel")
        with asking("_longest_of"):
            wait_for(folder / "_longest_of.kernel")
        assert first.poll() is None


@pytest.mark.slow
def test_it_waits_for_another_that_compiles_and_passes_over_what_that_has_compiled(folder: Path) -> None:
    with (folder / "compiling").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with asking("_no_strides") as helper:
            assert helper.stdin is not None
            helper.stdin.write(b"_longest_of\n")
            helper.stdin.close()
            with pytest.raises(subprocess.TimeoutExpired):
                helper.wait(2.0)
            (folder / "_no_strides.kernel").write_bytes(b"by another")
            fcntl.flock(lock, fcntl.LOCK_UN)
            assert helper.wait(300.0) == 0
    assert (folder / "_no_strides.kernel").read_bytes() == b"by another"
    assert (folder / "_longest_of.kernel").is_file()


def test_one_that_is_killed_while_it_compiles_leaves_no_lock(folder: Path) -> None:
    code = (
        "from rb_dynamics.numerics.background_compilation import asked_for\n"
        "for _ in asked_for():\n    print('compiling', flush=True)\n    input()\n"
    )
    killed = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with killed:
        assert killed.stdin is not None
        assert killed.stdout is not None
        killed.stdin.write("_no_strides\n")
        killed.stdin.flush()
        assert killed.stdout.readline() == "compiling\n"
        killed.kill()
    with asking("_no_strides"):
        wait_for(folder / "_no_strides.kernel")


def test_what_was_asked_of_a_process_that_has_ended_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background_compilation, "_asked", {})
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    with asking("") as helper:
        monkeypatch.setattr(background_compilation, "_other_process", lambda: helper)
        assert background_compilation.ask_for("a")
        assert background_compilation.ask_for("of_a_plugin", "order")
        assert background_compilation.waited_for() == ["a"]
        (tmp_path / "a.kernel").touch()
        assert background_compilation.waited_for() == []
        helper.kill()
        helper.wait()
        assert background_compilation.ask_for("a")
        assert not background_compilation.ask_for("of_a_plugin", "order")
