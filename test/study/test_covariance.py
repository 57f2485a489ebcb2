"""`covariance`: against differences of flights of the engine, against a campaign, and where it is not true."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rb_dynamics as rb
from rb_dynamics.analysis.identification import rotations
from rb_dynamics.cli import main
from rb_dynamics.run.ensemble import Ensemble
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.covariance import QUANTITIES
from rb_dynamics.study.uncertain_inputs import uncertain_numbers

SCENE = """
body:
  mass: 3.0
  center_of_mass: [0.1, -0.05, 0.02]
  inertia: {matrix: [[1.0, 0.1, -0.05], [0.1, 1.5, 0.07], [-0.05, 0.07, 1.2]]}
  frames: {jet: {position: [0.4, 0.1, -0.3], orientation: {x: 0.5, y: 0.5, z: -0.5, w: 0.5}}}
initial: {angular_velocity_body: [0.9, 0.2, -0.4], linear_velocity_world: [0.3, 0, 0.1]}
effects:
  - {type: uniform_gravity, acceleration_world: [0, 0.3, -9.8]}
  - {type: linear_drag, rotation: [0.1, 0.2, 0.3], translation: [0.3, 0.2, 0.1]}
  - type: scheduled_wrench
    frame_id: jet
    schedule: [{time: 0, torque: [0.1, 0, 0.2]}, {time: 0.35, force: [0.5, 0, 0.2]}, {time: 0.8}]
  - {type: scheduled_wrench, frame_id: world, schedule: [{time: 0.1, force: [0, 0.4, 0], torque: [0.2, 0, 0]}]}
wrenches: [{topic: push, timeout: 0.5}, {topic: turn}]
solver: {method: rkmk4, step: 0.02}
duration: 1.0
output_rate: 10
"""
MATRIX = np.array([[1.0, 0.1, -0.05], [0.1, 1.5, 0.07], [-0.05, 0.07, 1.2]])


def commands(scale: float = 1.0) -> list[tuple[str, rb.Wrench]]:
    return [
        ("push", rb.Wrench((2.0 * scale, 0.0, 1.0 * scale), (0.1 * scale, 0.2 * scale, 0.0), "jet", 200_000_000)),
        ("turn", rb.Wrench((0.0, 1.0, 0.0), (0.0, 0.3, -0.2), "world", 500_000_000)),
    ]


def end(overrides: dict[str, object], scale: float = 1.0) -> Any:
    return rb.simulate(rb.parse_scene(SCENE, overrides=overrides), commands(scale)).sample


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("covariance") / "run.mcap"
    rb.simulate(rb.parse_scene(SCENE), commands(), [McapSink(path)])
    return path


def changed(name: str, by: float) -> tuple[dict[str, object], float]:
    """Return the overrides and the scale of commands with a number changed."""
    whole, _, axis = name.rpartition(".")
    k = "xyz".find(axis)
    if name.startswith("wrench_scale"):
        return {}, 1.0 + by
    if name == "mass":
        return {"body.mass": 3.0 + by}, 1.0
    if whole == "inertia":
        i, j = (("xyz".index(c)) for c in axis)
        moved = MATRIX.copy()
        moved[i, j] += by
        moved[j, i] = moved[i, j]
        return {"body.inertia": {"matrix": moved.tolist()}}, 1.0
    if whole == "initial.orientation":
        turned = rotations.quaternions(by * np.eye(3)[k])
        return {whole: dict(zip("xyzw", turned.tolist(), strict=True))}, 1.0
    scene = rb.parse_scene(SCENE)
    values: Any = {
        "center_of_mass": scene.body.center_of_mass,
        "initial.angular_velocity_body": scene.initial.angular_velocity_body,
        "initial.position_world": scene.initial.position_world,
        "initial.linear_velocity_world": scene.initial.linear_velocity_world,
        "effects[1].rotation": (0.1, 0.2, 0.3),
        "effects[1].translation": (0.3, 0.2, 0.1),
        "effects[0].acceleration_world": (0.0, 0.3, -9.8),
        "effects[2].schedule[0].torque": (0.1, 0.0, 0.2),
        "effects[2].schedule[1].force": (0.5, 0.0, 0.2),
        "effects[2].schedule[2].force": (0.0, 0.0, 0.0),
        "effects[3].schedule[0].torque": (0.2, 0.0, 0.0),
    }[whole]
    moved_values = [v + (by if n == k else 0.0) for n, v in enumerate(values)]
    return {"body.center_of_mass" if whole == "center_of_mass" else whole: moved_values}, 1.0


@pytest.mark.parametrize(
    "name",
    [
        "mass", "center_of_mass.x", "center_of_mass.z", "inertia.xx", "inertia.zz", "inertia.xy", "inertia.yz",
        "initial.orientation.y", "initial.angular_velocity_body.z", "initial.position_world.x",
        "initial.linear_velocity_world.y", "effects[1].rotation.y", "effects[1].translation.x",
        "effects[0].acceleration_world.z", "effects[2].schedule[0].torque.z", "effects[2].schedule[1].force.x",
        "effects[2].schedule[2].force.y", "effects[3].schedule[0].torque.x", "wrench_scale.push",
    ],
)  # fmt: skip
def test_of_each_number_alone_it_is_the_difference_of_flights(log: Path, name: str) -> None:
    sigma = 1e-4
    found = rb.covariance(log, {name: sigma})
    minus, plus = (end(*changed(name, sign * sigma)) for sign in (-1.0, 1.0))
    turn = rotations.logarithms(
        rotations.products(rotations.conjugates(np.array(minus.orientation_xyzw)), np.array(plus.orientation_xyzw))
    )
    rest = [np.subtract(getattr(plus, key), getattr(minus, key)) for key in list(QUANTITIES)[1:]]
    expected = np.abs([turn, *rest]) / 2.0
    there = [found.deviations(key)[-1] for key in QUANTITIES]
    assert there == pytest.approx(expected, rel=2e-5, abs=1e-6 * sigma)
    assert found.alone[0] == pytest.approx(np.linalg.norm(expected, axis=1), rel=2e-5, abs=1e-6 * sigma)
    assert found.linear_until_ns is None


def test_a_campaign_spreads_as_it_says(tmp_path: Path) -> None:
    start = {"angular_velocity_body": (0.5, 0.2, -0.4), "linear_velocity_world": (0.3, 0.0, 0.1)}
    path, force, torque = tmp_path / "run.mcap", (0.4, 0.0, 0.1), (0.02, -0.03, 0.01)
    solver = {"method": "rkmk4", "step": 0.1}
    initial = {key: list(value) for key, value in start.items()}
    changes = {"body.mass": 2.0, "body.center_of_mass": [0, 0, 0], "effects": [], "initial": initial, "solver": solver}
    scene = rb.parse_scene(SCENE, overrides={**changes, "wrenches[0].timeout": 0, "duration": 4.0, "output_rate": 1})
    nominal = rb.simulate(scene, [("push", rb.Wrench(force, torque))], [McapSink(path)]).sample
    sigmas = {
        "mass": 0.01, "inertia": 0.004, "initial.orientation": 0.01, "initial.angular_velocity_body": 0.004,
        "initial.position_world": 0.02, "initial.linear_velocity_world": 0.01,
    }  # fmt: skip
    found = rb.covariance(path, sigmas)
    assert found.departure < 0.1
    runs, random = 400, np.random.default_rng(7)
    bodies, states = [], []
    for _ in range(runs):
        draw = 0.004 * random.standard_normal((3, 3))
        inertia = MATRIX + np.triu(draw) + np.triu(draw, 1).T
        bodies.append(rb.RigidBody.from_matrix(2.0 + 0.01 * random.standard_normal(), inertia.tolist()))
        parts = {
            "position_world": 0.02 * random.standard_normal(3),
            "angular_velocity_body": start["angular_velocity_body"] + 0.004 * random.standard_normal(3),
            "linear_velocity_world": start["linear_velocity_world"] + 0.01 * random.standard_normal(3),
            "orientation_xyzw": rotations.quaternions(0.01 * random.standard_normal(3)),
        }
        states.append(rb.State(**{name: tuple(map(float, part)) for name, part in parts.items()}))
    ensemble = Ensemble(bodies, states, "rkmk4", 0.1)
    ensemble.hold(force_body=force, torque_body=torque)
    ensemble.advance(4.0)
    there = ensemble.samples()
    centre = np.array(nominal.orientation_xyzw)
    turns = rotations.logarithms(rotations.products(rotations.conjugates(centre), np.array(there.orientation_xyzw)))
    rest = [np.array(getattr(there, key)) - getattr(nominal, key) for key in list(QUANTITIES)[1:]]
    spread = np.concatenate([turns, *rest], axis=1)
    # Each axis to four standard errors of its own, and all correlations together.
    told = np.concatenate([found.deviations(key)[-1] for key in QUANTITIES])
    assert spread.std(axis=0) == pytest.approx(told, rel=4.0 / math.sqrt(2.0 * runs))
    squares = np.einsum("ni,ij,nj->", spread, np.linalg.inv(found.matrices[-1]), spread)
    assert squares == pytest.approx(12.0 * runs, rel=4.0 * math.sqrt(2.0 / (12.0 * runs)))


def test_what_is_not_linear_is_said(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bent = rb.covariance(log, {"initial.angular_velocity_body": 4.0})
    assert bent.departure > 0.1
    assert bent.linear_until_ns is not None
    assert bent.linear_until_ns < 1_000_000_000
    impossible = rb.covariance(log, {"inertia.yy": 1.0})
    assert (impossible.departure, impossible.linear_until_ns) == (math.inf, 0)
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    assert main(["simulate", str(scene), "--sigma", "inertia.yy=1.0"]) == 0
    assert "NOT LINEAR: a body that is one standard deviation off cannot exist" in capsys.readouterr().out
    assert main(["simulate", str(scene), "--sigma", "initial.angular_velocity_body=4", "--sigma", "mass=0"]) == 0
    assert "NOT LINEAR from t = " in capsys.readouterr().out


def test_rounding_in_what_does_not_depend_on_a_number_is_no_departure(tmp_path: Path) -> None:
    """The mass does not turn a body: its spread in attitude was rounding, and called not linear from 0 s on."""
    text = SCENE.replace("push, timeout: 0.5", "push, timeout: 0.5, delay: 0.05").replace("1.0\noutput", "4.0\noutput")
    drag = "{type: quadratic_drag, translation: [0.1, 0.2, 0.3], rotation: 0.02, medium_velocity_world: [0.5, 0, 0]}"
    buoyancy = "{type: buoyancy, volume: 0.003, density: 1000, acceleration_world: [0, 0, -9.8]}"
    text = text.replace("{type: linear_drag", f"{drag}\n  - {buoyancy}\n  - {{type: linear_drag")
    rb.simulate(rb.parse_scene(text), commands(), [McapSink(tmp_path / "run.mcap")])
    found = rb.covariance(tmp_path / "run.mcap", {"mass": 0.01})
    assert found.largest("attitude").max() < 1e-12
    assert (found.departure < 0.01, found.linear_until_ns) == (True, None)


def fit(path: Path, names: list[str], matrix: Any) -> Path:
    """Write what `identify --json` prints of these numbers; NaN is not known."""
    errors = np.sqrt(np.diagonal(matrix)).tolist()
    told = [
        {"name": name, "known": bool(np.isfinite(e)), "standard_error": e if np.isfinite(e) else None}
        for name, e in zip(names, errors, strict=True)
    ]
    rows = [[v if np.isfinite(v) else None for v in row] for row in matrix.tolist()]
    path.write_text(json.dumps({"parameters": told, "covariance": rows, "inertia": MATRIX.tolist()}))
    return path


def test_a_fit_goes_on_as_an_uncertainty(tmp_path: Path) -> None:
    log, random = tmp_path / "run.mcap", np.random.default_rng(3)
    turned = {"x": 0.5, "y": -0.5, "z": 0.1, "w": 0.7}
    rb.simulate(rb.parse_scene(SCENE, overrides={"initial.orientation": turned}), commands(), [McapSink(log)])
    names = ["mass", *(f"initial.rotation.{k}" for k in "xyz"), *(f"initial.angular_velocity_body.{k}" for k in "xyz")]
    root = 1e-3 * random.standard_normal((7, 7))
    matrix = root @ root.T
    found = rb.covariance(log, fit(tmp_path / "fit.json", names, matrix))
    assert (found.names, found.exact) == (tuple(names), ())
    assert found.sigmas == pytest.approx(np.sqrt(np.diagonal(matrix)))
    assert found.matrices[0, 3:6, 3:6] == pytest.approx(matrix[4:, 4:])
    # A rotation vector and a turn of the body axes are one near no rotation alone.
    scene = rb.parse_scene(SCENE, overrides={"initial.orientation": turned})
    turns = rotations.right_jacobians(rotations.logarithms(np.array(scene.initial.orientation_xyzw)))
    assert found.matrices[0, :3, :3] == pytest.approx(turns @ matrix[1:4, 1:4] @ turns.T)
    # Correlations count.
    alone = rb.covariance(log, fit(tmp_path / "alone.json", names, np.diag(np.diagonal(matrix))))
    assert abs(alone.largest("attitude")[-1] / found.largest("attitude")[-1] - 1.0) > 0.05
    # What is given anew is not taken from the fit, nor is it correlated with it.
    anew = rb.covariance(
        log, tmp_path / "fit.json", {"initial.angular_velocity_body": 0.01, "initial.orientation": 0.0}
    )
    assert anew.matrices[0, :3, :3] == pytest.approx(np.zeros((3, 3)))
    assert anew.matrices[0, 3:6, 3:6] == pytest.approx(1e-4 * np.eye(3))


def test_a_torque_that_a_fit_found_is_uncertain_where_the_scene_has_it(log: Path, tmp_path: Path) -> None:
    names = [f"effects[2].schedule[0].torque.{k}" for k in "xyz"]
    found = rb.covariance(log, fit(tmp_path / "fit.json", names, 1e-6 * np.eye(3)))
    anew = rb.covariance(log, {"effects[2].schedule[0].torque": 1e-3})
    assert found.names == anew.names == tuple(names)
    assert found.matrices == pytest.approx(anew.matrices)
    assert found.deviations("angular_velocity_body")[-1].min() > 1e-5
    lacks = fit(tmp_path / "lacks.json", ["effects[4].schedule[0].torque.x"], 1e-6 * np.eye(1))
    with pytest.raises(rb.SceneError, match="simulate the scene that identify wrote with --out"):
        rb.covariance(log, lacks)


def test_drag_between_outputs_that_are_far_apart_is_resolved(tmp_path: Path) -> None:
    """v falls as exp(-c t / m): so does its deviation, where the body does not turn and outputs are 20 s apart."""
    scene = rb.parse_scene("""
    body: {mass: 2.0, inertia: {diagonal: [1, 1, 1]}}
    initial: {linear_velocity_world: [1, 0, 0]}
    wrenches: []
    effects: [{type: linear_drag, translation: 0.08}]
    duration: 60
    output_rate: 0.05
    """)
    rb.simulate(scene, sinks=[McapSink(path := tmp_path / "run.mcap")])
    found = rb.covariance(path, sigmas={"initial.linear_velocity_world.x": 1e-3})
    last = found.time_ns[-1] * 1e-9
    left = math.exp(-0.04 * last)
    assert found.deviations("linear_velocity_world")[-1, 0] == pytest.approx(1e-3 * left, rel=2e-5)
    assert found.deviations("position_world")[-1, 0] == pytest.approx(1e-3 * (1.0 - left) / 0.04, rel=2e-5)


def test_along_an_orbit_it_is_that_of_clohessy_and_wiltshire(tmp_path: Path) -> None:
    """Central gravity is differentiated by differences, as the effects of plug-ins are."""
    radius, mu = 7e6, 3.986004418e14
    rate = np.sqrt(mu / radius**3)
    scene = rb.parse_scene(f"""
body: {{mass: 10, inertia: {{diagonal: [1, 2, 2.5]}}}}
initial: {{position_world: [{radius}, 0, 0], linear_velocity_world: [0, {radius * rate}, 0]}}
effects: [{{type: central_gravity, gravitational_parameter: {mu}}}]
solver: {{method: auto, accuracy: 1.0e-10}}
duration: 5000
output_rate: 0.05
""")
    rb.simulate(scene, sinks=[McapSink(tmp_path / "orbit.mcap")])
    found = rb.covariance(tmp_path / "orbit.mcap", {"initial.linear_velocity_world.y": 1e-3})
    angle = rate * found.time_ns * 1e-9
    radial, along = 2.0 * (1.0 - np.cos(angle)), 4.0 * np.sin(angle) - 3.0 * angle
    expected = 1e-3 / rate * np.hypot(radial, along)
    assert found.largest("position_world") == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_ratios_of_a_fit_without_torque_are_used_and_the_rest_is_called_exact(log: Path, tmp_path: Path) -> None:
    axes = ("xx", "yy", "zz", "xy", "xz", "yz")
    names = ["mass", *(f"inertia.{k}" for k in axes), *(f"inertia_ratios.{k}" for k in axes), "gyro_bias.imu.x"]
    matrix = np.full((14, 14), np.nan)
    matrix[7:13, 7:13] = 1e-6 * np.eye(6)
    matrix[13, 13] = 1.0
    found = rb.covariance(log, fit(tmp_path / "fit.json", names, matrix))
    assert found.names == tuple(f"inertia.{k}" for k in axes)
    assert found.sigmas == pytest.approx([1e-3 * np.trace(MATRIX)] * 6)
    assert found.exact == ("mass", "scale of the inertia")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("inertia.yx=1", "found 'inertia.yx', expected one of initial.orientation"),
        ("effects[7].rotation=1", "found 'effects[7].rotation'"),
        ("effects[2].schedule[3].torque=1", "found 'effects[2].schedule[3].torque'"),
        ("effects[2].schedule=1", "found 'effects[2].schedule'"),
        ("effects[2].kind=1", "found 'effects[2].kind'"),
        ("mass=-1", "mass: found -1.0, expected a standard deviation, 0 or more"),
        ("inertia=[1, 2]", "or a list of 6 (xx, yy, zz, xy, xz, yz)"),
        ("mass=0", "found nothing uncertain"),
        ("mass=1e200", "expected a standard deviation, 0 or more, up to 1e+100"),
        ("mass", "expected NAME=VALUE"),
        ("wrench_scale.thrust=1", "expected the scale of a topic of the run: "),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, given: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    assert main(["simulate", str(scene), "--duration", "0.5", "--sigma", given]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert "Traceback" not in found


def test_the_command_prints_it_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, sigmas = tmp_path / "scene.yaml", tmp_path / "sigmas.yaml"
    scene.write_text(SCENE)
    sigmas.write_text("body.mass: 1e-1\ninitial.angular_velocity_body: [0, 0, 0.01]\n")
    assert main(["simulate", str(scene), "--covariance", str(sigmas), "--sigma", "mass=2e-1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["uncertainty"]
    assert len(found["time_ns"]) == len(found["attitude"]) == 11
    assert [each["standard_deviation"] for each in found["from"]] == [0.0, 0.0, 0.01, 0.2]
    assert found["angular_velocity_body"][0] == [0.0, 0.0, 0.01]
    assert found["linear_until_s"] is None
    assert main(["simulate", str(scene), "--covariance", str(tmp_path / "none.yaml")]) == 2
    assert capsys.readouterr().err.startswith("rb-dynamics: cannot read ")


@pytest.mark.parametrize("rows", [[[-1.0, 0], [0, 1]], [[1, 2], [2, 1]], [[1, None], [None, 1]], [[1, 0.5], [0, 1]]])
def test_the_covariance_of_a_fit_is_one(rows: list[list[float | None]]) -> None:
    each = {"known": True, "standard_error": 1.0}
    numbers = [{"name": f"initial[0].angular_velocity_body.{axis}", **each} for axis in "xy"]
    fit = {"parameters": numbers, "covariance": rows, "inertia": MATRIX.tolist()}
    with pytest.raises(
        rb.SceneError, match="is no covariance, expected a matrix of finite numbers that is symmetric and positive"
    ):
        uncertain_numbers(fit, None, rb.parse_scene(SCENE))
    exact = {**fit, "covariance": [[1.0, -1.0], [-1.0, 1.0]]}
    assert uncertain_numbers(exact, None, rb.parse_scene(SCENE)).matrix.tolist() == exact["covariance"]


def test_the_momentum_of_a_rotor_that_a_fit_found_may_be_uncertain() -> None:
    rotor = "{type: rotor, axis_body: [0, 0, 1], axial_inertia: 0.01, spin_rate: 50}"
    scene = rb.parse_scene(f"body: {{mass: 1, inertia: {{diagonal: [1, 1, 1]}}}}\neffects: [{rotor}]\n")
    found = uncertain_numbers({"effects[0].momentum_body": 0.1}, None, scene)
    assert found.names == tuple(f"effects[0].momentum_body.{axis}" for axis in "xyz")
