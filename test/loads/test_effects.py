"""Each effect against a closed-form motion, and its energy against the booked work."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motions import EPS, Recorder

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.effect import Effect, Point, Wrenching
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.motion.method import Increment
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics.rotation import angle_between, exp, multiply, normalize
from rb_dynamics.numerics.vector import Vector, add, add_scaled, cross, dot, norm, scale, subtract
from rb_dynamics.run.plan import Plan
from rb_dynamics.run.simulate import Run, simulate
from rb_dynamics.scene.read import parse_scene

SKEW = (
    "body: {mass: 2.5, center_of_mass: [0.1, -0.2, 0.3], "
    "inertia: {matrix: [[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]]}}"
)
BALL = "body: {mass: 2.0, inertia: {diagonal: [0.5, 0.5, 0.5]}}"


def run(text: str, duration: float, method: str = "auto", accuracy: float = 1e-11) -> Run:
    solver = f"solver: {{method: {method}, accuracy: {accuracy!r}}}"
    return simulate(parse_scene(f"{text}\nwrenches: []\noutput_rate: 1\nduration: {duration}\n{solver}"))


class TestUniformGravity:
    TEXT = (
        SKEW + "\ninitial: {linear_velocity_world: [1, 2, 3], angular_velocity_body: [0.3, -1, 0.7]}\n"
        "effects: [{type: uniform_gravity, acceleration_world: [0.5, 0, -9.8]}]"
    )

    def test_the_centre_of_mass_falls_on_a_parabola_and_the_spin_does_not_notice(self) -> None:
        weightless = run(self.TEXT.partition("effects")[0], 4.0).sample
        sample = run(self.TEXT, 4.0).sample

        fallen = subtract(sample.position_world, weightless.position_world)
        assert fallen == pytest.approx((4.0, 0.0, -78.4), abs=1e-13)
        assert sample.orientation_xyzw == weightless.orientation_xyzw
        assert sample.angular_velocity_body == weightless.angular_velocity_body

    def test_work_is_what_the_potential_loses(self) -> None:
        start, end = run(self.TEXT, 1e-9).sample, run(self.TEXT, 4.0).sample

        assert end.potential_energy is not None
        assert start.potential_energy is not None
        assert end.work == pytest.approx(start.potential_energy - end.potential_energy, rel=4 * EPS, abs=2e-7)
        assert abs(end.energy_defect) <= 4 * EPS * end.kinetic_energy

    def test_is_held_like_a_wrench_and_costs_no_step(self) -> None:
        result = run(self.TEXT, 4.0)

        assert result.method == "exact"
        assert result.steps == 1

    def test_every_method_takes_it(self) -> None:
        end = run(self.TEXT, 0.5).sample
        for name in METHODS:
            accuracy = 1e-4 if name in ("euler", "midpoint", "dlm2", "strang2", "dmv82") else 1e-8
            # So few steps are not worth a kernel for each method.
            with counted_by(Tally()):
                found = run(self.TEXT, 0.5, name, accuracy).sample
            assert norm(subtract(found.position_world, end.position_world)) <= 2 * accuracy, name
            assert angle_between(found.orientation_xyzw, end.orientation_xyzw) <= accuracy, name


class TestCentralGravity:
    def test_an_eccentric_orbit_is_keplers(self) -> None:
        """Over 1.3 periods, by Kepler's equation: a = 2, e = 0.5, mu = 3, from the perihelion on."""
        mu, a, e, time = 3.0, 2.0, 0.5, 1.3 * 2.0 * math.pi * math.sqrt(8.0 / 3.0)
        anomaly = mean = time * math.sqrt(mu / a**3)
        for _ in range(60):
            anomaly = mean + e * math.sin(anomaly)
        expected = (a * (math.cos(anomaly) - e), a * math.sqrt(1.0 - e * e) * math.sin(anomaly), 0.0)
        speed = math.sqrt(mu / a * (1.0 + e) / (1.0 - e))
        text = (
            f"body: {{mass: 7}}\ninitial: {{position_world: [1, 0, 0], linear_velocity_world: [0, {speed!r}, 0]}}\n"
            f"effects: [{{type: central_gravity, gravitational_parameter: {mu}}}]"
        )

        sample = run(text, round(time, 9)).sample

        assert norm(subtract(sample.position_world, expected)) < 1e-8
        assert abs(sample.energy_defect) < 1e-10

    def test_pitch_swings_at_the_frequency_of_the_lecture_books(self) -> None:
        """Small libration at 3 n^2 (Ix - Iz) / Iy, over one period of it, in an orbit that hardly feels it."""
        mu, radius = 3.986004418e14, 6_778_137.0
        n = math.sqrt(mu / radius**3)
        period = 2.0 * math.pi / (n * math.sqrt(3.0 * (10.0 - 2.0) / 11.0))
        upright = (0.5, -0.5, 0.5, -0.5)
        tilt = 1e-4
        x, y, z, w = multiply(upright, exp((0.0, tilt, 0.0)))

        def swing(duration: float) -> float:
            sample = run(
                "body: {mass: 50, inertia: {diagonal: [10, 11, 2]}}\n"
                f"initial: {{position_world: [{radius!r}, 0, 0], linear_velocity_world: [0, {n * radius!r}, 0], "
                f"orientation: {{x: {x!r}, y: {y!r}, z: {z!r}, w: {w!r}}}, angular_velocity_body: [0, {-n!r}, 0]}}\n"
                "effects: [{type: central_gravity, gravitational_parameter: 3.986004418e14, gravity_gradient: true}]",
                duration,
                accuracy=1e-9,
            ).sample
            orbit = exp((0.0, 0.0, n * duration))
            turned = multiply((-orbit[0], -orbit[1], -orbit[2], orbit[3]), sample.orientation_xyzw)
            relative = multiply((-upright[0], -upright[1], -upright[2], upright[3]), turned)
            return (
                2.0 * math.atan2(relative[1], relative[3])
                if relative[3] > 0
                else 2.0 * math.atan2(-relative[1], -relative[3])
            )

        assert swing(round(period, 9)) == pytest.approx(tilt, rel=1e-3)
        assert swing(round(0.5 * period, 9)) == pytest.approx(-tilt, rel=1e-3)

    @given(
        st.tuples(*[st.floats(-3.0, 3.0)] * 3).filter(lambda r: norm(r) > 0.5),
        st.tuples(*[st.floats(-3.0, 3.0)] * 3),
        st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda d: norm(d) > 0.1),
    )
    def test_force_and_torque_are_the_slope_of_the_potential(
        self, position: Vector, attitude: Vector, direction: Vector
    ) -> None:
        body = RigidBody.from_diagonal(1.3, (1.0, 1.5, 2.2))
        gravity = CentralGravity(2.0, (0.1, -0.2, 0.3), gravity_gradient=True)
        if norm(subtract(position, gravity.center_world)) < 0.3:
            return
        wrenching, potential = gravity.wrenching(body, 0.0), gravity.potential(body)
        q = exp(attitude)
        here = Point(0.0, position, (0.0, 0.0, 0.0), q, (0.0, 0.0, 0.0))
        force, torque = wrenching(here)

        h = 1e-5

        def moved(s: float) -> float:
            return potential(here._replace(position=add_scaled(position, s, direction)))

        def turned(s: float) -> float:
            return potential(here._replace(orientation=normalize(multiply(q, exp(scale(s, direction))))))

        scale_of_it = 1.0 + norm(force) + norm(torque) + abs(potential(here))
        assert dot(force, direction) == pytest.approx(-(moved(h) - moved(-h)) / (2 * h), abs=1e-7 * scale_of_it**3)
        assert dot(torque, direction) == pytest.approx(-(turned(h) - turned(-h)) / (2 * h), abs=1e-7 * scale_of_it**3)

    def test_energy_and_momentum_about_the_centre_are_kept(self) -> None:
        text = (
            "body: {mass: 3, inertia: {diagonal: [0.3, 0.4, 0.6]}}\n"
            "initial: {position_world: [2, 0, 0], linear_velocity_world: [0.1, 0.9, 0.2], "
            "angular_velocity_body: [0.4, 0.1, -0.3]}\n"
            "effects: [{type: central_gravity, gravitational_parameter: 2, gravity_gradient: true}]"
        )

        def kept(time: float) -> tuple[float, Vector]:
            s = run(text, time).sample
            assert s.potential_energy is not None
            about_center = add(s.angular_momentum_world, cross(s.position_world, s.linear_momentum_world))
            return s.kinetic_energy + s.potential_energy, about_center

        (energy, momentum), (energy_later, momentum_later) = kept(1e-9), kept(20.0)
        assert energy_later == pytest.approx(energy, rel=1e-10)
        assert norm(subtract(momentum_later, momentum)) < 1e-9 * norm(momentum)

    def test_a_body_that_falls_into_the_centre_is_told_so(self) -> None:
        text = "body: {mass: 1}\neffects: [{type: central_gravity, gravitational_parameter: 1.0}]"
        with pytest.raises(ConvergenceError, match=r"has reached the centre at \[0.0, 0.0, 0.0\].*start it further"):
            run(text, 1.0, "rk4", 1e-6)


class TestDrag:
    def test_linear_drag_is_exponential(self) -> None:
        text = (
            BALL + "\ninitial: {linear_velocity_world: [3, 0, 1], angular_velocity_body: [1, -2, 0.5]}\n"
            "effects: [{type: linear_drag, translation: 0.6, rotation: 0.2, medium_velocity_world: [0, 1, 0]}]"
        )

        sample = run(text, 4.0).sample

        left, turning = math.exp(-0.3 * 4.0), math.exp(-0.4 * 4.0)
        expected = (3.0 * left, 1.0 - left, left)
        assert sample.linear_velocity_world == pytest.approx(expected, abs=1e-10)
        assert sample.angular_velocity_body == pytest.approx((turning, -2.0 * turning, 0.5 * turning), abs=1e-10)
        path = (1.0 - left) / 0.3
        assert sample.position_world == pytest.approx((3.0 * path, 4.0 - path, path), abs=1e-10)
        # The angle turned is |w| (1 - exp) / rate, about an axis that stays.
        axis = scale((1.0 - turning) / 0.4, (1.0, -2.0, 0.5))
        assert angle_between(sample.orientation_xyzw, exp(axis)) < 1e-10
        assert abs(sample.energy_defect) < 1e-10

    def test_quadratic_drag_is_hyperbolic(self) -> None:
        text = (
            BALL + "\ninitial: {linear_velocity_world: [0, 8, 0], angular_velocity_body: [0, 0, 5]}\n"
            "effects: [{type: quadratic_drag, translation: 0.5, rotation: 0.1}]"
        )

        sample = run(text, 3.0).sample

        assert sample.linear_velocity_world[1] == pytest.approx(8.0 / (1.0 + 0.25 * 8.0 * 3.0), abs=1e-10)
        assert sample.position_world[1] == pytest.approx(math.log(1.0 + 0.25 * 8.0 * 3.0) / 0.25, abs=1e-10)
        assert sample.angular_velocity_body[2] == pytest.approx(5.0 / (1.0 + 0.2 * 5.0 * 3.0), abs=1e-10)

    def test_coefficients_are_along_the_axes_of_the_body(self) -> None:
        """Only the resistance along body x acts, on a body whose x axis points along world y: that part of v goes."""
        text = (
            "body: {mass: 1, inertia: {matrix: [[2, 0.3, 0], [0.3, 1.5, 0], [0, 0, 3]]}}\n"
            "initial: {orientation: {x: 0, y: 0, z: 0.7071067811865476, w: 0.7071067811865476}, "
            "linear_velocity_world: [1, 1, 1]}\n"
            "effects: [{type: linear_drag, translation: [0.7, 0, 0]}]"
        )

        assert run(text, 2.0).sample.linear_velocity_world == pytest.approx((1.0, math.exp(-1.4), 1.0), abs=1e-10)

    @given(st.tuples(*[st.floats(-5.0, 5.0)] * 3), st.tuples(*[st.floats(-5.0, 5.0)] * 3))
    def test_takes_energy_out(self, velocity: Vector, omega: Vector) -> None:
        scene = parse_scene(
            SKEW + "\neffects: [{type: linear_drag, translation: [1, 0, 2], rotation: 0.3}, "
            "{type: quadratic_drag, translation: 0.2, rotation: [0, 1, 0.5]}]"
        )
        load_from = scene.combined_effects.load_from(0.0)
        assert load_from is not None
        q = exp((0.3, -0.4, 1.2))
        force, torque = load_from(Point(0.0, (0.0, 0.0, 0.0), velocity, q, omega))(
            0.0, (0.0, 0.0, 0.0), velocity, q, omega
        )
        assert dot(force, velocity) + dot(torque, omega) <= 1e-12 * (norm(velocity) + norm(omega)) ** 3


class TestBuoyancy:
    GRAVITY = "{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}"
    LIFT = "{type: buoyancy, volume: 0.002, density: 1000, acceleration_world: [0, 0, -9.8], center_body: [0, 0, %s]}"
    BODY = "body: {mass: 2.0, center_of_mass: [0, 0, -0.04], inertia: {diagonal: [0.5, 0.5, 0.5]}}\n"

    def of(self, height: float, tilt: float, duration: float) -> Run:
        x, w = math.sin(tilt / 2), math.cos(tilt / 2)
        initial = f"initial: {{orientation: {{x: {x!r}, y: 0, z: 0, w: {w!r}}}}}\n"
        return run(f"{self.BODY}{initial}effects: [{self.GRAVITY}, {self.LIFT % height}]", duration)

    def test_a_neutral_body_swings_like_a_pendulum_about_its_centre_of_mass(self) -> None:
        # The centre of buoyancy is 0.1 m above the centre of mass: I a = -m g h sin(tilt).
        quarter = math.pi / 2 * math.sqrt(0.5 / (2.0 * 9.8 * 0.1))
        found = self.of(0.06, 1e-4, quarter).sample
        assert found.orientation_xyzw[0] == pytest.approx(0.0, abs=1e-11)
        assert found.angular_velocity_body[0] == pytest.approx(-1e-4 * math.pi / 2 / quarter, rel=1e-7)
        assert found.linear_momentum_world == pytest.approx((0.0, 0.0, 0.0), abs=1e-13)

    def test_what_it_gives_comes_from_its_potential_and_it_turns_over_if_it_is_below(self) -> None:
        for height, turned in ((0.06, False), (-0.14, True)):
            found = self.of(height, 0.5, 1.0)
            begun = self.of(height, 0.5, 1e-9)
            gained = found.sample.kinetic_energy
            assert found.sample.potential_energy is not None
            assert begun.sample.potential_energy is not None
            assert begun.sample.potential_energy - found.sample.potential_energy == pytest.approx(gained, rel=1e-8)
            assert (found.sample.orientation_xyzw[0] > math.sin(0.25)) == turned

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("{type: buoyancy, volume: 0, density: 1000, acceleration_world: [0, 0, -9.8]}", "greater than 0"),
            ("{type: buoyancy, density: 1000, acceleration_world: [0, 0, -9.8]}", "volume"),
        ],
    )
    def test_what_displaces_nothing_is_refused(self, text: str, expected: str) -> None:
        with pytest.raises(SceneError, match=expected):
            parse_scene(f"{BALL}\neffects: [{text}]")
        with pytest.raises(SceneError, match="particle and does not turn"):
            parse_scene(f"body: {{mass: 1}}\neffects: [{self.LIFT % 1}]")


class TestRotor:
    def test_spinning_up_at_rest_turns_the_body_back(self) -> None:
        """Nothing acts from outside: J s + I w = 0 at any time, and the angle is that of the integral of w."""
        text = (
            "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\n"
            "effects: [{type: rotor, axis_body: [0, 0, 5], axial_inertia: 0.1, "
            "spin_rate: [{time: 1, rate: 0}, {time: 3, rate: 40}]}]"
        )

        sample = run(text, 4.0).sample

        assert sample.angular_velocity_body == pytest.approx((0.0, 0.0, -0.1 * 40.0 / 3.0), abs=1e-12)
        assert sample.angular_momentum_world == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        angle = -0.1 / 3.0 * (40.0 + 40.0)  # half of 40 rad/s over 2 s, then 40 rad/s over 1 s
        assert angle_between(sample.orientation_xyzw, exp((0.0, 0.0, angle))) < 1e-11
        omega = -0.1 * 40.0 / 3.0
        assert sample.kinetic_energy == pytest.approx(1.5 * omega**2 + 0.1 * 40.0 * omega + 0.05 * 1600.0, rel=1e-12)
        assert sample.work == pytest.approx(sample.kinetic_energy, rel=1e-11)  # all of it is the motor's
        assert sample.potential_energy is None

    def test_precession_of_a_symmetric_gyrostat(self) -> None:
        """It w1' = -((I3 - It) w3 + h) w2: the transverse rate turns at ((I3 - It) w3 + h) / It."""
        text = (
            "body: {mass: 1, inertia: {diagonal: [2, 2, 3]}}\ninitial: {angular_velocity_body: [0.4, 0, 0.7]}\n"
            "effects: [{type: rotor, axis_body: [0, 0, 1], axial_inertia: 0.05, spin_rate: 30}]"
        )

        sample = run(text, 7.0).sample

        angle = (0.7 + 0.05 * 30.0) / 2.0 * 7.0
        expected = (0.4 * math.cos(angle), 0.4 * math.sin(angle), 0.7)
        assert sample.angular_velocity_body == pytest.approx(expected, abs=1e-10)

    @pytest.mark.parametrize("name", sorted(name for name, m in METHODS.items() if m.takes == LoadDependence.ANY))
    def test_keeps_the_momentum_of_the_whole(self, name: str) -> None:
        text = (
            SKEW + "\ninitial: {angular_velocity_body: [0.4, -0.2, 0.7]}\n"
            "effects: [{type: rotor, axis_body: [1, 1, 0], axial_inertia: 0.05, "
            "spin_rate: [{time: 0, rate: 5}, {time: 1, rate: 30}, {time: 1.5, rate: -10}]}]"
        )
        accuracy = {"euler": 1e-3, "midpoint": 1e-4}.get(name, 1e-8)

        # So few steps are not worth a kernel for each method.
        with counted_by(Tally()):
            sample, start = run(text, 2.0, name, accuracy).sample, run(text, 1e-9, name, accuracy).sample

        assert norm(subtract(sample.angular_momentum_world, start.angular_momentum_world)) < 10 * accuracy
        assert norm(sample.angular_momentum_defect_world) < 10 * accuracy
        assert abs(sample.energy_defect) < 10 * accuracy

    @given(st.floats(-1.0, 6.0))
    def test_the_rate_is_linear_between_its_knots(self, time: float) -> None:
        rotor = Rotor((0.0, 0.0, 1.0), 0.5, ((1.0, 0.0), (3.0, 8.0), (4.0, 6.0)))
        body = RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))
        stored = rotor.storing(body)(Point(time, (0.0,) * 3, (0.0,) * 3, (0.0, 0.0, 0.0, 1.0), (0.0,) * 3))
        rate = 0.0 if time < 1 else 4 * (time - 1) if time < 3 else 8 - 2 * (time - 3) if time < 4 else 6.0
        assert stored.momentum[2] == pytest.approx(0.5 * rate, abs=1e-12)
        assert stored.energy == pytest.approx(0.25 * rate**2, abs=1e-11)

    def test_a_schedule_ends_steps_at_its_knots(self) -> None:
        """The knot lies inside a step of rkmk4 and would break its order if steps did not end there."""
        text = (
            SKEW + "\ninitial: {angular_velocity_body: [0.4, -0.2, 0.7]}\nwrenches: []\nduration: 2\noutput_rate: 1\n"
            "effects: [{type: rotor, axis_body: [0, 0, 1], axial_inertia: 0.5, "
            "spin_rate: [{time: 0, rate: 0}, {time: 1.033, rate: 9}]}]\nsolver: {method: rkmk4, step: STEP}"
        )
        ends = [simulate(parse_scene(text.replace("STEP", step))).sample for step in ("0.04", "0.02", "0.0025")]
        coarse, fine = (angle_between(e.orientation_xyzw, ends[2].orientation_xyzw) for e in ends[:2])
        assert coarse / fine > 11.0


class TestScheduledWrench:
    def test_is_what_the_same_commands_do(self) -> None:
        body = SKEW + "\ninitial: {angular_velocity_body: [0.4, -0.2, 0.7]}\nduration: 3\noutput_rate: 10\n"
        scheduled = parse_scene(
            body + "wrenches: []\neffects: [{type: scheduled_wrench, schedule: "
            "[{time: 0.25, force: [1, 0, 2], torque: [0.1, 0.2, -0.3]}, {time: 1.5, torque: [0, 0.2, 0]}]}]"
        )
        commands = [
            ("wrench", Wrench((1.0, 0.0, 2.0), (0.1, 0.2, -0.3), stamp_ns=250_000_000)),
            ("wrench", Wrench((0.0, 0.0, 0.0), (0.0, 0.2, 0.0), stamp_ns=1_500_000_000)),
        ]

        assert simulate(scheduled).sample == simulate(parse_scene(body), commands).sample

    def test_is_told_to_the_sinks_under_a_name_of_its_own(self) -> None:
        scene = parse_scene(
            SKEW + "\nduration: 1\nwrenches: [{topic: wrench}]\neffects: [{type: uniform_gravity, "
            "acceleration_world: [0, 0, -1]}, {type: scheduled_wrench, schedule: [{time: 0.5, torque: [1, 0, 0]}]}, "
            "{type: scheduled_wrench, frame_id: world, schedule: [{time: 0.5, force: [1, 0, 0]}]}]"
        )
        recorder = Recorder()
        simulate(scene, sinks=[recorder])
        topics = [(event.topic, event.time_ns, event.frame_id) for event in recorder.events if hasattr(event, "topic")]
        assert topics == [
            ("effects/uniform_gravity", 0, "world"),
            ("effects/scheduled_wrench", 500_000_000, "body"),
            ("effects/scheduled_wrench_2", 500_000_000, "world"),
        ]

    def test_none_takes_the_place_of_another(self) -> None:
        """A kind may be named like the numbered second effect of another kind."""

        class Push(Effect):
            kind = "push"

            def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
                return ((0.0, Wrench((1.0, 0.0, 0.0))),)

        class Push2(Push):
            kind = "push_2"

        scene = replace(parse_scene(BALL), duration=1.0, effects=(Push2(), Push(), Push()))

        assert [name for name, _ in scene.combined_effects.schedules()] == [
            "effects/push_2",
            "effects/push",
            "effects/push_3",
        ]
        assert simulate(scene).sample.linear_momentum_world == pytest.approx((3.0, 0.0, 0.0), abs=1e-12)


class TestWhatIsNotListed:
    def test_costs_nothing(self) -> None:
        scene = parse_scene(SKEW)
        assert scene.combined_effects.load_from(0.0) is None
        assert scene.combined_effects.potential() is None
        assert scene.combined_effects.storing() is None
        assert scene.combined_effects.schedules() == []

    def test_a_method_that_cannot_take_an_effect_is_refused(self) -> None:
        scene = parse_scene(SKEW + "\neffects: [{type: linear_drag, rotation: 1}]\nsolver: {method: strang2}")
        with pytest.raises(SceneError, match=r"found strang2, expected a method that supports linear_drag: auto"):
            Plan(scene)

    def test_bits_do_not_depend_on_when_it_is_looked_at(self) -> None:
        ends = set()
        for rate in (1, 7, 100):
            scene = parse_scene(
                SKEW + f"\nduration: 2\noutput_rate: {rate}\ninitial: {{angular_velocity_body: [1, 2, 3]}}\n"
                "effects: [{type: linear_drag, rotation: 0.1, translation: 0.1}, "
                "{type: rotor, axis_body: [1, 0, 0], axial_inertia: 0.1, "
                "spin_rate: [{time: 0, rate: 1}, {time: 1, rate: 3}]}]"
            )
            ends.add(simulate(scene).sample)
        assert len(ends) == 1


def test_time_of_an_effect_is_that_of_the_run() -> None:
    """1e5 steps of 0.1 ms: the time that a load sees is the sum of all steps, rounded once."""
    zero = (0.0, 0.0, 0.0)
    phase = PhaseState((0.0, 0.0, 0.0, 1.0), zero, (0.0,) * 14, (0.0,) * 14)
    for _ in range(100_000):
        phase = phase.after(Increment(zero, phase.orientation, zero, zero, zero, 0.0), 1e-4)
    assert phase.time == float(100_000 * Fraction(1e-4))


class TestFromPython:
    """Effects made in Python are checked as those of a scene file are."""

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: Rotor((0.0, 0.0, 0.0), 0.1, ((0.0, 1.0),)), "expected the direction of its axis"),
            (lambda: Rotor((0.0, 0.0, 1.0), math.nan, ((0.0, 1.0),)), "axial_inertia is nan"),
            (lambda: Rotor((0.0, 0.0, 1.0), 0.1, ()), "expected at least one"),
            (lambda: Rotor((0.0, 0.0, 1.0), 0.1, ((-1.0, 1.0), (0.5, 3.0))), "not negative"),
            (lambda: Rotor((0.0, 0.0, 1.0), 0.1, ((1.0, 1.0), (0.5, 3.0))), "each later than the one before"),
            (lambda: Rotor((0.0, 0.0, 1.0), 0.1, ((1.0, 1.0), (1.0 + 1e-12, 3.0))), "by a nanosecond or more"),
            (lambda: LinearDrag((-1.0, 0.0, 0.0)), "drag takes energy out"),
            (lambda: QuadraticDrag(rotation=(0.0, math.inf, 0.0)), "three finite numbers"),
            (lambda: CentralGravity(-1.0), "greater than 0"),
            (lambda: CentralGravity(math.inf), "is inf, expected a number greater than 0"),
        ],
    )
    def test_nonsense_is_refused(self, make: Callable[[], Effect], message: str) -> None:
        with pytest.raises(SceneError, match=message):
            make()

    def test_a_rotor_that_is_no_part_of_the_body_is_refused(self) -> None:
        rotor = Rotor((1.0, 0.0, 1.0), 3.0, ((0.0, 1.0),))
        with pytest.raises(SceneError, match=r"axial_inertia is 3.0, expected at most 2 kg m\^2"):
            CombinedEffects(RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0)), (rotor,))

    def test_so_is_one_in_a_scene_file(self) -> None:
        with pytest.raises(SceneError, match=r"effects\[0\]: .*expected at most 0.5"):
            parse_scene(BALL + "\neffects: [{type: rotor, axis_body: [0, 0, 1], axial_inertia: 1, spin_rate: 1}]")


class TestALoadInsideTheStepThatIsNotDeclared:
    """No method would be checked for support of the load, so some results would be silently wrong."""

    class Undeclared(CentralGravity):
        kind = "undeclared"
        takes = LoadDependence.HELD

    class Late(Undeclared):
        def knots(self) -> tuple[float, ...]:
            return (0.5,)

        def wrenching(self, body: RigidBody, start: float) -> Wrenching | None:
            return super().wrenching(body, start) if start >= 0.5 else None

    MESSAGE = r"undeclared: has a load inside the step but takes is HELD, .*; declare takes = LoadDependence.FIELD"

    @pytest.mark.parametrize("method", ["auto", "taylor", "rk4", "strang2"])
    def test_is_refused_by_name(self, method: str) -> None:
        scene = parse_scene(BALL + f"\nduration: 0.1\nsolver: {{method: {method}}}")
        with pytest.raises(SceneError, match=self.MESSAGE):
            simulate(replace(scene, effects=(self.Undeclared(1.0, (1.0, 0.0, 0.0)),)))

    def test_is_refused_where_it_begins_later(self) -> None:
        scene = parse_scene(BALL + "\nduration: 1\nsolver: {method: rk4}")
        with pytest.raises(SceneError, match=self.MESSAGE):
            simulate(replace(scene, effects=(self.Late(1.0, (1.0, 0.0, 0.0)),)))


class TestNoCommandReachesAnEffect:
    TEXT = BALL + "\nduration: 1\neffects: [{type: uniform_gravity, acceleration_world: [0, 0, -1]}]\n"

    def test_by_its_name(self) -> None:
        run = simulate(parse_scene(self.TEXT), [("effects/uniform_gravity", Wrench())])
        assert run.sample.position_world == (0.0, 0.0, -0.5)
        assert len(run.rejected) == 1
        assert "expected one of ['wrench']" in run.rejected[0]

    def test_nor_can_a_channel_take_it(self) -> None:
        with pytest.raises(SceneError, match="expected a topic outside effects/"):
            parse_scene(self.TEXT + "wrenches: [{topic: effects/uniform_gravity}]")
