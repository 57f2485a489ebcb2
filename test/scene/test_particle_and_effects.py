"""Bodies without inertia, and invalid entries of `effects`: errors with value, expectation and remedy."""

from __future__ import annotations

import pytest

from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.read import parse_scene

RIGID = "body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}\n"
PARTICLE = "body: {mass: 2}\n"


class TestParticle:
    def test_moves_as_the_full_model_of_a_body_that_does_not_turn(self) -> None:
        rest = (
            "initial: {position_world: [1, 2, 3], linear_velocity_world: [0.1, -0.7, 4], "
            "orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}\nduration: 3\noutput_rate: 5\n"
            "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}, "
            "{type: quadratic_drag, translation: [0.1, 0.3, 0.2]}]\nsolver: {method: rkmk4, step: 0.01}"
        )
        commands = [("wrench", Wrench((0.3, 0.1, -4.0), stamp_ns=1_000_000_000))]

        particle = simulate(parse_scene(PARTICLE + rest), commands).sample
        rigid = simulate(parse_scene(RIGID + rest), commands).sample

        assert particle == rigid

    def test_has_no_angular_momentum_and_no_attitude_to_change(self) -> None:
        sample = simulate(parse_scene(PARTICLE + "initial: {linear_velocity_world: [1, 2, 3]}\nduration: 2")).sample
        assert sample.angular_momentum_world == (0.0, 0.0, 0.0)
        assert sample.orientation_xyzw == (0.0, 0.0, 0.0, 1.0)
        assert sample.kinetic_energy == 14.0
        assert sample.position_world == (2.0, 4.0, 6.0)

    def test_a_torque_on_it_is_rejected(self) -> None:
        run = Simulation(parse_scene(PARTICLE + "duration: 1"))
        run.post("wrench", Wrench((1.0, 0.0, 0.0)))
        with pytest.raises(
            WrenchError, match=r"torque about the centre of mass is \[0.0, 0.5, 0.0\].*add body.inertia"
        ):
            run.post("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.5, 0.0)))

    def test_so_is_a_lever_arm(self) -> None:
        run = Simulation(parse_scene("body: {mass: 2, frames: {nozzle: {position: [1, 0, 0]}}}\nduration: 1"))
        run.post("wrench", Wrench((1.0, 0.0, 0.0), frame_id="nozzle"))
        with pytest.raises(WrenchError, match="it is a particle"):
            run.post("wrench", Wrench((0.0, 1.0, 0.0), frame_id="nozzle"))

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("initial: {angular_velocity_body: [0, 0, 1]}", "no angular velocity, since a body without inertia"),
            ("effects: [{type: rotor, axis_body: [0, 0, 1], axial_inertia: 1, spin_rate: 1}]", "no rotor, as a body"),
            ("effects: [{type: linear_drag, rotation: 1}]", "does not turn"),
            ("effects: [{type: scheduled_wrench, schedule: [{time: 0, torque: [1, 0, 0]}]}]", "it is a particle"),
        ],
    )
    def test_has_nothing_that_turns(self, text: str, message: str) -> None:
        with pytest.raises(SceneError, match=message):
            parse_scene(PARTICLE + text)

    def test_is_where_its_origin_is(self) -> None:
        with pytest.raises(SceneError, match=r"located at its origin; add body\.inertia"):
            parse_scene("body: {mass: 2, center_of_mass: [0, 0, 1]}")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("5", r"effects\[0\]: found 5, expected a mapping with the key type"),
        ("{}", "expected a mapping with the key type"),
        ("{type: gravity}", r"effects\[0\].type: found gravity, expected one of uniform_gravity, .*did you mean"),
        ("{type: [rotor]}", "expected one of uniform_gravity"),
        ("{type: uniform_gravity}", "acceleration_world: found nothing, expected a list of 3 numbers"),
        ("{type: uniform_gravity, acceleration: [0, 0, 1]}", "did you mean acceleration_world"),
        ("{type: uniform_gravity, acceleration_world: [0, 0, .nan]}", "expected a finite number"),
        ("{type: central_gravity}", "gravitational_parameter: found nothing"),
        ("{type: central_gravity, gravitational_parameter: -1}", "write mu = G M"),
        ("{type: central_gravity, gravitational_parameter: 1, gravity_gradient: yes please}", "expected true or false"),
        ("{type: linear_drag}", "at least one of translation and rotation"),
        ("{type: linear_drag, translation: -1}", "drag takes energy out"),
        ("{type: quadratic_drag, rotation: [1, 2]}", "expected a list of 3 numbers"),
        ("{type: rotor, axial_inertia: 1, spin_rate: 2}", "axis_body: found nothing"),
        ("{type: rotor, axis_body: [0, 0, 0], axial_inertia: 1, spin_rate: 2}", "expected a direction, not zero"),
        ("{type: rotor, axis_body: [0, 0, 1], axial_inertia: 0, spin_rate: 2}", "rotor's inertia about its own axis"),
        ("{type: rotor, axis_body: [0, 0, 1], axial_inertia: 1}", "spin_rate: found nothing"),
        ("{type: rotor, axis_body: [0, 0, 1], axial_inertia: 1, spin_rate: fast}", "expected a finite number"),
        ("{type: rotor, axis_body: [0, 0, 1], axial_inertia: 1, spin_rate: []}", "at least one entry"),
        (
            (
                "{type: rotor, axis_body: [0, 0, 1], axial_inertia: 1, "
                "spin_rate: [{time: 2, rate: 1}, {time: 1, rate: 1}]}"
            ),
            "times that grow from entry to entry",
        ),
        ("{type: scheduled_wrench}", "schedule: found nothing"),
        ("{type: scheduled_wrench, schedule: []}", "at least one entry"),
        ("{type: scheduled_wrench, schedule: [{force: [1, 0, 0]}]}", "time: found nothing"),
        ("{type: scheduled_wrench, frame_id: moon, schedule: [{time: 0}]}", "frame_id is 'moon', expected one of"),
        ("{type: scheduled_wrench, schedule: [{time: -1}]}", "expected a number from 0 to"),
    ],
)
def test_a_bad_effect_is_answered(entry: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(f"{RIGID}effects: [{entry}]")


def test_effects_that_are_no_list_are_answered() -> None:
    with pytest.raises(SceneError, match="expected a list of effects"):
        parse_scene(RIGID + "effects: {type: rotor}")


def test_one_number_is_for_all_axes() -> None:
    one, three = (
        parse_scene(RIGID + f"effects: [{{type: linear_drag, translation: {text}}}]").effects
        for text in ("3", "[3, 3, 3]")
    )
    assert one == three
