"""Wrench channels: when a command takes effect, how long it is held, and how channels add up."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rb_dynamics as rb
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.wrench import FixedFrame, HeldWrench, Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import AppliedWrench, Channel, RejectedWrench, WrenchChannels
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

MS = 1_000_000


def push(x: float, frame_id: str = "body") -> Wrench:
    return Wrench((x, 0.0, 0.0), ZERO, frame_id)


def channels(*which: Channel) -> WrenchChannels:
    frames = WrenchFrames(fixed={"hook": FixedFrame((0.0, 1.0, 0.0))}, center_of_mass=(0.0, 0.25, 0.0))
    return WrenchChannels(which or (Channel("wrench"),), frames)


def run(posted: WrenchChannels, until_ns: int) -> list[AppliedWrench]:
    """Apply each change at its own time, as a run does."""
    changes = []
    while (time_ns := posted.next_change_ns()) is not None and time_ns <= until_ns:
        changes += posted.apply(time_ns)
    return changes


class TestHold:
    def test_starts_at_zero(self) -> None:
        assert channels().total() == HeldWrench()
        assert channels().next_change_ns() is None
        assert channels().apply(10) == []

    def test_takes_effect_at_its_time_and_is_held(self) -> None:
        c = channels()
        c.post("wrench", push(1.0), 5 * MS)

        assert c.next_change_ns() == 5 * MS
        assert c.apply(5 * MS - 1) == []
        assert c.total() == HeldWrench()
        c.apply(5 * MS)
        assert c.total() == HeldWrench(force_body=(1.0, 0.0, 0.0))
        assert c.next_change_ns() is None
        c.apply(10**18)
        assert c.total() == HeldWrench(force_body=(1.0, 0.0, 0.0))

    def test_next_command_takes_the_place_of_the_last_whole(self) -> None:
        c = channels()
        c.post("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), "body"), 0)
        c.post("wrench", push(2.0, "world"), 1)
        run(c, 1)

        assert c.total() == HeldWrench(force_world=(2.0, 0.0, 0.0))

    def test_order_of_posting_does_not_matter_where_times_differ(self) -> None:
        c = channels()
        for k in (3, 1, 4, 0, 2):
            c.post("wrench", push(float(k)), k)

        assert [(a.time_ns, a.force[0]) for a in run(c, 9)] == [(k, float(k)) for k in range(5)]

    def test_of_equal_times_the_last_posted_wins_and_all_are_told(self) -> None:
        c = channels()
        for x in (1.0, 3.0, 2.0):
            c.post("wrench", push(x), 7)

        assert [a.force[0] for a in c.apply(7)] == [1.0, 3.0, 2.0]
        assert c.total().force_body == (2.0, 0.0, 0.0)

    def test_late_commands_take_effect_in_the_order_of_their_times(self) -> None:
        c = channels()
        c.post("wrench", push(2.0), 2)
        c.post("wrench", push(1.0), 1)

        assert [(a.time_ns, a.force[0]) for a in c.apply(100)] == [(100, 1.0), (100, 2.0)]
        assert c.total().force_body == (2.0, 0.0, 0.0)


class TestTimeout:
    def test_drops_to_zero_at_the_very_nanosecond(self) -> None:
        c = channels(Channel("wrench", timeout=0.1))
        c.post("wrench", push(1.0), 3)
        c.apply(3)

        assert c.next_change_ns() == 3 + 100 * MS
        assert c.apply(2 + 100 * MS) == []
        assert c.total().force_body == (1.0, 0.0, 0.0)
        assert c.apply(3 + 100 * MS) == [AppliedWrench(3 + 100 * MS, "wrench", None, "body", ZERO, ZERO)]
        assert c.total() == HeldWrench()
        assert c.next_change_ns() is None

    def test_each_command_begins_it_anew(self) -> None:
        c = channels(Channel("wrench", timeout=0.1))
        c.post("wrench", push(1.0), 0)
        c.post("wrench", push(2.0), 60 * MS)

        assert [(a.time_ns, a.force[0]) for a in run(c, 10**9)] == [(0, 1.0), (60 * MS, 2.0), (160 * MS, 0.0)]

    def test_command_at_the_time_of_expiry_wins(self) -> None:
        c = channels(Channel("wrench", timeout=0.1))
        c.post("wrench", push(1.0), 0)
        c.post("wrench", push(2.0), 100 * MS)

        assert [(a.time_ns, a.force[0]) for a in run(c, 150 * MS)] == [(0, 1.0), (100 * MS, 2.0)]
        assert c.total().force_body == (2.0, 0.0, 0.0)

    def test_command_one_nanosecond_later_finds_it_at_zero(self) -> None:
        c = channels(Channel("wrench", timeout=0.1))
        c.post("wrench", push(1.0), 0)
        c.post("wrench", push(2.0), 100 * MS + 1)

        changes = run(c, 150 * MS)

        assert [(a.time_ns, a.force[0]) for a in changes] == [(0, 1.0), (100 * MS, 0.0), (100 * MS + 1, 2.0)]

    def test_drops_its_own_channel_only(self) -> None:
        c = channels(Channel("a", timeout=0.1), Channel("b"))
        c.post("a", push(1.0), 0)
        c.post("b", push(10.0), 0)

        assert [(a.topic, a.received) for a in run(c, 10**9)][2:] == [("a", None)]
        assert c.total().force_body == (10.0, 0.0, 0.0)

    @pytest.mark.parametrize("timeout", [0.1, 0.3, 1.1, 1e-9, 0.123456789, 33.3])
    def test_is_a_whole_number_of_nanoseconds(self, timeout: float) -> None:
        c = channels(Channel("wrench", timeout=timeout))
        c.post("wrench", push(1.0), 0)
        c.apply(0)

        assert c.next_change_ns() == round(timeout * 1e9)

    def test_shorter_than_a_nanosecond_is_not_for_ever(self) -> None:
        with pytest.raises(SceneError, match="timeout is 1e-10, expected a time of 0 or from 1e-09"):
            Channel("wrench", timeout=1e-10)


class TestSum:
    def test_channels_add_up_in_the_order_of_the_scene(self) -> None:
        """1e16 + 1 - 1e16 depends on the order, so its bits show it."""
        for order in (("a", "b", "c"), ("c", "b", "a"), ("b", "a", "c")):
            c = channels(*map(Channel, order))
            values = {"a": 1e16, "b": 1.0, "c": -1e16}
            for k, topic in enumerate(("b", "c", "a")):
                c.post(topic, push(values[topic]), k)
            run(c, 9)
            assert c.total().force_body[0] == (0.0 + values[order[0]] + values[order[1]]) + values[order[2]]

    def test_body_and_world_parts_stay_apart(self) -> None:
        c = channels(Channel("a"), Channel("b"), Channel("c"))
        c.post("a", push(1.0, ""), 0)
        c.post("b", push(2.0, "world"), 0)
        c.post("c", push(4.0, "hook"), 0)
        c.apply(0)

        assert c.total() == HeldWrench(
            force_body=(5.0, 0.0, 0.0), torque_body=(0.0, 0.0, -3.0), force_world=(2.0, 0.0, 0.0)
        )

    @given(
        st.lists(
            st.tuples(
                st.integers(0, 50), st.sampled_from("abc"), st.integers(-9, 9), st.sampled_from(["body", "world"])
            ),
            max_size=30,
        )
    )
    def test_is_what_a_simple_model_says(self, posted: list[tuple[int, str, int, str]]) -> None:
        """The model: of each channel the last command, by time and then by arrival, unless it is 20 ns old."""
        c = channels(Channel("a", timeout=20e-9), Channel("b", timeout=7e-9), Channel("c"))
        for time_ns, topic, x, frame in posted:
            c.post(topic, push(float(x), frame), time_ns)

        lives = {"a": 20, "b": 7, "c": 10**9}
        for now in range(60):
            if c.next_change_ns() is not None and c.next_change_ns() <= now:
                c.apply(now)
            body = world = 0.0
            for topic, life in lives.items():
                known = [(t, k, x, f) for k, (t, name, x, f) in enumerate(posted) if name == topic and t <= now]
                if known:
                    time_ns, _, x, frame = max(known)
                    if now - time_ns < life:
                        body += x * (frame == "body")
                        world += x * (frame == "world")
            assert (c.total().force_body[0], c.total().force_world[0]) == (body, world)


class TestApplied:
    def test_says_what_was_received_and_what_it_does(self) -> None:
        c = channels(Channel("/robot/wrench"))
        wrench = Wrench((0.0, 0.0, 2.0), (0.5, 0.0, 0.0), "hook", 3)
        c.post("robot/wrench", wrench, 5)

        assert c.apply(5) == [AppliedWrench(5, "/robot/wrench", wrench, "body", (0.0, 0.0, 2.0), (2.0, 0.0, 0.0))]

    def test_world_wrench_stays_in_world_axes(self) -> None:
        c = channels()
        wrench = push(1.0, "world")
        c.post("/wrench", wrench, 0)

        assert c.apply(0) == [AppliedWrench(0, "wrench", wrench, "world", (1.0, 0.0, 0.0), ZERO)]


class TestRefusal:
    @pytest.mark.parametrize(
        ("topic", "wrench", "says"),
        [
            ("other", push(1.0), "wrench topic is 'other', expected one of"),
            ("wrench", push(math.nan), "finite"),
            ("wrench", push(1.0, "nowhere"), "'nowhere'"),
        ],
    )
    def test_has_no_effect(self, topic: str, wrench: Wrench, says: str) -> None:
        c = channels()
        c.post("wrench", push(1.0), 0)
        c.apply(0)

        with pytest.raises(WrenchError, match=says):
            c.post(topic, wrench, 1)

        rejected = c.apply(1)
        assert [(r.time_ns, r.topic, r.received) for r in rejected] == (
            [(1, "wrench", wrench)] if topic == "wrench" else []
        )
        assert all(isinstance(r, RejectedWrench) and says in r.reason for r in rejected)
        assert c.total().force_body == (1.0, 0.0, 0.0)

    def test_equal_times_come_in_the_order_of_the_scene(self) -> None:
        for order in (("a", "b"), ("b", "a")):
            c = WrenchChannels((Channel("a"), Channel("b")), WrenchFrames())
            for topic in order:
                c.post(topic, push(1.0), 5)
            assert [change.topic for change in c.apply(5)] == ["a", "b"]


class TestLimits:
    LIMITS = Channel("wrench", max_force=5.0, max_torque=1.0)

    @pytest.mark.parametrize(
        ("force", "torque", "says"),
        [
            ((3.0, 0.0, 4.1), ZERO, r"force is 5.08035432 N, expected at most max_force = 5.0 N of the channel wrench"),
            (ZERO, (0.0, -1.01, 0.0), r"torque is 1.01 N m, expected at most max_torque = 1.0 N m"),
            ((1e308, 1e308, 1e308), ZERO, "max_force"),
            ((math.inf, 0.0, 0.0), ZERO, "finite"),
        ],
    )
    def test_beyond_them_a_command_is_rejected(self, force: Vector, torque: Vector, says: str) -> None:
        c = channels(self.LIMITS)
        c.post("wrench", push(1.0), 0)
        with pytest.raises(WrenchError, match=says):
            c.post("wrench", Wrench(force, torque), 0)
        with pytest.raises(WrenchError, match=says):
            c.check("wrench", Wrench(force, torque)).require()

        assert [type(change) for change in c.apply(0)] == [AppliedWrench, RejectedWrench]
        assert c.total().force_body == (1.0, 0.0, 0.0)

    def test_at_them_it_acts_however_its_norm_is_rounded(self) -> None:
        c = channels(self.LIMITS)
        for k in range(1, 100):
            direction = (math.sin(k), math.cos(3.0 * k), 0.7)
            norm = math.sqrt(sum(v * v for v in direction))
            wrench = Wrench(tuple(5.0 / norm * v for v in direction), tuple(1.0 / norm * v for v in direction))
            assert not c.post("wrench", wrench, k)
            [applied] = c.apply(k)
            assert isinstance(applied, AppliedWrench)
            assert (applied.force, applied.torque, applied.clipped) == (wrench.force, wrench.torque, False)

    @pytest.mark.parametrize("size", [10.0, 1e200, 1e308])
    def test_clipped_it_keeps_its_direction(self, size: float) -> None:
        c = channels(replace(self.LIMITS, on_excess="clip"))
        wrench = Wrench((0.6 * size, 0.0, -0.8 * size), (0.0, 0.25, 0.0), "hook")
        assert c.post("wrench", wrench, 3)

        [applied] = c.apply(3)
        assert isinstance(applied, AppliedWrench)
        assert applied.clipped
        assert applied.received == wrench
        assert applied.force == pytest.approx((3.0, 0.0, -4.0), rel=1e-15)
        # The moment is that of the force that acts, and has no limit.
        assert applied.torque == pytest.approx((-0.75 * 4.0, 0.25, -0.75 * 3.0), rel=1e-15)

    def test_a_force_and_a_torque_are_clipped_each_for_itself(self) -> None:
        c = channels(replace(self.LIMITS, on_excess="clip"))
        c.post("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 9.0), "world"), 0)
        c.apply(0)

        assert c.total() == HeldWrench(force_world=(1.0, 0.0, 0.0), torque_world=(0.0, 0.0, 1.0))

    def test_infinite_is_rejected_where_others_are_clipped(self) -> None:
        c = channels(replace(self.LIMITS, on_excess="clip"))
        with pytest.raises(WrenchError, match="finite"):
            c.post("wrench", push(math.inf), 0)


class TestTooLarge:
    BODY = RigidBody.from_diagonal(2.0, (1.0, 2.0, 2.5))

    @pytest.mark.parametrize(
        ("wrench", "says"),
        [
            (push(1e308), r"force about the centre of mass is 1e\+308 N, expected at most 3.93e\+150 N"),
            (push(-1e200, "world"), "range of double precision"),
            (
                Wrench(torque=(0.0, 1e20, 0.0)),
                r"torque about the centre of mass is 1e\+20 N m, expected at most 1e",
            ),
            (Wrench((1e140, 0.0, 0.0), frame_id="hook"), "radian in a nanosecond"),
        ],
    )
    def test_is_rejected_like_infinity(self, wrench: Wrench, says: str) -> None:
        frames = WrenchFrames(fixed={"hook": FixedFrame((0.0, 1.0, 0.0))})
        c = WrenchChannels((Channel("wrench"),), frames, (), self.BODY)
        c.post("wrench", push(1.0), 0)
        with pytest.raises(WrenchError, match=says):
            c.post("wrench", wrench, 0)

        assert [type(change) for change in c.apply(0)] == [AppliedWrench, RejectedWrench]
        assert c.total().force_body == (1.0, 0.0, 0.0)

    def test_a_particle_has_no_torque_to_be_too_large(self) -> None:
        c = WrenchChannels((Channel("wrench"),), WrenchFrames(turns=False), (), RigidBody.particle(2.0))
        c.post("wrench", push(1e100), 0)
        assert [type(change) for change in c.apply(0)] == [AppliedWrench]


class TestDelayAndBias:
    SCENE = """
body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}
wrenches:
  - {topic: wrench, timeout: 0.1, delay: 0.02, max_force: 4, bias: {force: [0, 0, 0.5], torque: [0.1, 0, 0]}}
duration: 0.3
output_rate: 50
"""

    def test_a_command_is_told_when_it_comes_and_acts_after_the_delay(self) -> None:
        c = channels(Channel("wrench", timeout=1e-6, delay=2e-8))
        c.post("wrench", push(1.0), 100)
        c.post("wrench", push(2.0), 110)
        with pytest.raises(WrenchError):
            c.post("wrench", push(math.nan), 105)
        told = []
        while (time_ns := c.next_change_ns()) is not None:
            told += [(type(change).__name__, change.time_ns) for change in c.apply(time_ns)]
            assert time_ns < 10_000
            if time_ns == 120:
                assert c.total().force_body == (1.0, 0.0, 0.0)
        assert told == [
            ("ReceivedWrench", 100),
            ("RejectedWrench", 105),
            ("ReceivedWrench", 110),
            ("AppliedWrench", 120),
            ("AppliedWrench", 130),
            ("AppliedWrench", 1130),
        ]

    def test_what_is_on_its_way_is_outstanding_from_when_it_came(self) -> None:
        c = channels(Channel("wrench", delay=2e-8))
        c.post("wrench", push(1.0), 100)
        c.apply(100)
        assert [time_ns for _, _, time_ns in c.outstanding()] == [100]

    def test_delayed_commands_act_in_the_order_in_which_they_were_told(self) -> None:
        """A node that fell behind let the first to arrive act last; its log, and so a replay, had the other order."""
        c = channels(Channel("wrench", delay=2e-8))
        c.post("wrench", replace(push(1.0), stamp_ns=5), 5)
        c.post("wrench", replace(push(2.0), stamp_ns=3), 3)
        told = c.apply(3)
        assert c.hasten(9, 3) == []
        told += c.apply(3)
        assert [change.received for change in told] == [replace(push(2.0), stamp_ns=3), replace(push(1.0), stamp_ns=5)]
        assert [change.received for change in c.apply(23)] == [change.received for change in told]

    def test_impulse_log_and_replay_of_a_delayed_and_biased_channel(self, tmp_path: Path) -> None:
        scene, path = rb.parse_scene(self.SCENE), tmp_path / "run.mcap"
        commands = [("wrench", Wrench((0.0, 3.0, 0.0), stamp_ns=50_000_000)), ("wrench", push(9.0))]
        run = rb.simulate(scene, commands, [McapSink(path)])
        # 0.1 s until the timeout; the bias, on a body that turns slowly, all the time.
        assert rotate_inverse(run.sample.orientation_xyzw, run.sample.linear_momentum_world) == pytest.approx(
            (0.0, 0.3, 0.15), abs=2e-3
        )
        assert len(run.rejected) == 1
        bag = read_bag(path)
        assert bag.topics["/wrench"].log_times.tolist() == [0, 50_000_000]
        assert bag.topics["/wrench/applied"].log_times.tolist() == [70_000_000, 170_000_000]
        assert bag.topics["/effects/wrench/bias/applied"].numbers.tolist() == [[0.0, 0.0, 0.5, 0.1, 0.0, 0.0]]
        assert replay(path).identical
        again = rb.simulate(scene, RecordedWrenches([path], ["wrench"], start="auto"))
        assert again.sample == run.sample
        assert rb.inspect(path).passed


@pytest.mark.parametrize("name", ["max_force", "max_torque", "timeout", "delay"])
def test_a_masked_number_is_no_limit(name: str) -> None:
    """It was kept, and every comparison with it was neither true nor false."""
    for masked in (np.ma.masked, np.ma.array(1.0, mask=True)):
        with pytest.raises(TypeError, match=f"^{name} is .*, expected a "):
            Channel("wrench", **{name: masked})
