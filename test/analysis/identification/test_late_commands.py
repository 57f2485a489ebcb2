"""Commands without stamps act when they were recorded, but for errors that the intervals include."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_rows import write_rows
from foreign_bags import GEOMETRY, Row, header, of, write_bag
from scipy.spatial.transform import Rotation

import rb_dynamics as rb
from rb_dynamics.formats.bag_source import open_source

BEGIN = 1_700_000_000 * 10**9


def pushed(path: Path, seed: int, late_s: tuple[float, float]) -> tuple[rb.Scene, Path]:
    """Return a scene, and the bag of its flight: noise, and torques that were recorded late, each by another time."""
    random = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix = (turned @ np.diag([0.3, 0.4, 0.5]) @ turned.T).tolist()
    scene = rb.parse_scene(
        f"body: {{mass: 5, inertia: {{matrix: {matrix}}}}}\n"
        f"initial: {{angular_velocity_body: {(0.3 * random.normal(size=3)).tolist()}}}\n"
        "wrenches: [{topic: wrench}]\nduration: 10\noutput_rate: 100\n"
    )
    times = (1e9 * np.sort(random.uniform(0.2, 9.5, 20))).astype(int).tolist()
    torques, memory = 0.1 * random.normal(size=(20, 3)), rb.MemorySink()
    sent = [("wrench", rb.Wrench(torque=tuple(row), stamp_ns=at)) for at, row in zip(times, torques, strict=True)]
    rb.simulate(scene, sent, sinks=[memory])
    rows: list[Row] = []
    still = of("Vector3", 0.0, 0.0, 0.0)
    for sample in memory.samples:
        at = BEGIN + sample.time_ns
        turn = Rotation.from_quat(sample.orientation_xyzw) * Rotation.from_rotvec(1e-3 * random.normal(size=3))
        pose = of("Pose", of("Point", 0.0, 0.0, 0.0), of("Quaternion", *turn.as_quat().tolist()))
        rows.append(("/pose", f"{GEOMETRY}PoseStamped", at, of("PoseStamped", header(at, "world"), pose)))
        rates = of("Vector3", *(sample.angular_velocity_body + 1e-3 * random.normal(size=3)).tolist())
        rows.append(
            ("/twist", f"{GEOMETRY}TwistStamped", at, of("TwistStamped", header(at, "body"), of("Twist", still, rates)))
        )
    for at, row in zip(times, torques.tolist(), strict=True):
        logged = BEGIN + at + int(1e9 * random.uniform(*late_s))
        rows.append(("/wrench", f"{GEOMETRY}Wrench", logged, of("Wrench", still, of("Vector3", *row))))
    return scene, write_bag(path, sorted(rows, key=lambda each: each[2]))


def errors(found: rb.Identification, scene: rb.Scene) -> list[float]:
    """Return those of moments and products over their standard errors."""
    truth = {f"inertia.{a}{b}": scene.body.inertia[i][j] for i, a in enumerate("xyz") for j, b in enumerate("xyz")}
    told = [each for each in found.parameters if each.name in truth]
    return [(each.value - truth[each.name]) / each.standard_error for each in told if each.standard_error]


def told(found: rb.Identification) -> bool:
    return any("times of commands on /wrench are not known exactly" in note for note in found.notes)


@pytest.mark.parametrize("seed", [6, 7, 9])
def test_errors_of_times_are_in_the_intervals(tmp_path: Path, seed: int) -> None:
    """They were taken for exact: moments and products were 4.6 to 5.9 standard errors off, without a word."""
    scene, bag = pushed(tmp_path / "bag", seed, (1e-4, 8e-4))
    found = rb.identify(scene, [str(bag)], ["inertia"])
    assert max(map(abs, errors(found, scene))) < 3.0
    assert told(found)


def test_times_that_are_exact_widen_little(tmp_path: Path) -> None:
    scene, bag = pushed(tmp_path / "bag", 3, (0.0, 0.0))
    found = rb.identify(scene, [str(bag)], ["inertia"])
    assert len(errors(found, scene)) == 6
    assert not told(found)


def part(bag: Path, name: str, first_s: float, end_s: float) -> Path:
    """Return what another program would have recorded of the flight of `bag` in that time."""
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages()]
    span = range(BEGIN + round(first_s * 1e9), BEGIN + round(end_s * 1e9))
    return write_rows(bag.parent / name, [row for row in rows if row[2] in span])


def test_a_recording_that_begins_amid_commands_is_fitted_from_the_next_on(tmp_path: Path) -> None:
    """What was held when it began is not in it; nothing was taken to act, and the model did not explain the motion."""
    scene, bag = pushed(tmp_path / "bag", 3, (0.0, 0.0))
    begun = part(bag, "begun.mcap", 2.0, 11.0)
    found = rb.identify(scene, [str(begun)], ["inertia"])
    assert found.explained
    assert len(errors(found, scene)) == 6
    assert max(map(abs, errors(found, scene))) < 3.5
    assert any("amid commands" in note for note in found.notes)


def test_a_fit_is_validated_by_what_begins_amid_commands(tmp_path: Path) -> None:
    """It "did not predict" the motion before the first of them."""
    scene, bag = pushed(tmp_path / "bag", 5, (0.0, 0.0))
    first, second = part(bag, "first.mcap", 0.0, 4.5), part(bag, "second.mcap", 4.5, 11.0)
    found = rb.identify(scene, [str(first)], ["inertia"], validate=[str(second)])
    assert found.validated
    assert any("amid commands" in note for note in found.notes)


@pytest.mark.parametrize(("seed", "factor", "end_s"), [(4, 1.05, 5.0), (4, 1.02, 11.0), (6, 1.02, 11.0)])
def test_no_cut_explains_a_wrong_body(tmp_path: Path, seed: int, factor: float, end_s: float) -> None:
    """What was left after the first command was less than 5 times the noise: it passed, though nothing was missing."""
    scene, bag = pushed(tmp_path / "bag", seed, (0.0, 0.0))
    matrix = (factor * np.array(scene.body.inertia)).tolist()
    wrong = rb.parse_scene(scene.text, "wrong.yaml", {"body.inertia.matrix": matrix})
    flight, start = part(bag, "flight.mcap", 0.0, end_s), part(bag, "start.mcap", 0.0, 1.0)
    assert not rb.identify(wrong, [str(flight)], ["initial"]).explained
    assert rb.identify(wrong, [str(start)], ["initial"], validate=[str(flight)]).validated is False
