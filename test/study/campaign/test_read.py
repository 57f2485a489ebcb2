"""Campaign files: valid keys, and the errors of invalid ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaigns import CAMPAIGN, SCENE, write

from rb_dynamics.errors import SceneError
from rb_dynamics.scene import read_scene
from rb_dynamics.study.campaign.distributions import Choice, LogUniform, Normal, Uniform
from rb_dynamics.study.campaign.read import read_campaign

ROOT = Path(__file__).parents[3]
BARE = "scene: scene.yaml\nruns: 3\nmetrics: {final_rate: {final: rate}}\n"


@pytest.mark.parametrize("path", sorted((ROOT / "config" / "campaigns").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_campaign_is_valid(path: Path) -> None:
    assert read_campaign(path).runs >= 50


def test_what_a_campaign_says(tmp_path: Path) -> None:
    campaign = read_campaign(write(tmp_path))

    found = {each.name: each.distribution for each in campaign.inputs}
    assert found["body.mass"] == Uniform(1.5, 2.5)
    assert [found[f"initial.angular_velocity_body[{i}]"] for i in range(3)] == [
        Normal(0.4, 0.2), Normal(-0.3, 0.2), Normal(0.5, 0.2),
    ]  # fmt: skip
    assert found["control.delay"] == Choice((0.0, 0.1, 0.35), (1 / 3, 1 / 3, 1 / 3))
    assert found["control.parameters.gain"] == LogUniform(0.5, 2.0)
    assert campaign.control is not None
    assert campaign.control.period_ns == campaign.observe_ns == 250_000_000
    assert "topic: control" in campaign.scene_text


def test_the_text_tells_nothing_of_the_folder(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
    one, other = (read_campaign(write(folder)) for folder in folders)
    assert one.scene_text == other.scene_text


def test_overrides(tmp_path: Path) -> None:
    campaign = read_campaign(write(tmp_path), {"runs": 5, "seed": 2})
    assert (campaign.runs, campaign.seed) == (5, 2)
    assert "\nruns: 5\nseed: 2\n" in campaign.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("runs: 24", "runs: 0"), r"campaign.yaml:2: runs: found 0, expected a whole number from 1 to 1e12"),
        (("runs: 24", "runs: 1.5"), r"runs: found 1.5, expected a whole number"),
        (("sampling: random", "sampling: sobel"), r"campaign.yaml:4: sampling: found sobel, .* did you mean sobol\?"),
        (("disperse:", "dispers:"), r"found an unknown key, .* did you mean disperse\?"),
        (("body.mass: {u", "body.mas: {u"), r"campaign.yaml:7: disperse.body.mas: found no number under body.mas"),
        (("{low: 1.5, high: 2.5}", "{low: 2.5, high: 1.5}"), r"disperse.body.mass.uniform: .* expected low less than"),
        (("deviation: 0.2", "deviaton: 0.2"), r"did you mean deviation\?"),
        (("{second_moments: 0.3, axes: 0.1}", "{moments: 0.3}"), r"disperse.body.inertia.moments: found an unk"),
        (("law: rate_damping", "law: rate_dampin"), r"control.law: .* did you mean rate_damping\?"),
        (("law: rate_damping", "law: nowhere.law"), r"control.law: found nowhere.law, expected a function that can be"),
        (("gain: 1.0}", "gian: 1.0}"), r"control.parameters: found no such parameter, expected the parameter gain"),
        (("  rate: 4\n", "  rate: 3\n"), r"control.rate: found a rate|control.rate: found .* whole"),
        (("  rate: 4\n", "  rate: 8\n"), r"control.rate: found a period of 125000000 ns, expected a period that is a"),
        (("{final: rate}", "{final: rat}"), r"metrics.final_rate.final: found rat, .* did you mean rate\?"),
        (("{final: rate}", "{final: [rate]}"), r"metrics.final_rate.final: found .*rate.*, expected one of attitude"),
        (("{final: rate}", "{final: {rate: 1}}"), r"metrics.final_rate.final: found .*, expected one of attitude"),
        (("{final: rate}", "{final: rate, worst: rate}"), r"exactly one of final, worst"),
        (("final_rate: {final", "error: {final"), r"metrics.error: found the name error, expected a name"),
        (("rate, below: 0.4}", "rate}"), r"metrics.settled: found no threshold, expected a threshold for time_to"),
        (("{final: rate}", "{final: rate, below: 1}"), r"final_rate.below: found 1, .* write the limit under require"),
        (("{final: rate}", "{final: rate, stays: true}"), r"final_rate.stays: found .* not time_to; remove it"),
        (("rate, below: 0.4}", "rate, below: 0.0}"), r"settled: .* expected limits that rate can meet; rate is"),
        (("rate, below: 0.4}", "rate, below: 0.4, target: {x: 0, y: 0, z: 0, w: 1}}"), r"settled.target: .* remove it"),
        (("rate, below: 0.4}", "attitude, above: 3.2}"), r"attitude is from 0 to 3.14159265: correct above or below"),
        (("{below: 0.25}", "{below: -1}"), r"require.final_rate: found .* can meet; final_rate is at least 0: correct"),
        (("{below: 0.25}", "{below: 1, above: 2}"), r"require.final_rate: .* nothing lies between: correct above or"),
        (("{below: 0.25}", "{below: 1, above: 1}"), r"require.final_rate: .* nothing lies between: correct above or"),
        (("{below: 0.25}", "{above: .nan}"), r"require.final_rate.above: .*infinities and NaN are not accepted"),
        (("final_rate: {below: 0.25}", "settled: {above: 2, below: 3}"), r"require.settled: .* is from 0 to 2: corr"),
        (("  final_rate: {below", "  last_rate: {below"), r"require.last_rate: found an unknown key"),
        (("scene: scene.yaml", "scene: sceen.yaml"), r"campaign.yaml:1: scene: found sceen.yaml, expected the path of"),
        (("deviation: 0.2", "deviation: 1e308"), r"normal: .* expected numbers within the range of double precision"),
        (("deviation: 0.2", "deviation: 0.2, low: 99"), r"normal: .* expected low and high between which such values"),
        (("{low: 1.5, high: 2.5}", "{low: -1e308, high: 1e308}"), r"expected a width within the range of double prec"),
        (("{low: 1.5, high: 2.5}", "{half_width: 1e308, step: 0.1}"), r"whole multiples"),
        (("{low: 0.5, high: 2.0}", "{low: 1e-300, high: 1e300}"), r"expected a ratio of high to low within the range"),
        (("0.35]}", "0.35], weights: [1e308, 1e308, 1]}"), r"one is greater than 0, with a sum that is finite"),
        (("second_moments: 0.3", "second_moments: 1e308"), r"second_moments: found 1e\+?308, expected a number from"),
        (("{low: 1.5, high: 2.5}", "{low: 1.5, high: 2.5, step: 0.4}"), r"expected a step of which the lowest and the"),
        (("{low: 1.5, high: 2.5}", "{low: 1.5, high: 2.5, step: 1e-320}"), r"expected a step of which the lowest and"),
        (("runs: 24", "set: {body.mass: -1}\nruns: 24"), r"scene.yaml:override: body.mass: found -1"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    assert change[0] in CAMPAIGN
    with pytest.raises(SceneError, match=message):
        read_campaign(write(tmp_path, CAMPAIGN.replace(*change)))


def test_limits_that_can_be_met_are_accepted(tmp_path: Path) -> None:
    text = CAMPAIGN.replace(
        "final_rate: {below: 0.25}", "final_rate: {above: -1, below: 1e-300}\n  settled: {above: 2}"
    )
    # What never happens meets any lower limit.
    assert [each.above for each in read_campaign(write(tmp_path, text)).requirements] == [-1.0, 2.0]
    # A duration that differs from run to run may be longer than that of the scene.
    longer = text.replace("above: 2}", "above: 2.5, below: 2.8}")
    longer = longer.replace("disperse:", "disperse:\n  duration: {uniform: {low: 1, high: 3}}")
    assert len(read_campaign(write(tmp_path, longer)).requirements) == 2


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([("body.mass", "body.weight", 0.5)], r"expected a dispersed number; choose from .*body.mass"),
        ([("body.mass", "body.mass", 0.5)], "two different inputs"),
        ([("body.mass", "control.delay", 1.5)], "a number between -1 and 1"),
        (
            [
                ("body.mass", "control.delay", 0.9),
                ("body.mass", "control.parameters.gain", 0.9),
                ("control.delay", "control.parameters.gain", -0.9),
            ],
            "expected correlations that are possible together",
        ),
    ],
)
def test_correlations_that_cannot_be(tmp_path: Path, pairs: list[tuple[str, str, float]], message: str) -> None:
    lines = "".join(f"  - {{between: [{a}, {b}], coefficient: {c}}}\n" for a, b, c in pairs)
    with pytest.raises(SceneError, match=message):
        read_campaign(write(tmp_path, f"{CAMPAIGN}correlate:\n{lines}"))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ("target: [0, 0, 0, 1]", r"target: found \S.*, expected {x:, y:, z:, w:}; name the components, .* {x: 0, y: 0"),
        ("target: 1", r"target: found 1, expected a mapping of x, y, z, w"),
        ("derivative: [1, 2]", r"derivative: found .*, expected a finite number; write a single number"),
    ],
)  # fmt: skip
def test_parameters_of_a_known_law(tmp_path: Path, parameters: str, message: str) -> None:
    law = f"control: {{law: attitude_pd, rate: 4, parameters: {{proportional: 1, {parameters}}}}}\n"
    with pytest.raises(SceneError, match=message):
        read_campaign(write(tmp_path, BARE + law))


@pytest.mark.parametrize("form", ["choice: {values: [[1, 2], 3]}", "normal: {mean: [0, 0, 0], deviation: 0.1}"])
def test_what_is_wrong_for_each_number_of_a_list_is_said_once(tmp_path: Path, form: str) -> None:
    given = "initial.angular_velocity_body: {normal: {deviation: 0.2}}"
    assert given in CAMPAIGN
    with pytest.raises(SceneError) as raised:
        read_campaign(write(tmp_path, CAMPAIGN.replace(given, f"initial.angular_velocity_body: {{{form}}}")))
    assert len(str(raised.value).splitlines()) == 1


def test_an_attitude_is_no_angle_from_the_target_of_another_law(tmp_path: Path) -> None:
    (tmp_path / "own_aim.py").write_text("def law(parameters):\n    return None\n")
    law = "control: {law: own_aim.law, rate: 4, parameters: {target: [0, 0, 1]}}\n"
    text = BARE.replace("{final: rate}", "{final: attitude}") + law
    with pytest.raises(SceneError, match=r"found \[0.0, 0.0, 1.0\] as the target of the law, expected an attitude in"):
        read_campaign(write(tmp_path, text))
    mended = text.replace("{final: attitude}", "{final: attitude, target: {x: 0, y: 0, z: 0, w: 1}}")
    assert read_campaign(write(tmp_path, mended)).metrics[0].target_xyzw == (0.0, 0.0, 0.0, 1.0)


def test_a_particle_has_no_controller(tmp_path: Path) -> None:
    scene = "body: {mass: 1}\nduration: 1\nsolver: {method: rk4, step: 0.05}\n"
    text = BARE + "control: {law: rate_damping, rate: 4, parameters: {gain: 1}}\n"
    with pytest.raises(SceneError, match=r"campaign.yaml:1: scene: found a particle, expected a body that turns"):
        read_campaign(write(tmp_path, text, scene))


def test_a_scene_without_an_end(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"scene: found no duration in it, expected a scene that ends"):
        read_campaign(write(tmp_path, BARE, SCENE.replace("duration: 2.0\n", "")))


def test_a_scene_given_for_a_campaign_and_a_campaign_for_a_scene(tmp_path: Path) -> None:
    campaign = write(tmp_path)
    scene = tmp_path / "scene.yaml"
    with pytest.raises(
        SceneError, match=rf"^{scene}: found a scene, .* rb-dynamics simulate {scene}, or write [^\n]*$"
    ):
        read_campaign(scene)
    with pytest.raises(
        SceneError, match=rf"^{campaign}: found a campaign, .* rb-dynamics campaign {campaign}, [^\n]*$"
    ):
        read_scene(campaign)


def test_a_dispersed_number_of_a_wheel_that_is_not_there(tmp_path: Path) -> None:
    wheels = "actuators: [{type: reaction_wheel, name: wheel_x, axis: [1, 0, 0], inertia: 0.01, max_torque: 0.1}]\n"
    text = CAMPAIGN.replace("body.mass: {u", "actuators.wheel_q.max_torque: {u")
    with pytest.raises(SceneError, match=r"max_torque: found no actuator wheel_q, expected one of wheel_x; correct"):
        read_campaign(write(tmp_path, text, SCENE + wheels))
