"""Measure the peak memory of `inspect` by the length of a log.

Usage: python benchmarks/inspection.py [samples ...]

Each log is of one free body at 1 kHz and is inspected in a process of its own. Prints samples, size of the log, peak
resident and anonymous memory at the end, and processor time.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import rb_dynamics as rb
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = """
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
wrenches: [{topic: wrench}]
output_rate: 1000
"""
INSPECT = """
import sys, time
from rb_dynamics.analysis.inspection import inspect
kept = inspect(sys.argv[1])
status = dict(line.split(":") for line in open("/proc/self/status"))
print(*(int(status[name].split()[0]) / 1024 for name in ("VmHWM", "RssAnon")), time.process_time())
"""


def main() -> None:
    for count in [int(text) for text in sys.argv[1:]] or [200_000, 400_000, 800_000]:
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder, "run.mcap")
            rb.simulate(rb.parse_scene(SCENE, overrides={"duration": count / 1000.0}), (), [McapSink(log)])
            command = [sys.executable, "-c", INSPECT, str(log)]
            said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            peak, anonymous, seconds = map(float, said.split())
            size = log.stat().st_size / 1e6
            print(
                f"{count} samples, {size:.0f} MB: peak {peak:.0f} MiB, {anonymous:.0f} MiB at the end, {seconds:.1f} s"
            )


if __name__ == "__main__":
    main()
