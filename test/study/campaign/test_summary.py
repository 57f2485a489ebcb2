"""Statistics of a campaign: coverage of intervals, ranks, and the page."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from campaigns import CAMPAIGN, write
from scipy import stats

from rb_dynamics.study.campaign.block_of_runs import simulate_block
from rb_dynamics.study.campaign.model import Campaign, Requirement
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.sampling import inputs
from rb_dynamics.study.campaign.summary import (
    FAR,
    as_text,
    proportion_interval,
    quantile_interval,
    rerun_commands,
    summarise,
)


@pytest.mark.parametrize(("count", "probability"), [(60, 0.5), (200, 0.95), (400, 0.01)])
def test_intervals_of_quantiles_cover(count: int, probability: float) -> None:
    r, true = np.random.default_rng(5), stats.expon.ppf(probability)
    found = [quantile_interval(np.sort(r.exponential(size=count)), probability) for _ in range(400)]
    covered = [(each.low is None or each.low <= true) and (each.high is None or true <= each.high) for each in found]
    # At least 95 %; of 400 trials fewer than 92 % would be a chance of 1 in 200.
    assert np.mean(covered) > 0.92
    assert np.mean([each.value for each in found]) == pytest.approx(true, rel=0.2)


def test_too_few_runs_bound_nothing() -> None:
    found = quantile_interval(np.arange(20.0), 0.99)
    assert found.high is None
    # The largest of 20 stands for 97.5 %: nothing is known of 99 %, but that it is hardly below the second largest.
    assert found.value is None
    assert found.low == 18.0
    assert quantile_interval(np.arange(20.0), 0.975).value == 19.0
    assert quantile_interval(np.arange(186.0), FAR).value == 185.0
    assert quantile_interval(np.arange(185.0), FAR).value is None
    assert quantile_interval(np.arange(1365.0), FAR).high == 1364.0
    assert quantile_interval(np.arange(1364.0), FAR).high is None
    assert quantile_interval(np.array([3.0]), 0.5).value == 3.0


def test_the_interval_of_a_pass_rate() -> None:
    # Clopper and Pearson: no failure in n runs bounds the rate of failures by 1 - 0.025^(1/n).
    low, high = proportion_interval(100, 100)
    assert (low, high) == (pytest.approx(0.025 ** (1.0 / 100.0)), 1.0)
    assert proportion_interval(0, 100) == (0.0, pytest.approx(1.0 - low))


def test_what_rows_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    campaign = read_campaign(write(tmp_path))
    rows = simulate_block(campaign, 0, 24)
    summary = summarise(campaign, rows)

    assert summary.passed == rows["passed"].sum()
    assert list(summary.failed) == [run for run in range(24) if not rows["final_rate"][run] < 0.25]
    metric = {each.name: each for each in summary.metrics}["final_rate"]
    expected = {each.name: stats.spearmanr(rows[each.name], rows["final_rate"]).statistic for each in campaign.inputs}
    assert dict(metric.sensitivity) == pytest.approx(expected)
    sizes = [abs(value) for _, value in metric.sensitivity]
    assert sizes == sorted(sizes, reverse=True)
    assert metric.quantiles[2].value == pytest.approx(np.median(rows["final_rate"]), rel=0.05)
    settled = {each.name: each for each in summary.metrics}["settled"]
    assert settled.missing == np.isnan(rows["settled"]).sum()
    json.dumps(summary.as_dict(), allow_nan=False)
    assert f"{summary.passed} of 24" in as_text(campaign, summary)
    assert f"--rerun {summary.failed[0]}" in as_text(campaign, summary)
    assert "(rank correlation, -1 to 1)" in as_text(campaign, summary)


def by_its_inputs(folder: Path, runs: int) -> tuple[Campaign, dict[str, Any]]:
    """Return a campaign by Sobol points, and rows of it that hold its inputs, a third of them failed."""
    campaign = read_campaign(write(folder, CAMPAIGN.replace("random", "sobol").replace("runs: 24", f"runs: {runs}")))
    table, numbers = inputs(campaign, 0, runs), np.arange(runs)
    rows: dict[str, Any] = {each.name: table[:, k] for k, each in enumerate(campaign.inputs)}
    metrics = {metric.name: np.ones(runs) for metric in campaign.metrics}
    return campaign, {"run": numbers, **rows, **metrics, "passed": numbers % 3 > 0, "error": [""] * runs}


def test_in_few_runs_an_input_that_goes_with_the_one_that_counts_is_told_apart(tmp_path: Path) -> None:
    """The metric is one of the inputs; other inputs correlate with it only by chance."""
    campaign, rows = by_its_inputs(tmp_path, 16)
    names = [each.name for each in campaign.inputs]
    correlations = abs(stats.spearmanr(np.stack([rows[name] for name in names], axis=1)).statistic)
    pairs = [(correlations[i, j], names[i], names[j]) for i in range(len(names)) for j in range(i)]
    shared, driver, bystander = max(pairs)
    assert shared > summarise(campaign, rows).metrics[0].noise
    rows["final_rate"] = rows[driver]
    metric = {each.name: each for each in summarise(campaign, rows).metrics}["final_rate"]

    assert abs(dict(metric.sensitivity)[bystander]) == pytest.approx(shared)
    assert metric.drivers[0] == (driver, pytest.approx(1.0))
    assert bystander not in dict(metric.drivers)
    assert (bystander, driver) in [(name, stronger) for name, stronger, _ in metric.echoes]
    text = as_text(campaign, summarise(campaign, rows))
    assert f"not told apart: {metric.echoes[0][0]}, whose correlation with {driver}" in text
    assert f"16 runs are few for {len(names)} inputs" in text


def test_what_depends_on_an_input_whatever_its_sign_is_found(tmp_path: Path) -> None:
    """An even dependence has no rank correlation; on a second input it is even and decreasing."""
    campaign, rows = by_its_inputs(tmp_path, 512)
    spin, mass = rows["initial.angular_velocity_body[0]"], rows["body.mass"]
    rows["final_rate"] = abs(spin - np.median(spin))
    rows["worst_energy"] = -abs(mass - np.median(mass)) + 0.01 * stats.zscore(rows["control.parameters.gain"])
    summary = summarise(campaign, rows)
    final, worst, _ = summary.metrics

    assert abs(dict(final.sensitivity)["initial.angular_velocity_body[0]"]) < 0.1
    assert dict(final.either_way)["initial.angular_velocity_body[0]"] == pytest.approx(1.0, abs=1e-3)
    assert final.drivers[0][0] == "initial.angular_velocity_body[0] either way"
    assert worst.drivers[0] == ("body.mass either way", pytest.approx(-1.0, abs=0.02))
    text = as_text(campaign, summary)
    assert "depends     final_rate on initial.angular_velocity_body[0] either way +1.00" in text
    assert " either way: on how far an input is from its median" in text
    json.dumps(summary.as_dict(), allow_nan=False)


@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, 1.0, 2.0], [1.0, 1.0, 2.0, 3.0, 3.0, 3.0, 3.0, 3.0]])
def test_an_input_of_few_values_is_not_compared_with_itself(tmp_path: Path, values: list[float]) -> None:
    """Of two values, the distance from the median is the input again; it was told apart from itself at -1.00."""
    campaign, rows = by_its_inputs(tmp_path, 512)
    rows["body.mass"] = np.resize(values, 512)
    rows["final_rate"] = rows["body.mass"] + 0.1 * stats.zscore(rows["control.parameters.gain"])
    final = summarise(campaign, rows).metrics[0]

    assert final.drivers[0] == ("body.mass", pytest.approx(1.0, abs=0.2))
    assert "body.mass either way" not in [name for name, value in final.drivers if abs(value) > 0.1]
    assert not [echo for echo in final.echoes if echo[0].startswith("body.mass")]
    assert ("body.mass" in dict(final.either_way)) is (len(set(values)) > 2)


def test_a_dependence_either_way_on_an_input_of_few_values_is_found(tmp_path: Path) -> None:
    campaign, rows = by_its_inputs(tmp_path, 512)
    mass = rows["body.mass"] = np.resize([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 3.0], 512)
    rows["final_rate"] = abs(mass - 2.0)
    final = summarise(campaign, rows).metrics[0]
    assert final.drivers[0][0] == "body.mass either way"


def test_what_keeps_runs_from_being_completed_drives_no_metric(tmp_path: Path) -> None:
    campaign, rows = by_its_inputs(tmp_path, 512)
    spin, mass = rows["initial.angular_velocity_body[0]"], rows["body.mass"]
    lost = mass > np.quantile(mass, 0.7)
    rows["error"] = ["too heavy" if each else "" for each in lost]
    rows["final_rate"] = np.where(lost, np.nan, spin)
    summary = summarise(campaign, rows)
    final = summary.metrics[0]

    assert dict(final.sensitivity)["initial.angular_velocity_body[0]"] == pytest.approx(1.0)
    assert abs(dict(final.sensitivity)["body.mass"]) < final.noise


def test_a_metric_that_is_nan_is_no_largest_value(tmp_path: Path) -> None:
    """A logarithm of rates of both signs: half are NaN, which ranked above all numbers."""
    campaign, rows = by_its_inputs(tmp_path, 512)
    spin = rows["initial.angular_velocity_body[0]"]
    with np.errstate(invalid="ignore"):
        rows["final_rate"] = np.log(spin - np.median(spin))
    rows["worst_energy"] = np.where(np.arange(512) == 3, -np.inf, spin)
    rows["settled"] = np.where(spin > np.median(spin), np.nan, spin)
    summary = summarise(campaign, rows)
    final, worst, settled = summary.metrics

    assert final.drivers[0] == ("initial.angular_velocity_body[0]", pytest.approx(1.0))
    assert (final.compared, worst.compared, settled.compared) == (256, 512, 512)
    assert final.noise == pytest.approx(1.96 / math.sqrt(255))
    assert dict(worst.sensitivity)["initial.angular_velocity_body[0]"] == pytest.approx(
        stats.spearmanr(spin, rows["worst_energy"]).statistic
    )
    # What was never reached took longer than any time.
    never = np.where(np.isnan(rows["settled"]), np.inf, spin)
    assert dict(settled.sensitivity)["initial.angular_velocity_body[0]"] == pytest.approx(
        stats.spearmanr(spin, never).statistic
    )
    lines = as_text(campaign, summary).splitlines()
    ends = {line.split()[1]: line.partition("(")[2] for line in lines if line.startswith("depends")}
    assert ends["final_rate"] == "rank correlation, -1 to 1, over the 256 runs with a value)"
    assert ends["settled"] == "rank correlation, -1 to 1)"


def test_the_worst_runs_are_named_with_their_command(tmp_path: Path) -> None:
    campaign, rows = by_its_inputs(tmp_path, 36)
    values = np.arange(36.0)
    rows |= {
        "final_rate": abs(values - 20.0),
        "worst_energy": -values,
        "settled": np.where(values == 7.0, np.nan, values),
    }
    text = as_text(campaign, summarise(campaign, rows), ["--seed", "7"])
    # Below 0.25 is required of the first; nothing of the others, which are the largest then, or never came.
    assert "worst       final_rate: 20 rad/s, the largest, in run 0\n" in text
    assert "worst       settled: never in run 7\n" in text
    assert [line.split()[-1] for line in text.splitlines() if "--seed 7 --rerun" in line][:2] == ["0", "7"]
    for limits, expected in (
        ((Requirement("settled", above=3.0),), "settled: 0 s, the smallest, in run 0"),
        ((Requirement("settled", 40.0, 3.0),), "settled: never in run 7"),
        ((Requirement("final_rate", above=3.0),), "final_rate: 0 rad/s, the smallest, in run 20"),
        ((Requirement("final_rate", 19.0, 2.5),), "final_rate: 0 rad/s, the smallest, in run 20"),
        ((Requirement("final_rate", 19.0, 0.5),), "final_rate: 20 rad/s, the largest, in run 0"),
    ):
        assert expected in as_text(campaign, summarise(replace(campaign, requirements=limits), rows))
    # A run that could not be flown is not a worst run: it stands among those.
    rows["error"] = [*(7 * [""]), "too fast", *(28 * [""])]
    required = replace(campaign, requirements=(Requirement("settled", 100.0),))
    for each in (campaign, required):
        assert "settled: 35 s, the largest, in run 35" in as_text(each, summarise(each, rows))
    never = rows | {"settled": np.full(36, np.nan)}
    assert "settled: never in run 0" in as_text(campaign, summarise(campaign, never))


def test_an_infinite_value_is_one(tmp_path: Path) -> None:
    """It was counted among the runs without a value, and shown in the quantiles."""
    campaign, rows = by_its_inputs(tmp_path, 36)
    rows["worst_energy"] = np.where(np.arange(36) == 5, np.inf, 1.0)
    summary = summarise(campaign, rows)
    energy = summary.metrics[1]
    assert (energy.count, energy.missing, energy.most) == (36, 0, math.inf)
    assert "worst       worst_energy: inf J, the largest, in run 5\n" in as_text(campaign, summary)
    json.dumps(summary.as_dict(), allow_nan=False)


@pytest.mark.slow
def test_a_tile_of_what_was_never_reached_names_no_largest_value(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from rb_dynamics.report.campaign_page import campaign_report

    campaign, rows = by_its_inputs(tmp_path, 36)
    rows["settled"] = np.full(36, np.nan)
    (tile,) = (each for each in campaign_report(campaign, rows).sections[0].tiles if "settled" in each.label)
    assert (tile.value, tile.note) == ("never", "median never, never in 36 runs")


def test_lists_say_what_part_of_all_they_show(tmp_path: Path) -> None:
    campaign, rows = by_its_inputs(tmp_path, 36)
    rows["error"] = [*(7 * ["too fast"]), *(29 * [""])]
    text = as_text(campaign, summarise(campaign, rows), rows="out/rows.parquet")
    assert "\n            5 of 7 shown; all in out/rows.parquet, where error is not empty\n" in text
    assert "full log (5 of 12 shown; all in out/rows.parquet, where passed is false):\n" in text


def test_far_quantiles_say_how_far_they_can_be_trusted(tmp_path: Path) -> None:
    campaign, rows = by_its_inputs(tmp_path, 36)
    rows["final_rate"] = np.arange(36.0)
    line = next(line for line in as_text(campaign, summarise(campaign, rows)).splitlines() if "final_rate [" in line)
    assert line.split() == ["final_rate", "[rad/s]", "unknown", "17", "34", "unknown", "unknown", "34", "or", "more"]
    assert "99.73 %: unknown with fewer than 186 runs, without an upper bound with fewer than 1365." in as_text(
        campaign, summarise(campaign, rows)
    )
    campaign, rows = by_its_inputs(tmp_path, 2048)
    rows["final_rate"] = np.arange(2048.0)
    text = as_text(campaign, summarise(campaign, rows))
    assert "99.73 % below" in text
    assert "2042  2036 to 2047" in text
    assert "unknown" not in text


def test_with_runs_enough_two_that_both_count_are_both_named(tmp_path: Path) -> None:
    campaign, rows = by_its_inputs(tmp_path, 1024)
    one, other = (each.name for each in campaign.inputs[:2])
    rows["final_rate"] = stats.zscore(rows[one]) + 0.5 * stats.zscore(rows[other])
    summary = summarise(campaign, rows)
    metric = {each.name: each for each in summary.metrics}["final_rate"]
    assert metric.echoes == ()
    assert [name for name, _ in metric.drivers[:2]] == [one, other]
    assert "are few for" not in as_text(campaign, summary)


def test_a_printed_command_begins_as_the_program_was_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = read_campaign(write(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "rb-dynamics").touch(0o755)
    for called, begins in (
        (".venv/bin/rb-dynamics", ".venv/bin/rb-dynamics campaign "),
        ("/a place/rb-dynamics", "'/a place/rb-dynamics' campaign "),
        # As a shell calls what it has found by its name.
        (str(tmp_path / "rb-dynamics"), "rb-dynamics campaign "),
        ("/some/where/__main__.py", "rb-dynamics campaign "),
    ):
        monkeypatch.setattr("sys.argv", [called, "campaign"])
        (command,) = rerun_commands(campaign, [3])
        assert command.startswith(begins)


def test_a_condition_that_is_never_met_is_no_number(tmp_path: Path) -> None:
    text = "scene: scene.yaml\nruns: 3\nmetrics: {never: {time_to: rate, above: 100}}\n"
    campaign = read_campaign(write(tmp_path, text))
    summary = summarise(campaign, simulate_block(campaign, 0, 3))
    assert summary.metrics[0].missing == 3
    assert math.isnan(summary.metrics[0].mean)
    assert json.loads(json.dumps(summary.as_dict(), allow_nan=False))["metrics"][0]["mean"] is None
    assert "never [s]" in as_text(campaign, summary)


def test_what_never_comes_meets_that_it_comes_late(tmp_path: Path) -> None:
    """A turn of 1 rad, about a fixed axis, comes after 10, 2.5 or 0.5 s of 4 s; a negative mass is no run."""
    scene = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 0, 0]}\n"
    text = """\
scene: scene.yaml
set: {duration: 4, output_rate: 10}
runs: 24
disperse:
  initial.angular_velocity_body[2]: {choice: {values: [0.1, 0.41, 2.01]}}
  body.mass: {choice: {values: [1, 1, -1]}}
metrics: {turned: {time_to: attitude, above: 1, stays: false}}
require: {turned: {above: 1}}
"""
    flown: dict[str, tuple[set[float], str]] = {}
    for limits in ("above: 1", "above: 4", "below: 3", "above: 1, below: 3"):
        campaign = read_campaign(write(tmp_path, text.replace("{above: 1}}", f"{{{limits}}}}}"), scene))
        rows = simulate_block(campaign, 0, 24)
        failed = np.array([bool(error) for error in rows["error"]])
        assert 0 < failed.sum() < 24
        assert not rows["passed"][failed].any()
        spins = rows["initial.angular_velocity_body[2]"]
        passed = set(spins[rows["passed"]])
        assert passed.isdisjoint(spins[~rows["passed"] & ~failed])
        worst = summarise(campaign, rows).metrics[0].worst
        assert worst is not None
        flown[limits] = passed, worst.which
    assert flown == {
        "above: 1": ({0.1, 0.41}, "smallest"),
        "above: 4": ({0.1}, "smallest"),
        "below: 3": ({0.41, 2.01}, "without a value"),
        "above: 1, below: 3": ({0.41}, "without a value"),
    }


def test_a_time_to_what_never_came_is_longer_than_any(tmp_path: Path) -> None:
    """Of 1000 runs 100 do not settle and 50 cannot be flown: 95 % of the flown ones are not below any time."""
    text = "scene: scene.yaml\nruns: 1000\nmetrics: {settled: {time_to: rate, below: 0.1}, last: {final: rate}}\n"
    campaign = read_campaign(write(tmp_path, text))
    column = np.where(np.arange(1000) < 150, math.nan, np.arange(1000.0))
    summary = summarise(
        campaign,
        {
            "run": np.arange(1000), "settled": column, "last": column, "passed": np.ones(1000, dtype=bool),
            "error": ["no scene" if run < 50 else "" for run in range(1000)],
        },
    )  # fmt: skip
    settled, last = summary.metrics
    assert (settled.count, settled.missing, settled.never) == (850, 150, 100)
    assert {each.probability: each.value for each in settled.quantiles} == {
        0.01: 159.0, 0.05: 197.0, 0.5: 624.0, 0.95: math.inf, 0.99: math.inf, FAR: math.inf
    }  # fmt: skip
    assert [each.value for each in last.quantiles][-1] == 997.0
    line = next(line for line in as_text(campaign, summary).splitlines() if "settled [s]" in line)
    assert line.split() == ["settled", "[s]", "159", "624", "never", "never", "never", "never", "150"]
    found = json.loads(json.dumps(summary.as_dict(), allow_nan=False))["metrics"][0]
    assert (found["never"], found["quantiles"][-1]["value"]) == (100, None)


def test_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    from rb_dynamics.report import campaign_page
    from rb_dynamics.report.html import render_html

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    campaign = read_campaign(write(tmp_path))
    rows = simulate_block(campaign, 0, 24)
    report = campaign_page.campaign_report(campaign, rows)

    headings = [section.heading for section in report.sections]
    assert headings[:4] == ["At a glance", "Over time", "Distributions of the metrics", "What drives them"]
    for section in report.sections:
        for figure in section.figures:
            assert ElementTree.fromstring(figure.picture.svg).tag == "svg"
    failed = next(section for section in report.sections if section.heading == "Runs that failed")
    failures = failed.table
    assert failures is not None
    # One command for all of them.
    (command,) = failed.lines
    assert command.endswith(f"campaign.yaml --rerun {failures.rows[0][0]}")
    assert [row[0] for row in failures.rows] == [str(run) for run in rows["run"][~rows["passed"]]]
    written = render_html(report)
    assert "src=" not in written
    assert "url(http" not in written


@pytest.mark.slow
def test_the_page_says_what_part_of_the_runs_it_shows_over_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    from rb_dynamics.report import campaign_page

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    monkeypatch.setattr(campaign_page, "_WATCHED", 20)
    campaign, rows = by_its_inputs(tmp_path, 36)
    # Of the first 12 runs, which are flown for the figure, 4 failed; those that are drawn go on to the 22nd.
    report = campaign_page.campaign_report(campaign, rows)
    (section,) = (section for section in report.sections if section.heading == "Over time")
    assert all("16 of the 36 runs; orange: 8 of the 12 that failed." in figure.caption for figure in section.figures)


@pytest.mark.slow
def test_the_page_draws_no_input_that_drives_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    from rb_dynamics.report import campaign_page

    campaign, rows = by_its_inputs(tmp_path, 36)
    monkeypatch.setattr(campaign_page, "_over_time", lambda *_: [])

    def drawn() -> int:
        (section,) = (
            each for each in campaign_page.campaign_report(campaign, rows).sections if each.heading.endswith("them")
        )
        return len(section.figures)

    # All runs have the same metrics: no input drives any.
    assert drawn() == 1
    rows["final_rate"] = rows[campaign.inputs[0].name]
    assert drawn() == 2


@pytest.mark.slow
def test_only_a_time_without_a_value_is_never(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of failed runs said never of rates, and of runs that were not flown."""
    pytest.importorskip("matplotlib")
    from rb_dynamics.report.campaign_page import campaign_report

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    (tmp_path / "own_sign.py").write_text(
        "import numpy as np\n\n\ndef logarithm(samples):\n"
        "    rate = samples.angular_velocity_body[:, 0]\n"
        "    return np.where(rate > 0.4 * samples.time_ns / 1e9, rate, np.nan)\n"
    )
    text = CAMPAIGN.replace("worst_energy: {worst: energy}", "logarithm: {final: own_sign.logarithm}")
    campaign = read_campaign(write(tmp_path, text))
    rows = simulate_block(campaign, 0, 24)
    rows["passed"][:2], rows["error"][0] = False, "too fast"
    for metric in campaign.metrics:
        rows[metric.name][:2] = math.nan
    sections = {section.heading: section for section in campaign_report(campaign, rows).sections}
    table = sections["Runs that failed"].table
    assert table is not None
    assert table.rows[0][1:] == ["no value", "no value", "no value", "too fast"]
    assert table.rows[1][1:] == ["no value", "no value", "never", ""]
    # At the end no run has a value of this quantity, and at the begin some.
    rate, logarithm = (figure.caption for figure in sections["Over time"].figures)
    assert "fewer" not in rate
    assert re.search(r"; at some times of fewer, as \d+ of these runs have no value \(NaN\) there\.", logarithm)


def test_the_page_counts_every_run_that_could_not_be_flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the summary does not name them all."""
    pytest.importorskip("matplotlib")
    from rb_dynamics.report.campaign_page import campaign_report

    monkeypatch.setattr("rb_dynamics.study.campaign.summary.MOST_FAILURES", 2)
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    campaign = read_campaign(write(tmp_path))
    rows = simulate_block(campaign, 0, 24)
    rows["error"] = [*(5 * ["too fast"]), *rows["error"][5:]]
    for metric in campaign.metrics:
        rows[metric.name][:5] = math.nan
    (tile,) = (tile for tile in campaign_report(campaign, rows).sections[0].tiles if tile.label == "Not completed")
    assert tile.value == "5"
