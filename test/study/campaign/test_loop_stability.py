"""A loop that is too slow for what it turns is named before the runs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from campaigns import CAMPAIGN, SCENE, write

from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.study.campaign.block_of_runs import simulate_alone
from rb_dynamics.study.campaign.loop_stability import growth_per_sample, remarks
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.repeated_run import rerun

ROOT = Path(__file__).resolve().parents[3]


def flown(stiffness: float, damping: float, period: float, delay: float, lag: float = 0.0) -> float:
    """Return the growth per sample of the loop, sample by sample."""
    angle, rate, acting, size, (whole, part) = 1.0, 0.0, 0.0, [], divmod(delay, period)
    commands = [0.0] * (int(whole) + 1)
    for _ in range(400):
        commands.append(-stiffness * angle - damping * rate)
        for command, time in ((commands[-int(whole) - 2], part), (commands[-int(whole) - 1], period - part)):
            angle, rate = angle + rate * time + 0.5 * command * time * time, rate + command * time
            if lag:
                off, part_left = acting - command, math.exp(-time / lag)
                angle += off * lag * (time - lag * (1.0 - part_left))
                rate, acting = rate + off * lag * (1.0 - part_left), command + off * part_left
        size.append(math.hypot(angle, rate))
    return (max(size[300:350]) / max(size[100:150])) ** (1.0 / 200.0)


@pytest.mark.parametrize(
    "loop",
    [
        *((0.5, 0.7, 1.0, 0.3), (0.1, 0.3, 1.0, 2.4), (0.5, 2.5, 1.0, 0.0), (0.4, 0.8, 1.0, 1.0), (0.2, 0.6, 0.5, 0.1)),
        *((0.5, 0.7, 1.0, 0.3, 0.4), (0.5, 2.5, 1.0, 0.0, 0.8), (0.5, 0.4, 1.0, 1.2, 0.3)),
    ],
)
def test_the_growth_is_that_of_a_flown_loop(loop: tuple[float, ...]) -> None:
    assert growth_per_sample(*loop) == pytest.approx(flown(*loop), rel=5e-3)


def test_damping_alone_is_stable_up_to_twice_the_inertia_per_period() -> None:
    """And with a delay of a whole period up to once."""
    assert growth_per_sample(0.0, 1.99, 1.0, 0.0) == pytest.approx(0.99)
    assert growth_per_sample(0.0, 2.01, 1.0, 0.0) == pytest.approx(1.01)
    assert growth_per_sample(0.0, 0.99, 1.0, 1.0) < 1.0 < growth_per_sample(0.0, 1.01, 1.0, 1.0)


def test_a_loop_that_grows_and_a_body_that_is_too_fast_are_named(tmp_path: Path) -> None:
    assert remarks(read_campaign(write(tmp_path))) == []
    slow = CAMPAIGN.replace("  rate: 4\n", "  rate: 0.4\n")
    # The channel's own delay and lag count.
    for late, told in (("delay: 3", "a delay of 3.1 s,"), ("delay: 1, lag: 9", "1.1 s, followed with a lag of 9 s,")):
        scene = SCENE.replace("wrenches: []", f"wrenches: [{{topic: control, {late}}}]")
        assert told in remarks(read_campaign(write(tmp_path, scene=scene)))[0]
    for late in ("delay: 1", "lag: 9"):
        scene = SCENE.replace("wrenches: []", f"wrenches: [{{topic: control, {late}}}]")
        assert remarks(read_campaign(write(tmp_path, scene=scene))) == []
    (fast, unstable) = remarks(read_campaign(write(tmp_path, slow)))
    assert fast == "the body turns by 1.8 rad from one sample of the control law to the next; raise control.rate"
    assert unstable.startswith("rate_damping is unstable about the axis of 0.9")
    assert "2.5 s and a delay of 0.1 s" in unstable
    assert remarks(read_campaign(write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: math.floor")))) == []


@pytest.mark.parametrize("name", ["capture", "detumble", "rotor", pytest.param("spacecraft", marks=pytest.mark.slow)])
def test_the_shipped_campaigns_are_fast_enough(name: str) -> None:
    assert remarks(read_campaign(ROOT / "config" / "campaigns" / f"{name}.yaml")) == []


WHEEL_LAW = """\
import numpy as np


def law(parameters):
    momentum = np.array([0.0, 0.0, 0.3])
    gain = parameters["gain"][:, None]
    return lambda measured: -gain * measured.angular_velocity_body - np.cross(measured.angular_velocity_body, momentum)
"""

BALL = """\
body: {mass: 2.0, inertia: {diagonal: [1, 1, 1]}}
initial: {angular_velocity_body: [0.01, 0, 0]}
wrenches: []
solver: {method: rk4, step: 0.25}
duration: 87.0
output_rate: 1
"""

LOOP = """\
scene: scene.yaml
runs: 4
seed: 7
disperse:
  control.delay: {choice: {values: [0.0]}}
control: {law: wheel_law.law, rate: 1, parameters: {gain: 0.0}}
metrics: {final_rate: {final: rate}}
"""


def test_a_held_gyroscopic_torque_that_drives_the_body_is_named(tmp_path: Path) -> None:
    """Of a ball it is Euler's method on w' = i W w exactly: each sample multiplies the rate by sqrt(1 + (W T)^2)."""
    (tmp_path / "wheel_law.py").write_text(WHEEL_LAW, encoding="utf-8")
    campaign = write(tmp_path, LOOP, BALL)

    def end(period: float) -> float:
        """Return the root mean square of the rates in the fourth quarter of 87 samples."""
        factor = 1.0 + (0.3 * period) ** 2
        rates = [0.01**2 * factor ** (k / period) for k in range(66, 88)]
        return math.sqrt(sum(rates) / len(rates))

    (told,) = remarks(read_campaign(campaign))
    assert told.startswith("wheel_law.law depends on its period of 1 s: in the first 87 s of run 0 ")
    assert f"to {end(1.0):.2g} rad/s, with half the period and delay to no more than {end(0.5):.2g};" in told
    # With damping, or in less time than tells anything, nothing is said.
    assert remarks(read_campaign(write(tmp_path, LOOP.replace("gain: 0.0", "gain: 0.2"), BALL))) == []
    assert remarks(read_campaign(write(tmp_path, LOOP, BALL.replace("87.0", "10.0")))) == []
    # A loop that runs away is looked at until then; what runs away with half the period too may do so by intent.
    (told,) = remarks(read_campaign(write(tmp_path, LOOP.replace("gain: 0.0", "gain: 2.5"), BALL)))
    assert "with half the period" in told
    (told,) = remarks(read_campaign(write(tmp_path, LOOP.replace("gain: 0.0", "gain: 10.0"), BALL)))
    assert "with 1/8 of the period" in told
    assert remarks(read_campaign(write(tmp_path, LOOP.replace("gain: 0.0", "gain: -0.5"), BALL))) == []


MOMENTUM_WHEEL = """\
body: {mass: 10, inertia: {matrix: [[0.05, 0.001, 0], [0.001, 0.12, 0.002], [0, 0.002, 0.14]]}}
initial: {angular_velocity_body: [1.0e-6, 2.0e-6, -1.0e-6]}
wrenches: [{topic: control, delay: 3.0}]
actuators:
  - {type: reaction_wheel, name: x, axis: [1, 0, 0], inertia: 1.0e-3, max_speed: 300}
  - {type: reaction_wheel, name: y, axis: [0, 1, 0.2], inertia: 1.0e-3, max_speed: 300, speed: SPEED}
  - {type: reaction_wheel, name: z, axis: [0, 0, 1], inertia: 1.0e-3, max_speed: 300}
duration: 40
output_rate: 1
"""
THROUGH = """\
scene: scene.yaml
runs: 1
seed: 7
disperse: {control.delay: {choice: {values: [1.0]}}}
control: {law: rate_damping, rate: 1, delay: 1.0, through: [x, y, z], parameters: {gain: 0.02}}
metrics: {final_rate: {final: rate}}
"""


def test_a_momentum_wheel_counts_and_the_channel_of_a_torque_through_wheels_does_not(tmp_path: Path) -> None:
    assert remarks(read_campaign(write(tmp_path, THROUGH, MOMENTUM_WHEEL.replace("SPEED", "0")))) == []
    campaign = read_campaign(write(tmp_path, THROUGH, MOMENTUM_WHEEL.replace("SPEED", "100")))
    (told,) = remarks(campaign)
    assert told.startswith("rate_damping is unstable with 0.1 N m s in wheels and rotors: for a period of 1 s and a ")
    assert "delay of 1 s, an error grows by a factor of 1.13 per sample" in told
    rates: list[float] = []
    campaign = replace(campaign, observe_ns=10**9, metrics=())
    simulate_alone(campaign, 0, watch=lambda seen: rates.append(math.hypot(*seen.angular_velocity_body[0].tolist())))
    assert (rates[40] / rates[20]) ** (1.0 / 20.0) == pytest.approx(1.13, abs=0.02)


JETS_AND_WHEEL = """\
body:
  mass: 10
  inertia: {diagonal: [0.05, 0.12, 0.14]}
  frames: {jet: {position: [0, 0.1, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}
wrenches: []
actuators:
  - {type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-4, max_torque: 5.0e-3, max_speed: 60.0}
  - {type: thruster, name: jet, frame: jet, force: 0.01, minimum_on: 0.01}
duration: 5
"""
ASKING_TOO_MUCH = """\
import numpy as np


def law(parameters):
    return lambda measured: {
        "wheel": np.full(len(measured.angular_velocity_body), 4e-3),
        "jet": np.full(len(measured.angular_velocity_body), 0.005),
    }
"""


def test_a_wheel_near_its_limit_and_rejected_commands_are_named(tmp_path: Path) -> None:
    (tmp_path / "asking.py").write_text(ASKING_TOO_MUCH, encoding="utf-8")
    loop = LOOP.replace("wheel_law.law", "asking.law").replace(", parameters: {gain: 0.0}", "")
    campaign = read_campaign(write(tmp_path, loop, JETS_AND_WHEEL))
    near, rejected = remarks(campaign)
    assert near.startswith("wheel comes near its max_speed of 60 rad/s in run 0, at 2 s")
    assert rejected.startswith("5 commands are rejected in the first 6 samples of run 0, such as an on-time below")
    # The log of a run says so, too, and what that run met.
    rerun(campaign, 0, tmp_path / "run.mcap", tmp_path / "none.parquet")
    ((_, _, ((level, _, told, _, _),)),) = read_bag(tmp_path / "run.mcap").topics["/diagnostics"].decoded()
    assert (level, near in told, rejected in told) == (1, True, True)
    assert "; wheel was near its max_speed of 60 rad/s at " in told
    assert "5 commands were rejected and had no effect; the first: jet/command: an on-time of 0.005 s" in told


DAMPING = """\
def law(parameters):
    return lambda measured: -parameters["gain"][:, None] * measured.angular_velocity_body
"""


def test_a_law_that_hears_sensors_as_slow_as_itself_is_tried_with_faster_ones(tmp_path: Path) -> None:
    """With the old ones, sampling twice as often would change nothing: damping by 2.5 inertias per period grows."""
    (tmp_path / "damping.py").write_text(DAMPING, encoding="utf-8")
    loop = LOOP.replace("wheel_law.law", "damping.law").replace("gain: 0.0", "gain: GAIN")
    ball = f"{BALL}sensors: [{{type: imu, name: imu, rate: 1, gyro: {{noise_density: 1.0e-5}}}}]\n"
    (told,) = remarks(read_campaign(write(tmp_path, loop.replace("GAIN", "2.5"), ball)))
    assert told.startswith("damping.law depends on its period of 1 s")
    assert "sensors as fast" in told
    assert remarks(read_campaign(write(tmp_path, loop.replace("GAIN", "1.5"), ball))) == []
