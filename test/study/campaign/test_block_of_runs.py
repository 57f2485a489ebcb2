"""Blocks of runs: each run has the bits it would have alone, and the controller works as documented."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import CAMPAIGN, SCENE, write

from rb_dynamics import Simulation, Wrench, simulate
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.sinks.memory_sink import MemorySink
from rb_dynamics.study.campaign.block_of_runs import simulate_alone, simulate_block, watch_runs
from rb_dynamics.study.campaign.block_propagation import CHANNEL
from rb_dynamics.study.campaign.engine import goes_alone, goes_side_by_side
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.sampling import inputs
from rb_dynamics.study.campaign.scenes import Scenes
from rb_dynamics.study.campaign.user_functions import FunctionError

EFFECT = "effects: [{type: linear_drag, rotation: 0.05}]\n"
ACCURATE = ("solver: {method: rk4, step: 0.05}", "solver: {method: auto, accuracy: 1.0e-8}")


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compilation does not pay here; test_ensemble.py shows that compiled runs have the same bits."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")


def rows(columns: dict[str, Any]) -> list[str]:
    lists = [column if isinstance(column, list) else column.tolist() for column in columns.values()]
    return [repr(row) for row in zip(*lists, strict=True)]


@pytest.mark.parametrize("scene", [SCENE, SCENE + EFFECT, SCENE.replace(*ACCURATE)], ids=["many", "effect", "auto"])
def test_a_run_is_the_same_in_any_block(tmp_path: Path, scene: str) -> None:
    campaign = read_campaign(write(tmp_path, CAMPAIGN, scene))
    whole = simulate_block(campaign, 0, 14)

    parts = [
        row for first, last in ((0, 1), (1, 12), (12, 14)) for row in rows(simulate_block(campaign, first, last, 1))
    ]
    assert parts == rows(whole)
    assert not any(whole["error"])
    assert len(set(whole["final_rate"].tolist())) == 14


@pytest.mark.parametrize("law", ["rate_damping", "b_dot", "attitude_pd"])
def test_a_run_alone_has_the_bits_of_the_block(tmp_path: Path, law: str) -> None:
    parameters = {
        "rate_damping": "{gain: 1.0}",
        "b_dot": "{gain: 1.0, field_period: 3.0}",
        "attitude_pd": "{gain: 1.0}",
    }[law]
    text = CAMPAIGN.replace("law: rate_damping", f"law: {law}").replace("{gain: 1.0}", parameters)
    if law == "attitude_pd":
        aim = "{proportional: 0.7, derivative: 1.1, target: {x: 0.6, y: 0, z: 0, w: 0.8}}"
        text = text.replace("{gain: 1.0}", aim)
        text = text.replace("control.parameters.gain: {log_uniform", "control.parameters.derivative: {log_uniform")
    campaign = read_campaign(write(tmp_path, text))
    block = simulate_block(campaign, 0, 4)

    for run in range(4):
        alone = simulate_alone(campaign, run)
        assert {name: repr(value) for name, value in alone.items()} == {
            name: repr(float(block[name][run])) for name in alone
        }


@pytest.mark.parametrize(
    "effect",
    [
        "uniform_gravity, acceleration_world: [0, 0.5, -9.81]",
        "linear_drag, rotation: 0.05",
        "central_gravity, gravitational_parameter: 3.0, gravity_gradient: true, center_world: [9, 0.5, 0.1]",
    ],
)
@pytest.mark.parametrize("driven", [True, False])
def test_effects_go_side_by_side(tmp_path: Path, effect: str, driven: bool) -> None:
    text = CAMPAIGN.replace("[0.0, 0.1, 0.35]", "[0.0, 0.1, 0.3]")
    if not driven:
        text = re.sub(r"  control\..*\n|control:\n(  .*\n)*", "", text)
    scene = SCENE.replace("angular_velocity_body", "linear_velocity_world: [1, 0, 3]\n  angular_velocity_body")
    campaign = read_campaign(write(tmp_path, text, f"{scene}effects: [{{type: {effect}}}]\n"))
    assert (campaign.control is not None) == driven
    assert goes_side_by_side(campaign)

    block = simulate_block(campaign, 0, 3)
    for run in range(3):
        alone = simulate_alone(campaign, run)
        assert {name: repr(value) for name, value in alone.items()} == {
            name: repr(float(block[name][run])) for name in alone
        }


@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("solver", ["step: 0.05", "accuracy: 1.0e-4"])
def test_effects_of_plugins_go_side_by_side_or_in_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, driven: bool, solver: str
) -> None:
    point = EntryPoint("rope", "plugin_effects:Roped", "rb_dynamics.effects")
    monkeypatch.setattr(EFFECTS, "_loaded", {})
    monkeypatch.setitem(vars(EFFECTS), "_plugins", {"rope": [point]})
    text = CAMPAIGN.replace("[0.0, 0.1, 0.35]", "[0.0, 0.1, 0.3]")
    if not driven:
        text = re.sub(r"  control\..*\n|control:\n(  .*\n)*", "", text).replace("require", "observe_rate: 7\nrequire")
    scene = SCENE.replace("step: 0.05", solver) + "effects: [{type: rope}]\n"
    campaign = read_campaign(write(tmp_path, text, scene))
    assert goes_side_by_side(campaign) == ("step" in solver)
    assert goes_alone(campaign) == (driven and "accuracy" in solver)

    block = simulate_block(campaign, 0, 3)
    assert not any(block["error"])
    for run in range(3):
        alone = simulate_alone(campaign, run)
        assert {name: repr(value) for name, value in alone.items()} == {
            name: repr(float(block[name][run])) for name in alone
        }


@pytest.mark.parametrize(
    ("effect", "solver"),
    [
        ("rotor, axis_body: [0, 0, 1], axial_inertia: 0.1, spin_rate: 5", "{method: rk4, step: 0.05}"),
        ("scheduled_wrench, schedule: [{time: 1, force: [0, 0, 1], torque: [0, 0, 1]}]", "{method: rk4, step: 0.05}"),
        ("magnetic_field, model: uniform, field_world: [1.0e-5, 0, 0]", "{method: rk4, step: 0.05}"),
        ("linear_drag, rotation: 0.05", "{method: rk4, accuracy: 1.0e-6}"),
    ],
)
def test_other_effects_do_not(tmp_path: Path, effect: str, solver: str) -> None:
    text = CAMPAIGN.replace("[0.0, 0.1, 0.35]", "[0.0, 0.1, 0.3]")
    scene = SCENE.replace("{method: rk4, step: 0.05}", solver) + f"effects: [{{type: {effect}}}]\n"
    assert not goes_side_by_side(read_campaign(write(tmp_path, text, scene)))


QUANTITIES = """
def torque_impulse(samples): return samples.torque_impulse_world[:, 0]
def impulse(samples): return samples.impulse_world[:, 2]
def momentum(samples): return samples.angular_momentum_world[:, 1]
def work(samples): return samples.work
"""


@pytest.mark.parametrize(
    "effects",
    [
        "rotor, axis_body: [0, 0, 1], axial_inertia: 0.1, spin_rate: [{time: 0.3, rate: 5}, {time: 1.2, rate: 2}]",
        "scheduled_wrench, schedule: [{time: 1, force: [0, 0, 1], torque: [0, 0, 1]}]",
        "linear_drag, rotation: 0.05, translation: 0.1",
        "linear_drag, rotation: 1.0e-18",
    ],
)
@pytest.mark.parametrize("solver", ["auto, accuracy: 1.0e-7", "rk4, accuracy: 1.0e-5", "rk4, step: 0.05"])
def test_runs_in_turn_have_the_bits_of_a_run_alone(tmp_path: Path, effects: str, solver: str) -> None:
    (tmp_path / "turn_quantities.py").write_text(QUANTITIES)
    names = ("torque_impulse", "impulse", "momentum", "work")
    text = re.sub(r"  control\..*\n|control:\n(  .*\n)*", "", CAMPAIGN)
    text = text.replace("metrics:", "\n".join(["metrics:", *(f"  {n}: {{mean: turn_quantities.{n}}}" for n in names)]))
    scene = SCENE.replace("angular_velocity_body", "linear_velocity_world: [1, 0, 3]\n  angular_velocity_body")
    scene = scene.replace("method: rk4, step: 0.05", f"method: {solver}") + f"effects: [{{type: {effects}}}]\n"
    campaign = read_campaign(write(tmp_path, text.replace("require", "observe_rate: 7\nrequire"), scene))

    block = simulate_block(campaign, 0, 3)
    assert not any(block["error"])
    for run in range(3):
        alone = simulate_alone(campaign, run)
        assert {name: repr(value) for name, value in alone.items()} == {
            name: repr(float(block[name][run])) for name in alone
        }


def test_a_run_in_turn_that_fails_leaves_the_others_alone(tmp_path: Path) -> None:
    text = "scene: scene.yaml\nruns: 8\nseed: 1\nsampling: random\nobserve_rate: 20\n"
    text += "disperse:\n  'initial.position_world[0]': {uniform: {low: 0.5, high: 2.0}}\n"
    text += "metrics: {worst_rate: {worst: rate}}\n"
    scene = SCENE.replace("{method: rk4, step: 0.05}", "{method: auto, accuracy: 1.0e-6}")
    scene = scene.replace("initial:", "initial:\n  position_world: [1, 0, 0]")
    scene += "effects: [{type: central_gravity, gravitational_parameter: 0.3}]\n"
    campaign = read_campaign(write(tmp_path, text, scene))

    block = simulate_block(campaign, 0, 8)
    failed = [bool(error) for error in block["error"]]
    assert 0 < sum(failed) < 8
    for run, error in enumerate(block["error"]):
        if error:
            assert math.isnan(block["worst_rate"][run])
            with pytest.raises(ConvergenceError, match=re.escape(error)):
                simulate_alone(campaign, run)
        else:
            assert simulate_alone(campaign, run)["worst_rate"] == block["worst_rate"][run]


def test_a_run_alone_ends_when_its_scene_does(tmp_path: Path) -> None:
    """8562165.564 * 1e9 is a nanosecond less in double precision."""
    text = "scene: scene.yaml\nset: {duration: 8562165.564, output_rate: 1e-6}\nobserve_rate: 1e-6\nruns: 1\n"
    scene = SCENE.replace("{method: rk4, step: 0.05}", "{method: auto, accuracy: 1.0e-6}")
    campaign = read_campaign(write(tmp_path, text + "metrics: {final_rate: {final: rate}}\n", scene))
    simulate_alone(campaign, 0, [memory := MemorySink()])
    assert memory.time_ns[-1] == 8_562_165_564_000_000


def test_the_controller_is_what_it_is_said_to_be(tmp_path: Path) -> None:
    """The commands of a run, made again by hand: sampled, damped, limited, biased and late."""
    text = CAMPAIGN.replace("noise: {rate: 0.01, attitude: 0.01}", "bias: [0.01, 0, -0.02]")
    campaign = read_campaign(write(tmp_path, text))
    names, run = [each.name for each in campaign.inputs], 3
    values = dict(zip(names, inputs(campaign, run, run + 1)[0].tolist(), strict=True))
    scene = Scenes(campaign).whole(values)

    simulation, delay_ns = Simulation(scene), round(values["control.delay"] * 20) * 50_000_000
    for k in range(8):
        simulation.advance(k * 250_000_000)
        spin = simulation.look().angular_velocity_body
        torque = [min(max(-values["control.parameters.gain"] * w, -0.6), 0.6) for w in spin]
        biased = (torque[0] + 0.01, torque[1], torque[2] - 0.02)
        simulation.post(CHANNEL, Wrench(torque=biased), k * 250_000_000 + delay_ns)
    simulation.advance(2_000_000_000)
    w = simulation.sample.angular_velocity_body
    assert simulate_block(campaign, run, run + 1)["final_rate"][0] == math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])


def test_noise_is_of_the_size_that_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "spy_law.py").write_text(
        "import numpy as np\nSEEN = []\n\n\ndef law(parameters):\n    def command(measured):\n"
        "        SEEN.append((measured.angular_velocity_body.copy(), measured.orientation_xyzw.copy()))\n"
        "        return 0.0 * measured.angular_velocity_body\n    return command\n"
    )
    text = CAMPAIGN.replace("law: rate_damping", "law: spy_law.law").replace("  rate: 4\n", "  rate: 20\n")
    text = text.replace("disperse:", "disperse:\n  initial.position_world: {normal: {deviation: 1}}\nxdisperse:")
    text = text[: text.index("xdisperse:")] + text[text.index("control:\n") :]
    scene = SCENE.replace("[0.4, -0.3, 0.5]\n", "[0, 0, 0]\n  position_world: [0, 0, 0]\n")
    campaign = read_campaign(write(tmp_path, text, scene))
    simulate_block(campaign, 0, 24)

    seen = campaign.modules.load("spy_law").SEEN
    spins = np.array([spin for spin, _ in seen])
    turns = 2.0 * np.array([attitude[:, :3] for _, attitude in seen])
    assert spins.shape == (40, 24, 3)
    assert spins.std() == pytest.approx(0.01, rel=0.1)
    assert turns.std() == pytest.approx(0.01, rel=0.1)
    assert np.corrcoef(spins[:, 0].ravel(), spins[:, 1].ravel())[0, 1] == pytest.approx(0.0, abs=0.3)


def test_the_attitude_law_points(tmp_path: Path) -> None:
    text = """\
scene: scene.yaml
set: {duration: 40}
runs: 4
disperse: {initial.orientation: any}
control:
  law: attitude_pd
  rate: 4
  parameters: {proportional: 0.4, derivative: 1.2, target: {x: 0, y: 0.6, z: 0, w: 0.8}}
metrics: {off: {final: attitude}, worst: {worst: attitude}, defect: {final: energy_defect}}
"""
    found = simulate_block(read_campaign(write(tmp_path, text)), 0, 4)
    assert found["off"].max() < 1e-2 < 1.0 < found["worst"].max()
    assert found["defect"].max() < 1e-6


def test_metrics(tmp_path: Path) -> None:
    """Free motion about one axis: everything is known."""
    scene = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 0, 0.5]}\n"
    text = """\
scene: scene.yaml
set: {duration: 4, output_rate: 10}
runs: 2
metrics:
  last: {final: attitude}
  most: {worst: attitude}
  least: {least: attitude}
  mean: {mean: attitude}
  reached: {time_to: attitude, above: 0.999}
  never: {time_to: attitude, above: 3}
  passing: {time_to: attitude, below: 1.5, stays: false}
  staying: {time_to: attitude, below: 1.5}
  momentum: {final: angular_momentum}
  energy: {final: energy}
"""
    found = simulate_block(read_campaign(write(tmp_path, text, scene)), 0, 2)
    expected = {
        "last": 2.0, "most": 2.0, "least": 0.0, "mean": 1.0, "reached": 2.0, "never": math.nan, "passing": 0.0,
        "staying": math.nan, "momentum": 1.5, "energy": 0.375,
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name] == pytest.approx([value, value], nan_ok=True, abs=1e-12), name


def test_a_quantity_that_is_not_known_everywhere_has_no_largest_value(tmp_path: Path) -> None:
    """What is NaN for a moment may have been the largest then; the mean is as unknown, the final value is not."""
    (tmp_path / "partly.py").write_text(
        "import numpy as np\n\n\ndef quantity(samples):\n"
        "    known = np.ones(len(samples.kinetic_energy))\n"
        "    return known * (np.nan if samples.time_ns == 2_000_000_000 else 1.0)\n"
    )
    reductions = ("final", "worst", "least", "mean")
    listed = ", ".join(f"{each}: {{{each}: partly.quantity}}" for each in reductions)
    text = f"scene: scene.yaml\nset: {{duration: 4}}\nruns: 2\nmetrics: {{{listed}}}\n"
    found = simulate_block(read_campaign(write(tmp_path, text)), 0, 2)
    assert found["final"].tolist() == [1.0, 1.0]
    for reduction in reductions[1:]:
        assert found[reduction].tolist() == pytest.approx([math.nan, math.nan], nan_ok=True), reduction


def test_a_run_that_cannot_be_solved_does_not_stop_the_others(tmp_path: Path) -> None:
    text = """\
scene: scene.yaml
runs: 6
sampling: latin_hypercube
disperse: {"initial.angular_velocity_body[0]": {choice: {values: [0.1, 20000.0], weights: [5, 1]}}}
metrics: {final_rate: {final: rate}}
"""
    found = simulate_block(read_campaign(write(tmp_path, text)), 0, 6)
    bad = [run for run in range(6) if found["initial.angular_velocity_body[0]"][run] > 1.0]
    assert len(bad) == 1
    assert [bool(error) for error in found["error"]] == [run in bad for run in range(6)]
    assert "rk4" in found["error"][bad[0]]
    assert found["passed"].tolist() == [run not in bad for run in range(6)]
    assert math.isnan(found["final_rate"][bad[0]])


def test_runs_that_fixed_steps_ruin_are_failed_ones(tmp_path: Path) -> None:
    """Under drag of 100/s, steps of 0.05 s are beyond the stability of rk4; at 1/s they are not."""
    scene = (
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {linear_velocity_world: [1, 0, 0]}\nwrenches: []\n"
        "effects: [{type: linear_drag, translation: 1}]\nsolver: {method: rk4, step: 0.05}\nduration: 2\n"
    )
    text = """\
scene: scene.yaml
runs: 6
sampling: latin_hypercube
disperse: {"effects[0].translation": {choice: {values: [1.0, 100.0], weights: [1, 1]}}}
metrics: {final_energy: {final: energy}}
"""
    campaign = read_campaign(write(tmp_path, text, scene))
    found = simulate_block(campaign, 0, 6)
    bad = [run for run in range(6) if found["effects[0].translation"][run] > 1.0]
    assert len(bad) == 3
    assert ["steps of 0.05 s are too long" in error for error in found["error"]] == [run in bad for run in range(6)]
    with pytest.raises(FunctionError) as failed:
        simulate_alone(campaign, bad[0])
    assert str(failed.value) == found["error"][bad[0]]


def test_a_sample_that_is_no_scene_is_named(tmp_path: Path) -> None:
    text = """\
scene: scene.yaml
runs: 4
sampling: latin_hypercube
disperse: {body.mass: {uniform: {low: -1.0, high: 1.0}}}
metrics: {final_rate: {final: rate}}
"""
    found = simulate_block(read_campaign(write(tmp_path, text)), 0, 4)
    assert sum("body.mass: found -0." in error for error in found["error"]) == 2
    assert found["passed"].sum() == 2


def test_a_load_that_the_method_does_not_support_concerns_its_own_run(tmp_path: Path) -> None:
    scene = SCENE.replace("wrenches: []", "wrenches: [{topic: push, lag: 0.0}]")
    scene = scene.replace("{method: rk4, step: 0.05}", "{method: taylor, accuracy: 1.0e-9}")
    text = """\
scene: scene.yaml
runs: 12
seed: 1
disperse: {"wrenches[0].lag": {choice: {values: [0.0, 0.05]}}}
metrics: {final_rate: {final: rate}}
"""
    campaign = read_campaign(write(tmp_path, text, scene))
    found = simulate_block(campaign, 0, 12)
    lags = found["wrenches[0].lag"]
    assert 0 < np.count_nonzero(lags) < 12
    assert ["supports push/lag" in error for error in found["error"]] == [lag > 0.0 for lag in lags]
    assert np.isfinite(found["final_rate"][lags == 0.0]).all()

    # All fail if the base scene does: it is refused at once.
    campaign = read_campaign(write(tmp_path, text, scene.replace("lag: 0.0", "lag: 0.05")))
    with pytest.raises(SceneError, match="supports push/lag"):
        simulate_block(campaign, 0, 12)


OWN = """\
import numpy as np


def law(parameters):
    gain = parameters["gain"][:, None]

    def torque(measured):
        {first}
        rate = measured.angular_velocity_body
        rate *= -gain
        return {torque}

    return torque


def quantity(samples):
    {quantity}
    return samples.angular_velocity_body[:, 0]
"""
GOOD = {"first": "pass", "torque": "rate", "quantity": "pass"}
FAST = "np.any(gain > 1.8) and measured.time_s > 0.9"
LATE = "samples.time_ns > 10**9 and np.any(samples.angular_velocity_body > 0.3)"
BAD = {
    "NaN": {"torque": f"np.where((gain > 1.8) & (measured.time_s > 0.9), np.nan, {GOOD['torque']})"},
    "masked": {"torque": f"np.ma.masked_where((gain + 0 * rate > 1.8) & (measured.time_s > 0.9), {GOOD['torque']})"},
    "huge": {"torque": f"np.where((gain > 1.8) & (measured.time_s > 0.9), -1e200, {GOOD['torque']})"},
    "raise": {"first": f"raise_ = [][1] if {FAST} else 0"},
    "complex": {"torque": f"({GOOD['torque']}) * (1j if {FAST} else 1)"},
    "none": {"torque": f"None if {FAST} else {GOOD['torque']}"},
    "shape": {"torque": f"({GOOD['torque']})[:, : 2 if {FAST} else 3]"},
    "name": {"torque": f"{{'nope' if {FAST} else 'torque': {GOOD['torque']}}}"},
    "exit": {"first": f"raise_ = __import__('sys').exit(3) if {FAST} else 0"},
    "generator": {"first": f"raise_ = (_ for _ in ()).throw(GeneratorExit()) if {FAST} else 0"},
    "quantity": {"quantity": f"[][1] if {LATE} else 0"},
    "shape of a metric": {"quantity": f"if {LATE}: return 0.0"},
    "overwrite": {"quantity": f"if {LATE}: samples.angular_velocity_body[:] = 0.0"},
}
# Tried one run after another in `make test` too, and not only in `make test-slow`.
OFTEN = ("NaN", "raise", "quantity")


@pytest.fixture(scope="module")
def good_runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], dict[str, Any]]:
    """Return a function that gives the runs of a campaign and a scene with functions that do not fail."""

    @cache
    def runs(text: str, scene: str) -> dict[str, Any]:
        folder = tmp_path_factory.mktemp("good")
        (folder / "own_bad.py").write_text(OWN.format(**GOOD))
        return simulate_block(read_campaign(write(folder, text, scene)), 0, 24)

    return runs


@pytest.mark.parametrize(
    ("bad", "scene"),
    [
        *(pytest.param(bad, SCENE, id=f"many-{bad}", marks=[pytest.mark.slow] * (bad not in OFTEN)) for bad in BAD),
        *(
            pytest.param(bad, SCENE + EFFECT, id=f"alone-{bad}", marks=[pytest.mark.slow] * (bad not in OFTEN))
            for bad in BAD
        ),
    ],
)
def test_a_function_that_fails_for_a_run_is_a_row_with_its_reason(
    tmp_path: Path, good_runs: Callable[[str, str], dict[str, Any]], scene: str, bad: str
) -> None:
    text = CAMPAIGN.replace("law: rate_damping", "law: own_bad.law").replace(
        "{final: rate}", "{final: own_bad.quantity}"
    )
    if bad == "huge":
        text = text.replace("saturation: 0.6", "saturation: 1e300")
    good = good_runs(text, scene)
    (tmp_path / "own_bad.py").write_text(OWN.format(**{**GOOD, **BAD[bad]}))
    campaign = read_campaign(write(tmp_path, text, scene))
    found = simulate_block(campaign, 0, 24)

    failed = [run for run, error in enumerate(found["error"]) if error]
    reason = {
        "NaN": r"control.law: own_bad.law returned \(nan, nan, nan\) N m at simulation time 1.0 s, no finite torque",
        "masked": r"control.law: own_bad.law returned \(nan, nan, nan\) N m at simulation time 1.0 s, no finite torque",
        "huge": r"control.law: own_bad.law returned \(-1e\+200, -1e\+200, -1e\+200\) N m at simulation time 1.0 s, .*"
        r"N m, .*is more than the .* N m that the body can be simulated under",
        "raise": r"control.law: own_bad.law raised IndexError: list index out of range, own_bad.py:8",
        "complex": r"control.law: own_bad.law returned values of type complex128, expected real numbers",
        "none": r"control.law: own_bad.law returned an array of shape \(\), expected \(1, 3\): a torque .*",
        "shape": r"control.law: own_bad.law returned an array of shape \(1, 2\), expected \(1, 3\): a torque .*",
        "name": r"control.law: own_bad.law returned a command for 'nope', expected one of torque, force; .*",
        "shape of a metric": r"metrics: own_bad.quantity returned an array of shape \(\), expected \(1,\): a number .*",
        "exit": r"control.law: own_bad.law raised SystemExit: 3, own_bad.py:8",
        "generator": r"control.law: own_bad.law raised GeneratorExit, own_bad.py:8",
        "quantity": r"metrics: own_bad.quantity raised IndexError: list index out of range, own_bad.py:17",
        "overwrite": r"metrics: own_bad.quantity raised ValueError: assignment destination is read-only, own_bad.py:17",
    }[bad]
    assert 0 < len(failed) < 20
    assert all(re.fullmatch(reason, found["error"][run]) for run in failed)
    assert np.isnan(found["final_rate"][failed]).all()
    assert not found["passed"][failed].any()
    if bad not in ("quantity", "overwrite", "shape of a metric"):
        assert failed == [run for run in range(24) if good["control.parameters.gain"][run] > 1.8]
    others = [run for run in range(24) if run not in failed]
    assert [rows(found)[run] for run in others] == [rows(good)[run] for run in others]
    parts = [row for first in (0, 1, 13) for row in rows(simulate_block(campaign, first, {0: 1, 1: 13, 13: 24}[first]))]
    assert parts == rows(found)
    with pytest.raises(FunctionError, match=reason):
        simulate_alone(campaign, failed[0])


def test_what_a_law_or_a_metric_prints_goes_to_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    prints = {"first": "print('law')", "quantity": "print('metric')"}
    (tmp_path / "own_bad.py").write_text("print('module')\n" + OWN.format(**{**GOOD, **prints}))
    text = CAMPAIGN.replace("law: rate_damping", "law: own_bad.law").replace(
        "{final: rate}", "{final: own_bad.quantity}"
    )
    simulate_block(read_campaign(write(tmp_path, text)), 0, 2)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert {*printed.err.split()} == {"module", "law", "metric"}


def test_a_module_that_exits_is_named(tmp_path: Path) -> None:
    (tmp_path / "own_none.py").write_text("raise SystemExit(0)\n")
    with pytest.raises(SceneError, match=r"found own_none.law, expected a function that can be imported \(SystemExit"):
        read_campaign(write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: own_none.law")))


def test_a_function_that_is_not_there_is_named_as_the_user_wrote_it(tmp_path: Path) -> None:
    (tmp_path / "own_trials.py").write_text("def low():\n    pass\n")
    with pytest.raises(SceneError, match=r"\(AttributeError: module 'own_trials' has no attribute 'law'"):
        read_campaign(write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: own_trials.law")))


def test_a_law_that_lacks_a_file_is_no_failed_run(tmp_path: Path) -> None:
    (tmp_path / "own_bad.py").write_text(OWN.format(**{**GOOD, "first": "open('/none/such')"}))
    campaign = read_campaign(write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: own_bad.law")))
    with pytest.raises(SceneError, match=r"own_bad.law raised FileNotFoundError: .*, own_bad.py:8; what a law or a m"):
        simulate_block(campaign, 0, 2)


@pytest.mark.parametrize(("returned", "message"), [("None", "returned None, expected a function of the measurement")])
def test_a_law_that_makes_no_function(tmp_path: Path, returned: str, message: str) -> None:
    (tmp_path / "own_none.py").write_text(f"def law(parameters):\n    return {returned}\n")
    campaign = read_campaign(write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: own_none.law")))
    with pytest.raises(SceneError, match=f"control.law: own_none.law {message}; correct the law"):
        simulate_block(campaign, 0, 2)


def test_a_controller_that_cannot_be_is_a_row_with_its_reason(tmp_path: Path) -> None:
    """A delay before the sample, noise of negative size, no torque at all."""
    text = CAMPAIGN.replace("{choice: {values: [0.0, 0.1, 0.35]}}", "{choice: {values: [-0.05, 0.1]}}")
    more = "  control.saturation: {uniform: {low: -1, high: 1}}\n  control.noise.rate: {uniform: {low: -1, high: 1}}\n"
    campaign = read_campaign(write(tmp_path, text.replace("disperse:\n", f"disperse:\n{more}")))
    found = simulate_block(campaign, 0, 24)
    for run, error in enumerate(found["error"]):
        wrong = [
            key
            for key in ("control.saturation", "control.noise.rate", "control.delay")
            if not (found[key][run] > 0.0 if key == "control.saturation" else found[key][run] >= 0.0)
        ]
        assert error.startswith(f"{wrong[0]}: found -" if wrong else "")
        assert bool(error) == bool(wrong)
    assert 0 < sum(map(bool, found["error"])) < 24


@pytest.mark.parametrize("scene", [SCENE, SCENE + EFFECT], ids=["many", "effect"])
def test_a_delay_between_steps_is_flown_as_it_is(tmp_path: Path, scene: str) -> None:
    """The torque acts at its exact time for any step, also beside runs whose delays are whole steps."""
    fixed = "solver: {method: rk4, step: 0.05}"
    text = CAMPAIGN.replace("[0.0, 0.1, 0.35]", "[0.0, 0.01, 0.1]").replace("noise: {rate: 0.01, attitude: 0.01}", "")
    steps = [
        simulate_block(read_campaign(write(tmp_path, text, scene.replace(fixed, other))), 0, 12)
        for other in (fixed, fixed.replace("0.05", "0.01"), ACCURATE[1])
    ]
    assert set(steps[0]["control.delay"].tolist()) == {0.0, 0.01, 0.1}
    for other in steps[1:]:
        assert steps[0]["final_rate"] == pytest.approx(other["final_rate"], rel=1e-6)
    campaign = read_campaign(write(tmp_path, text, scene))
    alone = [simulate_alone(campaign, run)["final_rate"] for run in range(12)]
    assert alone == steps[0]["final_rate"].tolist()
    assert not goes_side_by_side(campaign)


@pytest.mark.parametrize(
    ("delay", "expected"),
    [
        ("{choice: {values: [0.05, 0.1]}}", True),
        ("{choice: {values: [0.05, 0.01]}}", False),
        ("{uniform: {low: 0.05, high: 0.45}}", False),
        ("{uniform: {low: 0.05, high: 0.45, step: 0.05}}", True),
        ("{uniform: {low: 0.02, high: 0.04, step: 0.02}}", False),
        ("{normal: {deviation: 0.02, low: 0, high: 0.4, step: 0.1}}", True),
    ],
)
def test_delays_of_whole_steps_go_side_by_side(tmp_path: Path, delay: str, expected: bool) -> None:
    campaign = read_campaign(write(tmp_path, CAMPAIGN.replace("{choice: {values: [0.0, 0.1, 0.35]}}", delay)))
    assert goes_side_by_side(campaign) == expected
    fixed = CAMPAIGN.replace("  control.delay: {choice: {values: [0.0, 0.1, 0.35]}}\n", "")
    for value, on_grid in ((0.1, True), (0.02, False)):
        text = fixed.replace("delay: 0.1", f"delay: {value}")
        assert goes_side_by_side(read_campaign(write(tmp_path, text))) == on_grid


def test_an_own_law_and_an_own_quantity(tmp_path: Path) -> None:
    (tmp_path / "own_code.py").write_text(
        "def law(parameters):\n    return lambda measured: parameters['push']\n\n\n"
        "def first(samples):\n    return samples.angular_velocity_body[:, 0]\n"
    )
    text = """\
scene: scene.yaml
runs: 3
control: {law: own_code.law, rate: 4, parameters: {push: [0.0, 0.0, 0.2]}}
metrics: {first: {final: own_code.first}, momentum: {final: angular_momentum}}
"""
    campaign: Campaign = read_campaign(write(tmp_path, text))
    sink = MemorySink()
    alone = simulate_alone(campaign, 1, [sink])
    assert alone["first"] == sink.samples[-1].angular_velocity_body[0]
    assert simulate_block(campaign, 0, 3)["first"].tolist() == [alone["first"]] * 3


@pytest.mark.parametrize("rate", [3, 30, 33.333333333333336])
def test_a_law_sees_what_sensors_of_its_rate_measure_at_its_sample(tmp_path: Path, rate: float) -> None:
    (tmp_path / "stale.py").write_text(
        "def law(parameters):\n"
        "    def command(measured):\n"
        "        assert measured.time_s == measured.sensors['imu'].time_s[0]\n"
        "        return 0.0 * measured.angular_velocity_body\n"
        "    return command\n"
    )
    scene = SCENE.replace(*ACCURATE) + f"sensors: [{{type: imu, name: imu, rate: {rate}}}]\n"
    text = (
        f"scene: scene.yaml\nruns: 1\ncontrol: {{law: stale.law, rate: {rate}}}\nmetrics: {{rate: {{final: rate}}}}\n"
    )
    campaign = read_campaign(write(tmp_path, text, scene))

    assert simulate_block(campaign, 0, 1)["error"] == [""]


@pytest.mark.parametrize("given", ["", "observe_rate: 3\n"], ids=["outputs", "given"])
def test_observations_are_at_the_times_of_outputs(tmp_path: Path, given: str) -> None:
    scene = SCENE.replace(*ACCURATE).replace("output_rate: 4", "output_rate: 3").replace("2.0\noutput", "100.0\noutput")
    text = f"scene: scene.yaml\nruns: 1\n{given}metrics: {{rate: {{final: rate}}}}\n"
    path = write(tmp_path, text, scene)
    times: list[int] = []
    watch_runs(read_campaign(path), [0], lambda samples: times.append(int(samples.time_ns)))

    log = MemorySink()
    simulate(tmp_path / "scene.yaml", sinks=[log])
    assert times == [int(each) for each in log.time_ns]
