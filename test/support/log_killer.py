"""Write logs in child processes and kill each with SIGKILL at a random moment.

Run as a script: `log_killer.py FOLDER KILLS FLUSH_S SHORTEST_S LONGEST_S`; prints one JSON object for each kill: the
path, whether `open` had returned, the number of samples `write` had taken, and how many of those were `FLUSH_S` old.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import signal
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from rb_dynamics import Sample, parse_scene
from rb_dynamics.run.sink import RunInfo
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink

SCENE = parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\n")
MOST = 200_000


def samples() -> Iterator[Sample]:
    """Yield samples of which each number tells the sample and the place in it."""
    zero = (0.0, 0.0, 0.0)
    for i in range(MOST):
        position = (i + 0.1, i + 0.2, i + 0.3)
        yield Sample(
            i * 1000, position, (0.0, 0.0, 0.0, 1.0), zero, zero, zero, zero, float(i), -i, 0.5 * i, zero, zero
        )


def write_until_killed(path: Path, flush_s: float, written: mmap.mmap) -> None:
    sink = McapSink(path, settings=LogSettings(flush_s=flush_s))
    sink.open(RunInfo(SCENE, "rk4"))
    struct.pack_into("<q", written, 0, 1)
    for i, sample in enumerate(samples()):
        sink.write(sample)
        struct.pack_into("<q", written, 8 + 8 * i, time.monotonic_ns())
        # A log that readers in Python can take in a moment.
        time.sleep(0.001)


def kill(path: Path, flush_s: float, after_s: float) -> dict[str, object]:
    written = mmap.mmap(-1, 8 + 8 * MOST)
    child = os.fork()
    if child == 0:
        write_until_killed(path, flush_s, written)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    now = time.monotonic_ns()
    opened, *stamps = struct.unpack(f"<{1 + MOST}q", written)
    taken = [stamp for stamp in stamps if stamp]
    old = sum(now - stamp >= flush_s * 1e9 for stamp in taken)
    return {"path": str(path), "opened": bool(opened), "written": len(taken), "old": old}


if __name__ == "__main__":
    folder, kills, flush_s, shortest_s, longest_s = Path(sys.argv[1]), int(sys.argv[2]), *map(float, sys.argv[3:])
    source = random.Random(11)
    # What a first log imports is imported here, not in each child again: they are killed while they log.
    first = McapSink(folder / "first.mcap", settings=LogSettings(flush_s=0.0))
    first.open(RunInfo(SCENE, "rk4"))
    first.close({})
    for number in range(kills):
        result = kill(folder / f"{number}.mcap", flush_s, source.uniform(shortest_s, longest_s))
        sys.stdout.write(json.dumps(result) + "\n")
