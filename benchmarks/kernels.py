"""What compilation buys: the time of a step in plain Python and compiled, of every method that can be compiled.

Usage: python benchmarks/kernels.py [name ...]

A forced body, through `Arc`, as in a run; best of some repeats. Apart from that, what is paid once: the import of
numba, the first compilation ever (into an empty folder), and loading the result in a process that finds it there. Times
are of this machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

from rb_dynamics.compiled import available
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, Method
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.phase import Phase
from rb_dynamics.motion.step_control import NANOSECONDS, FixedStep
from rb_dynamics.rotation import normalize

INERTIA = Inertia(3.7, (1.6, 2.1, 2.9))
HELD = HeldWrench((0.9, -0.4, 0.6), (0.3, -0.2, 0.25), (0.1, 0.2, -0.3), (0.2, 0.35, -0.3))
START = Phase(normalize((0.5, -0.1, 0.7, 0.5)), (0.7, -1.1, 0.9), (0.0,) * 14, (0.0,) * 14)
STEP = 0.001
REPEATS = 5


def seconds(method: Method, steps: int, when: str) -> float:
    """Return the time that `steps` steps take."""
    os.environ["RB_DYNAMICS_COMPILE"] = when
    arc = Arc(method, INERTIA, HELD, FixedStep(STEP), 0, START)
    begin = time.perf_counter()
    arc.advance(round(steps * STEP * NANOSECONDS))
    return time.perf_counter() - begin


def first(name: str) -> None:
    """Print how long the import of numba takes here, and the first step after it."""
    begin = time.perf_counter()
    import numba  # noqa: F401

    imported = time.perf_counter() - begin
    print(imported, seconds(METHODS[name], 1, "always"))


def first_in_new_process(name: str, cache: str) -> tuple[float, float]:
    environment = os.environ | {"XDG_CACHE_HOME": cache, "NUMBA_DISABLE_INTEL_SVML": "1"}
    command = [sys.executable, __file__, "--first", name]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
    return float(found[0]), float(found[1])


def main(names: list[str]) -> None:
    if not available():
        sys.exit("numba is not installed: pip install 'rb_dynamics[fast]'")
    print(f"{'':10} {'us per step':^17} {'':7} {'s, once':^24}")
    print(f"{'method':10} {'plain':>8} {'compiled':>8} {'ratio':>7} {'import':>8} {'compile':>8} {'load':>6}")
    for method in METHODS.values():
        if method.compiles and (not names or method.name in names):
            with tempfile.TemporaryDirectory() as cache:
                imported, compiled = first_in_new_process(method.name, cache)
                again, loaded = first_in_new_process(method.name, cache)
            plain = min(seconds(method, 1000, "never") for _ in range(REPEATS)) / 1000
            seconds(method, 1, "always")
            fast = min(seconds(method, 100_000, "always") for _ in range(REPEATS)) / 100_000
            print(
                f"{method.name:10} {plain * 1e6:8.1f} {fast * 1e6:8.3f} {plain / fast:7.0f} "
                f"{min(imported, again):8.2f} {compiled:8.2f} {loaded:6.2f}"
            )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--first"]:
        first(sys.argv[2])
    else:
        main(sys.argv[1:])
