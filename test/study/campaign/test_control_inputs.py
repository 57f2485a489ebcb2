"""Laws hear the sensors of the scene and command its actuators: the ones that `simulate` and the node have."""

from __future__ import annotations

import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import CAMPAIGN, SCENE, write

from rb_dynamics import Scene, Setpoint, Wrench, simulate
from rb_dynamics.errors import SceneError
from rb_dynamics.run.sink import ActuatorCommand, Event, Measurement, RunInfo
from rb_dynamics.study.campaign.block_of_runs import simulate_alone, simulate_block
from rb_dynamics.study.campaign.block_propagation import CHANNEL
from rb_dynamics.study.campaign.control import sharing
from rb_dynamics.study.campaign.engine import goes_side_by_side
from rb_dynamics.study.campaign.laws import RandomStreams
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.sampling import LAW, generator, inputs
from rb_dynamics.study.campaign.scenes import Scenes

SPACECRAFT = """\
body:
  mass: 10.0
  inertia: {diagonal: [0.05, 0.12, 0.14]}
  frames:
    jet: {position: [0.1, 0.15, 0.05], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}
    skew: {position: [0.1, 0, 0], orientation: {x: 0.6, y: 0, z: 0, w: 0.8}}
initial: {angular_velocity_body: [0.02, -0.03, 0.01]}
wrenches: [{topic: control, delay: 0.01}]
effects: [{type: magnetic_field, model: uniform, field_world: [2.0e-5, 0, -4.0e-5]}]
actuators:
  - {type: reaction_wheel, name: wheel_x, axis: [1, 0, 0], inertia: 1.0e-4, max_torque: 5.0e-4,
     friction: {coulomb: 1.0e-5}}
  - {type: reaction_wheel, name: wheel_y, axis: [0, 2, 0], inertia: 1.0e-4, speed: 100.0}
  - {type: reaction_wheel, name: wheel_z, axis: [0, 0, 1], inertia: 1.0e-4}
  - {type: thruster, name: jet, frame: jet, force: 0.5, minimum_on: 0.005, delay: 0.002}
  - {type: magnetorquer, name: rod, axis: [0, 0, 1], max_dipole: 0.2}
sensors:
  - {type: imu, name: imu, frame: skew, rate: 10.0, gyro: {noise_density: 1.0e-4, bias: [0, 0, 0]}, delay: 0.005}
  - {type: star_tracker, name: tracker, frame: skew, rate: 5.0, noise: 1.0e-4, delay: 0.15}
  - {type: magnetometer, name: mag, rate: 5.0, noise_density: 1.0e-8}
  - {type: sun_sensor, name: sun, rate: 5.0, direction_world: [-1, 0, 0], field_of_view: 0.5}
solver: {accuracy: 1.0e-6}
duration: 1.5
output_rate: 4
"""

LOOP = """\
scene: scene.yaml
runs: 3
seed: 7
disperse:
  initial.orientation: {turn: 0.1}
  actuators.wheel_x.max_torque: {normal: {relative: 0.1}}
  "actuators[1].inertia": {normal: {relative: 0.1}}
  sensors.imu.gyro.bias: {normal: {deviation: 1.0e-4}}
  control.delay: {uniform: {low: 0, high: 0.1}}
control: {law: spy.law, rate: 10, delay: 0.02, parameters: {stiffness: 0.01, damping: 0.05}}
metrics:
  final_rate: {final: rate}
  energy_defect: {worst: energy_defect}
  speed: {worst: wheel_speed}
  rejected: {final: rejected_commands}
  clipped: {final: clipped_commands}
"""

SPY = """\
import numpy as np

SEEN = []


def law(parameters):
    calls = 0

    def command(measured):
        nonlocal calls
        calls += 1
        SEEN.append(measured)
        q, rate = measured.orientation_xyzw, measured.angular_velocity_body
        wheels = parameters["stiffness"][:, None] * 2.0 * q[:, :3] + parameters["damping"][:, None] * rate
        wheels = wheels + 1e-6 * measured.random.normal(3)
        commands = {f"wheel_{axis}": wheels[:, i] for i, axis in enumerate("xyz")}
        commands["rod"] = 0.1 * np.sign(measured.sensors["mag"].magnetic_field[:, 0])
        if calls % 5 == 0:
            commands["jet"] = np.full(len(q), 0.002 if calls % 2 else 0.02)
            commands["force"] = 0.01 * measured.random.uniform(3)
        return commands

    return command
"""


class Recorder:
    """Keeps what a run is commanded and measures."""

    def __init__(self) -> None:
        self.commands: list[tuple[str, Wrench | Setpoint]] = []
        self.measured: list[Measurement] = []

    def open(self, run: RunInfo) -> None:
        """Begin."""

    def write(self, event: Event) -> None:
        """Keep an event."""
        if isinstance(event, Measurement):
            self.measured.append(event)
        elif isinstance(event, ActuatorCommand):
            self.commands.append((event.topic, Setpoint(event.value, event.time_ns)))
        elif getattr(event, "topic", "") == CHANNEL and (received := getattr(event, "received", None)):
            if not getattr(event, "delayed", False):
                self.commands.append((CHANNEL, received))
        elif isinstance(wrench := getattr(event, "wrench", None), Wrench):
            self.commands.append((event.topic, wrench))

    def close(self, result: Any) -> None:
        """End."""


def spacecraft(folder: Path, text: str = LOOP, scene: str = SPACECRAFT, law: str = SPY) -> Campaign:
    (folder / "spy.py").write_text(law, encoding="utf-8")
    campaign = read_campaign(write(folder, text, scene))
    if "spy" in campaign.modules.hashes:
        campaign.modules.load("spy").SEEN.clear()
    return campaign


def scene_of_run(campaign: Campaign, run: int) -> Scene:
    names, row = [each.name for each in campaign.inputs], inputs(campaign, run, run + 1)[0].tolist()
    return Scenes(campaign).whole(dict(zip(names, row, strict=True)), run)


def seen(campaign: Campaign) -> list[Any]:
    return list(campaign.modules.load("spy").SEEN)


def test_a_run_is_a_simulation_with_its_commands(tmp_path: Path) -> None:
    """And its books close: momentum and energy of the wheels are in them."""
    campaign = spacecraft(tmp_path)
    found = simulate_alone(campaign, 1, [recorder := Recorder()])
    again = Recorder()
    run = simulate(scene_of_run(campaign, 1), recorder.commands, [again])

    x, y, z = run.sample.angular_velocity_body
    assert found["final_rate"] == math.sqrt(x * x + y * y + z * z)
    assert again.measured == recorder.measured
    assert max(map(abs, run.sample.angular_momentum_defect_world)) < 1e-16
    assert max(map(abs, run.sample.linear_momentum_defect_world)) < 1e-16
    assert found["energy_defect"] < 1e-15
    # The tracker speaks at 0.15 s for the first time; of 13 calls, the fifth gives the jet 0.002 s, the tenth 0.02 s.
    assert len(recorder.commands) == 13 * 4 + 2 * 2
    assert found["rejected"] == 1.0
    assert found["clipped"] > 0.0
    assert found["speed"] >= 100.0


def test_a_run_is_the_same_in_any_block_and_process(tmp_path: Path) -> None:
    campaign = spacecraft(tmp_path)
    whole = simulate_block(campaign, 0, 2)
    parts = [simulate_block(pickle.loads(pickle.dumps(campaign)), run, run + 1) for run in (1, 0)]

    assert not any(whole["error"])
    assert not goes_side_by_side(campaign)
    for name in whole:
        assert [whole[name][run] for run in (1, 0)] == [part[name][0] for part in parts], name
    assert len(set(whole["final_rate"].tolist())) == 2


def test_a_law_hears_what_has_come_from_the_sensors(tmp_path: Path) -> None:
    campaign = spacecraft(tmp_path)
    simulate_alone(campaign, 0, [recorder := Recorder()])

    heard = seen(campaign)
    assert heard[0].time_s == 0.2
    for measured in heard:
        for name, part in (("imu", slice(13, 16)), ("tracker", slice(0, 4)), ("mag", slice(0, 3))):
            by_then = [
                each for each in recorder.measured if each.topic == name and each.time_ns <= measured.time_s * 1e9
            ]
            reading = measured.sensors[name]
            assert reading.time_s[0] == by_then[-1].taken_ns / 1e9
            assert tuple(next(iter(reading.values.values()))[0]) == by_then[-1].numbers[part]
        # The sun is behind; no one waits for it.
        assert np.isnan(measured.sensors["sun"].direction).all()
        assert np.isnan(measured.sensors["sun"].time_s).all()
        assert measured.magnetic_field_world.tolist() == [[2.0e-5, 0.0, -4.0e-5]]
    assert heard[0].wheel_speeds["wheel_y"][0] == pytest.approx(100.0, abs=1e-3)
    with pytest.raises(
        AttributeError, match=r"sensor imu has no torque, expected one of time_s, angular_velocity, spec"
    ):
        _ = heard[0].sensors["imu"].torque


def test_attitude_and_rate_are_turned_from_the_frame_of_the_sensor(tmp_path: Path) -> None:
    scene = re.sub(r"noise(_density)?: 1.0e-\d", r"noise\1: 0.0", SPACECRAFT)
    scene = scene.replace("delay: 0.15", "delay: 0.0").replace("delay: 0.005", "delay: 0.0")
    campaign = spacecraft(tmp_path, re.sub(r"disperse:.*?control:", "control:", LOOP, flags=re.DOTALL), scene)
    simulate_alone(campaign, 0)

    first = seen(campaign)[0]
    assert first.time_s == 0.0
    assert first.orientation_xyzw[0] == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-15)
    assert first.angular_velocity_body[0] == pytest.approx([0.02, -0.03, 0.01], rel=1e-14)
    assert first.sensors["imu"].angular_velocity[0] != pytest.approx([0.02, -0.03, 0.01], rel=1e-3)


def test_each_run_has_noise_and_random_numbers_of_its_own(tmp_path: Path) -> None:
    campaign = spacecraft(tmp_path)
    seeds = [scene_of_run(campaign, run).seed for run in range(3)]
    assert len(set(seeds)) == 3
    assert "seed: " in scene_of_run(campaign, 0).text

    streams = [RandomStreams(lambda runs=runs: [generator(7, run, LAW) for run in runs]) for runs in ((0, 1), (1,))]
    both, alone = ([draw(2) for draw in (each.normal, each.uniform)] for each in streams)
    assert [part[1].tolist() for part in both] == [part[0].tolist() for part in alone]
    assert both[0][0].tolist() != both[0][1].tolist()


def test_the_seed_of_a_run_cannot_be_dispersed(tmp_path: Path) -> None:
    text = LOOP.replace("disperse:\n", "disperse:\n  seed: {uniform: {low: 0, high: 9}}\n")
    with pytest.raises(SceneError, match=r"disperse.seed: found the seed, .* each run has a seed of its own"):
        spacecraft(tmp_path, text, SPACECRAFT + "seed: 3\n")


def test_a_number_is_dispersed_once(tmp_path: Path) -> None:
    text = LOOP.replace("disperse:\n", "disperse:\n  actuators.wheel_y.inertia: {normal: {relative: 0.1}}\n")
    with pytest.raises(SceneError, match="expected each number once"):
        spacecraft(tmp_path, text)


def test_the_inertia_is_not_dispersed_as_a_whole_and_in_part(tmp_path: Path) -> None:
    inner = "body.inertia.diagonal: {normal: {relative: 0.1}}"
    text = LOOP.replace("disperse:\n", f"disperse:\n  body.inertia: {{second_moments: 0.1, axes: 0}}\n  {inner}\n")
    with pytest.raises(SceneError, match=r"inertia.diagonal: found a key of what .* expected each number once"):
        spacecraft(tmp_path, text)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'commands["rod"]',
            'commands["rot"]',
            r"a command for 'rot', expected one of torque, force, wheel_x, wheel_y, ",
        ),
        (
            'commands["rod"] = 0.1',
            'commands["rod"] = np.ones(2)',
            r"shape \(2,\), expected \(1,\): a command to rod for",
        ),
        (
            '"force"] = 0.01 * measured.random.uniform(3)',
            '"force"] = np.ones(3)',
            r"\(3,\), expected \(1, 3\): a force",
        ),
    ],
)
def test_a_command_that_no_one_can_follow_fails_the_run(tmp_path: Path, old: str, new: str, said: str) -> None:
    [error] = simulate_block(spacecraft(tmp_path, law=SPY.replace(old, new)), 0, 1)["error"]
    assert re.search(said, error)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "0.1 * np.sign",
            "np.nan * np.sign",
            r"returned nan at simulation time 0.2 s, no finite command to rod",
        ),
        (
            "0.01 * measured.random",
            "1e300 * measured.random",
            r"e\+(299|300)\) N at simulation time 0.6 s, .* more than",
        ),
        ("measured.angular_velocity_body", "measured.sensors['gyro']", r"raised KeyError: 'gyro', spy.py:13"),
        (
            "measured.angular_velocity_body",
            "measured.sensors['imu'].rate",
            r"the sensor imu has no rate, expected one of time_s, .*, spy.py:13",
        ),
    ],
)
def test_a_run_with_an_impossible_command_fails(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert re.search(said, simulate_block(spacecraft(tmp_path, law=SPY.replace(old, new)), 0, 1)["error"][0])


BUILT_IN = LOOP.replace("law: spy.law", "law: attitude_pd, through: [wheel_x, wheel_y, wheel_z]").replace(
    "{stiffness: 0.01, damping: 0.05}", "{proportional: 0.01, derivative: 0.05}"
)


def test_wheels_give_the_torque_of_a_law(tmp_path: Path) -> None:
    campaign = spacecraft(tmp_path, BUILT_IN)
    simulate_alone(campaign, 0, [recorder := Recorder()])
    assert {topic for topic, _ in recorder.commands} == {f"wheel_{axis}/command" for axis in "xyz"}

    share = sharing(Scenes(campaign).base, ("wheel_x", "wheel_y", "wheel_z"))
    assert share == {"wheel_x": (-1, 0, 0), "wheel_y": (0, -1, 0), "wheel_z": (0, 0, -1)}


def test_the_torque_of_four_skew_wheels_is_that_of_the_law(tmp_path: Path) -> None:
    axes = [(1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 2.0)]
    wheels = [f"{{type: reaction_wheel, name: w{i}, axis: {list(a)}, inertia: 1.0e-4}}" for i, a in enumerate(axes)]
    scene = re.sub(r"actuators:.*?sensors", f"actuators: [{', '.join(wheels)}]\nsensors", SPACECRAFT, flags=re.DOTALL)
    text = re.sub(r"  (actuators|\"actuators).*\n", "", BUILT_IN).replace("wheel_x, wheel_y, wheel_z", "w0, w1, w2, w3")
    rows = sharing(Scenes(spacecraft(tmp_path, text, scene)).base, ("w0", "w1", "w2", "w3"))
    given = np.array([0.1, -0.2, 0.3])
    u = {name: np.dot(row, given) for name, row in rows.items()}
    assert -sum(u[f"w{i}"] * np.array(a) / np.linalg.norm(a) for i, a in enumerate(axes)) == pytest.approx(given)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (", through: [wheel_x, wheel_y, wheel_z]", "", r"add through: \[wheel_x, wheel_y, wheel_z\], or through: \[\]"),
        (
            "wheel_x, wheel_y, wheel_z",
            "wheel_x, wheel_y",
            "three wheels or more, with axes that do not lie in one plane",
        ),
        ("wheel_x, wheel_y, wheel_z", "wheel_x, jet", "torque is commanded, known: wheel_x, wheel_y, wheel_z"),
        (
            "rate: 10, ",
            "rate: 10, noise: {attitude: 2.0e-4, rate: 1.0e-3}, ",
            (
                r"remove noise, and write in the scene sensors: \[\{type: imu, name: imu, rate: 10, "
                r"gyro: \{noise_density: "
                r"0.000316228\}\}, \{type: star_tracker, name: tracker, rate: 10, noise: 0.0002\}\]"
            ),
        ),
        ("rate: 10, ", "rate: 10, saturation: 0.002, ", r"remove saturation, and write .* max_torque: 0.002 for react"),
        ("rate: 10, ", "rate: 10, bias: [0.1, 0, 0], ", r"\[\{topic: control, bias: \{torque: \[0.1, 0.0, 0.0\]\}\}\]"),
        ("control.delay", "control.noise.rate", "no number under control.noise.rate"),
        ("control.delay", "control.saturation", "no number under control.saturation"),
    ],
)
def test_what_the_scene_says_better_is_refused_with_the_new_lines(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    with pytest.raises(SceneError, match=said):
        spacecraft(tmp_path, BUILT_IN.replace(old, new))


def test_a_law_that_no_sensor_serves_is_refused(tmp_path: Path) -> None:
    scene = re.sub(r"  - \{type: star_tracker.*\n", "", SPACECRAFT)
    with pytest.raises(
        SceneError, match=r"no orientation_xyzw, expected a star_tracker or a pose in the scene for att"
    ):
        spacecraft(tmp_path, BUILT_IN, scene)
    assert (
        "no sensor of the scene measures the attitude"
        in simulate_block(spacecraft(tmp_path, LOOP, scene), 0, 1)["error"][0]
    )


@pytest.mark.parametrize("quantity", ["wheel_speed", "rejected_commands", "clipped_commands"])
def test_a_quantity_of_actuators_needs_them(tmp_path: Path, quantity: str) -> None:
    with pytest.raises(
        SceneError, match=f"metrics.final_rate.final: found {quantity}, expected a quantity that the sc"
    ):
        read_campaign(write(tmp_path, CAMPAIGN.replace("{final: rate}", f"{{final: {quantity}}}")))


def test_channels_of_the_scene_stay_as_they_are(tmp_path: Path) -> None:
    """The limits of the controller's own, too; then each run goes alone."""
    own = "{topic: control, max_torque: 0.05, on_excess: clip, delay: 0.01}"
    scene = SCENE.replace("wrenches: []", f"wrenches: [{{topic: jets, max_force: 2.0}}, {own}]")
    text = CAMPAIGN.replace("  control.delay: {choice: {values: [0.0, 0.1, 0.35]}}\n", "")
    campaign = read_campaign(write(tmp_path, text, scene))
    jets, control = Scenes(campaign).base.channels
    assert (jets.max_force, control.max_torque, control.on_excess, control.delay) == (2.0, 0.05, "clip", 0.01)
    assert not goes_side_by_side(campaign)
    simulate_alone(campaign, 0, [recorder := Recorder()])
    assert max(np.linalg.norm(wrench.torque) for _, wrench in recorder.commands if isinstance(wrench, Wrench)) > 0.05
    assert goes_side_by_side(read_campaign(write(tmp_path, text)))


def test_a_force_goes_side_by_side_and_alone_with_the_same_bits(tmp_path: Path) -> None:
    law = SPY.split("def law", 1)[0] + (
        "def law(parameters):\n    return lambda m: {'force': m.random.normal(3), 'torque': -m.angular_velocity_body}\n"
    )
    text = CAMPAIGN.replace("law: rate_damping", "law: spy.law").replace("{final: rate}", "{final: energy}")
    campaign = spacecraft(tmp_path, text, SCENE, law)
    assert goes_side_by_side(campaign)
    block = simulate_block(campaign, 0, 3)
    assert [simulate_alone(campaign, run)["final_rate"] for run in range(3)] == block["final_rate"].tolist()
    assert len({*block["final_rate"].tolist()}) == 3


@pytest.mark.parametrize("silent", ["delay: 10.0", "dropout: 0.999999"])
def test_a_run_whose_law_is_never_called_has_failed(tmp_path: Path, silent: str) -> None:
    """It would show a body without control as the result of the law."""
    campaign = spacecraft(tmp_path, scene=SPACECRAFT.replace("delay: 0.15", silent))
    rows = simulate_block(campaign, 0, 1)

    assert not seen(campaign)
    why = "control.law: spy.law was never called: it waits for a first message from tracker; correct their rate, "
    assert rows["error"] == [why + "delay or dropout, or make the run longer"]
    assert not rows["passed"].any()
