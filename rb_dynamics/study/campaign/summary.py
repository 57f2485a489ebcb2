"""What the rows of a campaign show: quantiles and pass rate with confidence intervals, failures, sensitivities.

Intervals treat the runs as independent draws. A Latin hypercube or a Sobol sequence covers each input more evenly
than that, and with few runs its inputs may be correlated by chance; a driver that is only such an echo is marked as
one.
"""

from __future__ import annotations

import math
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rb_dynamics.study.campaign.model import Campaign

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.study.campaign.flight import Columns

    Numbers = npt.NDArray[np.float64]

CONFIDENCE = 0.95
FAR = 0.9973
"""The part of runs that requirements often speak of: what lies within three deviations of a normal number."""

PROBABILITIES = (0.01, 0.05, 0.5, 0.95, 0.99, FAR)
SHOWN = (0.01, 0.5, 0.95, 0.99, FAR)
"""Of these, what a table has room for."""

BELOW = tuple("median" if each == 0.5 else f"{100.0 * each:g} % below" for each in SHOWN)
"""Heads of their columns."""

TRUE = f"true {100.0 * FAR:g} % in"
"""Head of the column that says where the quantile of all possible runs lies."""

UNKNOWN = "unknown"
"""What stands where the runs are too few to tell."""

EITHER_WAY = " either way"
"""Behind the name of an input: its distance from its median, of which a metric may depend whatever the sign."""


@dataclass(frozen=True)
class Quantile:
    """A quantile of a metric with its interval; None is what there are too few runs to tell."""

    probability: float
    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Worst:
    """The run that is worst by a metric: by what is required of it, else the largest, of `least` the smallest.

    Attributes:
        run: its number, the first where there are several.
        value: of the metric; None where it has none and needs one.
        which: `largest`, `smallest` or `without a value`.
    """

    run: int
    value: float | None
    which: str


@dataclass(frozen=True)
class MetricSummary:
    """What became of one metric.

    Attributes:
        name: of the metric.
        unit: of its values.
        count: of runs in which it is a number.
        missing: of runs in which it is none: a condition that was never met, or a run that could not be flown.
        mean: of the numbers.
        deviation: likewise, standard deviation.
        least: likewise.
        most: likewise.
        quantiles: of the numbers.
        worst: the worst run; None where no run has a number.
        sensitivity: rank correlation with each input, the strongest first.
        either_way: rank correlation with the distance of each input from its median, likewise.
        echoes: of both the inputs that only follow a stronger one: they correlate with it in these runs, beyond
            chance, and with the metric no more than that brings with it; with its name and that correlation.
    """

    name: str
    unit: str
    count: int
    missing: int
    mean: float
    deviation: float
    least: float
    most: float
    quantiles: tuple[Quantile, ...]
    worst: Worst | None
    sensitivity: tuple[tuple[str, float], ...]
    either_way: tuple[tuple[str, float], ...]
    echoes: tuple[tuple[str, str, float], ...]

    @property
    def drivers(self) -> tuple[tuple[str, float], ...]:
        """All sensitivities, the strongest first, without the echoes of stronger ones."""
        only_follow = {name for name, _, _ in self.echoes}
        known = _strongest_first([*self.sensitivity, *((name + EITHER_WAY, value) for name, value in self.either_way)])
        return tuple(pair for pair in known if pair[0] not in only_follow)


@dataclass(frozen=True)
class CampaignSummary:
    """What became of all runs.

    Attributes:
        runs: number of them.
        passed: of those that met every requirement.
        pass_rate: their part of all.
        pass_low: lower end of its interval, for all possible runs.
        pass_high: upper end.
        failed: the numbers of runs that did not pass, the first `MOST_FAILURES` of them; there are `runs - passed`.
        not_flown: number of runs that could not be flown, or not to their end.
        errors: numbers and texts of these, likewise.
        noise: the size that a rank correlation has by chance alone in 5 % of cases.
        metrics: each of them.
    """

    runs: int
    passed: int
    pass_rate: float
    pass_low: float
    pass_high: float
    failed: tuple[int, ...]
    not_flown: int
    errors: tuple[tuple[int, str], ...]
    noise: float
    metrics: tuple[MetricSummary, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON: what is no finite number is None."""
        found: dict[str, Any] = _finite(asdict(self))
        return found


MOST_FAILURES = 1000

_RUNS_AN_INPUT = 10


def summarise(campaign: Campaign, rows: Columns) -> CampaignSummary:
    """Return what `rows` show."""
    import numpy as np

    from rb_dynamics.study.campaign.metric_units import unit_of

    good = rows["passed"]
    runs, passed = len(good), int(np.count_nonzero(good))
    low, high = proportion_interval(passed, runs)
    ranks = {each.name: _ranks(rows[each.name]) for each in campaign.inputs}
    ranks |= {name + EITHER_WAY: _ranks(abs(each - each.mean())) for name, each in ranks.items()}
    noise = min(1.0, 1.96 / math.sqrt(max(1, runs - 1)))
    errors = [(int(run), text) for run, text in zip(rows["run"], rows["error"], strict=True) if text]
    return CampaignSummary(
        runs,
        passed,
        passed / runs,
        low,
        high,
        tuple(rows["run"][~good][:MOST_FAILURES].tolist()),
        len(errors),
        tuple(errors[:MOST_FAILURES]),
        noise,
        tuple(_metric(campaign, each.name, unit_of(each), rows, ranks, noise) for each in campaign.metrics),
    )


def quantile_interval(values: Numbers, probability: float) -> Quantile:
    """Return a quantile of sorted `values` with an interval between order statistics, free of any distribution.

    Of n values so many lie below the true quantile as a binomial number says: the r-th and the s-th bound it with at
    least `CONFIDENCE` (David and Nagaraja, Order Statistics, section 7.1). The k-th stands for the quantile of
    (k - 1/2)/n (Hazen); what lies before the first or behind the last of these has no value.
    """
    from scipy.stats import binom

    count, tail = len(values), 0.5 * (1.0 - CONFIDENCE)
    below = int(binom.ppf(tail, count, probability))
    above = int(binom.ppf(1.0 - tail, count, probability)) + 1
    is_within = 0.5 <= probability * count <= count - 0.5
    return Quantile(
        probability,
        float(values[max(0, math.ceil(probability * count) - 1)]) if is_within else None,
        float(values[below - 1]) if below >= 1 else None,
        float(values[above - 1]) if above <= count else None,
    )


def proportion_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the interval of Clopper and Pearson (Biometrika 26 (1934) 404): it covers at least `CONFIDENCE`."""
    from scipy.stats import beta

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = float(beta.ppf(tail, successes, trials - successes + 1)) if successes else 0.0
    high = float(beta.ppf(1.0 - tail, successes + 1, trials - successes)) if successes < trials else 1.0
    return low, high


def _metric(
    campaign: Campaign, name: str, unit: str, rows: Columns, ranks: Mapping[str, Numbers], noise: float
) -> MetricSummary:
    import numpy as np

    column = rows[name]
    is_number = np.isfinite(column)
    values = np.sort(column[is_number])
    count = len(values)
    if count == 0:
        nan, worst = math.nan, _worst(campaign, name, rows)
        return MetricSummary(name, unit, 0, len(column), nan, nan, nan, nan, (), worst, (), (), ())
    sensitivity = _sensitivity(column, is_number, ranks)
    with np.errstate(over="ignore", invalid="ignore"):
        mean, deviation = float(values.mean()), float(values.std(ddof=1)) if count > 1 else 0.0
    return MetricSummary(
        name,
        unit,
        count,
        len(column) - count,
        mean,
        deviation,
        float(values[0]),
        float(values[-1]),
        tuple(quantile_interval(values, probability) for probability in PROBABILITIES),
        _worst(campaign, name, rows),
        tuple(pair for pair in sensitivity if not pair[0].endswith(EITHER_WAY)),
        tuple((pair[0].removesuffix(EITHER_WAY), pair[1]) for pair in sensitivity if pair[0].endswith(EITHER_WAY)),
        _echoes(sensitivity, ranks, noise),
    )


def _worst(campaign: Campaign, name: str, rows: Columns) -> Worst | None:
    """Return the worst of the runs that could be flown."""
    import numpy as np

    column, is_number = rows[name], np.isfinite(rows[name])
    required = [each for each in campaign.requirements if each.metric == name]
    lacks = ~is_number & np.array([not error for error in rows["error"]], dtype=np.bool_)
    if required and lacks.any():
        return Worst(int(rows["run"][lacks][0]), None, "without a value")
    if not is_number.any():
        return None
    is_least = next(each.reduction for each in campaign.metrics if each.name == name) == "least"
    if required:
        low, high = required[0].above, required[0].below
    else:
        low, high = (0.0, math.inf) if is_least else (-math.inf, 0.0)
    with np.errstate(over="ignore"):
        above, below = column - high, low - column
    place = int(np.argmax(np.where(is_number, np.fmax(above, below), -math.inf)))
    which = "smallest" if below[place] > above[place] else "largest"
    return Worst(int(rows["run"][place]), float(column[place]), which)


def _sensitivity(
    column: Numbers, is_number: npt.NDArray[np.bool_], ranks: Mapping[str, Numbers]
) -> tuple[tuple[str, float], ...]:
    """Return Spearman's correlation with each of `ranks`; what is no number ranks above all numbers."""
    import numpy as np

    own = _ranks(np.where(is_number, column, math.inf))
    return _strongest_first([(name, _correlation(own, other)) for name, other in ranks.items()])


def _strongest_first(found: Sequence[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(found, key=lambda pair: -abs(pair[1])))


def _echoes(
    sensitivity: Sequence[tuple[str, float]], ranks: Mapping[str, Numbers], noise: float
) -> tuple[tuple[str, str, float], ...]:
    """Return the inputs whose correlation is that of a stronger one, times theirs with it; see `MetricSummary`."""
    drivers: list[tuple[str, float]] = []
    echoes = []
    for name, value in sensitivity:
        if abs(value) <= noise:
            break
        for stronger, most in drivers:
            shared = _correlation(ranks[name], ranks[stronger])
            if abs(shared) > noise and abs(value - shared * most) <= noise:
                echoes.append((name, stronger, shared))
                break
        else:
            drivers.append((name, value))
    return tuple(echoes)


def _ranks(column: Numbers) -> Numbers:
    from scipy.stats import rankdata

    ranks: Numbers = rankdata(column)
    return ranks


def _correlation(a: Numbers, b: Numbers) -> float:
    da, db = a - a.mean(), b - b.mean()
    size = math.sqrt(float((da * da).sum()) * float((db * db).sum()))
    return float((da * db).sum()) / size if size > 0.0 else 0.0


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_text(
    campaign: Campaign, summary: CampaignSummary, options: Sequence[str] = (), rows: str = "", most: int = 5
) -> str:
    """Return the summary for a person at a terminal; `options` as in `rerun_commands`, `rows` where all runs are."""
    lines = [
        f"runs        {summary.runs}, seed {campaign.seed}, {campaign.sampling.replace('_', ' ')}",
        f"passed      {summary.passed} of {summary.runs}: {_percents(summary)}",
        *(f"  {line}" for line in _aligned(quantile_table(summary))),
        f"  99 % below: so many of the runs have a smaller value. {TRUE}: where it lies for all possible runs, with",
        f"  {CONFIDENCE:.0%} confidence. no value: runs that never met the condition, or could not be flown.",
    ]
    if far := far_text(summary):
        lines.append(f"  {far}")
    lines += [f"worst       {worst_text(metric)}" for metric in summary.metrics if metric.worst]
    runs = dict.fromkeys(metric.worst.run for metric in summary.metrics if metric.worst)
    lines += [f"            {command}" for command in rerun_commands(campaign, list(runs), options)]
    either_way = False
    for metric in summary.metrics:
        strongest = [f"{name} {value:+.2f}" for name, value in metric.drivers[:3] if abs(value) > summary.noise]
        either_way |= any(EITHER_WAY in each for each in strongest)
        if strongest:
            lines.append(f"depends     {metric.name} on {', '.join(strongest)} (rank correlation, -1 to 1)")
        lines += [
            f"            not told apart: {name}, which goes with {stronger} in these runs by {shared:+.2f}"
            for name, stronger, shared in metric.echoes[:3]
        ]
    if either_way:
        lines.append(f"           {EITHER_WAY}: on how far an input is from its median, above or below")
    if few := few_runs(campaign, summary):
        lines.append(f"note        {few}")
    place = rows or "the rows"
    lines += [f"not flown   run {run}: {text}" for run, text in summary.errors[:most]]
    if summary.not_flown > most:
        lines.append(f"            {most} of {summary.not_flown} shown; all in {place}, where error is not empty")
    if summary.failed:
        failed = summary.runs - summary.passed
        some = f" ({most} of {failed} shown; all in {place}, where passed is false)" if failed > most else ""
        lines.append(f"failed      {failed}; to fly one again with a full log{some}:")
    lines += [f"            {command}" for command in rerun_commands(campaign, summary.failed[:most], options)]
    return "\n".join(lines)


def few_runs(campaign: Campaign, summary: CampaignSummary) -> str:
    """Return that the runs are too few to tell so many inputs apart; "" where they are enough."""
    wanted = _RUNS_AN_INPUT * len(campaign.inputs)
    if summary.runs >= wanted:
        return ""
    return (
        f"{summary.runs} runs are few for {len(campaign.inputs)} inputs, some of which go with each other by chance; "
        f"{wanted} or more tell them apart"
    )


def percent(part: float, runs: int) -> str:
    """Return a part of `runs` in per cent, with the digits that so many runs can tell."""
    return f"{part:.{max(1, math.ceil(math.log10(runs)) - 2)}%}"


def _percents(summary: CampaignSummary) -> str:
    rate, low, high = (percent(part, summary.runs) for part in (summary.pass_rate, summary.pass_low, summary.pass_high))
    return f"{rate}; of all possible runs {low} to {high}, with {CONFIDENCE:.0%} confidence"


def quantile_table(summary: CampaignSummary) -> list[list[str]]:
    """Return head and rows of the quantiles of each metric, as texts."""
    from rb_dynamics.study.campaign.metric_units import titled

    table = [["metric", *BELOW, TRUE, "no value"]]
    for metric in summary.metrics:
        at = {each.probability: each for each in metric.quantiles}
        values = [at[each].value if at else None for each in SHOWN]
        cells = [UNKNOWN if value is None else f"{value:.4g}" for value in values]
        missing = f"{metric.missing}" if metric.missing else ""
        table.append([titled(metric.name, metric.unit), *cells, interval_text(at.get(FAR)), missing])
    return table


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table: the first column and the last two begin at the left, numbers end at the right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for row in table:
        cells = [f"{cell:>{width}}" for cell, width in zip(row[1:-2], widths[1:-2], strict=True)]
        lines.append("  ".join([f"{row[0]:{widths[0]}}", *cells, f"{row[-2]:{widths[-2]}}", row[-1]]).rstrip())
    return lines


def far_text(summary: CampaignSummary) -> str:
    """Return what so few runs cannot tell of the farthest quantile; "" where they can."""
    count = min((metric.count for metric in summary.metrics if metric.count), default=0)
    reached = math.ceil(0.5 / (1.0 - FAR))
    bounded = math.ceil(math.log(0.5 * (1.0 - CONFIDENCE)) / math.log(FAR))
    if count >= bounded:
        return ""
    return (
        f"{100.0 * FAR:g} %: unknown with fewer than {reached} runs, without an upper bound with fewer than {bounded}."
    )


def worst_text(metric: MetricSummary) -> str:
    """Return which run is the worst by a metric, "" where none is."""
    if metric.worst is None:
        return ""
    if metric.worst.value is None:
        return f"{metric.name}: no value in run {metric.worst.run}"
    value = f"{metric.worst.value:.4g} {metric.unit}".strip()
    return f"{metric.name}: {value}, the {metric.worst.which}, in run {metric.worst.run}"


def interval_text(quantile: Quantile | None) -> str:
    """Return where the true quantile lies, as far as so many runs tell."""
    if quantile is None or quantile.low is None:
        return UNKNOWN
    return f"{quantile.low:.4g} " + ("or more" if quantile.high is None else f"to {quantile.high:.4g}")


def rerun_commands(campaign: Campaign, runs: Sequence[int], options: Sequence[str] = ()) -> list[str]:
    """Return the command that flies each run again, quoted for a shell.

    Args:
        campaign: that the runs are of.
        runs: their numbers.
        options: words of the command line that made it this campaign and say where its rows are.
    """
    begin = shlex.join([_program(), "campaign", campaign.source, *options])
    return [f"{begin} --rerun {run}" for run in runs]


def _program() -> str:
    """Return what starts the command line here: as it was called where a shell would not find it by its name."""
    name, called = "rb-dynamics", sys.argv[0]
    return called if Path(called).stem == name and shutil.which(name) != called else name
