"""Time `rb-dynamics identify` on a throw of 0.6 s at 4 kHz and on an hour at 100 Hz: docs/identify.md.

    python tools/time_identify.py [SECONDS_OF_THE_LONG_ONE]

Both are simulated tumbles of which a gyro with noise and a bias tells; ratios and bias are fitted, by the command, with
reading and start-up. The long one is also fitted with slow noise of 0.013 rad/s over the white noise of 0.005 rad/s,
which takes all starts. A loop of fixed work is timed before and after: where it differs, others used the machine.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from rb_dynamics import RigidBody, State
from rb_dynamics.run.ensemble import driven_motion

SCENE = "body: {mass: 1, inertia: {diagonal: [1.1, 1.4, 2.2]}}\n"
COMMAND = (sys.executable, "-m", "rb_dynamics", "identify")


def loop() -> float:
    """Return the processor time of some fixed work, s."""
    begin, total = time.process_time(), 0
    for k in range(3_000_000):
        total += k
    return time.process_time() - begin


def recorded(path: Path, seconds: float, rate: float, spin: float, slow: float = 0.0) -> int:
    """Write a recording of a tumble at about `spin` (rad/s), with `slow` noise in each step, and return its rows."""
    random = np.random.default_rng(0)
    times = np.rint(np.arange(round(seconds * rate) + 1) * 1e9 / rate).astype(np.int64)
    body = RigidBody.from_matrix(1.0, [[1.0, 0.1, 0.05], [0.1, 1.5, 0.1], [0.05, 0.1, 2.0]])
    start = State(angular_velocity_body=(0.3 * spin, spin, 0.4 * spin))
    motion = driven_motion(body, start, times[1:], method="rkmk4", step=min(0.01, 4.0 / rate))
    rates = np.vstack([start.angular_velocity_body, np.asarray(motion.angular_velocity_body)])
    noisy = rates + (0.01, -0.02, 0.005) + 5e-3 * random.standard_normal(rates.shape)
    noisy += lfilter([1.0], [1.0, -0.999], slow * random.standard_normal(rates.shape), axis=0)
    table = np.column_stack([times * 1e-9, noisy])
    np.savetxt(path, table, "%.9f", ",", header="time_s,wx,wy,wz", comments="")
    return len(times)


def main() -> None:
    """Print the table."""
    long = float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0
    print(f"loop of fixed work: {loop():.2f} s before")
    print("| recording | samples | s | processor, s | MiB |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        scene, recording, output = (Path(folder) / name for name in ("scene.yaml", "recording.csv", "found.json"))
        scene.write_text(SCENE, encoding="utf-8")
        given = (
            ("0.6 s at 4 kHz", 0.6, 4000.0, 20.0),
            (f"{long:g} s at 100 Hz", long, 100.0, 2.0),
            ("the same, slow noise", long, 100.0, 2.0, 6e-4),
        )
        for name, *flight in given:
            count = recorded(recording, *flight)
            options = ("--fit", "inertia_ratios,gyro_bias", "--columns", "gyro=wx,wy,wz", "--json")
            begin = time.monotonic()
            with output.open("w") as out:
                files = [(os.POSIX_SPAWN_DUP2, out.fileno(), 1)]
                command = [*COMMAND, str(scene), str(recording), *options]
                child = os.posix_spawn(command[0], command, os.environ, file_actions=files)
                _, status, used = os.wait4(child, 0)
            if status:
                raise SystemExit(f"{name}: identify ended with {os.waitstatus_to_exitcode(status)}")
            wall, processor = time.monotonic() - begin, used.ru_utime + used.ru_stime
            print(f"| {name} | {count} | {wall:.1f} | {processor:.1f} | {used.ru_maxrss / 1024:.0f} |", flush=True)
    print(f"loop of fixed work: {loop():.2f} s after")


if __name__ == "__main__":
    main()
