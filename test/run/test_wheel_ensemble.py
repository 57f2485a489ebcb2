"""Bodies with wheels in an ensemble: the bits of a simulation of each."""

from __future__ import annotations

import contextlib
import gc
import math
import random
import weakref
from dataclasses import replace
from typing import Any

import pytest

from rb_dynamics import RigidBody, Scene, State
from rb_dynamics.errors import ConvergenceError, WrenchError
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.magnetorquer import Magnetorquer
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import FixedFrame, WrenchFrames
from rb_dynamics.motion.arc import Stepper
from rb_dynamics.motion.kernel_layout import phase_numbers
from rb_dynamics.motion.phase_state import SUMS, PhaseState
from rb_dynamics.motion.wheel_arcs_kernel import ARRIVED, LANES
from rb_dynamics.numerics.compilation import available
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.simulation import Simulation, without_outputs
from rb_dynamics.run.wheel_ensemble import WheelEnsemble, actuators_of, shared_by_wheels
from rb_dynamics.scene.model import Solver

# The first test compiles the kernels.
pytestmark = [pytest.mark.skipif(not available(), reason="needs numba"), pytest.mark.timeout(600)]

SOLVERS = {
    "auto": Solver("auto", accuracy=1e-7),
    "auto with a step": Solver("auto", step=0.05, accuracy=None),
    "dop853": Solver("dop853", accuracy=1e-9),
    "dop853 with a step": Solver("dop853", step=0.03, accuracy=None),
    "dverk": Solver("dverk", accuracy=1e-7),
}
# The kernels of dverk differ from those of dop853 in the tableau, and take long to compile.
NAMES = [pytest.param(name, marks=[pytest.mark.slow] * (name == "dverk")) for name in SOLVERS]


def satellite(number: int, solver: Solver, commands: str) -> Scene:
    """Return a satellite in orbit; its wheels rub, and most of them soon come to rest or to their limits."""
    draw = random.Random(number)
    axes = [tuple(draw.gauss(0.0, 1.0) for _ in range(3)) for _ in range(3)]
    wheels = [
        ReactionWheel(
            name=f"w{k}",
            axis=axes[k],
            inertia=draw.uniform(1e-4, 3e-4),
            command=commands,
            coulomb=draw.choice([0.0, 2e-4]),
            viscous=draw.uniform(0.0, 1e-6),
            max_torque=3e-3,
            max_speed=draw.choice([30.0, math.inf]),
            speed=draw.choice([0.0, draw.uniform(-5.0, 5.0), 30.0]),
        )
        for k in range(3)
    ]
    orientation = math.sin(0.3), 0.0, 0.0, math.cos(0.3)
    rate = tuple(draw.gauss(0.0, 0.2) for _ in range(3))
    body = RigidBody.from_matrix(
        10.0, [[0.05, 0.003, 0.0], [0.003, 0.12, 0.001], [0.0, 0.001, 0.14]], (0.01, 0.0, 0.02)
    )
    return Scene(
        body=body,
        frames=WrenchFrames(),
        initial=State(0, (6.9e6, 0.0, 0.0), orientation, (0.0, 0.0, 7612.6), rate),
        channels=(),
        solver=solver,
        effects=(CentralGravity(gravitational_parameter=3.986e14, gravity_gradient=True),),
        actuators=tuple(wheels),
        duration=20.0,
    )


def alone(scene: Scene, at_ns: list[int], commands: list[list[float]]) -> list[tuple[float, ...]]:
    """Return the phases at these times, from each of which on the next commands act."""
    run, found = Simulation(without_outputs(scene)), list[tuple[float, ...]]()
    run.start()
    for time_ns, values in zip(at_ns, commands, strict=True):
        run.advance(time_ns)
        found.append(numbers(run.phase))
        for actuator, value in zip(actuators_of(scene), values, strict=True):
            if not math.isnan(value):
                # A rejected command counts, and has no effect.
                with contextlib.suppress(WrenchError):
                    run.actuate(actuator.name + COMMAND, value, time_ns)
    return found


def together_as_alone(scenes: list[Scene], times: list[int], given: list[list[list[float]]]) -> WheelEnsemble:
    """Return bodies that went side by side, after a check that each has the bits of itself alone."""
    import numpy as np

    bodies, rows = WheelEnsemble(scenes, 1), []
    for time_ns, values in zip(times, given, strict=True):
        bodies.advance_to(time_ns)
        rows.append(bodies.phases.tolist())
        bodies.command(np.array(values))
    assert not bodies.left_behind.any()
    for i, scene in enumerate(scenes):
        expected = alone(scene, times, [values[i] for values in given])
        # Without wheels, the states of a body alone are not kept.
        assert [row[i][: len(expected[0])] for row in rows] == [list(row) for row in expected], f"body {i}"
    return bodies


def numbers(phase: PhaseState) -> tuple[float, ...]:
    high, low = phase.high, phase.low
    body = phase_numbers(phase._replace(high=high[:SUMS], low=low[:SUMS]))
    return (*body, *high[SUMS:], *low[SUMS:])


@pytest.mark.parametrize("commands", ["torque", "speed"])
@pytest.mark.parametrize("name", NAMES)
def test_each_body_has_the_bits_of_itself_alone(monkeypatch: pytest.MonkeyPatch, name: str, commands: str) -> None:
    """With wheels at rest, at their limits and in between, commands that come to some at odd times, and no effects."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    scenes = [satellite(number, SOLVERS[name], commands) for number in range(6)]
    if name == "auto with a step":
        scenes = [replace(scene, effects=()) for scene in scenes]
    draw, size = random.Random(name + commands), 4e-3 if commands == "torque" else 40.0
    times = sorted({0, *(draw.randrange(20 * NANOSECONDS) for _ in range(24)), 20 * NANOSECONDS})
    given = [
        [[draw.uniform(-size, size) if draw.random() < 0.5 else math.nan for _ in range(3)] for _ in scenes]
        for _ in times
    ]
    assert together_as_alone(scenes, times, given).clipped.sum() > 0.0


@pytest.mark.parametrize(
    ("count", "solver"),
    [
        (2, "dop853"),
        (3, "auto"),
        pytest.param(3, "dverk", marks=pytest.mark.slow),
        pytest.param(4, "dop853", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("acting", [True, False])
def test_bodies_under_regular_commands_have_the_bits_of_themselves_alone(
    monkeypatch: pytest.MonkeyPatch, count: int, solver: str, acting: bool
) -> None:
    """Those that try the same stride do so side by side; wheels that come to rest or to their limits interrupt it."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    draw, scenes = random.Random(count), []
    for number in range(LANES + 3):
        scene = satellite(number, SOLVERS[solver], "torque")
        fourth = replace(scene.wheels[0], name="w3", axis=scene.wheels[1].axis)
        wheels = (*scene.wheels, fourth)[:count]
        scenes.append(replace(scene, actuators=wheels, effects=scene.effects if acting else (), duration=10.0))
    times = [250_000_000 * k for k in range(41)]
    given = [[[draw.uniform(-3e-3, 3e-3) for _ in range(count)] for _ in scenes] for _ in times]
    together_as_alone(scenes, times, given)


@pytest.mark.parametrize("solver", [Solver("dop853", accuracy=0.1), Solver("dop853", accuracy=1e-4)])
def test_commands_and_checks_go_side_by_side_while_wheels_turn(monkeypatch: pytest.MonkeyPatch, solver: Solver) -> None:
    """Errors are far below the accuracy, or near it; one wheel comes to rest, some get no command."""
    import numpy as np

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    draw, scenes = random.Random(7), []
    for number in range(LANES):
        scene = satellite(number, solver, "torque")
        speeds = [200.0, -150.0, 0.1 if number == 3 else 300.0]
        wheels = [
            replace(wheel, speed=speed, max_speed=400.0, coulomb=2e-5)
            for wheel, speed in zip(scene.wheels, speeds, strict=True)
        ]
        scenes.append(replace(scene, actuators=tuple(wheels), duration=10.0))
    times = [250_000_000 * k for k in range(41)]
    given = [
        [[math.nan if draw.random() < 0.2 else draw.gauss(0.0, 1e-3) for _ in range(3)] for _ in scenes] for _ in times
    ]
    given[20] = [[math.nan] * 3] * LANES
    arrived, go = [], WheelEnsemble._go_to
    monkeypatch.setattr(
        WheelEnsemble, "_go_to", lambda s, until: (go(s, until), arrived.append((s._whole[:, ARRIVED] != 0).sum()))
    )
    together_as_alone(scenes, times, given)
    assert 0.5 * LANES < np.mean(arrived[4:]) < LANES


@pytest.mark.parametrize("solver", [Solver("auto", accuracy=1e-6), Solver("dop853", step=0.25, accuracy=None)])
def test_wheels_that_come_back_within_a_step_have_the_bits_of_themselves_alone(
    monkeypatch: pytest.MonkeyPatch, solver: Solver
) -> None:
    """Each body has a wheel that reaches rest, its limit or breakaway, between two ends of a stride, and comes back."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    cases = [
        ((0.385, -0.98, 0.88), (0.0356, -0.506, 0.594), 0.2305, 0.0145, math.inf),
        ((1.5, 0.2, 0.8), (1.0, 2.0, 2.0), 0.9, 0.02, math.inf),
        ((-0.4, -0.4, 2.0), (1.0, 2.0, 2.0), 0.4, 0.0, 0.4663),
        ((-0.7, 0.1, -1.3), (1.0, 2.0, 2.0), 0.0, 0.02298, math.inf),
    ]
    body, scene, switched, scenes = (
        RigidBody.from_diagonal(1.0, (1.0, 1.7, 2.1)),
        satellite(1, solver, "torque"),
        [],
        [],
    )
    for rate, axis, speed, coulomb, limit in cases:
        wheel = replace(scene.wheels[0], axis=axis, inertia=0.05, coulomb=coulomb, viscous=0.0, speed=speed)
        wheel = replace(wheel, max_speed=limit, max_torque=math.inf)
        initial = State(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), rate)
        scenes.append(replace(scene, body=body, initial=initial, actuators=(wheel,), effects=(), duration=3.2))
    switch = Simulation._switch
    monkeypatch.setattr(Simulation, "_switch", lambda s, phase: (switched.append(s), switch(s, phase)))
    together_as_alone(scenes, [0, 1_100_000_000, 3_200_000_000], [[[math.nan]] * 4] * 3)
    assert [switched.count(run) for run in dict.fromkeys(switched)] == [2, 2, 2, 2]


def with_thrusters(scene: Scene, number: int) -> Scene:
    """Return the scene with pulsed and throttled thrusters, each with a delay and a force of its own."""
    draw, fixed, thrusters = random.Random(number), {}, list[Thruster]()
    for k in range(4):
        axes = [draw.gauss(0.0, 1.0) for _ in range(4)]
        size = math.sqrt(sum(each * each for each in axes))
        place = draw.uniform(-0.1, 0.1), draw.uniform(-0.1, 0.1), draw.uniform(-0.1, 0.1)
        fixed[f"place{k}"] = FixedFrame(place, tuple(each / size for each in axes))
        command = "level" if k == 3 else "on_time"
        delay, least = draw.choice([0.0, 0.013, 0.6]), 0.02 if k == 0 else 0.0
        entry = Thruster(
            name=f"t{k}",
            frame=f"place{k}",
            force=draw.uniform(0.1, 0.5),
            command=command,
            minimum_on=least,
            delay=delay,
        )
        thrusters.append(entry)
    frames = replace(scene.frames, fixed=fixed)
    return replace(scene, frames=frames, actuators=(thrusters[0], *scene.actuators, *thrusters[1:]))


@pytest.mark.parametrize(
    ("name", "wheels"),
    [
        ("auto", 3),
        ("dop853 with a step", 3),
        ("dop853", 0),
        pytest.param("dverk", 3, marks=pytest.mark.slow),
        pytest.param("dverk", 0, marks=pytest.mark.slow),
        ("auto with a step", 0),
        ("dop853 without effects", 0),
        ("dop853 with a step without effects", 0),
    ],
)
def test_bodies_with_thrusters_have_the_bits_of_themselves_alone(
    monkeypatch: pytest.MonkeyPatch, name: str, wheels: int
) -> None:
    """Pulses that end at any time, are cut off, prolonged or too short, meet the next command, or change nothing."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    scenes = []
    for number in range(LANES + 2):
        scene = satellite(number, SOLVERS[name.removesuffix(" without effects")], "torque")
        scene = replace(scene, effects=() if "without" in name else scene.effects)
        scenes.append(with_thrusters(replace(scene, actuators=scene.actuators[:wheels]), number))
    draw = random.Random(name)
    times = sorted({*(500_000_000 * k for k in range(21)), *(draw.randrange(10 * NANOSECONDS) for _ in range(5))})

    def command(k: int) -> float:
        if draw.random() < 0.3:
            return math.nan
        if k < wheels:
            return draw.uniform(-2e-3, 2e-3)
        if k == wheels + 3:
            return draw.choice([0.0, 0.0, 0.4, 0.4, 1.0, 1.5, -0.1])
        return draw.choice([0.0, 0.0, 0.01, 0.1, 0.5, 0.7, draw.uniform(0.0, 2.0)])

    given = [[[command(k) for k in range(wheels + 4)] for _ in scenes] for _ in times]
    bodies = together_as_alone(scenes, times, given)
    assert bodies.clipped.sum() > 0.0
    assert bodies.rejected.sum() > 0.0


def test_samples_end_with_their_last_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the bodies move on, the phases of samples that somebody still has are copied."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    bodies = WheelEnsemble([satellite(0, SOLVERS["auto"], "torque")], 1)
    samples = bodies.samples()
    assert samples.wheel_speeds.shape == (1, 3)
    known = weakref.ref(samples)
    gc.disable()
    try:
        del samples
        assert known() is None
    finally:
        gc.enable()


def test_under_regular_commands_a_period_takes_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stride tried first ends where the next command is expected."""
    taken: list[float] = []
    pair, step = Stepper.pair, Stepper.__call__
    monkeypatch.setattr(Stepper, "pair", lambda s, phase, h: (taken.append(h), pair(s, phase, h))[1])
    monkeypatch.setattr(Stepper, "__call__", lambda s, phase, h: (taken.append(h), step(s, phase, h))[1])
    scene = satellite(1, SOLVERS["dop853"], "torque")
    wheels = tuple(replace(wheel, coulomb=0.0, max_speed=math.inf) for wheel in scene.wheels)
    run = Simulation(without_outputs(replace(scene, actuators=wheels)))
    run.start()
    for k in range(1, 9):
        run.advance(k * 250_000_000)
        run.actuate("w0" + COMMAND, 1e-4 * k, k * 250_000_000)
    taken.clear()
    for k in range(9, 20):
        run.advance(k * 250_000_000)
        run.actuate("w0" + COMMAND, 1e-4 * k, k * 250_000_000)
    assert taken == [0.25] * 11


def test_bodies_that_are_at_a_time_do_not_go_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each would choose a stride, which the command that then comes makes useless: it cost half of a campaign."""
    import numpy as np

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    bodies, gone = WheelEnsemble([satellite(number, SOLVERS["auto"], "torque") for number in range(2)]), list[object]()
    bodies.advance_to(NANOSECONDS)
    monkeypatch.setattr(bodies, "_go_to", gone.append)
    bodies.advance_some(np.full(2, NANOSECONDS), np.array([True, False]))
    assert not gone
    bodies.advance_some(np.full(2, 2 * NANOSECONDS), np.array([True, False]))
    assert len(gone) == 1


def test_auto_is_its_only_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """It took up to twelve pairs for a choice of one, after 1, 2, 4, 8 ... arcs."""
    taken: list[int] = []
    pair = Stepper.pair
    monkeypatch.setattr(Stepper, "pair", lambda s, phase, h: (taken.append(1), pair(s, phase, h))[1])
    times, counts = [250_000_000 * k for k in range(1, 33)], []
    for name in ("auto", "dop853"):
        scene, before = replace(satellite(1, SOLVERS["auto"], "torque"), duration=9.0), len(taken)
        scene = replace(scene, solver=Solver(name, accuracy=1e-7))
        counts.append((alone(scene, times, [[1e-4, -1e-4, 0.0]] * len(times)), len(taken) - before))
    assert counts[0] == counts[1]


def test_a_switch_is_found_in_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bisection took thirty; each wheel that stops is one nanosecond past rest."""
    taken: list[float] = []
    step = Stepper.__call__
    monkeypatch.setattr(Stepper, "__call__", lambda s, phase, h: (taken.append(h), step(s, phase, h))[1])
    scene = satellite(1, SOLVERS["auto"], "torque")
    wheels = [replace(wheel, speed=2.0 + k, coulomb=3e-4) for k, wheel in enumerate(scene.wheels)]
    run, stopped = Simulation(without_outputs(replace(scene, actuators=tuple(wheels)))), 0
    switch = Simulation._switch

    def switched(run: Simulation, phase: PhaseState) -> None:
        nonlocal stopped
        stopped += 1
        switch(run, phase)

    monkeypatch.setattr(Simulation, "_switch", switched)
    run.start()
    run.advance(20 * NANOSECONDS)
    assert stopped > 2
    assert len(taken) < 13 * stopped


@pytest.mark.slow
def test_arcs_of_many_strides_have_the_bits_of_themselves_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    scenes = [replace(satellite(number, SOLVERS["auto"], "torque"), effects=(), duration=40.0) for number in range(3)]
    fast = [replace(scene.initial, angular_velocity_body=(15.0, -10.0, 5.0 + i)) for i, scene in enumerate(scenes)]
    scenes = [replace(scene, initial=initial) for scene, initial in zip(scenes, fast, strict=True)]
    times = [4 * NANOSECONDS * k for k in range(11)]
    together_as_alone(scenes, times, [[[1e-4 * (i + k)] * 3 for i in range(3)] for k in range(11)])


def test_the_books_are_those_of_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    scenes = [satellite(number, SOLVERS["auto"], "torque") for number in range(3)]
    bodies = WheelEnsemble(scenes)
    bodies.advance_to(3 * NANOSECONDS)
    found = bodies.samples()
    for i, scene in enumerate(scenes):
        run = Simulation(without_outputs(scene))
        run.start()
        run.advance(3 * NANOSECONDS)
        sample: Any = run.look()
        for field in ("position_world", "orientation_xyzw", "angular_velocity_body", "wheel_speeds", "work"):
            assert getattr(found, field)[i].tolist() == pytest.approx(getattr(sample, field), abs=0.0, rel=0.0), field
        for field in ("angular_momentum_world", "kinetic_energy", "energy_defect", "linear_velocity_world"):
            assert getattr(found, field)[i].tolist() == pytest.approx(getattr(sample, field), abs=0.0, rel=0.0), field


def test_a_body_that_cannot_go_on_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others go on: it falls into the centre of gravity."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    scenes = [satellite(number, SOLVERS["auto"], "torque") for number in (1, 2)]
    falling = replace(scenes[0].initial, position_world=(1.0, 0.0, 0.0), linear_velocity_world=(0.0, 0.0, 0.0))
    bodies = WheelEnsemble([scenes[1], replace(scenes[0], initial=falling)])
    bodies.advance_to(NANOSECONDS)
    assert bodies.left_behind.tolist() == [False, True]


def test_only_what_kernels_know_is_in_an_ensemble() -> None:
    scene = satellite(1, SOLVERS["auto"], "torque")
    assert shared_by_wheels(scene) == shared_by_wheels(satellite(2, SOLVERS["auto"], "torque"))
    assert shared_by_wheels(replace(scene, actuators=())) is None
    jets, bare = with_thrusters(scene, 1), with_thrusters(replace(scene, actuators=()), 1)
    assert None is not shared_by_wheels(jets) != shared_by_wheels(scene)
    slow = replace(jets.actuators[0], rise=0.01)
    assert shared_by_wheels(replace(jets, actuators=(slow, *jets.actuators[1:]))) is None
    # Without wheels, `auto` has several methods, and under held wrenches the closed form.
    assert shared_by_wheels(bare) is None
    assert shared_by_wheels(replace(bare, solver=Solver("auto", step=0.1, accuracy=None), effects=())) is None
    assert None is not shared_by_wheels(replace(bare, solver=Solver("dop853", accuracy=1e-6), effects=()))
    assert shared_by_wheels(replace(scene, solver=Solver("radau", accuracy=1e-6))) is None
    assert shared_by_wheels(replace(scene, solver=Solver("dop853", step=1.0 / 3.0, accuracy=None))) is None
    field = replace(scene, effects=(MagneticField("uniform", (1e-5, 0.0, 0.0)),))
    rods = replace(field, actuators=(*scene.wheels, Magnetorquer(name="rod", axis=(1.0, 0.0, 0.0), max_dipole=1.0)))
    assert None is not shared_by_wheels(rods) != shared_by_wheels(field)
    assert shared_by_wheels(replace(rods, effects=field.effects * 2)) is None
    shaking = replace(scene.wheels[0], dynamic_imbalance=1e-8)
    assert shared_by_wheels(replace(scene, actuators=(shaking, *scene.wheels[1:]))) is None


def test_bodies_of_which_some_share_their_actuators(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    draw = random.Random(3)
    one, two = (satellite(number, SOLVERS["dop853"], "torque") for number in (1, 2))
    heavy = RigidBody.from_matrix(12.0, [[0.06, 0.0, 0.002], [0.0, 0.11, 0.0], [0.002, 0.0, 0.15]], (0.0, 0.01, 0.0))
    spinning = replace(one.initial, position_world=(0.0, 7.0e6, 1.0), angular_velocity_body=(0.1, -0.2, 0.05))
    scenes = [one, two, replace(one, body=heavy), replace(two, initial=spinning), replace(one, initial=spinning)]
    assert scenes[2].actuators is one.actuators
    times = [k * NANOSECONDS // 2 for k in range(1, 9)]
    given = [[[draw.uniform(-2e-3, 2e-3) for _ in range(3)] for _ in scenes] for _ in times]
    together_as_alone(scenes, times, given)


def test_a_step_that_does_not_suit_one_of_the_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    wheel = ReactionWheel(name="wheel", axis=(1.0, 0.0, 0.0), inertia=1e-3, viscous=1e-2)
    one = replace(satellite(1, SOLVERS["dop853 with a step"], "torque"), actuators=(wheel,))
    light = replace(one, body=RigidBody.from_diagonal(10.0, (1.005e-3, 1e-3, 1e-3)))
    WheelEnsemble([one, one], 1)
    with pytest.raises(ConvergenceError, match=r"solver.step: found 0.03 s"):
        WheelEnsemble([one, light], 1)


def test_the_books_can_be_read_beside_a_body_whose_phase_is_no_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that are too long for the fall into a centre: gravity has no potential at such a place."""
    import numpy as np

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    effects = (CentralGravity(1000.0, gravity_gradient=True),)
    scene = replace(satellite(1, Solver("dop853", step=0.1, accuracy=None), "torque"), effects=effects)
    states = [
        replace(scene.initial, position_world=(x, 0.1, 0.0), linear_velocity_world=(-8.0, 0.0, 0.0))
        for x in (1e3, *np.linspace(9.5, 10.5, 31).tolist())
    ]
    bodies = WheelEnsemble([replace(scene, initial=state) for state in states])
    bodies.advance_to(NANOSECONDS)
    assert np.isnan(bodies.phases[bodies.left_behind]).any()
    assert not bodies.left_behind[0]
    assert math.isfinite(bodies.samples().kinetic_energy[0])
