"""Scenes of the runs of a campaign: those of which only body, initial state and seed are read are those of all."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.scene.model import Scene
from rb_dynamics.study.campaign import scenes as under_test
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.sampling import inputs
from rb_dynamics.study.campaign.scenes import FACTORS, Scenes

SCENE = """\
world_frame: inertial
body: {mass: 10.0, center_of_mass: [0.01, 0.0, 0.02], inertia: {diagonal: [0.05, 0.12, 0.14]},
  frames: {camera: {position: [0.1, 0, 0], orientation: {x: 0, y: 0, z: 1, w: 0}}}}
initial: {position_world: [6.9e6, 0, 0], linear_velocity_world: [0, 0, 7600], angular_velocity_body: [0, 0, 0.1]}
effects: [{type: central_gravity, gravitational_parameter: 3.986e14, gravity_gradient: true}OTHERS]
actuators: [{type: reaction_wheel, name: x, axis: [1, 0, 0], inertia: 3.0e-5, max_torque: 0.002}]
sensors: [{type: star_tracker, name: tracker, rate: 2.0, noise: 1.0e-4, frame: camera}]
duration: 10.0
"""
CAMPAIGN = """\
scene: scene.yaml
runs: 5
disperse:
  initial.angular_velocity_body: {normal: {deviation: 0.01}}
  initial.orientation: {turn: 0.1}
  body.inertia: {second_moments: 0.05, axes: 0.02}
metrics: {final_rate: {final: rate}}
"""


def scenes(folder: Path, campaign: str = CAMPAIGN, others: str = "") -> tuple[Scenes, list[dict[str, float]]]:
    """Return what makes the scenes, and the inputs of the runs."""
    (folder / "scene.yaml").write_text(SCENE.replace("OTHERS", others))
    (folder / "campaign.yaml").write_text(campaign)
    found = read_campaign(folder / "campaign.yaml")
    names = [each.name for each in found.inputs]
    return Scenes(found), [dict(zip(names, row, strict=True)) for row in inputs(found, 0, 5).tolist()]


def read_in_full(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Return a list to which each scene is added whose text is read in full."""
    found: list[Scene] = []
    read = under_test.scene_of
    monkeypatch.setattr(under_test, "scene_of", lambda *args: (found.append(read(*args)), found[-1])[1])
    return found


@pytest.mark.parametrize("body", ["inertia: {second_moments: 0.05, axes: 0.02}", "mass: {normal: {deviation: 0.1}}"])
def test_scenes_of_which_few_sections_change_are_those_read_in_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str
) -> None:
    center = "center_of_mass: {normal: {deviation: 0.01}}"
    campaign = CAMPAIGN.replace("body.inertia: {second_moments: 0.05, axes: 0.02}", f"body.{body}\n  body.{center}")
    few, rows = scenes(tmp_path, campaign)
    whole, _ = scenes(tmp_path, campaign)
    whole._is_known = False
    full = read_in_full(monkeypatch)
    found = [few.scene(values, run) for run, values in enumerate(rows)]
    assert not full
    assert found == [whole.scene(values, run) for run, values in enumerate(rows)] == full
    assert [scene.findings for scene in found] == [scene.findings for scene in full]
    assert len({scene.seed for scene in found}) == len({scene.body for scene in found}) == 5


@pytest.mark.parametrize(
    ("disperse", "others"),
    [
        # What depends on the body beyond a check, and what is dispersed elsewhere.
        ("", ", {type: linear_drag, rotation: 1.0e-4}"),
        ("  actuators[0].inertia: {normal: {mean: 3.0e-5, deviation: 1.0e-6}}\n", ""),
    ],
)
def test_other_scenes_are_read_in_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, disperse: str, others: str
) -> None:
    found, rows = scenes(tmp_path, CAMPAIGN.replace("metrics:", f"{disperse}metrics:"), others)
    full = read_in_full(monkeypatch)
    found.scene(rows[0])
    assert len(full) == 1


@pytest.mark.parametrize("reason", ["inertia of x is 2.999", "found nan"])
def test_what_no_run_can_have_is_refused_as_in_a_scene(tmp_path: Path, reason: str) -> None:
    """A wheel heavier than the body that it is in, and a rate that is no number."""
    few, rows = scenes(tmp_path)
    whole, _ = scenes(tmp_path)
    whole._is_known = False
    light = dict.fromkeys(FACTORS, 1e-5) if "inertia" in reason else {"initial.angular_velocity_body[0]": math.nan}
    messages = []
    for found in (few, whole):
        with pytest.raises(SceneError, match=reason) as refused:
            found.scene({**rows[0], **light})
        messages.append(str(refused.value))
    assert messages[0] == messages[1]
