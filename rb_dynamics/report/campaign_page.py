"""The page of a campaign: pass rate, distributions of the metrics, their sensitivities, and notable runs."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.report.html import Figure, Report, Section, Table, Tile, made_by
from rb_dynamics.study.campaign.block_of_runs import Columns, watch_runs
from rb_dynamics.study.campaign.metric_units import titled, unit_of
from rb_dynamics.study.campaign.metrics import QUANTITIES, quantity
from rb_dynamics.study.campaign.model import NO_VALUE, Campaign, Metric
from rb_dynamics.study.campaign.scenes import Scenes
from rb_dynamics.study.campaign.summary import (
    CONFIDENCE,
    EITHER_WAY,
    CampaignSummary,
    MetricSummary,
    far_text,
    few_runs,
    over_runs,
    percent,
    quantile_table,
    rerun_commands,
    summarise,
    value_text,
    worst_text,
)

if TYPE_CHECKING:
    from rb_dynamics.run.sample_arrays import Samples

_WATCHED = 200
"""Number of runs repeated for the figure over time."""

_LOOKS = 600
"""Most intervals of a line over time."""

_LISTED = 30


def campaign_report(
    campaign: Campaign, rows: Columns, options: Sequence[str] = (), summary: CampaignSummary | None = None
) -> Report:
    """Return the page of `rows`; if runs go side by side, the first of them are repeated for a figure over time.

    `options` as in `rerun_commands`, `summary` of the rows if known.
    """
    from rb_dynamics.report import campaign_figures

    summary = summary or summarise(campaign, rows)
    passed = rows["passed"]
    lead = (
        f"{summary.runs} runs of {len(campaign.inputs)} dispersed numbers, {campaign.sampling.replace('_', ' ')}, seed "
        f"{campaign.seed}: {summary.passed} passed, {summary.runs - summary.passed} failed."
    )
    spread = campaign_figures.histograms(
        [(_title(each), rows[each.name], passed, _limit(campaign, each)) for each in campaign.metrics]
    )
    sections = [
        Section("At a glance", _glance(campaign, summary), tiles=_tiles(summary)),
        *_over_time(campaign, summary, rows),
        Section(
            "Distributions of the metrics",
            far_text(summary),
            figures=[Figure(spread, _SPREAD)],
            table=Table.of(quantile_table(summary)),
        ),
    ]
    if campaign.inputs:
        drivers = campaign_figures.sensitivities([(each.name, each.drivers, each.noise) for each in summary.metrics])
        sections.append(
            Section("What drives them", figures=[Figure(drivers, _DRIVERS), *_scatters(campaign, summary, rows)])
        )
    sections += [
        _worst(campaign, summary, options),
        _failed(campaign, summary, rows, options),
        Section("The campaign", source=campaign.text, source_title="The campaign file"),
        Section("The scene", source=campaign.scene_text, source_title="The base scene, as simulated"),
    ]
    return Report(f"Campaign: {os.path.basename(campaign.source)}", lead, sections, made_by())


_SPREAD = (
    "Number of runs per value; failed runs are orange, the dashed line is the requirement. The table gives quantiles "
    f"of the runs, and the {CONFIDENCE:.0%} confidence interval of the 99.73 % quantile of all possible runs, "
    "whatever the distribution; the .json file has it for every quantile. A run has no value if it never met the "
    "condition (it then counts as larger than any), or if it could not be completed or its metric is NaN (it then does "
    "not count)."
)
_DRIVERS = (
    "Spearman's rank correlation, the strongest inputs first: +1 if a metric always increases with an input, -1 if "
    "it always decreases. Either way: with the distance of the input from its median, above or below. Values within "
    "the grey band may be due to chance. Runs without a value are left out, except those that never met the condition. "
    "Inputs that are only correlated with a stronger one in these runs are left out; the .json file has them (echoes)."
)
_SCATTER = "Each metric against its strongest input, if that is more than chance; failed runs are orange."


def _glance(campaign: Campaign, summary: CampaignSummary) -> str:
    parts = []
    if campaign.requirements:
        wanted = [f"{each.metric} {_range(each.below, each.above)}" for each in campaign.requirements]
        parts.append(f"A run passes if {' and '.join(wanted)}.")
    else:
        parts.append("There are no requirements: every completed run passes.")
    for metric in summary.metrics:
        if metric.strongest and abs(metric.strongest[1]) > 0.1:
            name, value = metric.strongest
            over = over_runs(summary, metric)
            parts.append(f"{metric.name} depends most on {name} (rank correlation {value:+.2f}{over}).")
    if few := few_runs(campaign, summary):
        parts.append(f"{few}.")
    return "\n\n".join(parts)


def _range(below: float, above: float) -> str:
    bounds = [f"is below {below:g}"] if math.isfinite(below) else []
    return " and ".join(bounds + ([f"is above {above:g}"] if math.isfinite(above) else []))


def _tiles(summary: CampaignSummary) -> list[Tile]:
    low, high = percent(summary.pass_low, summary.runs), percent(summary.pass_high, summary.runs)
    interval = f"of all possible runs {low} to {high}, with {CONFIDENCE:.0%} confidence"
    failed = summary.runs - summary.passed
    tiles = [
        Tile("Passed", percent(summary.pass_rate, summary.runs), interval, "bad" if failed else "good"),
        Tile("Failed", f"{failed}", f"of {summary.runs} runs", "bad" if failed else "good"),
    ]
    if summary.errors:
        tiles.append(Tile("Not completed", f"{summary.not_flown}", summary.errors[0][1][:80], "bad"))
    for metric in summary.metrics:
        value = next((each.value for each in metric.quantiles if each.probability == 0.95), None)
        if value is not None:
            shown = f"{value_text(value, metric)} {metric.unit if math.isfinite(value) else ''}".strip()
            tiles.append(Tile(f"{metric.name}, 95 % of runs below", shown, _note(metric)))
    return tiles


def _note(metric: MetricSummary) -> str:
    middle = next(each.value for each in metric.quantiles if each.probability == 0.5)
    missing = (
        f", {'never' if metric.never == metric.missing else NO_VALUE} in {metric.missing} runs"
        if metric.missing
        else ""
    )
    most = f", most {metric.most:.4g}" if metric.count else ""
    return f"median {value_text(middle, metric)}{most}{missing}"


def _over_time(campaign: Campaign, summary: CampaignSummary, rows: Columns) -> list[Section]:
    """Repeat some runs, failed ones among them, and show the required metrics over time."""
    import numpy as np

    from rb_dynamics.report import campaign_figures

    followed: dict[tuple[object, ...], Metric] = {}
    for metric in campaign.metrics:
        followed.setdefault((metric.quantity, metric.target_xyzw), metric)
    flyable = np.array([not text for text in rows["error"]])
    failed = rows["run"][~rows["passed"] & flyable][:8].tolist()
    runs = sorted({*rows["run"][flyable][: _WATCHED - len(failed)].tolist(), *failed})
    if not runs:
        return []
    functions = [quantity(campaign, metric) for metric in followed.values()]
    times: list[float] = []
    values: list[list[object]] = [[] for _ in functions]

    def watch(samples: Samples) -> None:
        times.append(float(samples.time_ns / NANOSECONDS))
        for column, function in zip(values, functions, strict=True):
            column.append(function(samples))

    # Observe no more often than is drawn, at times at which the runs were also observed.
    looks = (Scenes(campaign).base.end_ns or 0) / campaign.observe_ns
    seldom = replace(campaign, observe_ns=campaign.observe_ns * max(1, math.ceil(looks / _LOOKS)))
    try:
        watch_runs(seldom, runs, watch)
    except (RigidBodyError, ValueError):
        return []
    bad = np.isin(runs, failed)
    caption = f"median and the middle 90 % of {_some(len(runs), summary.runs, 'runs')}"
    if failed:
        caption += f"; orange: {_some(len(failed), summary.runs - summary.passed, 'that failed')}"
    drawn = []
    for metric, column in zip(followed.values(), map(np.array, values), strict=True):
        title, without = _quantity_title(metric), int(np.isnan(column).any(axis=0).sum())
        rest = f"; at some times of fewer, as {without} of these runs have no value (NaN) there" if without else ""
        drawing = campaign_figures.over_time(np.array(times), title, column, bad)
        drawn.append(Figure(drawing, f"{title}: {caption}{rest}."))
    return [Section("Over time", figures=drawn)]


def _some(shown: int, all_of_them: int, what: str) -> str:
    """Return the number shown and the total, as text."""
    return f"{shown} of the {all_of_them} {what}" if shown < all_of_them else f"all {shown} {what}"


def _scatters(campaign: Campaign, summary: CampaignSummary, rows: Columns) -> list[Figure]:
    from rb_dynamics.report import campaign_figures

    pairs = []
    for metric, found in zip(campaign.metrics, summary.metrics, strict=True):
        if found.strongest:
            name = found.strongest[0].removesuffix(EITHER_WAY)
            pairs.append((name, _title(metric), rows[name], rows[metric.name], rows["passed"]))
    return [Figure(campaign_figures.scatters(pairs), _SCATTER)] if pairs else []


def _worst(campaign: Campaign, summary: CampaignSummary, options: Sequence[str]) -> Section:
    found = [metric for metric in summary.metrics if metric.worst]
    runs = dict.fromkeys(metric.worst.run for metric in found if metric.worst)
    commands = rerun_commands(campaign, list(runs), options)
    return Section("The worst runs", "\n\n".join(map(worst_text, found)), lines=commands)


def _failed(campaign: Campaign, summary: CampaignSummary, rows: Columns, options: Sequence[str]) -> Section:
    heading = "Runs that failed"
    if not summary.failed:
        most = percent(1.0 - summary.pass_low, summary.runs)
        none = f"None. With {CONFIDENCE:.0%} confidence fewer than {most} of all possible runs would fail."
        return Section(heading, none)
    failed = summary.runs - summary.passed
    rest = f" {_LISTED} of {failed} are listed; the rows have all, where passed is false." if failed > _LISTED else ""
    text = (
        f"The command below repeats run {summary.failed[0]} to the bit, with a full log of its motion and of its "
        f"commands; with another number, any other.{rest}"
    )
    commands = rerun_commands(campaign, summary.failed[:1], options)
    return Section(heading, text, lines=commands, table=_failures(campaign, summary, rows))


def _failures(campaign: Campaign, summary: CampaignSummary, rows: Columns) -> Table | None:
    shown = summary.failed[:_LISTED]
    if not shown:
        return None
    errors = dict(summary.errors)
    cells: list[Sequence[str]] = []
    header = ["run", *(metric.name for metric in campaign.metrics), *(["not completed"] if errors else [])]
    for run in shown:
        known = [(float(rows[each.name][run]), NO_VALUE if run in errors else each.if_nan) for each in campaign.metrics]
        values = [if_nan if math.isnan(value) else f"{value:.4g}" for value, if_nan in known]
        cells.append([str(run), *values, *([errors.get(run, "")] if errors else [])])
    return Table(header, cells, numeric=False)


def _title(metric: Metric) -> str:
    return titled(metric.name, unit_of(metric))


def _quantity_title(metric: Metric) -> str:
    if metric.quantity not in QUANTITIES:
        return metric.quantity
    name, unit = QUANTITIES[metric.quantity]
    return titled(f"{name[:1].upper()}{name[1:]}", unit)


def _limit(campaign: Campaign, metric: Metric) -> float | None:
    for each in campaign.requirements:
        if each.metric == metric.name:
            return each.below if math.isfinite(each.below) else each.above
    return None
