"""Small campaigns for tests."""

from __future__ import annotations

from pathlib import Path

SCENE = """\
body:
  mass: 2.0
  inertia: {matrix: [[1.0, 0.1, 0.0], [0.1, 1.2, 0.05], [0.0, 0.05, 1.5]]}
initial:
  angular_velocity_body: [0.4, -0.3, 0.5]
wrenches: []
solver: {method: rk4, step: 0.05}
duration: 2.0
output_rate: 4
"""

CAMPAIGN = """\
scene: scene.yaml
runs: 24
seed: 7
sampling: random
disperse:
  body.inertia: {second_moments: 0.3, axes: 0.1}
  body.mass: {uniform: {low: 1.5, high: 2.5}}
  initial.angular_velocity_body: {normal: {deviation: 0.2}}
  initial.orientation: any
  control.delay: {choice: {values: [0.0, 0.1, 0.35]}}
  control.parameters.gain: {log_uniform: {low: 0.5, high: 2.0}}
control:
  law: rate_damping
  rate: 4
  delay: 0.1
  saturation: 0.6
  noise: {rate: 0.01, attitude: 0.01}
  parameters: {gain: 1.0}
metrics:
  final_rate: {final: rate}
  worst_energy: {worst: energy}
  settled: {time_to: rate, below: 0.4}
require:
  final_rate: {below: 0.25}
"""


def write(folder: Path, text: str = CAMPAIGN, scene: str = SCENE) -> Path:
    """Write scene and campaign to `folder`; return the path of the campaign."""
    (folder / "scene.yaml").write_text(scene, encoding="utf-8")
    path = folder / "campaign.yaml"
    path.write_text(text, encoding="utf-8")
    return path
