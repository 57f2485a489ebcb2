"""Memory does not grow with the length of a run: neither events nor finished commands are kept.

Each run is in its own process, because Rerun keeps some memory of every recording of a process.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

if not Path("/proc/self/status").exists():
    pytest.skip("peaks of memory are read from /proc", allow_module_level=True)
pytest.importorskip("mcap")
pytest.importorskip("rerun")

SCENE = """
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
wrenches: [{topic: wrench}]
solver: {method: euler, step: 0.01}
"""

PRELUDE = """
from rb_dynamics import Wrench, parse_scene, simulate
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.rerun_sink import RerunSink

def peak_kb():
    # Not ru_maxrss, which begins with that of the parent.
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))

def commands(count, duration):
    for k in range(count):
        yield "wrench", Wrench((1e-6 * k, 0.0, 0.0), (0.0, 1e-6 * k, 0.0), "world", k * duration * 10**9 // count)
"""
RUN = {
    "MCAP log": """
def run(name, duration):
    scene = parse_scene(SCENE, overrides={"duration": duration, "output_rate": 200.0})
    simulate(scene, (), [McapSink(name + ".mcap")])
""",
    "Rerun recording": """
def run(name, duration):
    scene = parse_scene(SCENE, overrides={"duration": duration, "output_rate": 200.0})
    simulate(scene, (), [RerunSink(name + ".rrd", max_rows=500, batch_rows=100)])
""",
    "commands": """
def run(name, duration):
    simulate(parse_scene(SCENE, overrides={"duration": duration}), commands(200 * duration, duration))
""",
    "commands of a bag": """
def run(name, duration):
    scene = parse_scene(SCENE, overrides={"duration": duration, "output_rate": 0.1})
    simulate(scene, commands(200 * duration, duration), [McapSink(name + ".bag.mcap")])
    bag = RecordedWrenches([name + ".bag.mcap"], ["wrench"])
    assert len(bag) == 200 * duration
    simulate(scene, bag)
""",
}
AT_MOST_KB = 3000


@pytest.mark.parametrize(
    "what", [pytest.param(what, marks=[pytest.mark.slow] * (what in ("Rerun recording", "commands"))) for what in RUN]
)
def test_longer_runs_take_no_more_memory(what: str, tmp_path: Path) -> None:
    """Keeping all events or commands would take 6 to 30 MB. Some thousand outputs or commands are held at a time."""
    durations = (100, 250) if what in ("MCAP log", "commands of a bag") else (10, 100)
    short, long = (_peak_kb(what, duration, tmp_path) for duration in durations)
    # A busy machine may keep some MB more for once; what grows does so again.
    if long - short >= AT_MOST_KB:
        long = _peak_kb(what, durations[1], tmp_path)
    assert long - short < AT_MOST_KB


def _peak_kb(what: str, duration: int, folder: Path) -> int:
    """Return the peak of the resident size (kB) of a run in a process of its own."""
    code = f"{PRELUDE}\nSCENE = {SCENE!r}\n{RUN[what]}\nrun('run', {duration})\nprint('PEAK', peak_kb())"
    # All compiled, or the longer run alone would load a compiler.
    environment = {**os.environ, "RB_DYNAMICS_COMPILE": "always" if find_spec("numba") else "auto"}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return int(result.stdout.rpartition("PEAK")[2])
