"""What sensors should have measured, against the engine; and its derivatives, against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identified_flights import flown, guess, random_body

from rb_dynamics import SceneError, parse_scene
from rb_dynamics.analysis.identification import measurement_model
from rb_dynamics.analysis.identification.estimation import sane, stacked
from rb_dynamics.analysis.identification.flights import (
    ACCELERATION,
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    Flight,
    Stream,
    WrenchSeries,
)
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.rotations import matrices, quaternions
from rb_dynamics.analysis.track import Array
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.motion import variational_equations
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.numerics.compilation import available
from rb_dynamics.run.kernels_to_compile import usual_kernels
from rb_dynamics.scene.model import Scene
from test.support.plugin_effects import Roped

SCENE = """
body:
  mass: 3.0
  center_of_mass: [0.1, -0.05, 0.02]
  inertia: {matrix: [[1.0, 0.1, -0.05], [0.1, 1.5, 0.07], [-0.05, 0.07, 1.2]]}
  frames: {nozzle: {position: [0.3, 0.1, -0.2], orientation: {x: 0.5, y: 0.5, z: -0.5, w: 0.5}}}
effects:
  - {type: uniform_gravity, acceleration_world: [0, 0.3, -9.8]}
  - {type: linear_drag, rotation: [0.1, 0.2, 0.3], translation: [0.3, 0.2, 0.1], medium_velocity_world: [1, 0, 0]}
  - {type: quadratic_drag, rotation: [0.01, 0.02, 0.03], translation: [0.03, 0.02, 0.01]}
  - {type: rotor, axis_body: [0, 1, 2], axial_inertia: 0.01, spin_rate: 50}
  - {type: scheduled_wrench, frame_id: world, schedule:
      [{time: 0.013, force: [1, 2, 3]}, {time: 0.237, torque: [1, 0, 2]}]}
  - {type: scheduled_wrench, frame_id: nozzle, schedule: [{time: 0.163, force: [1, 2, 0], torque: [0.1, 0, 0]}]}
"""
FIT = (
    "mass", "center_of_mass", "inertia", "gyro_bias", "gyro_scale", "gyro_alignment", "accelerometer", "delay",
    "wrench_scale", "effects[0].acceleration_world", "effects[1].rotation", "effects[1].translation",
    "effects[1].medium_velocity_world", "effects[2].rotation", "effects[2].translation", "effects[3].axial_inertia",
    "effects[3].axis_body", "effects[3].spin_rate", "effects[4].schedule[0].force", "effects[4].schedule[1].torque",
    "effects[5].schedule[0].force", "effects[5].schedule[0].torque",
)  # fmt: skip


def every_sensor() -> Flight:
    random = np.random.default_rng(0)
    count = 6
    times = (np.arange(count) * 1e8).astype(np.int64)
    attitude = random.standard_normal((count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    mount, place = matrices(quaternions(np.array([0.3, 0.2, -0.5]))), np.array([0.1, 0.2, 0.3])
    rows = iter(random.standard_normal((9, count, 3)))
    streams = (
        Stream("pose", ATTITUDE, times, attitude),
        Stream("pose", POSITION, times, next(rows)),
        Stream("twist", VELOCITY, times, next(rows)),
        Stream("twist", RATES, times, next(rows)),
        Stream("other", VELOCITY, times, next(rows), world=True),
        Stream("other", RATES, times, next(rows), world=True),
        Stream("imu", RATES, times, next(rows), mount=mount, gyro=True),
        Stream("imu", ACCELERATION, times, next(rows), mount=mount, place=place),
    )
    channels = (
        WrenchSeries("a", np.array([-200, 125, 415], np.int64) * 10**6, random.standard_normal((3, 15))),
        WrenchSeries("b", np.array([133, 377], np.int64) * 10**6, random.standard_normal((2, 15))),
    )
    return Flight("every", streams, channels)


@pytest.mark.parametrize(("late", "lag"), [(0.01, 0.01), pytest.param(0.15, 0.1, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_differences(late: float, lag: float) -> None:
    model = Model(parse_scene(SCENE), [every_sensor()], FIT)
    model.turn = 0.03
    z = 0.1 * np.random.default_rng(1).standard_normal(model.layout.count)
    for name, block in model.layout.blocks.items():
        if name.startswith("delay"):
            # In units of 0.1 s; the later command comes between the earliest measurement and the start.
            z[block.at] = 10.0 * (late if name == "delay.commands" else lag)
    with counted_by(Tally()):
        here = {each.key: each.by for each in model.predict(z)}
        slopes = {k: _difference(model, z, k) for k in range(model.layout.count)}

    for name, block in model.layout.blocks.items():
        for k in range(block.at.start, block.at.stop):
            for key, by in here.items():
                if name == "delay.imu" and key[1] == ACCELERATION:
                    continue  # its jerk is taken between samples
                scale = max(float(np.abs(by[:, :, k]).max()), 1e-3)
                np.testing.assert_allclose(
                    by[:, :, k], slopes[k][key], rtol=0.0, atol=2e-5 * scale, err_msg=f"{name} {key}"
                )


def test_the_jerk_of_an_accelerometer_knows_no_steps_of_wrenches() -> None:
    """A delay that moves its samples moves none of them across a command."""
    random = np.random.default_rng(0)
    times, commands = np.arange(101) * 5_000_000, np.arange(5) * 100_000_000 + 1_234_567
    streams = (Stream("imu", kind, times, np.zeros((101, 3)), gyro=kind == RATES) for kind in (RATES, ACCELERATION))
    pose = Stream("pose", ATTITUDE, times, np.tile([0.0, 0.0, 0.0, 1.0], (101, 1)))
    flight = Flight("steps", (pose, *streams), (WrenchSeries("a", commands, random.standard_normal((5, 15))),))
    scene = parse_scene(SCENE.split("effects:", maxsplit=1)[0] + "initial: {angular_velocity_body: [1, 2, 1]}")
    model = Model(scene, [flight], ("delay", "accelerometer"))
    z, k = np.zeros(model.layout.count), model.layout["delay.imu"].at.start
    z[model.layout["initial[0].angular_velocity_body"].at] = [1.0, 2.0, 1.0]
    force = next(each for each in model.predict(z) if each.key[1] == ACCELERATION)
    slope = _difference(model, z, k)[force.key]
    np.testing.assert_allclose(force.by[:, :, k], slope, rtol=0.0, atol=0.05 * float(np.abs(slope).max()))


def _difference(model: Model, z: Array, k: int) -> dict[tuple[str, str], Array]:
    step = np.zeros_like(z)
    step[k] = 1e-4 if any(n.startswith("delay") and b.at.start == k for n, b in model.layout.blocks.items()) else 1e-5
    above, below = ({each.key: each.left for each in model.predict(z + sign * step)} for sign in (1, -1))
    return {key: (above[key] - below[key]) / (2.0 * step[k]) for key in above}


def test_the_momentum_of_a_rotor_stands_for_its_three_numbers() -> None:
    scene, key = parse_scene(SCENE), "effects[3].momentum_body"
    model, bare = (Model(scene, [every_sensor()], fit) for fit in ((key,), ()))
    z = np.zeros(model.layout.count)
    here = {each.key: each for each in model.predict(z)}

    assert model.effects(z)[key] == pytest.approx([0.0, 0.5 / 5**0.5, 1.0 / 5**0.5])
    for each in bare.predict(np.zeros(bare.layout.count)):
        np.testing.assert_allclose(here[each.key].left, each.left, rtol=0.0, atol=1e-12)
    at = model.layout[key].at
    for k in range(at.start, at.stop):
        for name, slope in _difference(model, z, k).items():
            np.testing.assert_allclose(
                here[name].by[:, :, k], slope, rtol=0.0, atol=2e-5 * max(1e-3, np.abs(slope).max())
            )
    with pytest.raises(SceneError, match=r"found effects\[3\].momentum_body and effects\[3\].spin_rate"):
        Model(scene, [every_sensor()], (key, "effects[3].spin_rate"))


def test_nothing_jumps_where_a_late_sensor_measured_as_a_command_came() -> None:
    model = Model(parse_scene(SCENE), [every_sensor()], ("delay",))
    z = np.zeros(model.layout.count)
    z[model.layout["delay.commands"].at] = 1.5
    predicted: list[dict[tuple[str, str], Array]] = []
    for lag in (0.05 - 2e-9, 0.05, 0.05 + 2e-9):
        z[model.layout["delay.twist"].at] = 10.0 * lag
        predicted.append({each.key: each.left for each in model.predict(z)})

    for key, left in predicted[1].items():
        for other in (predicted[0], predicted[2]):
            np.testing.assert_allclose(other[key], left, rtol=0.0, atol=1e-6, err_msg=str(key))


def test_prediction_is_the_flight_of_the_engine() -> None:
    random = np.random.default_rng(2)
    body = random_body(random)
    flight = flown(body, random, torque=1.0, force=1.0, gyro=0.0, pose=0.0)
    scene = guess(body)
    scene = type(scene)(body, scene.frames, scene.initial, text=scene.text)
    model = Model(scene, [flight], ("mass",))
    model.turn = 0.005

    z = np.zeros(model.layout.count)
    truth = {"angular_velocity_body": flight.streams[0].values[0], "position_world": 0.0, "linear_velocity_world": 0.0}
    for name, value in truth.items():
        block = model.layout[f"initial[0].{name}"]
        z[block.at] = (value - block.start) / block.scale

    assert max(float(np.abs(each.left).max()) for each in model.predict(z)) < 1e-6


def test_plain_and_compiled_kernel_have_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model(parse_scene(SCENE), [every_sensor()], FIT)
    model.turn = 0.3
    z = np.zeros(model.layout.count)
    predicted = []
    # Column by column, as it is compiled, and row by row.
    for when in ("auto", "never"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        predicted.append(list(model.predict(z)))
    one_by_one = variational_equations.propagate_sensitivities
    monkeypatch.setattr(measurement_model, "kernel", lambda *_: one_by_one)
    predicted.append(list(model.predict(z)))

    for each in zip(*predicted, strict=True):
        assert len({(one.left.tobytes(), one.by.tobytes()) for one in each}) == 1


def test_pieces_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """With commands and sensors that are late, so that commands begin pieces and the first goes back in time."""
    every = every_sensor()
    flight = every.without((ACCELERATION,))
    model = Model(parse_scene(SCENE), [flight, flight], [name for name in FIT if name != "accelerometer"])
    z = 0.1 * np.random.default_rng(1).standard_normal(model.layout.count)
    whole = list(model.predict(z))
    assert len(list(model.blocks(z))) == 2
    alone = list(model.predict(z, derivatives=False))
    for size in (1, 3):
        monkeypatch.setattr(measurement_model, "_BLOCK", size)
        assert len(list(model.blocks(z))) > 6
        for one, other, bare in zip(whole, model.predict(z), alone, strict=True):
            assert one.key == other.key == bare.key
            np.testing.assert_allclose(other.left, one.left, rtol=1e-12, atol=1e-14)
            np.testing.assert_allclose(other.by, one.by, rtol=1e-11, atol=1e-13)
            assert one.left.tobytes() == bare.left.tobytes()
            assert np.array_equal(one.time_ns, other.time_ns)
            assert np.array_equal(one.measured, other.measured)
            assert bare.by.shape == (*bare.left.shape, 0)


def test_the_kernel_is_made_ahead_and_used_once_it_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    assert variational_equations.kernel(10**6, 1) is variational_equations.plain
    monkeypatch.delenv("RB_DYNAMICS_COMPILE")
    with counted_by(Tally()):
        # What was decided while it was forbidden holds no longer.
        found = variational_equations.kernel(10**6, 1)
    assert (found is not variational_equations.plain) == available()
    assert variational_equations.VARIATIONAL.name in usual_kernels()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("far", [1e200, np.inf])
def test_a_motion_that_runs_away_has_no_numbers_and_no_warnings(monkeypatch: pytest.MonkeyPatch, far: float) -> None:
    def run_away(*given: Array) -> None:
        for part in given[14:]:
            part[:] = far

    monkeypatch.setattr(measurement_model, "kernel", lambda *_: run_away)
    model = Model(parse_scene(SCENE), [every_sensor()], FIT)
    predicted = list(model.predict(np.zeros(model.layout.count)))

    assert not sane(*stacked(predicted, {each.key: 1e-9 for each in predicted}))


def test_a_body_without_a_moment_about_an_axis_has_no_motion() -> None:
    model = Model(parse_scene("body: {mass: 1.0, inertia: {diagonal: [1.0, 1.0, 1.0]}}"), [every_sensor()], ["inertia"])
    z = np.zeros(model.layout.count)
    z[model.layout["shape"].at.start] = 40.0 / model.layout["shape"].scale[0]

    assert not sane(*(each.left for each in model.predict(z)))


def with_others() -> Scene:
    """Return the scene with central gravity and a rope to a point of the body, as a plug-in has it."""
    scene = parse_scene(SCENE)
    pull = CentralGravity(30.0, (2.0, -3.0, 4.0), gravity_gradient=True)
    return replace(scene, effects=(*scene.effects, pull, Roped(20.0)))


OTHERS = (*(name for name in FIT if name != "accelerometer"), "effects[6].center_world", "effects[7].stiffness")


@pytest.mark.slow
def test_derivatives_of_other_effects_are_those_of_differences() -> None:
    model = Model(with_others(), [every_sensor()], OTHERS)
    model.turn = 0.03
    z = 0.1 * np.random.default_rng(1).standard_normal(model.layout.count)
    z[model.layout["delay.commands"].at] = 0.1
    with counted_by(Tally()):
        here = {each.key: each.by for each in model.predict(z)}
        for k in range(model.layout.count):
            for key, slope in _difference(model, z, k).items():
                scale = max(float(np.abs(here[key][:, :, k]).max()), 1e-3)
                np.testing.assert_allclose(here[key][:, :, k], slope, rtol=0.0, atol=2e-5 * scale, err_msg=f"{k} {key}")


def test_other_effects_have_the_same_bits_in_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model(with_others(), [every_sensor()], OTHERS)
    model.turn = 0.3
    found = []
    for when in ("always", "never"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when if available() else "never")
        found.append([(e.left.tobytes(), e.by.tobytes()) for e in model.predict(np.zeros(model.layout.count))])
    assert found[0] == found[1]


def test_what_an_effect_refuses_is_no_motion() -> None:
    model = Model(with_others(), [every_sensor()], ("effects[6].gravitational_parameter",))
    z = np.zeros(model.layout.count)
    z[model.layout["effects[6].gravitational_parameter"].at] = -2.0
    assert not any(np.isfinite(each.left).any() for each in model.predict(z))
