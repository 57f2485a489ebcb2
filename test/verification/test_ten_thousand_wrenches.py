"""Ten thousand held wrenches in each of two frames over 100 s, against states to 30 digits.

A body-frame and a world-frame wrench, each with force and torque, change every 0.01 s; the body is triaxial with
off-diagonal inertia and its centre of mass off its origin. `make_reference.py` makes commands and states.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from types import ModuleType

import pytest
from motions import DATA, STEPPED, Recorder, attitude_error, scene, vector_error
from scripts import load_script

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import Run, simulate
from rb_dynamics.scene.model import Scene, Solver

PERIOD_NS = 10_000_000
COUNT = 10_000

DOCUMENT = json.loads((DATA / "ten_thousand_wrenches.json").read_text(encoding="utf-8"))
STATES = {state["time"]: state for state in DOCUMENT["states"]}


@cache
def generator() -> ModuleType:
    return load_script(DATA.parent / "make_reference.py")


def commands(count: int = COUNT) -> Iterator[tuple[str, Wrench]]:
    """The same doubles as the generator's: one wrench in each frame every 0.01 s."""
    for k in range(count):
        held = generator().commanded(k)
        yield "thrusters", Wrench(held["force_body"], held["torque_body"], "body", k * PERIOD_NS)
        yield "environment", Wrench(held["force_world"], held["torque_world"], "world", k * PERIOD_NS)


def flight(solver: Solver, duration: float) -> Scene:
    case = DOCUMENT["case"]
    body = RigidBody.from_matrix(case["mass"], case["inertia"], case["center_of_mass"])
    initial = State(0, *(tuple(case[name]) for name in State.__slots__[1:]))
    return scene(body, initial, solver, duration, 1.0, (Channel("thrusters"), Channel("environment")))


@cache
def flown(solver: Solver, duration: int) -> tuple[Run, dict[int, Sample]]:
    """Return the run and its samples at whole seconds."""
    recorder = Recorder()
    run = simulate(flight(solver, float(duration)), commands(100 * duration), [recorder])
    return run, {sample.time_ns // 1_000_000_000: sample for sample in recorder.samples}


def deviations(sample: Sample, time: int) -> dict[str, float]:
    """Return how far a sample is from the 30 digits."""
    reference = STATES[time]
    found = {
        "attitude": attitude_error(sample.orientation_xyzw, reference["orientation_xyzw"]),
        "work": vector_error((sample.work,), (reference["work"],)),
    }
    for name in ("angular_velocity_body", "position_world", "linear_velocity_world"):
        found[name] = vector_error(getattr(sample, name), reference[name])
    return found


# rad, rad/s, m, m/s, J; the body has come 34 m and turned by some 100 rad when it ends.
BOUNDS = {
    "attitude": 1e-11,
    "angular_velocity_body": 1e-11,
    "position_world": 2e-12,
    "linear_velocity_world": 5e-12,
    "work": 1e-12,
}


@pytest.mark.parametrize("time", STATES)
def test_auto_is_where_the_reference_is(time: int) -> None:
    run, samples = flown(Solver("auto", accuracy=1e-11), 100)

    assert run.rejected == ()
    for name, error in deviations(samples[time], time).items():
        assert error <= BOUNDS[name], name


@pytest.mark.parametrize("method", STEPPED)
def test_every_method_is_there_after_a_hundred(method: str) -> None:
    """With one step between commands the error is that of the order, or rounding."""
    run, samples = flown(Solver(method, step=0.01), 1)

    assert run.steps == 100
    order = STEPPED[method].order
    for name, error in deviations(samples[1], 1).items():
        assert error <= max(1e-13, 0.01**order), name


def test_the_balances_close_after_all_of_them() -> None:
    """Uses only the books of the run, not the reference."""
    _, samples = flown(Solver("auto", accuracy=1e-11), 100)

    last = samples[100]
    assert abs(last.energy_defect) <= 1e-11
    assert max(map(abs, last.angular_momentum_defect_world)) <= 1e-11
    assert max(map(abs, last.linear_momentum_defect_world)) <= 1e-12


def test_the_case_is_that_of_the_generator() -> None:
    assert DOCUMENT["case"] == generator().COMMANDED
    assert [k // 100 for k in generator().MARKS] == list(STATES)


def test_no_command_hangs_on_the_last_bit_of_a_sine() -> None:
    assert generator().distance_from_a_tie() > 1e-9
