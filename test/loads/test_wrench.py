"""The wrench rule: frames, lever arm, refused values."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.errors import WrenchError
from rb_dynamics.loads.wrench import FixedFrame, HeldWrench, Wrench, WrenchFrames, all_with_floats, with_floats
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.vector import ZERO, Vector, norm

EPS = 2.0**-52

QUARTER_Z = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
FORCE, TORQUE = (1.0, -2.0, 3.0), (0.1, 0.2, -0.3)
CENTER = (0.11, -0.07, 0.23)

FRAMES = WrenchFrames(
    "map", "hull", {"thruster": FixedFrame((0.5, -0.25, 1.0), QUARTER_Z), "hook": FixedFrame((0.5, 0.0, 0.0))}, CENTER
)

numbers = st.floats(-10.0, 10.0).map(lambda x: x if abs(x) > 1e-6 else 0.0)
vectors = st.tuples(numbers, numbers, numbers)
quaternions = (
    st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: math.hypot(*q) > 0.01).map(rotation.normalize)
)


class TestFrames:
    @pytest.mark.parametrize("frame_id", ["", "hull"])
    def test_body_wrench_acts_in_body_axes_through_the_center_of_mass(self, frame_id: str) -> None:
        assert FRAMES.hold(Wrench(FORCE, TORQUE, frame_id)) == HeldWrench(force_body=FORCE, torque_body=TORQUE)

    def test_world_wrench_acts_in_world_axes_through_the_center_of_mass(self) -> None:
        assert FRAMES.hold(Wrench(FORCE, TORQUE, "map")) == HeldWrench(force_world=FORCE, torque_world=TORQUE)

    def test_fixed_frame_by_hand(self) -> None:
        """x of the thruster lies along y of the hull; its arm about the center of mass is (0.39, -0.18, 0.77)."""
        held = FRAMES.hold(Wrench((2.0, 0.0, 0.0), (0.0, 0.0, 1.0), "thruster"))

        assert math.dist(held.force_body, (0.0, 2.0, 0.0)) <= 4.0 * EPS
        assert math.dist(held.torque_body, (-1.54, 0.0, 1.0 + 0.78)) <= 8.0 * EPS
        assert held.force_world == held.torque_world == ZERO

    def test_a_frame_at_the_origin_is_not_the_body_frame(self) -> None:
        """The body frame acts through the center of mass, a fixed frame through its own origin."""
        frames = WrenchFrames(fixed={"origin": FixedFrame()}, center_of_mass=(1.0, 0.0, 0.0))

        assert frames.hold(Wrench((0.0, 1.0, 0.0), ZERO, "origin")).torque_body == (0.0, 0.0, -1.0)
        assert frames.hold(Wrench((0.0, 1.0, 0.0), ZERO, "body")).torque_body == ZERO

    @pytest.mark.parametrize("frame_id", ["world", "body", "Hull", "hull ", "nowhere"])
    def test_unknown_frame_is_refused_by_name(self, frame_id: str) -> None:
        with pytest.raises(WrenchError) as error:
            FRAMES.hold(Wrench(FORCE, TORQUE, frame_id))

        for word in (repr(frame_id), "'hull'", "'map'", "'thruster'", "'hook'"):
            assert word in str(error.value)

    @pytest.mark.parametrize("frame_id", ["hull", "map", "thruster"])
    def test_a_leading_slash_as_in_ros_1_means_nothing(self, frame_id: str) -> None:
        assert FRAMES.hold(Wrench(FORCE, TORQUE, f"/{frame_id}")) == FRAMES.hold(Wrench(FORCE, TORQUE, frame_id))

    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("part", ["force", "torque"])
    @pytest.mark.parametrize("place", [0, 1, 2])
    @pytest.mark.parametrize("frame_id", ["", "map", "thruster", "nowhere"])
    def test_what_is_not_finite_is_refused(self, bad: float, part: str, place: int, frame_id: str) -> None:
        values = [1.0, 2.0, 3.0]
        values[place] = bad

        with pytest.raises(WrenchError, match=f"wrench {part} .* expected .*three finite numbers"):
            FRAMES.hold(Wrench(**{part: tuple(values)}, frame_id=frame_id))

    @pytest.mark.parametrize("kind", [list, np.array, partial(np.array, dtype=np.float32)])
    def test_a_wrench_keeps_what_an_array_held_when_it_was_made(self, kind: Callable[[Vector], Any]) -> None:
        force, torque = kind((1.0, -2.0, 3.0)), kind((0.5, 0.25, -0.5))
        wrench = Wrench(force, torque)
        force[0] = torque[0] = math.nan

        assert (wrench.force, wrench.torque) == ((1.0, -2.0, 3.0), (0.5, 0.25, -0.5))
        assert hash(wrench) == hash(Wrench((1.0, -2.0, 3.0), (0.5, 0.25, -0.5)))

    @pytest.mark.parametrize("bad", [(1.0, 2.0), (1.0,) * 4, 3.0, None, "abc", [[1.0, 2.0, 3.0]], np.zeros(2)])
    @pytest.mark.parametrize("part", ["force", "torque"])
    def test_what_is_not_three_components_is_no_wrench(self, part: str, bad: Any) -> None:
        with pytest.raises(TypeError, match=f"wrench {part} is .*, expected three components"):
            Wrench(**{part: bad})

    @given(vectors, vectors)
    def test_a_wrench_is_taken_to_the_bit(self, force: Vector, torque: Vector) -> None:
        assert FRAMES.hold(Wrench(force, torque, "hull")).torque_body == torque
        assert FRAMES.hold(Wrench(force, torque, "map")).force_world == force


def test_a_frame_without_a_name_is_no_frame() -> None:
    with pytest.raises(TypeError, match="wrench frame_id is 5, expected a str"):
        Wrench(frame_id=5)  # type: ignore[arg-type]


class TestLeverArm:
    @given(vectors, vectors, vectors, vectors, quaternions)
    def test_is_the_rule(self, force: Vector, torque: Vector, place: Vector, center: Vector, axes) -> None:  # type: ignore[no-untyped-def]
        """tau_com = R tau + (p - c) x (R f), in exact arithmetic from the matrix of the frame."""
        held = WrenchFrames(fixed={"f": FixedFrame(place, axes)}, center_of_mass=center).hold(
            Wrench(force, torque, "f")
        )

        x, y, z, w = (Fraction(c) for c in axes)
        rows = (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
        f = [sum(row[i] * Fraction(force[i]) for i in range(3)) for row in rows]
        t = [sum(row[i] * Fraction(torque[i]) for i in range(3)) for row in rows]
        arm = [Fraction(p) - Fraction(c) for p, c in zip(place, center, strict=True)]
        moment = [arm[(i + 1) % 3] * f[(i + 2) % 3] - arm[(i + 2) % 3] * f[(i + 1) % 3] for i in range(3)]
        tolerance = 16.0 * EPS * (norm(torque) + norm(force) * (norm(place) + norm(center)))
        assert math.dist(held.force_body, [float(c) for c in f]) <= 16.0 * EPS * norm(force)
        assert math.dist(held.torque_body, [float(a + b) for a, b in zip(t, moment, strict=True)]) <= tolerance

    @given(vectors, vectors, vectors)
    def test_only_the_line_of_action_counts(self, force: Vector, place: Vector, center: Vector) -> None:
        """A force slid along its line has the same moment."""
        slid = tuple(p + 0.5 * f for p, f in zip(place, force, strict=True))
        frames = WrenchFrames(fixed={"a": FixedFrame(place), "b": FixedFrame(slid)}, center_of_mass=center)

        a, b = (frames.hold(Wrench(force, ZERO, name)).torque_body for name in ("a", "b"))

        assert math.dist(a, b) <= 8.0 * EPS * norm(force) * (norm(place) + norm(center) + norm(force))

    @given(st.lists(st.tuples(st.floats(0.1, 5.0), vectors, vectors), min_size=2, max_size=12))
    def test_is_the_moment_of_the_forces_on_many_particles(self, particles: list[tuple[float, Vector, Vector]]) -> None:
        """Forces on single particles, each commanded in a frame at the particle, sum to F and to N about their c."""
        total = math.fsum(m for m, _, _ in particles)
        center = tuple(math.fsum(m * p[i] for m, p, _ in particles) / total for i in range(3))
        frames = WrenchFrames(
            fixed={str(k): FixedFrame(p) for k, (_, p, _) in enumerate(particles)}, center_of_mass=center
        )

        held = HeldWrench()
        for k, (_, _, force) in enumerate(particles):
            held = held + frames.hold(Wrench(force, ZERO, str(k)))

        # N about c, the long way: moments about the body origin, less that of F at c.
        force = [math.fsum(f[i] for _, _, f in particles) for i in range(3)]
        moment = [
            math.fsum(p[(i + 1) % 3] * f[(i + 2) % 3] - p[(i + 2) % 3] * f[(i + 1) % 3] for _, p, f in particles)
            - (center[(i + 1) % 3] * force[(i + 2) % 3] - center[(i + 2) % 3] * force[(i + 1) % 3])
            for i in range(3)
        ]
        assert math.dist(held.force_body, force) <= 1e-12
        assert math.dist(held.torque_body, moment) <= 1e-11


def test_a_wrench_has_its_numbers_as_floats_from_the_start() -> None:
    """A run with many commands then takes them as they are; what may be no number is judged later."""
    wrench = Wrench((1, np.float64(2.0), 10**400), (-(10**400), True, "3"))  # type: ignore[arg-type]

    assert [*map(type, wrench.force + wrench.torque)] == [float, float, float, float, bool, str]
    assert wrench.force + wrench.torque == (1.0, 2.0, math.inf, -math.inf, True, "3")


def test_wrenches_become_floats_together_as_each_alone() -> None:
    odd = [Wrench((1, 2, 3)), Wrench((np.float32(0.25), 0.5, 3)), Wrench(torque=(0.0, math.inf, 0.0))]
    plain = [Wrench((1.0, 2.0, 3.0)), Wrench(torque=(0.0, math.nan, 0.0))]

    found = all_with_floats([*odd, *plain])

    assert found == [*map(with_floats, odd[:2]), odd[2], *plain]
    assert {type(n) for wrench in found for n in (*wrench.force, *wrench.torque)} == {float}
    assert all_with_floats(plain) is plain


def test_held_wrenches_add_by_part() -> None:
    a = HeldWrench((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0), (10.0, 11.0, 12.0))
    b = HeldWrench((0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.5), (-10.0, 0.0, 0.0))

    assert type(a + b) is HeldWrench
    assert a + b == HeldWrench((1.5, 2.0, 3.0), (4.0, 5.5, 6.0), (7.0, 8.0, 9.5), (0.0, 11.0, 12.0))
