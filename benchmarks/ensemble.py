"""Measure the time per step and body in an ensemble, by number of bodies, method and threads.

Usage: python benchmarks/ensemble.py [name ...]

Forced bodies, compiled; best of several repeats. `alone` is the same method for one body through `driven_motion`, with
wrenches held for so many steps that the call itself does not count; `edge` is the extra cost of a new held wrench;
`short` is the time per body of the largest ensemble if it is advanced one step at a time. Times are for this machine:
processor time with one thread, wall-clock time with several, which needs as many idle cores. Without names: the methods
that support ensembles, and one that does not.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

import numpy as np

from rb_dynamics import METHODS, Ensemble, RigidBody, State, driven_motion
from rb_dynamics.numerics import compilation

BODY = RigidBody.from_matrix(2.5, [[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]], (0.1, -0.2, 0.3))
STEP, STEP_NS = 0.001, 1_000_000
BODIES = (1, 16, 64, 1024, 4096, 65536)
BODY_STEPS = 200_000
FEWEST_STEPS = 10
NAMES = ("rk4", "midpoint", "dlm2", "dlm4", "dop853")
EDGES = 10_000
REPEATS = 3


def best(do: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Return the shortest time (s) that `do` takes."""
    do()
    times = []
    for _ in range(REPEATS):
        begin = clock()
        do()
        times.append(clock() - begin)
    return min(times)


def many(name: str, bodies: int, threads: int, steps: int) -> float:
    """Return ns per step and body for advances of `steps` steps."""
    r = np.random.default_rng(1)
    states = [State(angular_velocity_body=tuple(spin)) for spin in r.normal(size=(bodies, 3)).tolist()]
    ensemble = Ensemble(BODY, states, name, STEP, threads)
    ensemble.hold(torque_body=r.normal(size=(bodies, 3)), force_body=r.normal(size=(bodies, 3)))
    clock = time.process_time if threads == 1 else time.perf_counter
    return best(lambda: ensemble.advance_to(ensemble.time_ns + steps * STEP_NS), clock) / (steps * bodies) * 1e9


def alone(name: str) -> tuple[float, float]:
    """Return ns per step, and additional ns per held wrench."""
    state = State(angular_velocity_body=(0.7, -1.1, 0.9))
    torques = 0.1 * np.random.default_rng(1).normal(size=(EDGES, 3))

    def seconds(times: np.ndarray) -> float:
        return best(
            lambda: driven_motion(BODY, state, times, method=name, step=STEP, torque_body=torques[: len(times)])
        )

    step = seconds(np.array([EDGES * STEP_NS])) / EDGES
    return step * 1e9, (seconds(STEP_NS * np.arange(1, EDGES + 1)) / EDGES - step) * 1e9


def main(names: list[str]) -> None:
    """Print a table for each number of threads."""
    if not compilation.available():
        sys.exit("numba is not installed: pip install 'rb_dynamics[fast]'")
    os.environ["RB_DYNAMICS_COMPILE"] = "always"
    chosen = [name for name, method in METHODS.items() if method.compiles and name in (names or NAMES)]
    print("ns per step and body")
    print(
        f"{'method':10} {'threads':>7} {'alone':>7} {'edge':>7}"
        + "".join(f"{bodies:>8}" for bodies in (*BODIES, "short"))
    )
    for name in chosen:
        step, edge = alone(name)
        for threads in (1, 2):
            sizes = [(bodies, max(FEWEST_STEPS, BODY_STEPS // bodies)) for bodies in BODIES] + [(BODIES[-1], 1)]
            times = "".join(f"{many(name, bodies, threads, steps):8.1f}" for bodies, steps in sizes)
            print(f"{name:10} {threads:7} {step:7.0f} {edge:7.0f}{times}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
