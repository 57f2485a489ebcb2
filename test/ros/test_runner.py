"""`Runner` without DDS: changes of state and parameters, and the motion after them."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from nav_msgs.msg import Odometry

from rb_dynamics import MemorySink, Simulation, Wrench, parse_scene
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.ros.conversions import to_state
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.pacing import ClockFollower, Pacer
from rb_dynamics.ros.runner import Host, Mode, Runner
from rb_dynamics.run.sink import Epoch, Event, Sink, StateChange, Status

SCENE = """\
body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.1], linear_velocity_world: [1, 0, 0]}
wrenches: [{topic: wrench}, {topic: push, timeout: 0.5}]
solver: {method: rkmk4, step: 0.005}
duration: 1.0
"""


class Memory:
    """A host that keeps its runs, one sink for each."""

    def __init__(self) -> None:
        self.runs: list[MemorySink] = []

    def sinks(self) -> list[Sink]:
        self.runs.append(MemorySink())
        return [self.runs[-1]]

    def take_commands(self) -> None: ...


def opened(
    text: str = SCENE,
    mode: Mode | None = None,
    host: Host | None = None,
    said: list[str] | None = None,
    pacer: Pacer | ClockFollower | None = None,
) -> Runner:
    scene = parse_scene(text)
    said = [] if said is None else said
    topics = [*(channel.topic for channel in scene.channels), *(each.topic for each in scene.actuators)]
    health = Health("/body", topics, lambda level, message: said.append(message))
    body = Runner(scene, mode or Mode(start_paused=True), pacer or Pacer(1.0), health, host or Memory())
    body.open()
    return body


def runner(*arguments: Any, **more: Any) -> Runner:
    body = opened(*arguments, **more)
    body.start()
    return body


def run_steps(body: Runner, count: int) -> None:
    body.step(count)
    while body.behind:
        body.tick()


def count(body: Runner, name: str) -> int:
    return int(body.health.status(body.simulation, body.pacer, "").values[f"wrench: {name}"])


def test_steps_are_output_periods_however_they_are_asked_for() -> None:
    one, many = runner(), runner()
    for _ in range(7):
        run_steps(one, 1)
    run_steps(many, 7)
    assert one.simulation.time_ns == many.simulation.time_ns == 70_000_000
    assert one.simulation.sample == many.simulation.sample
    many.step(3)
    many.pause(True)
    assert not many.behind


def test_a_command_that_acts_on_arrival_does_not_act_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    body, written = runner(mode=Mode(log_latency=True)), list[Any]()
    monkeypatch.setattr(body.simulation, "write", written.append)
    time.sleep(0.005)
    body.command("wrench", Wrench(force=(1.0, 0.0, 0.0)), age_ns=1_000_000, sent=(3_000, 5_000, 1))
    assert [each.acted_ns for each in written] == [5_000]


def test_a_new_mass_keeps_the_velocities_the_stamps_and_what_is_held() -> None:
    body = runner()
    body.command("wrench", Wrench(force=(4.0, 0.0, 0.0), frame_id="world"))
    run_steps(body, 10)
    before, stamp = body.simulation.sample, body.stamp_ns
    body.change(body.changed({"body.mass": 8.0, "body.inertia.diagonal": [2.0, 4.0, 5.0]}), initial_only=False)
    after = body.simulation.sample
    assert after.time_ns == 0
    assert body.stamp_ns == stamp == 100_000_000
    assert after.linear_velocity_world == before.linear_velocity_world
    assert after.angular_velocity_body == before.angular_velocity_body
    assert after.linear_momentum_world[0] == 4 * before.linear_momentum_world[0]
    run_steps(body, 10)
    # 4 N on 8 kg for 0.1 s.
    gained = body.simulation.sample.linear_velocity_world[0] - before.linear_velocity_world[0]
    assert gained == pytest.approx(0.05, rel=1e-12)
    # What was left of the second is left.
    run_steps(body, 1000)
    assert body.stamp_ns == 1_000_000_000
    assert body.done


def test_a_new_run_from_the_state_as_it_is_changes_no_digit_of_the_motion() -> None:
    whole, cut = runner(), runner()
    for body in (whole, cut):
        body.command("wrench", Wrench(torque=(0.0, 0.1, 0.0)))
        run_steps(body, 20)
    cut.set_state(cut.state)
    for body in (whole, cut):
        run_steps(body, 20)
    a, b = whole.simulation.sample, cut.simulation.sample
    assert b.angular_velocity_body == pytest.approx(a.angular_velocity_body, rel=1e-14)
    assert b.position_world == pytest.approx(a.position_world, rel=1e-14, abs=1e-15)


def test_a_value_that_was_there_already_begins_no_new_run() -> None:
    body = runner()
    run_steps(body, 3)
    before = body.simulation
    body.change(body.changed({"body.mass": 2, "body.inertia.diagonal": [1, 2, 2.5]}), initial_only=False)
    assert body.simulation is before


def test_a_change_of_state_is_an_event_of_the_run_that_simulate_repeats_and_the_books_count() -> None:
    body = runner(SCENE.replace("mass: 2.0", "mass: 2.0, center_of_mass: [0.1, 0, 0.3]"))
    body.command("wrench", Wrench(force=(0.0, 2.0, 0.0), torque=(0.0, 0.1, 0.0)))
    before = body.simulation
    run_steps(body, 10)
    jump = replace(body.state, angular_velocity_body=(0.0, 1.0, 0.01), linear_velocity_world=(0.3, 9.0, 0.1))
    body.set_state(jump)
    assert body.simulation is before
    assert body.state.angular_velocity_body == pytest.approx((0.0, 1.0, 0.01), rel=1e-15)
    assert body.state.linear_velocity_world == pytest.approx((0.3, 9.0, 0.1), rel=1e-15)
    run_steps(body, 20)
    again = Simulation(body.scene)
    again.post("wrench", Wrench(force=(0.0, 2.0, 0.0), torque=(0.0, 0.1, 0.0)))
    again.set_state(StateChange.to(jump, body.scene.body))
    again.start()
    again.advance(300_000_000)
    sample = body.simulation.sample
    assert again.sample == sample
    assert sample.work > 50.0
    assert abs(sample.energy_defect) < 1e-8 * sample.work
    for defect in (sample.angular_momentum_defect_world, sample.linear_momentum_defect_world):
        assert defect == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_commands_that_wait_and_timeouts_go_on_over_a_change() -> None:
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"))
    body.command("wrench", Wrench(force=(2.0, 0.0, 0.0), frame_id="world", stamp_ns=150_000_000))
    body.command("push", Wrench(force=(6.0, 0.0, 0.0), frame_id="world"))
    run_steps(body, 10)
    body.set_state(replace(body.state, linear_velocity_world=(0.0, 0.0, 0.0)))
    run_steps(body, 10)
    # push for 0.1 s from the change on, and wrench for the half of it: 3 m/s^2 * 0.1 s + 1 m/s^2 * 0.05 s
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(0.35, rel=1e-12)


def test_commands_that_came_out_of_order_go_on_in_the_order_of_their_stamps() -> None:
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"))
    for force, stamp_ms in ((6.0, 150), (4.0, 50), (2.0, 20), (8.0, 250)):
        body.command("wrench", Wrench(force=(force, 0.0, 0.0), frame_id="world", stamp_ns=stamp_ms * 1_000_000))
    run_steps(body, 10)
    body.command("wrench", Wrench(force=(9.0, 0.0, 0.0), frame_id="world", stamp_ns=300_000_000))
    body.set_state(replace(body.state, linear_velocity_world=(0.0, 0.0, 0.0)))
    run_steps(body, 15)
    # From 100 ms on: 4 N until 150 ms, 6 N until 250 ms, on 2 kg.
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(2 * 0.05 + 3 * 0.1, rel=1e-12)
    run_steps(body, 10)
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(0.4 + 4 * 0.05 + 4.5 * 0.05, rel=1e-12)


@pytest.mark.parametrize("mode", [Mode(start_paused=True, apply_at="stamp"), Mode(lockstep=True), Mode()])
def test_what_a_command_does_is_found_once(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    body, looked = runner(mode=mode), []
    hold = WrenchFrames.hold
    monkeypatch.setattr(WrenchFrames, "hold", lambda frames, wrench: (looked.append(wrench), hold(frames, wrench))[1])
    for wrench in (Wrench(stamp_ns=50_000_000), Wrench(frame_id="nowhere", stamp_ns=60_000_000)):
        body.command("wrench", wrench)
        assert looked.pop() is wrench
        assert not looked


def test_what_is_held_after_a_timeout_or_was_rejected_does_not_come_back() -> None:
    body = runner(SCENE.replace("push, timeout: 0.5", "push, timeout: 0.05, max_force: 50.0, on_excess: clip"))
    body.command("push", Wrench(force=(6.0, 0.0, 0.0), frame_id="world"))
    body.command("wrench", Wrench(torque=(1e8, 0.0, 0.0)))  # taken back: no step can be taken under it
    body.command("wrench", Wrench(frame_id="nowhere"))
    run_steps(body, 10)
    assert [count(body, name) for name in ("accepted", "rejected")] == [0, 2]
    assert body.simulation.outstanding() == []
    held = Wrench(force=(100.0, 0.0, 0.0), frame_id="world")
    body.command("push", held)
    run_steps(body, 1)
    assert body.simulation.outstanding() == [("push", held, 0)]
    before = body.simulation.sample.linear_velocity_world[0]
    body.set_state(body.state)
    run_steps(body, 10)
    assert body.simulation.sample.linear_velocity_world[0] - before == pytest.approx(25.0 * 0.04, rel=1e-12)
    assert body.simulation.outstanding() == []


def test_reset_leads_back_to_the_initial_state_and_its_parts_do_their_part() -> None:
    body = runner()
    body.command("wrench", Wrench(force=(4.0, 0.0, 0.0), frame_id="world"))
    run_steps(body, 10)
    first = body.simulation.sample
    body.reset_time()
    assert body.stamp_ns == 1
    assert body.state.position_world == first.position_world
    run_steps(body, 10)
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(1.4, rel=1e-12), "the force is held"
    body.reset_state()
    assert body.stamp_ns == 100_000_000
    assert body.state.linear_velocity_world == (1.0, 0.0, 0.0)
    run_steps(body, 10)
    assert body.simulation.sample.linear_velocity_world == (1.0, 0.0, 0.0)
    assert body.reset() == ""
    assert body.stamp_ns == 1
    body.change(body.changed({"initial.linear_velocity_world": [5.0, 0.0, 0.0]}), initial_only=True)
    assert body.state.linear_velocity_world == (1.0, 0.0, 0.0), "from the next reset on"
    body.reset()
    assert body.state.linear_velocity_world == (5.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"body.mass": -1.0}, "body.mass"),
        ({"body.inertia.diagonal": [1.0, 1.0, 3.0]}, "inertia"),
        ({"body.mass": 3.0, "body.inertia.diagonal": [1.0, -1.0, 3.0]}, "inertia"),
        ({"body.frame": "other"}, "body_frame: cannot be changed"),
        ({"wrenches[0].topic": "other"}, "topics cannot be changed"),
        ({"effects": [{"type": "scheduled_wrench", "schedule": [{"time": 0.5, "force": [1, 0, 0]}]}]}, "schedule"),
    ],
)
def test_a_change_is_checked_as_a_whole_and_a_bad_one_changes_nothing(
    overrides: dict[str, object], expected: str
) -> None:
    body = runner()
    run_steps(body, 3)
    before = body.simulation
    with pytest.raises(SceneError, match=expected):
        body.changed(overrides)
    assert body.simulation is before
    assert body.scene.body.mass == 2.0


def test_a_state_that_is_none_is_refused_and_the_run_goes_on() -> None:
    body = runner()
    run_steps(body, 3)
    before = body.simulation
    for bad in (
        replace(body.state, position_world=(float("nan"), 0.0, 0.0)),
        replace(body.state, orientation_xyzw=(0.0, 0.0, 0.0, 2.0)),
    ):
        with pytest.raises(SceneError, match="state"):
            body.set_state(bad)
    assert body.simulation is before
    run_steps(body, 1)


ORBIT = """\
body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}
initial: {position_world: [7e6, 0, 0], linear_velocity_world: [0, 7e3, 0]}
effects: [{type: central_gravity, gravitational_parameter: 4e14}]
wrenches: [{topic: wrench}]
duration: 100
"""


def test_a_state_that_nothing_follows_leaves_the_run_as_it_was() -> None:
    body, without = runner(ORBIT), runner(ORBIT)
    for each in (body, without):
        run_steps(each, 3)
    good = body.state
    for bad in (replace(good, position_world=(0.0, 0.0, 0.0)), replace(good, angular_velocity_body=(1e7, 1e7, 0.0))):
        for refuse in (lambda bad=bad: body.set_state(bad), lambda bad=bad: body.rehearse(None, bad)):
            with pytest.raises(ConvergenceError, match="the motion cannot continue from there"):
                refuse()
        assert (body.state, body.health.failure) == (good, "")
    for each in (body, without):
        run_steps(each, 3)
    assert body.simulation.sample == without.simulation.sample
    body.set_state(replace(good, angular_velocity_body=(1.0, 0.0, 0.0)))
    run_steps(body, 1)
    assert body.simulation.time_ns == 70_000_000


def test_what_cannot_continue_is_foreseen_with_the_body_that_is_to_be_and_what_is_held() -> None:
    body = runner(SCENE.replace("method: rkmk4, step: 0.005", "method: rk4, step: 0.05"))
    body.command("wrench", Wrench(torque=(0.0, 1e3, 2e3)))
    run_steps(body, 3)
    light = body.changed({"body.inertia.diagonal": [0.01, 0.02, 0.025]})
    with pytest.raises(ConvergenceError, match="the motion cannot continue from there: rk4"):
        body.rehearse(light, None)
    assert body.rehearse(body.changed({"body.mass": 4.0}), None) is None
    with pytest.raises(ConvergenceError, match="the motion cannot continue from there: rk4"):
        body.changed({"initial.angular_velocity_body": [1e4, 1e4, 0.0]})
    assert body.scene.body.mass == 2.0
    run_steps(body, 3)


def test_a_motion_that_cannot_continue_is_told_once_and_a_step_says_so() -> None:
    said: list[str] = []
    body = runner(SCENE, said=said)

    def stepped(count: int = 1) -> str:
        waiting = body.stepped(count)
        while True:
            try:
                waiting.send(None)
            except StopIteration as answer:
                return str(answer.value)
            body.tick()

    assert stepped(2) == ""
    # Not so large that no step is tried: that is the step's fault.
    body.command("wrench", Wrench(torque=(9e5, 9e5, 0.0)))
    for _ in range(3):
        assert "because the motion cannot be continued: rkmk4: a step" in stepped()
        body.tick()
    assert sum("the motion cannot be continued" in each for each in said) == 1
    assert body.simulation.time_ns == 20_000_000
    body.reset()
    assert stepped(100) == ""
    assert stepped() == "the run is over; ~/reset starts again"


def test_stamped_commands_late_early_twice_and_out_of_order() -> None:
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"))
    ms = 1_000_000
    run_steps(body, 2)

    def push(force: float, stamp_ns: int) -> None:
        body.command("wrench", Wrench(force=(force, 0.0, 0.0), frame_id="world", stamp_ns=stamp_ns))

    push(2.0, 60 * ms)  # early
    push(4.0, 40 * ms)  # early, and before the one that came first
    push(6.0, 40 * ms)  # the same stamp: the last one counts
    push(8.0, 10 * ms)  # late: acts from now, 20 ms, to 40 ms
    run_steps(body, 6)
    push(100.0, 50 * ms)  # late, and 60 ms has acted: left out
    run_steps(body, 2)
    assert [count(body, name) for name in ("accepted", "early", "late", "duplicate", "superseded")] == [4, 2, 1, 1, 1]
    # dv = F dt / 2 kg
    expected = 1.0 + (8 * 0.02 + 6 * 0.02 + 2 * 0.04) / 2
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(expected, rel=1e-12)
    push(0.0, 0)  # without a stamp: at once
    assert count(body, "late") == 1
    run_steps(body, 1)
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(expected, rel=1e-12)


def test_a_command_without_a_stamp_acts_when_it_comes_though_a_later_stamp_waits() -> None:
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"))
    ms = 1_000_000

    def push(force: float, stamp_ns: int) -> None:
        body.command("wrench", Wrench(force=(force, 0.0, 0.0), frame_id="world", stamp_ns=stamp_ns))

    push(6.0, 10 * ms)
    push(4.0, 80 * ms)
    run_steps(body, 2)
    push(0.0, 0)  # an emergency stop, at 20 ms
    run_steps(body, 2)
    push(100.0, 15 * ms)  # late, and would undo it
    # Over a change they act on as they would have.
    body.set_state(body.state)
    push(2.0, 0)
    run_steps(body, 6)
    expected = 1.0 + (6 * 0.01 + 2 * 0.04 + 4 * 0.02) / 2
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(expected, rel=1e-12)
    assert [count(body, name) for name in ("accepted", "early", "late", "superseded")] == [4, 2, 0, 1]


@pytest.mark.parametrize("how", ["pause", "lag"])
def test_commands_that_wait_keep_to_their_stamps_when_time_was_lost(how: str) -> None:
    """Stamps were turned into simulation time once, on arrival: after a pause of 2 s commands acted 2 s late."""
    ms, now = 1_000_000, [10**12]
    host = Memory()
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"), host=host)
    body.pacer = Pacer(1.0, lambda: now[0])
    begun = now[0]

    def push(force: float, stamp_ns: int) -> None:
        body.command("wrench", Wrench(force=(force, 0.0, 0.0), frame_id="world", stamp_ns=stamp_ns))

    push(100.0, begun + 500 * ms)
    push(6.0, begun + 1900 * ms)
    push(7.0, begun + 2030 * ms)
    push(8.0, begun + 2050 * ms)
    push(50.0, 0)  # without a stamp: at once, until a stamped one acts
    if how == "lag":
        body.pause(False)
        # The process stood still for so long.
        body.pacer._clock_ns -= 2000 * ms
    now[0] += 2000 * ms
    if how == "lag":
        body.tick()
    else:
        body.pause(False)
    body.pause(True)
    lost = (body.pacer.offset_ns or 0) - begun
    assert 1900 * ms < lost <= 2000 * ms
    run_steps(body, 20)
    assert [count(body, name) for name in ("accepted", "superseded")] == [4, 1]
    assert [event.time_ns for event in host.runs[-1].applied][-2:] == [2030 * ms - lost, 2050 * ms - lost]
    # What is newer than what acted at once is late, and no more than that.
    push(3.0, begun + lost + 70 * ms)
    assert [count(body, name) for name in ("accepted", "late", "superseded")] == [5, 1, 1]
    push(2.0, begun + lost + 40 * ms)
    assert count(body, "superseded") == 2


def test_by_arrival_the_commands_of_a_channel_keep_their_order() -> None:
    memory = Memory()
    body = runner(mode=Mode(), host=memory)
    body.pacer.restart(50_000_000)
    for force, age_ns in ((1.0, 0), (2.0, 40_000_000), (3.0, 0), (4.0, 20_000_000)):
        body.command("wrench", Wrench(force=(force, 0.0, 0.0), frame_id="world"), age_ns)
    body.simulation.advance(100_000_000)
    assert memory.runs[0].applied[-1].force[0] == 4.0


def test_another_factor_while_it_runs() -> None:
    body = runner(mode=Mode())
    body.pace(0.0)
    while not body.done:
        body.tick()
    assert body.simulation.time_ns == 1_000_000_000


def test_a_lag_is_given_up_and_counted_however_far_the_next_output_is() -> None:
    body = runner(SCENE.replace("duration: 1.0", "output_rate: 0.01"), Mode())
    body.pacer.restart(1_000_000_000)
    body.tick()
    while body.behind:
        body.tick()
    told = body.pacer.values()
    assert int(told["overruns"]) >= 1
    assert float(told["time dropped"].removesuffix(" s")) >= 0.95
    assert body.simulation.look().time_ns < 1_000_000_000
    body.reset()
    assert (body.pacer.values()["overruns"], body.pacer.warning()) == ("0", "")


def test_time_goes_on_from_what_was_computed_not_from_the_last_output() -> None:
    body = runner(SCENE.replace("duration: 1.0", "output_rate: 0.01"), Mode())
    body.pacer.restart(80_000_000)
    body.tick()
    while body.behind:
        body.tick()
    reached = body.simulation.look().time_ns
    assert reached > 0
    body.pause(True)
    body.pause(False)
    assert body.pacer.due_ns(10**12) >= reached
    body.pace(2.0)
    assert body.pacer.due_ns(10**12) >= reached


def test_a_change_from_outside_takes_no_time_from_the_motion_however_far_the_next_output_is() -> None:
    body = runner(SCENE.replace("duration: 1.0", "output_rate: 0.01"), Mode())
    passed, x = 0, 0.0
    for _ in range(3):
        body.pacer.restart(passed + 50_000_000)
        body.tick()
        while body.behind:
            body.tick()
        computed = body.simulation.look().time_ns
        state = body.state
        assert state.position_world[0] == pytest.approx(x + 1e-9 * (computed - passed), rel=1e-12)
        body.set_state(state)
        # To go on to now has brought some more.
        assert body.stamp_ns >= computed
        passed, x = body.stamp_ns, state.position_world[0]
    # What passed since it was computed last is gone on to before the change.
    body.pacer.restart(passed + 50_000_000)
    body.set_state(body.state)
    assert body.stamp_ns > passed


def test_what_it_takes_to_get_ready_is_no_lag() -> None:
    body = runner(mode=Mode())
    body.pacer.restart(300_000_000)
    before = time.monotonic_ns()
    body.go()
    assert body.pacer.due_ns(10**12) <= time.monotonic_ns() - before
    assert body.pacer.warning() == ""


def test_the_initial_state_is_stamped_when_time_begins() -> None:
    """It was stamped before all was ready: a gap of 0.1 s and more in a recording of the topics."""
    host, now = Memory(), [10**18]
    body = opened(mode=Mode(), host=host, pacer=Pacer(1.0, lambda: now[0]))
    now[0] += 200_000_000
    assert not host.runs[0].samples
    body.start()
    assert [sample.time_ns for sample in host.runs[0].samples] == [0]
    assert body.stamped(0) == now[0]


def test_a_run_that_a_reset_or_a_state_began_goes_on_when_time_begins() -> None:
    """The initial state was written a second time, and the log did not replay."""
    for first in (Runner.reset, lambda body: body.set_state(State(position_world=(5.0, 0.0, 0.0)))):
        host = Memory()
        body = opened(mode=Mode(), host=host)
        first(body)
        begun = [sample.time_ns for sample in host.runs[-1].samples]
        assert begun[0] == 0
        body.start()
        assert [sample.time_ns for sample in host.runs[-1].samples] == begun


def test_stop_stands_at_time_0_until_told() -> None:
    body = runner(mode=Mode())
    body.pause(True)
    run_steps(body, 2)
    assert body.stop() == ""
    assert (body.stopped, body.paused, body.simulation.time_ns) == (True, True, 0)
    body.pause(False)
    assert (body.stopped, body.paused) == (False, False)


def test_each_run_has_sinks_of_its_own() -> None:
    memory = Memory()
    body = runner(host=memory)
    run_steps(body, 2)
    body.change(body.changed({"body.mass": 3.0}), initial_only=False)
    run_steps(body, 3)
    assert [len(run.time_ns) for run in memory.runs] == [3, 4]


def test_a_command_acts_from_when_it_came_but_not_before_what_has_been_told() -> None:
    memory = Memory()
    body = runner(mode=Mode(), host=memory)
    # 50 ms have passed, and are computed.
    body.pacer.restart(body.simulation.time_ns + 50_000_000)
    body.tick()
    while body.behind:
        body.tick()
    told = body.simulation.time_ns
    for age_ns in (10**15, -(10**15)):
        body.command("wrench", Wrench(force=(1.0, 0.0, 0.0), frame_id="world"), age_ns)
    body.pacer.restart(body.simulation.time_ns + 50_000_000)
    body.command("push", Wrench(force=(1.0, 0.0, 0.0), frame_id="world"), 30_000_000)
    body.tick()
    while body.behind:
        body.tick()
    applied = {wrench.topic: wrench.time_ns for wrench in memory.runs[0].applied}
    assert told <= applied["wrench"] < told + 45_000_000
    assert told + 10_000_000 <= applied["push"] < body.simulation.time_ns


@pytest.mark.parametrize("apply_at", ["arrival", "stamp"])
def test_a_command_that_came_acts_before_the_output_is_due_unless_stamps_count(apply_at: str) -> None:
    memory = Memory()
    body = runner(SCENE.replace("duration: 1.0", "output_rate: 1"), Mode(apply_at=apply_at), memory)
    body.pacer.restart(50_000_000)
    body.command("wrench", Wrench(force=(1.0, 0.0, 0.0), frame_id="world", stamp_ns=20_000_000))
    body.prepare()
    while body.behind:
        body.tick()
    assert [wrench.topic for wrench in memory.runs[0].applied] == ["wrench"] * (apply_at == "arrival")
    # Told is nothing before its time.
    assert memory.runs[0].time_ns == [0]


def test_time_goes_no_further_than_to_when_commands_were_looked_for() -> None:
    looked = []

    class Slow(Memory):
        def take_commands(self) -> None:
            looked.append(time.monotonic_ns())
            body.command("wrench", Wrench(force=(1.0, 0.0, 0.0), frame_id="world"), age_ns=1_000_000_000)
            # Other channels take their time; on this one another command may come.
            time.sleep(0.02)

    memory = Slow()
    body = runner(SCENE.replace("duration: 1.0", "output_rate: 1"), Mode(), memory)
    before = time.monotonic_ns()
    body.pacer.restart(50_000_000)
    body.tick()
    assert [wrench.topic for wrench in memory.runs[0].applied] == ["wrench"]
    assert body.simulation.look().time_ns <= 50_000_000 + looked[0] - before


def test_lockstep_says_what_it_waits_for_and_warns_of_commands_that_move_no_time() -> None:
    told: list[Status] = []

    class Statuses(MemorySink):
        def write(self, event: Event) -> None:
            if isinstance(event, Status):
                told.append(event)

    class Watched(Memory):
        def sinks(self) -> list[Sink]:
            return [Statuses()]

    body = runner(mode=Mode(lockstep=True), host=Watched())

    def message() -> str:
        while body.behind:
            body.tick()
        body.report()
        return told[-1].message

    assert message() == "lockstep, waits for the first command on wrench"
    for topic in ("wrench", "push"):
        body.command(topic, Wrench(stamp_ns=0))
    assert message() == "lockstep, waits for a command on wrench with a header.stamp later than 0.000000000 s"
    body.command("wrench", Wrench(stamp_ns=20_000_000))
    body.tick()
    assert "waits for a command on push with a header.stamp later than 0.0" in message()
    body.command("push", Wrench(stamp_ns=0))
    assert "stamp each for the next output" in message()


@pytest.mark.parametrize(
    ("wrenches", "awaited"),
    [
        ("[]", "~/step: the scene has no wrench channel to move time"),
        ("[{topic: push, optional: true}, {topic: pull, optional: true}]", "a command on push or pull"),
    ],
)
def test_lockstep_that_no_channel_holds_back_says_what_it_waits_for(wrenches: str, awaited: str) -> None:
    """It stood at 0 without a word."""
    said: list[str] = []
    text = f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 3]}}}}\nwrenches: {wrenches}\noutput_rate: 100\n"
    body = runner(text, mode=Mode(lockstep=True), said=said)
    for _ in range(9):
        body.tick()
        body.every_second()
    assert said == [f"lockstep, waits for {awaited}"]


def test_lockstep_tells_once_of_a_long_wait_whoever_reads_the_diagnostics() -> None:
    said: list[str] = []
    body = runner(mode=Mode(lockstep=True), said=said)

    def wait(seconds: int) -> list[str]:
        said.clear()
        for _ in range(seconds):
            while body.behind:
                body.tick()
            body.every_second()
        return said

    assert wait(3) == []
    assert wait(9) == ["lockstep, waits for the first command on wrench"]
    for topic in ("wrench", "push"):
        body.command(topic, Wrench(stamp_ns=10_000_000))
    body.tick()
    assert "with a header.stamp later than 0.010000000 s; stamp each" in wait(9)[0]
    assert len(said) == 1
    body.pause(True)
    assert wait(9) == []
    body.pause(False)
    for number in range(2, 12):
        for topic in ("wrench", "push"):
            body.command(topic, Wrench(stamp_ns=10_000_000 * number))
        body.tick()
        assert wait(2) == []


@pytest.mark.parametrize(("epoch_ns", "stamp_ns", "far"), [(0, 10**18, "ahead of"), (10**18, 5 * 10**9, "behind")])
def test_stamps_of_another_clock_are_told_with_what_gives_both_one_time(epoch_ns: int, stamp_ns: int, far: str) -> None:
    said: list[str] = []
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"), said=said)
    body.pacer.begin(epoch_ns)
    body.command("wrench", Wrench(stamp_ns=stamp_ns))
    assert len(said) == 1
    assert f"far {far} ours" in said[0]
    assert "sender has use_sim_time and follows the same /clock (publish_clock:=true here)" in said[0]


def test_a_rejected_command_leaves_no_trace_in_what_the_stamps_of_others_mean() -> None:
    nothing = Wrench(force=(float("nan"), 0.0, 0.0), frame_id="world", stamp_ns=10**18)
    body = runner(mode=Mode(start_paused=True, apply_at="stamp"))
    run_steps(body, 2)
    body.command("wrench", nothing)
    body.command("wrench", Wrench(force=(2.0, 0.0, 0.0), frame_id="world"))
    run_steps(body, 10)
    assert body.simulation.sample.linear_velocity_world[0] == pytest.approx(1.1, rel=1e-12), "at its arrival"
    body.command("wrench", replace(nothing, stamp_ns=130_000_000))
    run_steps(body, 2)
    # Late, and the newest that was not rejected.
    body.command("wrench", Wrench(force=(4.0, 0.0, 0.0), frame_id="world", stamp_ns=125_000_000))
    before = body.simulation.sample.linear_velocity_world[0]
    run_steps(body, 10)
    assert body.simulation.sample.linear_velocity_world[0] - before == pytest.approx(0.2, rel=1e-12)
    assert [count(body, name) for name in ("accepted", "rejected", "late", "superseded")] == [2, 2, 1, 0]


def test_a_state_whose_quaternion_is_a_little_off_keeps_its_speed() -> None:
    message = Odometry()
    message.pose.pose.orientation.z = message.pose.pose.orientation.w = 0.5**0.5 * 1.0009
    message.twist.twist.linear.x = 1.0
    body = runner()
    body.set_state(to_state(message, body.scene.frames))
    assert body.state.linear_velocity_world == pytest.approx((0.0, 1.0, 0.0), abs=1e-15)


def test_what_is_told_of_a_pause_holds_as_long_as_the_pause() -> None:
    body = runner(mode=Mode())
    status = lambda: body.health.status(body.simulation, body.pacer, "")  # noqa: E731
    body.fail("a command was lost")
    assert status().level == 2
    assert status().message.startswith(
        "paused at simulation time 0 s (header.stamp 0.000000001 s), because a command was"
    )
    assert body.health.failure == status().message
    body.pause(False)
    assert (status().level, body.health.failure) == (1, "")
    assert status().message.startswith("went on after it had paused at simulation time 0 s")
    assert (status().values["simulation time"], status().values["header.stamp"]) == ("0.000000000 s", "0.000000001 s")


def test_commands_slower_than_the_body_turns_and_a_wheel_near_its_limit_are_told_once() -> None:
    """At 2 rad/s commands every 0.3 s are 0.6 rad apart; the wheel comes to 100 rad/s in 0.1 s."""
    text = SCENE.replace("[0.3, -0.2, 0.1]", "[0, 0, 2]").replace("duration: 1.0", "duration: 3.0")
    text = text.replace("solver: {method: rkmk4, step: 0.005}\n", "")
    text += "actuators: [{type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-4, max_speed: 100}]\n"
    said: list[str] = []
    body = runner(text, said=said)
    body.actuate("wheel/command", 0.1)
    for k in range(9):
        body.command("wrench", Wrench(torque=(0.0, 0.0, 1e-3)))
        run_steps(body, 30)
        body.every_second()
        if k == 4:
            assert not any("turns by" in message for message in said)
    (slow,) = (message for message in said if "turns by" in message)
    assert slow.startswith("wrench: the body turns by 0.6 rad from one command to the next")
    # A body at rest with moments of 1 and 2 kg m^2 nutates at 2.1 rad/s beside a wheel with 3 N m s.
    nutating: list[str] = []
    text = text.replace("[0, 0, 2]", "[0, 0, 0]").replace("max_speed: 100", "speed: 30000")
    body = runner(text.replace("axis: [1, 0, 0]", "axis: [0, 0, 1]"), said=nutating)
    for _ in range(9):
        body.command("wrench", Wrench())
        run_steps(body, 30)
        body.every_second()
    assert ["nutates by" in message for message in nutating] == [True]
    assert [message for message in said if "max_speed" in message] == [
        "wheel is near its max_speed of 100 rad/s, beyond which its motor does not drive it"
    ]


def test_a_state_that_costs_more_than_there_is_time_delays_no_message() -> None:
    """A step turns the body by about a radian: a slice learned before would take a day."""
    body = runner(
        "body: {mass: 1, inertia: {diagonal: [0.1, 0.2, 0.3]}}\neffects: [{type: linear_drag, rotation: 0.01}]\n",
        Mode(),
    )
    body.health.warn("an earlier command was rejected")
    body.go()
    until = time.monotonic() + 0.5
    while time.monotonic() < until:
        body.tick()
    body.set_state(replace(body.state, angular_velocity_body=(1e7, 0.0, 0.0)))
    before_ns, longest = body.simulation.computed_ns, 0.0
    until = time.monotonic() + 1.0
    while time.monotonic() < until:
        begun = time.process_time()
        body.tick()
        longest = max(longest, time.process_time() - begun)
    assert longest < 0.1
    assert 0 < body.simulation.computed_ns - before_ns < 500_000_000
    status = body.health.status(body.simulation, body.pacer, "running")
    assert int(status.values["overruns"]) > 0
    assert "the machine is too slow" in status.message


def test_a_log_says_from_which_time_on_the_ros_time_of_time_0_is_another() -> None:
    """It said that of the last output, while the body had gone on from there: commands seemed to act too late."""
    told = list[Epoch]()

    class Epochs(MemorySink):
        def write(self, event: Event) -> None:
            told.extend([event] if isinstance(event, Epoch) else [])
            super().write(event)

    class Told(Memory):
        def sinks(self) -> list[Sink]:
            return [Epochs()]

    body = runner(SCENE, Mode(), Told(), pacer=Pacer(1.0, time.time_ns))
    while body.simulation.computed_ns < 25_000_000:
        body.tick()
    reached = body.simulation.computed_ns
    assert reached > body.simulation.time_ns
    time.sleep(0.2)  # a lag
    body.tick()
    assert told[-1].time_ns == reached


def test_commands_keep_to_their_stamps_over_a_change_of_the_body() -> None:
    """After a pause of 1 s and a change, commands acted 1 s late, and an older one undid the one that was held."""
    ms, now, host = 1_000_000, [10**12], Memory()
    body = runner(SCENE.replace("duration: 1.0\n", ""), Mode(start_paused=True, apply_at="stamp"), host)
    body.pacer = Pacer(1.0, lambda: now[0])
    begun = now[0]

    def push(force: float, stamp_ms: int) -> None:
        body.command("wrench", Wrench(force=(force, 0.0, 0.0), stamp_ns=begun + stamp_ms * ms))

    push(5.0, 10)
    run_steps(body, 2)
    push(6.0, 1900)
    push(7.0, 500)
    now[0] += 1000 * ms
    body.change(body.changed({"body.mass": 4.0}), False)
    push(9.0, -2000)  # older than the one that is held
    now[0] += 500 * ms
    body.pause(False)
    body.pause(True)
    run_steps(body, 50)
    epoch = body.pacer.offset_ns or 0
    acted = [(each.force[0], each.time_ns) for each in host.runs[-1].applied][-2:]
    assert [force for force, _ in acted] == [7.0, 6.0]
    assert acted[1][1] == begun + 1900 * ms - epoch
    assert count(body, "superseded") == 1


@pytest.mark.parametrize("seen", [False, True])
@pytest.mark.parametrize("paused", [False, True])
def test_commands_that_wait_when_the_clock_jumps_back_never_act(paused: bool, seen: bool) -> None:
    """A command of the time before acted among those of the new one, at a stamp that is not its own."""
    clock = [100.0]
    follower = ClockFollower(lambda: round(clock[0] * 1e9))
    body = runner(SCENE.replace("duration: 1.0\n", ""), Mode(apply_at="stamp"), pacer=follower)

    def at(time_s: float) -> None:
        clock[0] = time_s
        body.tick()
        while body.behind:
            body.tick()

    def push(stamp_s: float) -> None:
        body.command("wrench", Wrench(force=(2.0, 0.0, 0.0), frame_id="world", stamp_ns=round(stamp_s * 1e9)))

    at(100.1)
    push(100.5)
    if paused:
        body.pause(True)
        clock[0] = 1.0
        if seen:  # by the diagnostics of every second
            follower.values()
        body.pause(False)
    at(1.0)
    assert follower.offset_ns == round(0.9e9)
    at(1.7)
    assert body.simulation.sample.linear_momentum_world[0] == pytest.approx(2.0)
    assert count(body, "superseded") == 1
    push(1.8)
    at(1.9)
    # 2 N for 0.1 s.
    assert body.simulation.sample.linear_momentum_world[0] == pytest.approx(2.2)
    # One of the time before that was under way.
    push(100.5)
    assert count(body, "superseded") == 2
    push(3.0)
    assert count(body, "superseded") == 2


@pytest.mark.parametrize("paused", [False, True])
def test_commands_that_wait_when_the_clock_leaps_ahead_keep_to_their_stamps(paused: bool) -> None:
    """A command stamped in the new time may overtake the clock; it acted when the body had gone all the way there."""
    clock = [100.0]
    follower = ClockFollower(lambda: round(clock[0] * 1e9))
    body = runner(SCENE.replace("duration: 1.0\n", ""), Mode(apply_at="stamp"), pacer=follower)

    def at(time_s: float) -> None:
        clock[0] = time_s
        follower.values()
        body.tick()
        while body.behind:
            body.tick()

    at(100.1)
    body.command("wrench", Wrench(force=(2.0, 0.0, 0.0), frame_id="world", stamp_ns=200_500_000_000))
    if paused:
        body.pause(True)
        at(200.0)
        body.pause(False)
    for time_s in (200.0, 200.7):
        at(time_s)
    # 2 N for 0.2 s, beside 2 N s at the start.
    assert body.simulation.sample.linear_momentum_world[0] == pytest.approx(2.4)


def test_a_command_that_comes_just_after_the_clock_jumped_has_the_stamp_of_the_new_time() -> None:
    class Waiting(Memory):
        def take_commands(self) -> None:
            while commands:
                body.command("wrench", commands.pop())

    clock, commands = [100.0], list[Wrench]()
    follower = ClockFollower(lambda: round(clock[0] * 1e9))
    body = runner(SCENE.replace("duration: 1.0\n", ""), Mode(apply_at="stamp"), Waiting(), pacer=follower)
    for clock[0] in (100.1, 1.0, 1.7):
        if clock[0] == 1.0:
            commands.append(Wrench(force=(2.0, 0.0, 0.0), frame_id="world", stamp_ns=1_500_000_000))
            body.prepare()
        body.tick()
        while body.behind:
            body.tick()
    # 2 N for 0.2 s, beside 2 N s at the start.
    assert body.simulation.sample.linear_momentum_world[0] == pytest.approx(2.4)
