"""Signals: a command that writes a log closes it, and its exit code names the signal."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from rb_dynamics import parse_scene, simulate
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.run.sink import Event, RunInfo
from rb_dynamics.run.stop_signals import Stopped, interrupted_by_signals, uninterrupted
from rb_dynamics.sinks.mcap_sink import McapSink

pytestmark = pytest.mark.usefixtures("signals_of_a_terminal")

SCENE = """\
body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 3, 0.1]}
solver: {method: rk4, step: 0.001}
output_rate: 1000
duration: 100000
"""


@contextlib.contextmanager
def begun(log: Path, *before: str, **options: int) -> Iterator[subprocess.Popen[str]]:
    """Start a run of `SCENE`, wait until it has begun to write `log`, and make sure that it is gone afterwards."""
    scene = log.with_name("scene.yaml")
    scene.write_text(SCENE)
    command = [*before, sys.executable, "-m", "rb_dynamics", "simulate", str(scene), "--mcap", str(log)]
    with subprocess.Popen(command, text=True, **{"stderr": subprocess.PIPE, **options}) as run:
        try:
            while run.poll() is None and not (log.exists() and log.stat().st_size > 100_000):
                with contextlib.suppress(subprocess.TimeoutExpired):
                    run.wait(0.02)
            yield run
        finally:
            run.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_closes_the_log_and_is_the_exit_code(tmp_path: Path, number: signal.Signals) -> None:
    log = tmp_path / "run.mcap"
    with begun(log) as run:
        run.send_signal(number)
        _, err = run.communicate(timeout=60)
    assert (run.returncode, err) == (128 + number, "rb-dynamics: interrupted\n")
    bag = read_bag(log)
    assert bag.complete
    assert bag.topics["/pose"].count > 100


def test_a_terminal_that_is_closed_closes_the_log(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    with begun(tmp_path / "run.mcap", "setsid", "--ctty", stdin=theirs, stdout=theirs, stderr=theirs) as run:
        os.close(theirs)
        os.close(ours)
        assert run.wait(60) == 128 + signal.SIGHUP
    assert read_bag(tmp_path / "run.mcap").complete


def test_the_first_signal_interrupts_and_what_was_there_comes_back() -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)
    with interrupted_by_signals():
        with pytest.raises(Stopped):
            signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGTERM)
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)) == before


def test_nohup_is_obeyed() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupted_by_signals():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_waits_for_the_end_of_a_write() -> None:
    written = []

    def write() -> None:
        with uninterrupted():
            with uninterrupted():
                os.kill(os.getpid(), signal.SIGTERM)
            written.append("all")
        written.append("more")

    with pytest.raises(Stopped), interrupted_by_signals():
        write()
    assert written == ["all"]


class Interrupted:
    """A sink that is interrupted within its third write, and within its closing."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def open(self, run: RunInfo) -> None:
        """Begin."""

    def write(self, event: Event) -> None:
        with uninterrupted():
            if len(self.told) == 2:
                os.kill(os.getpid(), signal.SIGINT)
            self.told.append("written")

    def close(self, result: Mapping[str, str]) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        self.told.append("closed")


def test_ctrl_c_leaves_users_of_the_library_a_finished_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python raises KeyboardInterrupt wherever it is, in the middle of a write or of the closing too."""
    # Otherwise the log would take a block ahead of the other sink, which takes events one by one.
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    sink = Interrupted()
    scene = parse_scene(SCENE, overrides={"duration": 1.0, "solver.method": "rkmk4"})
    with pytest.raises(KeyboardInterrupt):
        simulate(scene, sinks=[McapSink(tmp_path / "run.mcap"), sink])
    assert sink.told == ["written"] * 3 + ["closed"]
    bag = read_bag(tmp_path / "run.mcap")
    assert bag.complete
    assert bag.topics["/pose"].count == 3
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
