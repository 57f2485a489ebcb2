"""What is wrong with a scene before it runs: said by explain, simulate and campaign; that of wheels and sensors too."""

from __future__ import annotations

from pathlib import Path

import pytest

from rb_dynamics.cli import main
from rb_dynamics.run.scene_remarks import scene_remarks
from rb_dynamics.scene.read import parse_scene

SHAKEN = """
body: {mass: 10, inertia: {diagonal: [0.1, 0.1, 0.1]}}
wrenches: []
actuators: [{type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-4, imbalance: {dynamic: 1.0e-8}, SPEED}]
duration: 0.1
solver: SOLVER
"""


@pytest.mark.parametrize(
    ("speed", "solver", "said"),
    [
        ("speed: 300", "{method: dop853, step: 0.02}", "turns by 6 rad in a step of 0.02 s at 300 rad/s"),
        ("max_speed: 400", "{step: 0.02}", "turns by 8 rad in a step of 0.02 s at 400 rad/s"),
        ("speed: 300", "{method: dop853, step: 0.01}", ""),
        ("speed: 300", "{accuracy: 1.0e-6}", ""),
    ],
)
def test_steps_that_do_not_resolve_an_imbalance_are_named(speed: str, solver: str, said: str) -> None:
    found = scene_remarks(parse_scene(SHAKEN.replace("SPEED", speed).replace("SOLVER", solver)))
    assert len(found) == bool(said)
    assert all(said in remark for remark in found)
    assert not scene_remarks(
        parse_scene(SHAKEN.replace("imbalance: {dynamic: 1.0e-8}, SPEED", speed).replace("SOLVER", solver))
    )


def test_simulate_and_explain_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "shaken.yaml"
    path.write_text(SHAKEN.replace("SPEED", "speed: 300").replace("SOLVER", "{step: 0.02}"), encoding="utf-8")
    assert main(["simulate", str(path)]) == 0
    assert "note: wheel turns by 6 rad in a step" in capsys.readouterr().err
    assert main(["explain", str(path)]) == 0
    assert "note: wheel turns by 6 rad in a step" in capsys.readouterr().out
