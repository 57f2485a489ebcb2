"""Statistics of a campaign: intervals that cover what they say, ranks, and the page."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from campaigns import write
from scipy import stats

from rb_dynamics.campaign.flight import fly_block
from rb_dynamics.campaign.read import read_campaign
from rb_dynamics.campaign.summary import as_text, proportion_interval, quantile_interval, summarise


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
    assert found.value == 19.0
    assert quantile_interval(np.array([3.0]), 0.5).value == 3.0


def test_the_interval_of_a_pass_rate() -> None:
    # Clopper and Pearson: no failure in n runs bounds the rate of failures by 1 - 0.025^(1/n).
    low, high = proportion_interval(100, 100)
    assert (low, high) == (pytest.approx(0.025 ** (1.0 / 100.0)), 1.0)
    assert proportion_interval(0, 100) == (0.0, pytest.approx(1.0 - low))


def test_what_rows_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    campaign = read_campaign(write(tmp_path))
    rows = fly_block(campaign, 0, 24)
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


def test_a_condition_that_is_never_met_is_no_number(tmp_path: Path) -> None:
    text = "scene: scene.yaml\nruns: 3\nmetrics: {never: {time_to: rate, above: 100}}\n"
    campaign = read_campaign(write(tmp_path, text))
    summary = summarise(campaign, fly_block(campaign, 0, 3))
    assert summary.metrics[0].missing == 3
    assert math.isnan(summary.metrics[0].mean)
    assert json.loads(json.dumps(summary.as_dict(), allow_nan=False))["metrics"][0]["mean"] is None
    assert "never [s]" in as_text(campaign, summary)


def test_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    from rb_dynamics.campaign.page import campaign_report, write_campaign_page

    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    campaign = read_campaign(write(tmp_path))
    rows = fly_block(campaign, 0, 24)
    report = campaign_report(campaign, rows)

    headings = [section.heading for section in report.sections]
    assert headings[:4] == ["At a glance", "Over time", "How the metrics are spread", "What drives them"]
    for section in report.sections:
        for figure in section.figures:
            assert ElementTree.fromstring(figure.svg).tag == "svg"
    failed = next(section for section in report.sections if section.heading == "Runs that failed")
    failures = failed.table
    assert failures is not None
    # One command for all of them.
    assert failed.text.count("--rerun") == 1
    assert failed.text.endswith(f"campaign.yaml --rerun {failures.rows[0][0]}")
    assert [row[0] for row in failures.rows] == [str(run) for run in rows["run"][~rows["passed"]]]
    write_campaign_page(campaign, rows, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "src=" not in page
    assert "url(http" not in page


def test_the_page_counts_every_run_that_could_not_be_flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the summary does not name them all."""
    pytest.importorskip("matplotlib")
    from rb_dynamics.campaign.page import campaign_report

    monkeypatch.setattr("rb_dynamics.campaign.summary.MOST_FAILURES", 2)
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    campaign = read_campaign(write(tmp_path))
    rows = fly_block(campaign, 0, 24)
    rows["error"] = [*(5 * ["too fast"]), *rows["error"][5:]]
    (tile,) = (tile for tile in campaign_report(campaign, rows).sections[0].tiles if tile.label == "Could not be flown")
    assert tile.value == "5"
