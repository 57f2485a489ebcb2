"""The report of a run has the numbers of the terminal, in sections, for any log."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.report.html import Section, write_html
from rb_dynamics.report.inspection_text import as_text
from rb_dynamics.report.run_page import comparison_section, run_report, write_run_report
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene import parse_scene, read_scene
from rb_dynamics.sinks.mcap_sink import McapSink

SPIN = """
body: {mass: 1.0, inertia: {diagonal: [1, 2, 2.5]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
wrenches: []
solver: {method: auto}
duration: 1.0
"""


def page_of(path: Path) -> ElementTree.Element:
    return ElementTree.fromstring(path.read_text(encoding="utf-8").removeprefix("<!DOCTYPE html>"))


def words(element: ElementTree.Element) -> str:
    return " ".join("".join(element.itertext()).split())


def headings(page: ElementTree.Element) -> list[str]:
    return [words(heading) for heading in page.iter("h2")]


def test_report_of_a_run_has_everything(flight: Any, tmp_path: Path) -> None:
    target = tmp_path / "run.html"
    extra = Section("Extra", "told by the caller")
    summary = write_run_report(flight.log, target, extra=[extra])
    page = page_of(target)
    assert headings(page) == [
        "At a glance",
        "Warnings",
        "Extra",
        "What was simulated",
        "Motion",
        "Poinsot's construction",
        "Momentum and energy",
        "Wrenches",
        "Checks",
        "First and last state",
        "Extremes",
        "Topics",
        "Provenance",
    ]
    text = words(page)
    energy = summary.balance("energy")
    assert energy is not None
    assert f"{energy.relative:.2g}" in text
    assert f"{flight.result.sample.work:.7g}" in text
    assert f"{flight.result.steps} steps" in text
    assert "mass: 4.0" in text
    assert "/thrust timed out 1×, first at t = 1.05 s." in text
    assert len(list(page.iter("svg"))) == len(list(page.iter("figcaption"))) == 9
    assert all(words(caption) for caption in page.iter("figcaption"))
    for figure in (
        "Torque of /thrust about the centre of mass, body axes [N m]",
        "Force of /push, world axes [N]",
        "Energy defect",
    ):
        assert figure in text
    assert "What acted, each value held until the next. Torques are about the centre of mass" in text
    assert "Zero throughout: torque of /push, force of /thrust." in text
    assert "http" not in target.read_text()
    records = [words(row[0]) for row in page.iter("tr") if len(row) == 3 and words(row[0]).startswith("rb_dynamics")]
    # Whether there is a checkpoint, wall time says too.
    assert [each for each in records if each != "rb_dynamics.checkpoint"] == [
        "rb_dynamics", "rb_dynamics.result", "rb_dynamics.topics",
    ]  # fmt: skip


def test_a_note_breaks_between_its_parts(flight: Any, tmp_path: Path) -> None:
    write_run_report(flight.log, tmp_path / "run.html")
    page = page_of(tmp_path / "run.html")
    parts = [[words(part) for part in note] for note in page.iter("dd") if note.get("class") == "note"]
    assert ["all 13 checks passed"] in parts
    assert [len(note) for note in parts if note[0] == "relative;"] == [2, 2, 2]


def test_the_card_says_which_method_ran(tmp_path: Path) -> None:
    """For "auto" it is the chosen one; the long description of the solver is only in the table."""
    simulate(parse_scene(SPIN), (), [McapSink(tmp_path / "run.mcap")])
    summary = write_run_report(tmp_path / "run.mcap", tmp_path / "run.html")
    page = page_of(tmp_path / "run.html")
    assert summary.asked == "auto"
    assert summary.method == "exact"
    tiles = {words(tile[0]): list(map(words, tile[1:])) for tile in page.iter("div") if tile.find("dt") is not None}
    assert tiles["Method"] == ["exact", "auto; 1 step"]
    assert summary.solver in words(page)
    assert "; exact (auto), 1 step" in " ".join(as_text(summary).split())


def test_report_is_the_same_every_time(flight: Any, tmp_path: Path) -> None:
    for name in ("one.html", "two.html"):
        write_run_report(flight.log, tmp_path / name)
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_report_of_a_run_without_wrench(coasting: Any, tmp_path: Path) -> None:
    write_run_report(coasting.log, tmp_path / "run.html")
    assert "No command came with a force or a torque, and no effect held one." in words(page_of(tmp_path / "run.html"))


def test_a_balance_known_for_less_than_half_of_the_run_is_not_shown_as_good(flown: Any, tmp_path: Path) -> None:
    again = [Wrench((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), "body", k * 20_000_000 + 500_007_000) for k in range(110)]
    log = flown([("thrust", wrench) for wrench in again]).log
    summary = write_run_report(log, tmp_path / "run.html", bound=1e-8)
    page = page_of(tmp_path / "run.html")
    assert summary.passed
    share = next(check.share for check in summary.checks if check.name == "angular momentum balance")
    said = f"Every check passed, the angular momentum balance over {100.0 * share:.3g} % of the run."
    assert said in words(next(iter(page.iter("p"))))
    tiles = {words(tile): tile.get("class") or "" for tile in page.iter("div") if "tile" in (tile.get("class") or "")}
    (look,) = (look for text, look in tiles.items() if text.startswith("Angular momentum defect"))
    assert "good" not in look


@pytest.mark.parametrize("with_scene", [False, True])
def test_report_of_a_foreign_bag(with_scene: bool, example_dir: Path, scene_dir: Path, tmp_path: Path) -> None:
    scene = read_scene(scene_dir / "slew.yaml") if with_scene else None
    write_run_report(example_dir / "slew.mcap", tmp_path / "run.html", scene=scene)
    page = page_of(tmp_path / "run.html")
    assert ("Momentum and energy" in headings(page)) is with_scene
    assert "What was commanded, each value held until the next." in words(page)
    assert "What was recorded" in headings(page)
    assert ("Give them as a scene file" in words(page)) is not with_scene


@pytest.mark.slow
def test_report_says_if_the_scene_explains_a_foreign_bag(example_dir: Path, scene_dir: Path, tmp_path: Path) -> None:
    write_run_report(example_dir / "slew.mcap", tmp_path / "run.html", scene=read_scene(scene_dir / "slew.yaml"))
    text = words(page_of(tmp_path / "run.html"))
    assert "The inertia given explains the motion" in text
    assert "The forces fit a mass of 16.800000 ± 2e-05 kg best." in text
    assert "Residual torque about the centre of mass" in text


def test_failures_stand_at_the_top(flight: Any, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = flight.log.read_bytes()
    cut.write_bytes(data[: 2 * len(data) // 3])
    write_run_report(cut, tmp_path / "run.html")
    page = page_of(tmp_path / "run.html")
    lead = words(next(iter(page.iter("p"))))
    assert "; cut off at t = " in lead
    assert "Failed: file is whole" in lead
    # All of them, although some topics have one sample more than others.
    assert len(list(page.iter("svg"))) == 9


def test_scene_text_and_names_are_escaped(bagger: Any, tmp_path: Path) -> None:
    topic = "/<img src=x onerror=alert(1)>/pose"
    pose = "geometry_msgs/msg/PoseStamped"
    write_run_report(
        bagger([(topic, pose, k, (k, "<b>", (0.0,) * 6 + (1.0,))) for k in range(3)]), tmp_path / "run.html"
    )
    page = page_of(tmp_path / "run.html")
    assert topic in words(page)
    assert page.find(".//img") is None


def test_a_fact_of_several_lines_keeps_them(tmp_path: Path, example_dir: Path) -> None:
    """rosbag2 puts its metadata.yaml into a file as one fact."""
    bag, kept = read_bag(example_dir / "slew.mcap"), "version: 9\nstorage_identifier: mcap\n"
    bag.metadata["rosbag2"] = {"serialized_metadata": kept, "ROS_DISTRO": "jazzy"}
    track = read_track(bag)
    write_html(tmp_path / "run.html", run_report(track, summarize(track)))
    page = page_of(tmp_path / "run.html")
    assert any(kept.strip() in "".join(text.itertext()) for text in page.iter("pre"))
    rows = [[words(cell) for cell in row] for row in page.iter("tr")]
    assert ["rosbag2", "serialized_metadata", "below"] in rows
    assert ["", "ROS_DISTRO", "jazzy"] in rows


def test_comparison_tells_the_worst_and_when() -> None:
    time_s = np.array([0.0, 1.0, 2.0])
    section = comparison_section(time_s, {"position (m)": np.array([[0.0, 0, 0], [3e-9, 4e-9, 0], [0, 0, 1e-10]])})
    assert section.table is not None
    assert section.table.rows == [["position (m)", "5.000e-09", "1", "1.000e-10"]]
    assert "position (m)" in section.figures[0].picture.svg
