"""Statistics of a campaign: quantiles and pass rate with confidence intervals, failures, sensitivities.

Intervals treat the runs as independent draws. A Latin hypercube or a Sobol sequence covers each input more evenly, and
with few runs its inputs may be correlated by chance; a sensitivity that only reflects such a correlation is marked as
an echo.
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

from rb_dynamics.study.campaign.model import NO_VALUE, Campaign, Metric

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.study.campaign.block_of_runs import Columns

CONFIDENCE = 0.95
FAR = 0.9973
"""Probability within three standard deviations of a normal distribution, often used in requirements."""

PROBABILITIES = (0.01, 0.05, 0.5, 0.95, 0.99, FAR)
SHOWN = (0.01, 0.5, 0.95, 0.99, FAR)
"""The quantiles that fit in a table."""

BELOW = tuple("median" if each == 0.5 else f"{100.0 * each:g} % below" for each in SHOWN)
"""Heads of their columns."""

TRUE = f"true {100.0 * FAR:g} % in"
"""Head of the column with the confidence interval of the farthest quantile."""

UNKNOWN = "unknown"
"""Shown if there are too few runs for a value."""

EITHER_WAY = " either way"
"""Suffix of an input's name: its distance from its median, for metrics that depend on it whatever the sign."""


@dataclass(frozen=True)
class Quantile:
    """A quantile of a metric with its interval; None for anything that needs more runs."""

    probability: float
    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Worst:
    """The worst run by a metric: by its requirement, or else the largest (of `least`, the smallest).

    Attributes:
        run: its number, the first if there are several.
        value: of the metric; None if a required value is missing, or a condition was never met.
        which: `largest`, `smallest` or `without a value`.
    """

    run: int
    value: float | None
    which: str


@dataclass(frozen=True)
class MetricSummary:
    """Statistics of one metric.

    Attributes:
        name: of the metric.
        unit: of its values.
        count: number of runs with a value.
        missing: number of runs without a value: a condition that was never met, a metric that is NaN, or a run that was
            not completed.
        never: how many of these never met the condition; they count as larger than any value in quantiles.
        mean: of the values.
        deviation: standard deviation of the values.
        least: smallest value.
        most: largest value.
        quantiles: of the values and of those that never were one; infinite where they are.
        worst: the worst run; None if no run has a value, or never met a condition.
        compared: number of runs of which the correlations are: those completed, except those whose metric is NaN.
        noise: magnitude that a rank correlation of so many exceeds by chance in 5 % of cases.
        sensitivity: rank correlation with each input, strongest first.
        either_way: rank correlation with the distance of each input from its median, in ranks, strongest first; of an
            input with few different values, with the part of it that the input itself does not explain.
        echoes: inputs of both lists that only follow a stronger one: in these runs they correlate with it beyond
            chance, and with the metric no more than that explains; each with the name of the stronger input and that
            correlation.
    """

    name: str
    unit: str
    count: int
    missing: int
    never: int
    mean: float
    deviation: float
    least: float
    most: float
    quantiles: tuple[Quantile, ...]
    worst: Worst | None
    compared: int
    noise: float
    sensitivity: tuple[tuple[str, float], ...]
    either_way: tuple[tuple[str, float], ...]
    echoes: tuple[tuple[str, str, float], ...]

    @property
    def drivers(self) -> tuple[tuple[str, float], ...]:
        """All sensitivities, strongest first, without echoes."""
        only_follow = {name for name, _, _ in self.echoes}
        known = _strongest_first([*self.sensitivity, *((name + EITHER_WAY, value) for name, value in self.either_way)])
        return tuple(pair for pair in known if pair[0] not in only_follow)

    @property
    def strongest(self) -> tuple[str, float] | None:
        """The strongest of the drivers, if that is more than chance."""
        return next((pair for pair in self.drivers[:1] if abs(pair[1]) > self.noise), None)


@dataclass(frozen=True)
class CampaignSummary:
    """Statistics of all runs.

    Attributes:
        runs: number of them.
        passed: number that met every requirement.
        pass_rate: fraction that passed.
        pass_low: lower end of its confidence interval.
        pass_high: upper end.
        failed: numbers of the runs that did not pass, at most the first `MOST_FAILURES`; there are `runs - passed`.
        not_flown: number of runs that could not be completed.
        errors: numbers and error texts of these, at most the first `MOST_FAILURES`.
        metrics: statistics of each metric.
    """

    runs: int
    passed: int
    pass_rate: float
    pass_low: float
    pass_high: float
    failed: tuple[int, ...]
    not_flown: int
    errors: tuple[tuple[int, str], ...]
    metrics: tuple[MetricSummary, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the summary for JSON; numbers that are not finite are None."""
        found: dict[str, Any] = _finite(asdict(self))
        return found


MOST_FAILURES = 1000
# Failures of each kind that the text shows.
_SHOWN = 5

_RUNS_AN_INPUT = 10


def summarise(campaign: Campaign, rows: Columns) -> CampaignSummary:
    """Return the statistics of `rows`."""
    import numpy as np

    from rb_dynamics.study.campaign.metric_units import unit_of

    good = rows["passed"]
    runs, passed = len(good), int(np.count_nonzero(good))
    low, high = proportion_interval(passed, runs)
    # A run that could not be completed says nothing of a metric.
    flown = np.array([not error for error in rows["error"]], dtype=np.bool_)
    ranks = _input_ranks(campaign, rows, flown)
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
        tuple(_metric(campaign, each, unit_of(each), rows, flown, ranks) for each in campaign.metrics),
    )


def quantile_interval(values: Numbers, probability: float) -> Quantile:
    """Return a quantile of sorted `values` with a distribution-free interval between order statistics.

    The number of n values below the true quantile is binomial: the r-th and the s-th bound it with at least
    `CONFIDENCE` (David and Nagaraja, Order Statistics, section 7.1). The k-th value estimates the quantile of (k -
    1/2)/n (Hazen); quantiles before the first or after the last have no value.
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
    """Return the interval of Clopper and Pearson (Biometrika 26 (1934) 404) with coverage of at least `CONFIDENCE`."""
    from scipy.stats import beta

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = float(beta.ppf(tail, successes, trials - successes + 1)) if successes else 0.0
    high = float(beta.ppf(1.0 - tail, successes + 1, trials - successes)) if successes < trials else 1.0
    return low, high


def _metric(
    campaign: Campaign,
    metric: Metric,
    unit: str,
    rows: Columns,
    is_flown: npt.NDArray[np.bool_],
    ranks: Mapping[str, Numbers],
) -> MetricSummary:
    """Return the statistics of a metric; `ranks` of the inputs in the runs that `is_flown`."""
    import numpy as np

    name, column = metric.name, rows[metric.name]
    values = np.sort(column[~np.isnan(column)])
    count = len(values)
    flown, worst = column[is_flown], _worst(campaign, metric, rows, is_flown)
    # The time to an event that never happened counts as longer than any.
    never = int(np.count_nonzero(np.isnan(flown))) if metric.reduction == "time_to" else 0
    with_never = np.where(np.isnan(column), math.inf, column) if never else column
    is_compared = is_flown & ~np.isnan(with_never)
    ordered = np.sort(with_never[is_compared])
    compared = len(ordered)
    noise = min(1.0, 1.96 / math.sqrt(max(1, compared - 1)))
    quantiles = tuple(quantile_interval(ordered, probability) for probability in PROBABILITIES if len(ordered))
    if count == 0:
        nan = math.nan
        of_values = (nan, nan, nan, nan, quantiles, worst, compared, noise, (), (), ())
        return MetricSummary(name, unit, 0, len(column), never, *of_values)
    if compared < len(flown):
        ranks = _input_ranks(campaign, rows, is_compared)
    sensitivity = _sensitivity(with_never[is_compared], ranks)
    with np.errstate(over="ignore", invalid="ignore"):
        mean, deviation = float(values.mean()), float(values.std(ddof=1)) if count > 1 else 0.0
    return MetricSummary(
        name,
        unit,
        count,
        len(column) - count,
        never,
        mean,
        deviation,
        float(values[0]),
        float(values[-1]),
        quantiles,
        worst,
        compared,
        noise,
        tuple(pair for pair in sensitivity if not pair[0].endswith(EITHER_WAY)),
        tuple((pair[0].removesuffix(EITHER_WAY), pair[1]) for pair in sensitivity if pair[0].endswith(EITHER_WAY)),
        _echoes(sensitivity, ranks, noise),
    )


def _worst(campaign: Campaign, metric: Metric, rows: Columns, is_flown: npt.NDArray[np.bool_]) -> Worst | None:
    """Return the worst of the completed runs."""
    import numpy as np

    column, is_number = rows[metric.name], ~np.isnan(rows[metric.name])
    required = [each for each in campaign.requirements if each.metric == metric.name]
    lacks = ~is_number & is_flown
    # The time to an event that never happened counts as longer than any, which may be what is required.
    is_good = any(each.allows_never(metric) for each in required)
    if (required or metric.reduction == "time_to") and lacks.any() and not is_good:
        return Worst(int(rows["run"][lacks][0]), None, "without a value")
    if not is_number.any():
        return None
    if required:
        low, high = required[0].above, required[0].below
    else:
        low, high = (0.0, math.inf) if metric.reduction == "least" else (-math.inf, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        above, below = column - high, low - column
    place = int(np.argmax(np.where(is_number, np.fmax(above, below), -math.inf)))
    which = "smallest" if below[place] > above[place] else "largest"
    return Worst(int(rows["run"][place]), float(column[place]), which)


def _input_ranks(campaign: Campaign, rows: Columns, among: npt.NDArray[np.bool_]) -> dict[str, Numbers]:
    """Return the ranks of each input, and of its distance from its median, among some of the runs."""
    import numpy as np

    if not among.any():
        return {}
    ranks = {each.name: _ranks(rows[each.name][among]) for each in campaign.inputs}
    # Of two values, the distance from the median says what the input says.
    folded = {name: each for name, each in ranks.items() if len(np.unique(each)) > 2}
    return ranks | {name + EITHER_WAY: _beside(each, _ranks(abs(each - each.mean()))) for name, each in folded.items()}


def _sensitivity(column: Numbers, ranks: Mapping[str, Numbers]) -> tuple[tuple[str, float], ...]:
    """Return Spearman's correlation with each of `ranks`."""
    own = _ranks(column)
    return _strongest_first([(name, _correlation(own, other)) for name, other in ranks.items()])


def _strongest_first(found: Sequence[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(found, key=lambda pair: -abs(pair[1])))


def _echoes(
    sensitivity: Sequence[tuple[str, float]], ranks: Mapping[str, Numbers], noise: float
) -> tuple[tuple[str, str, float], ...]:
    """Return inputs whose correlation is no more than their correlation with a stronger one explains."""
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


def _beside(a: Numbers, b: Numbers) -> Numbers:
    """Return `b` without its linear dependence on `a`, which few different values of an input cause."""
    da = a - a.mean()
    rest: Numbers = b - da * (float((da * b).sum()) / float((da * da).sum()))
    return rest


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_text(campaign: Campaign, summary: CampaignSummary, options: Sequence[str] = (), rows: str = "") -> str:
    """Return the summary as text; `options` as in `rerun_commands`, `rows` is the file with all runs."""
    lines = [
        f"runs        {summary.runs}, seed {campaign.seed}, {campaign.sampling.replace('_', ' ')}",
        f"passed      {summary.passed} of {summary.runs}: {_percents(summary)}",
        *(f"  {line}" for line in _aligned(quantile_table(summary))),
        f"  99 % below: 99 % of the runs have a smaller value.  {TRUE}: its interval over all possible runs, with",
        f"  {CONFIDENCE:.0%} confidence. no value: runs that never met the condition, which count as larger than any,",
        "  and runs that could not be completed or whose metric is NaN, which do not count.",
    ]
    if far := far_text(summary):
        lines.append(f"  {far}")
    lines += [f"worst       {worst_text(metric)}" for metric in summary.metrics if metric.worst]
    runs = dict.fromkeys(metric.worst.run for metric in summary.metrics if metric.worst)
    lines += [f"            {command}" for command in rerun_commands(campaign, list(runs), options)]
    either_way = False
    for metric in summary.metrics:
        strongest = [f"{name} {value:+.2f}" for name, value in metric.drivers[:3] if abs(value) > metric.noise]
        either_way |= any(EITHER_WAY in each for each in strongest)
        if strongest:
            how = f"rank correlation, -1 to 1{over_runs(summary, metric)}"
            lines.append(f"depends     {metric.name} on {', '.join(strongest)} ({how})")
        lines += [
            f"            not told apart: {name}, whose correlation with {stronger} in these runs is {shared:+.2f}"
            for name, stronger, shared in metric.echoes[:3]
        ]
    if either_way:
        lines.append(f"           {EITHER_WAY}: on how far an input is from its median, above or below")
    if few := few_runs(campaign, summary):
        lines.append(f"note        {few}")
    place = rows or "the rows"
    lines += [f"incomplete  run {run}: {text}" for run, text in summary.errors[:_SHOWN]]
    if summary.not_flown > _SHOWN:
        lines.append(f"            {_SHOWN} of {summary.not_flown} shown; all in {place}, where error is not empty")
    if summary.failed:
        failed = summary.runs - summary.passed
        some = f" ({_SHOWN} of {failed} shown; all in {place}, where passed is false)" if failed > _SHOWN else ""
        lines.append(f"failed      {failed}; to repeat one with a full log{some}:")
    lines += [f"            {command}" for command in rerun_commands(campaign, summary.failed[:_SHOWN], options)]
    return "\n".join(lines)


def over_runs(summary: CampaignSummary, metric: MetricSummary) -> str:
    """Return of how many runs the correlations of `metric` are, if not of all that were completed; "" otherwise."""
    left_out = summary.runs - summary.not_flown - metric.compared
    return f", over the {metric.compared} runs with a value" if left_out else ""


def few_runs(campaign: Campaign, summary: CampaignSummary) -> str:
    """Return a note that there are too few runs to separate the inputs; "" if there are enough."""
    wanted = _RUNS_AN_INPUT * len(campaign.inputs)
    if summary.runs >= wanted:
        return ""
    return (
        f"{summary.runs} runs are few for {len(campaign.inputs)} inputs, some of which are correlated by chance; "
        f"{wanted} or more distinguish them"
    )


def percent(part: float, runs: int) -> str:
    """Return a fraction of `runs` in per cent, with as many digits as that many runs can resolve."""
    return f"{part:.{max(1, math.ceil(math.log10(runs)) - 2)}%}"


def _percents(summary: CampaignSummary) -> str:
    rate, low, high = (percent(part, summary.runs) for part in (summary.pass_rate, summary.pass_low, summary.pass_high))
    return f"{rate}; of all possible runs {low} to {high}, with {CONFIDENCE:.0%} confidence"


def quantile_table(summary: CampaignSummary) -> list[list[str]]:
    """Return head and rows of the table of quantiles, as text."""
    from rb_dynamics.study.campaign.metric_units import titled

    table = [["metric", *BELOW, TRUE, "no value"]]
    for metric in summary.metrics:
        at = {each.probability: each for each in metric.quantiles}
        values = [at[each].value if at else None for each in SHOWN]
        cells = [value_text(value, metric) for value in values]
        missing = f"{metric.missing}" if metric.missing else ""
        table.append([titled(metric.name, metric.unit), *cells, interval_text(at.get(FAR), metric), missing])
    return table


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table: numbers right-aligned, the first and the last two columns left-aligned."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for row in table:
        cells = [f"{cell:>{width}}" for cell, width in zip(row[1:-2], widths[1:-2], strict=True)]
        lines.append("  ".join([f"{row[0]:{widths[0]}}", *cells, f"{row[-2]:{widths[-2]}}", row[-1]]).rstrip())
    return lines


def far_text(summary: CampaignSummary) -> str:
    """Return a note if there are too few runs for the farthest quantile; "" if there are enough."""
    count = min((metric.count + metric.never for metric in summary.metrics if metric.count), default=0)
    reached = math.ceil(0.5 / (1.0 - FAR))
    bounded = math.ceil(math.log(0.5 * (1.0 - CONFIDENCE)) / math.log(FAR))
    if count >= bounded:
        return ""
    return (
        f"{100.0 * FAR:g} %: unknown with fewer than {reached} runs, without an upper bound with fewer than {bounded}."
    )


def worst_text(metric: MetricSummary) -> str:
    """Return which run is the worst by a metric, as text; "" if none is."""
    if metric.worst is None:
        return ""
    if metric.worst.value is None:
        return f"{metric.name}: {'never' if metric.never else NO_VALUE} in run {metric.worst.run}"
    value = f"{metric.worst.value:.4g} {metric.unit}".strip()
    return f"{metric.name}: {value}, the {metric.worst.which}, in run {metric.worst.run}"


def value_text(value: float | None, metric: MetricSummary) -> str:
    """Return a quantile of `metric` as text."""
    if value is None:
        return UNKNOWN
    return "never" if math.isinf(value) and metric.never else f"{value:.4g}"


def interval_text(quantile: Quantile | None, metric: MetricSummary) -> str:
    """Return the interval of the true quantile of `metric`, as text."""
    if quantile is None or quantile.low is None:
        return UNKNOWN
    low = value_text(quantile.low, metric)
    if quantile.low == math.inf:
        return low
    return f"{low} " + ("or more" if quantile.high is None else f"to {value_text(quantile.high, metric)}")


def rerun_commands(campaign: Campaign, runs: Sequence[int], options: Sequence[str] = ()) -> list[str]:
    """Return the command that repeats each run, quoted for a shell.

    Args:
        campaign: the campaign of the runs.
        runs: their numbers.
        options: words of the command line that define the campaign and the file of its rows.
    """
    begin = shlex.join([_program(), "campaign", campaign.source, *options])
    return [f"{begin} --rerun {run}" for run in runs]


def _program() -> str:
    """Return the command that starts this program, as called if a shell would not find it by name."""
    name, called = "rb-dynamics", sys.argv[0]
    return called if Path(called).stem == name and shutil.which(name) != called else name
