"""Measure what an output between two steps costs: a step of its own, except by Taylor's method, beside all the rest.

    python benchmarks/outputs.py    # some minutes; needs numba, after `rb-dynamics compile`

For a driven orbit and ten thousand held wrenches (problems of `compare.py`), each at some rates of outputs: processor
time of `simulate` for each output, without sinks, in memory and with an MCAP, and of it the time in compiled steps,
which is the most that a continuous extension could save. Best of three.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from peers.ours import _commands
from peers.problem import Problem, problem
from peers.translate import body_of, effects_of, states_of

import rb_dynamics as rb
from rb_dynamics.run import plan
from rb_dynamics.sinks.mcap_sink import McapSink

CASES = (("orbit", 3e-7, (0.01, 1.0, 20.0)), ("orbit-gradient", 1e-7, (0.01, 1.0, 20.0)), ("driven", 1e-9, (1.0, 1e3)))
TURNS = 3


def measured(task: Problem, accuracy: float, rate: float, sinks: Callable[[], Any]) -> tuple[float, float]:
    """Return the processor time (s) of a run, and of it that in the kernel that takes the steps."""
    channels = rb.Channel("thrusters"), rb.Channel("environment")
    solver, (state,), effects = rb.Solver("auto", accuracy=accuracy), states_of(task), effects_of(task)
    scene = rb.Scene(
        body_of(task), rb.WrenchFrames(), state, channels, solver, task.duration, effects=effects, output_rate=rate
    )
    found, inside, propagate = [], [0.0], plan.propagate

    def timed(*of: Any) -> Any:
        begin = time.process_time()
        result = propagate(*of)
        inside[0] += time.process_time() - begin
        return result

    plan.propagate = timed
    for _ in range(TURNS + 1):
        inside[0], begin = 0.0, time.process_time()
        rb.simulate(scene, _commands(task), sinks())
        found.append((time.process_time() - begin, inside[0]))
    plan.propagate = propagate
    return min(found[1:])


def main() -> None:
    os.environ.setdefault("RB_DYNAMICS_COMPILE", "always")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        sinks = {"nothing": list, "memory": lambda: [rb.MemorySink()], "MCAP": lambda: [McapSink(log)]}
        for name, accuracy, rates in CASES:
            for rate in rates:
                for kind, of_kind in sinks.items():
                    task = problem(name)
                    whole, steps = (
                        1e6 * each / (rate * task.duration) for each in measured(task, accuracy, rate, of_kind)
                    )
                    print(f"{name:15} {rate:6g} Hz {kind:7} {whole:8.2f} us an output, of it {steps:6.2f} us in steps")


if __name__ == "__main__":
    main()
