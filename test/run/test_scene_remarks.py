"""What is wrong with a scene before it runs: said by explain, simulate and campaign; that of wheels and sensors too."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

import rb_dynamics as rb
from rb_dynamics.cli import main
from rb_dynamics.loads.reaction_wheel import friction_rate
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.run.scene_remarks import nutation_rate, scene_remarks
from rb_dynamics.scene.model import Past
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.sinks.mcap_sink import McapSink

SHAKEN = """
body: {mass: 10, inertia: {diagonal: [0.1, 0.1, 0.1]}}
wrenches: []
actuators: [{type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-4, imbalance: {dynamic: 1.0e-8}, SPEED}]
duration: 0.1
solver: SOLVER
"""


@pytest.mark.parametrize(
    ("speed", "solver", "said"),
    [
        ("speed: 300", "{method: dop853, step: 0.02}", "turns by 6 rad in a step of 0.02 s at 300 rad/s"),
        ("max_speed: 400", "{step: 0.02}", "turns by 8 rad in a step of 0.02 s at 400 rad/s"),
        ("speed: 300", "{method: dop853, step: 0.01}", ""),
        ("speed: 300", "{accuracy: 1.0e-6}", ""),
    ],
)
def test_steps_that_do_not_resolve_an_imbalance_are_named(speed: str, solver: str, said: str) -> None:
    found = scene_remarks(parse_scene(SHAKEN.replace("SPEED", speed).replace("SOLVER", solver)))
    assert len(found) == bool(said)
    assert all(said in remark for remark in found)
    assert not scene_remarks(
        parse_scene(SHAKEN.replace("imbalance: {dynamic: 1.0e-8}, SPEED", speed).replace("SOLVER", solver))
    )


def test_steps_too_long_for_a_wheel_that_speeds_up_are_named_by_the_run() -> None:
    text = SHAKEN.replace("SPEED", "max_torque: 1.0").replace("SOLVER", "{step: 0.02}")
    (found,) = rb.simulate(rb.parse_scene(text), [("wheel/command", rb.Setpoint(0.5))]).remarks
    assert found.startswith("wheel turned by ")
    assert "too far to resolve its imbalance" in found


def test_simulate_and_explain_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "shaken.yaml"
    path.write_text(SHAKEN.replace("SPEED", "speed: 300").replace("SOLVER", "{step: 0.02}"), encoding="utf-8")
    assert main(["simulate", str(path)]) == 0
    assert "note: wheel turns by 6 rad in a step" in capsys.readouterr().err
    assert main(["explain", str(path)]) == 0
    said = capsys.readouterr().out
    assert "note: wheel turns by 6 rad in a step" in said
    assert "actuator wheel: reaction_wheel, with imbalance, commanded on wheel/command" in said


FULL = """
body:
  mass: 10
  inertia: {diagonal: [0.05, 0.12, 0.14]}
  frames: {jet: {position: [0, 0.1, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}
initial: {angular_velocity_body: [0, 1.5, 0]}
wrenches: []
actuators:
  - {type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-4, max_torque: 5.0e-3, max_speed: 60.0}
  - {type: thruster, name: jet, frame: jet, force: 0.01, minimum_on: 0.01}
duration: 6
"""
COMMANDS = [
    ("wheel/command", rb.Setpoint(4e-3)),
    *(("jet/command", rb.Setpoint(0.005 if k else 0.02, k * 10**9)) for k in range(5)),
]


def test_a_wheel_near_its_limit_an_on_time_too_short_and_slow_commands_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By simulate and by explain, of a bag."""
    scene, bag = tmp_path / "scene.yaml", tmp_path / "bag.mcap"
    scene.write_text(FULL, encoding="utf-8")
    run = rb.simulate(scene, COMMANDS, [McapSink(bag)])
    remark, slowly = run.remarks
    assert remark.startswith("wheel was near its max_speed of 60 rad/s at 1.")
    assert slowly.startswith("jet/command: the body turns by 1.")
    near, slow = "note: wheel was near its max_speed", "note: jet/command: the body turns by 1."
    assert main(["simulate", str(scene), "--wrench", str(bag)]) == 0
    said = capsys.readouterr().err
    assert near in said
    assert slow in said
    assert "4 of 6 commands were rejected" in said
    assert main(["explain", str(scene), "--wrench", str(bag)]) == 0
    said = capsys.readouterr().out
    assert near in said
    assert slow in said
    assert "4 of 6 commands were rejected" in said
    # The log ends with the same.
    (told,) = diagnostics(bag)
    assert "wheel was near its max_speed of 60 rad/s at 1." in told
    assert "jet/command: the body turns by 1." in told
    assert "4 commands were rejected and had no effect; the first: jet/command at simulation time 1." in told
    calm = rb.parse_scene(FULL.replace("[0, 1.5, 0]", "[0, 0.4, 0]"))
    assert not rb.simulate(
        calm, [("jet/command", rb.Setpoint(0.01, k * 10**9)) for k in range(5)], [McapSink(bag)]
    ).remarks
    assert diagnostics(bag) == []


def diagnostics(log: Path) -> list[str]:
    """Return the warnings in a log."""
    statuses = [each for _, _, found in read_bag(log).topics["/diagnostics"].decoded() for each in found]
    assert all(level == 1 for level, *_ in statuses)
    return [message for _, _, message, *_ in statuses]


def test_a_log_that_ends_by_ctrl_c_holds_the_warnings_so_far(tmp_path: Path) -> None:
    def interrupt(fraction: float) -> None:
        if fraction > 0.9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rb.simulate(parse_scene(FULL), COMMANDS, [McapSink(tmp_path / "log.mcap")], interrupt)
    (told,) = diagnostics(tmp_path / "log.mcap")
    assert "wheel was near its max_speed of 60 rad/s at 1." in told
    assert "commands were rejected and had no effect" in told


def test_a_log_that_ends_by_an_error_holds_the_warnings_so_far_and_the_error(tmp_path: Path) -> None:
    """Between two commands, 0.5 s apart, the body turns by 0.75 rad; then a torque spins it up too much for a step."""
    scene = parse_scene(
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 1.5, 0]}\n"
        "wrenches: [{topic: push}]\nsolver: {method: rk4, step: 0.1}\nduration: 10\n"
    )
    commands = [("push", rb.Wrench(torque=(0.0, 0.0, 600.0 * (k == 5)), stamp_ns=k * 500_000_000)) for k in range(6)]
    with pytest.raises(rb.ConvergenceError) as error:
        rb.simulate(scene, commands, [McapSink(tmp_path / "log.mcap")])
    (told,) = diagnostics(tmp_path / "log.mcap")
    assert "push: the body turns by" in told
    assert told.endswith(f"; the run ended by an error: {error.value}")


@pytest.mark.parametrize(("period_ms", "slow"), [(240, False), (260, True)])
def test_commands_slower_than_the_nutation_are_named(period_ms: int, slow: bool, tmp_path: Path) -> None:
    """A body at rest with 0.4 N m s along z nutates at 2 rad/s, by 0.5 rad in 250 ms: what is held drives it."""
    commands = [("push", rb.Wrench(stamp_ns=k * period_ms * 10**6)) for k in range(6)]
    scene = parse_scene(
        NUTATING.replace("wrenches: []", "wrenches: [{topic: push}]").replace("duration: 1", "duration: 2")
    )
    found = rb.simulate(replace(scene, sensors=()), commands, [McapSink(tmp_path / "log.mcap")]).remarks
    assert [each.startswith("push: the body nutates by 0.52 rad from one") for each in found] == [True] * slow
    assert diagnostics(tmp_path / "log.mcap") == list(found)
    assert [each for each in rb.explain(replace(scene, sensors=()), commands).remarks if "nutates" in each] == list(
        found
    )


def test_remarks_need_no_run() -> None:
    """They know the momentum inside without one: a scene that continues a long run would repeat it for them."""
    wheel = parse_scene(NUTATING)
    assert nutation_rate(wheel) == nutation_rate(wheel, rb.Simulation(wheel).sample) > 0.0
    # A rotor speeds up; its time counts from the start of the run that is continued.
    rotor = parse_scene(
        "body: {mass: 10, inertia: {diagonal: [0.1, 0.4, 0.3]}}\nwrenches: []\nduration: 1\neffects:\n"
        "  - {type: rotor, axis_body: [0, 0, 1], axial_inertia: 0.01, "
        "spin_rate: [{time: 0, rate: 0}, {time: 50, rate: 60}]}\n"
    )
    later = replace(rotor, initial=replace(rotor.initial, angular_velocity_body=(0.0, 0.0, -0.5)))
    later = replace(later, past=Past(25 * 10**9, rotor.initial))
    assert nutation_rate(later) == pytest.approx(nutation_rate(later, rb.Simulation(later).sample), rel=1e-12)
    assert nutation_rate(later) > nutation_rate(rotor)


NUTATING = """\
body: {mass: 10, inertia: {diagonal: [0.1, 0.4, 0.3]}}
wrenches: []
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-3, speed: 400}]
sensors: [{type: imu, name: slow, rate: 2}, {type: imu, name: fast, rate: 5}]
duration: 1
"""


def test_a_sensor_slower_than_the_nutation_is_named() -> None:
    """Beside 0.4 N m s along z, moments of 0.1 and 0.4 kg m^2 across it nutate at 0.4 / sqrt(0.1 * 0.4) = 2 rad/s."""
    (found,) = scene_remarks(parse_scene(NUTATING))
    assert found.startswith("slow: the body nutates by 1 rad from one message to the next")
    assert not scene_remarks(parse_scene(NUTATING.replace("speed: 400", "speed: 0")))


STIFF = """\
body: {mass: 1, inertia: {diagonal: [0.01, 0.012, 0.013]}}
wrenches: []
actuators:
- {type: reaction_wheel, name: w, axis: [1, 0, 0], inertia: 1.0e-5, speed: 18, max_speed: 20, friction: {viscous: 0.01}}
solver: {method: dop853, step: 0.003}
duration: 1
"""


def test_a_wheel_that_friction_slows_within_a_step_is_named() -> None:
    """At 0.01 N m s/rad over 1e-5 kg m^2 a step of 3 ms is three times too long."""
    scene = parse_scene(STIFF)
    (found,) = scene_remarks(scene)
    assert "slowed by its viscous friction within 0.001 s, which steps of 0.003 s do not resolve" in found
    assert not scene_remarks(parse_scene(STIFF.replace("step: 0.003", "step: 0.001")))
    assert not scene_remarks(parse_scene(STIFF.replace("step: 0.003", "accuracy: 1.0e-9")))
    # How fast the speed falls in a run that resolves it.
    end = rb.simulate(replace(scene, solver=rb.Solver("auto", accuracy=1e-12), duration=0.003)).sample
    rate, _ = friction_rate(scene.wheels, scene.body)
    assert end.wheel_speeds[0] == pytest.approx(18 * math.exp(-0.003 * rate), rel=1e-9)


def test_friction_of_wheels_that_share_a_body_slows_them_together() -> None:
    """Two alike on one axis hold 9 tenths of the body's inertia about it: turning together, they are slowed faster."""
    wheel = "{type: reaction_wheel, inertia: 0.9, axis: [0, 0, 1], speed: 1, friction: {viscous: 1.8}"
    text = (
        "body: {mass: 1, inertia: {diagonal: [1.5, 1.9, 2]}}\nwrenches: []\nduration: 0.05\n"
        f"actuators: [{wheel}, name: a}}, {wheel}, name: b}}]\nsolver: "
    )
    scene = parse_scene(f"{text}{{method: dverk, step: 0.05}}")
    rate, slowed = friction_rate(scene.wheels, scene.body)
    assert rate == pytest.approx(1.8 / (0.9 * (1.0 - 0.9)))
    assert slowed == "a and b are slowed by their viscous friction within 0.05 s"
    end = rb.simulate(parse_scene(f"{text}{{method: auto, accuracy: 1.0e-12}}")).sample
    assert end.wheel_speeds == pytest.approx([math.exp(-0.05 * rate)] * 2, rel=1e-9)
    with pytest.raises(rb.ConvergenceError, match="a and b are slowed"):
        rb.simulate(parse_scene(f"{text}{{method: dverk, step: 0.25}}"))


@pytest.mark.parametrize(("method", "longest"), [("dop853", 0.0062), ("dverk", 0.0039)])
def test_a_step_under_which_friction_would_speed_a_wheel_up_is_refused(method: str, longest: float) -> None:
    def scene(step: float) -> rb.Scene:
        return parse_scene(STIFF.replace("dop853, step: 0.003", f"{method}, step: {step}"))

    assert abs(rb.simulate(scene(longest)).sample.wheel_speeds[0]) < 18.0
    with pytest.raises(rb.ConvergenceError, match=r"found 0.0\d+ s, expected 0.001 s or less, as w is slowed"):
        rb.simulate(scene(longest + 0.0002))


@pytest.mark.parametrize(("drag", "off"), [(10.0, False), (50.0, True)])
def test_steps_that_speed_up_what_drag_should_stop_are_named(drag: float, off: bool) -> None:
    """By rk4 with steps of 0.1 s: 50/s is beyond its stability, 2.8 over the step."""
    text = (
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {linear_velocity_world: [1, 0, 0]}\nwrenches: []\n"
        f"effects: [{{type: linear_drag, translation: {drag}}}]\nduration: 1\nsolver: "
    )
    found = rb.simulate(parse_scene(f"{text}{{method: rk4, step: 0.1}}")).remarks
    assert ["steps of 0.1 s are too long" in remark for remark in found] == [True] * off
    assert not rb.simulate(parse_scene(f"{text}{{method: auto, accuracy: 1.0e-6}}")).remarks


def test_a_body_at_rest_whose_energy_is_rounding_has_no_steps_that_are_too_long() -> None:
    text = (
        "body: {mass: 3, inertia: {diagonal: [1, 2, 3]}}\nwrenches: []\nduration: 7\nsolver: {method: rk4, step: 0.1}\n"
        "effects: [{type: scheduled_wrench, schedule: [{time: 0, force: [1.0e-15, 0, 0]}, {time: 3.3}]}]\n"
    )
    assert not rb.simulate(parse_scene(text)).remarks
