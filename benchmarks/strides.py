"""Measure the cost of an accepted stride with its step control for every stepping method; `auto` uses these costs.

Processor time, in plain Python unless RB_DYNAMICS_COMPILE says otherwise; compiled, the ratios agree within a third.

Usage: python benchmarks/strides.py

For each kind of load and each accuracy, prints the methods in order of the time for two seconds of motion, with the
number of strides and the time per stride; finally the cost of a stride in units of one of dverk, as listed in
`rb_dynamics/motion/auto_method.py`.
"""

from __future__ import annotations

import os
import statistics
import time

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.auto_method import COST_OF_A_STEP
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.plan import Plan
from rb_dynamics.scene.read import parse_scene

SCENE = """
body:
  mass: 2.5
  center_of_mass: [0.1, -0.2, 0.3]
  inertia: {matrix: [[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]]}
initial:
  position_world: [5, 0, 0]
  linear_velocity_world: [0, 1, 0]
  angular_velocity_body: [0.4, -0.2, 0.7]
duration: 20
"""
EFFECTS = {
    LoadDependence.HELD: "",
    LoadDependence.FIELD: "effects: [{type: central_gravity, gravitational_parameter: 2, gravity_gradient: true}]",
    LoadDependence.ANY: "effects: [{type: linear_drag, translation: 0.2, rotation: 0.03}, "
    "{type: rotor, axis_body: [0, 1, 1], axial_inertia: 0.1, spin_rate: 10}]",
}
HELD = HeldWrench((0.9, -0.4, 0.6), (0.3, -0.2, 0.25))
ACCURACIES = (1e-4, 1e-6, 1e-9, 1e-11)
SECONDS = 2
# The lower the order, the more strides the measurement needs.
FINEST = {1: 1e-3, 2: 1e-5}


def measure(name: str, takes: LoadDependence, accuracy: float, turn: int) -> tuple[float, int]:
    """Return the time (s) for two seconds of motion and the number of strides; each turn has its own initial state."""
    solver = {"solver.method": name, "solver.accuracy": accuracy, "initial.angular_velocity_body[0]": 0.4 + 1e-3 * turn}
    scene = parse_scene(SCENE + EFFECTS[takes], overrides=solver)
    load_from = scene.combined_effects.load_from(0.0)
    load = None if load_from is None else (lambda phase: load_from(phase.point(scene.body)))
    arc = Plan(scene).arc(in_principal_axes(scene.body, HELD), 0, PhaseState.of(scene.body, scene.initial), load)
    begin = time.process_time()
    arc.advance(SECONDS * NANOSECONDS)
    return time.process_time() - begin, arc.steps_to(SECONDS * NANOSECONDS)


def main() -> None:
    os.environ.setdefault("RB_DYNAMICS_COMPILE", "never")
    prices: dict[str, list[float]] = {name: [] for name in COST_OF_A_STEP}
    for takes in EFFECTS:
        for accuracy in ACCURACIES:
            rows: list[tuple[float, int, str]] = []
            for name, method in METHODS.items():
                if method.order is None or method.takes < takes or accuracy < FINEST.get(method.order, 0.0):
                    continue
                try:
                    rows.append((*min(measure(name, takes, accuracy, turn) for turn in range(3)), name))
                except ConvergenceError:
                    continue
            print(f"\n{takes.name}, accuracy {accuracy:g}")
            for seconds, strides, name in sorted(rows):
                print(f"  {name:10} {seconds * 1e3:9.2f} ms  {strides:6d} strides of {seconds / strides * 1e6:7.0f} us")
            unit = next(seconds / strides for seconds, strides, name in rows if name == "dverk")
            for seconds, strides, name in rows:
                if name in prices:
                    prices[name].append(seconds / strides / unit)
    print("\nprice of a stride, in units of one of dverk (median), and as auto has it")
    for name, found in prices.items():
        print(f"  {name:10} {statistics.median(found):6.2f} {COST_OF_A_STEP[name]:6.2f}")


if __name__ == "__main__":
    main()
