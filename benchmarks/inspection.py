"""Measure time and peak memory of `inspect` by the length of a recording.

Usage: python benchmarks/inspection.py [samples ...]

Each recording is of one free body at 1 kHz: a log of this package, and its Odometry and pose alone in a bag, as another
program would record them, inspected alone and with a scene whose body is not the one that moved. Each is inspected in
a process of its own. Prints samples, size, peak resident memory and time, on the clock and of the processor, with that
to start.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import rb_dynamics as rb
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.formats.recovery import Copy
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = """
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
wrenches: [{topic: wrench}]
output_rate: 1000
"""
INSPECT = """
import sys
from rb_dynamics.analysis.inspection import inspect
inspect(*sys.argv[1:])
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def main() -> None:
    for count in [int(text) for text in sys.argv[1:]] or [100_000, 400_000, 1_200_000]:
        with tempfile.TemporaryDirectory() as folder:
            log, bag = Path(folder, "run.mcap"), Path(folder, "bag.mcap")
            rb.simulate(rb.parse_scene(SCENE, overrides={"duration": count / 1000.0}), (), [McapSink(log)])
            measure("log of this package", log, count)
            write_bag(log, bag)
            measure("bag", bag, count)
            other = Path(folder, "other.yaml")
            other.write_text(SCENE.replace("[1, 2, 3]", "[1.1, 2, 2.8]"))
            measure("bag with a scene", bag, count, other)


def write_bag(log: Path, bag: Path) -> None:
    """Copy the motion, but not what only this package writes."""
    source = open_source(log)
    with closing(OutputFile(bag)) as file:
        copy = Copy(McapWriter(file, "benchmark"))
        for message in source.messages():
            if message.channel.topic in ("/odom", "/pose"):
                copy.add(message)
        copy.finish((), {}, {})


def measure(what: str, path: Path, count: int, *scene: Path) -> None:
    """Print what it takes to inspect a recording."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    said = subprocess.run(
        [sys.executable, "-c", INSPECT, path, *scene], capture_output=True, text=True, check=True
    ).stdout
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    size, peak = path.stat().st_size / 1e6, int(said) / 1024
    print(
        f"{what}: {count} samples, {size:.0f} MB: peak {peak:.0f} MiB, {wall:.1f} s, {processor:.1f} s of the processor"
    )


if __name__ == "__main__":
    main()
