"""What the rows of a campaign show: quantiles and pass rate with confidence intervals, failures, sensitivities.

Intervals take the runs as independent draws. A Latin hypercube or a Sobol sequence covers each input more evenly than
that; a few runs of one may have inputs that go with each other far more, so that what is only such an echo is told
apart. Never draws: `page.py` does.
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
PROBABILITIES = (0.01, 0.05, 0.5, 0.95, 0.99)
SHOWN = (0.01, 0.5, 0.95, 0.99)
"""Of these, what a table has room for."""

BELOW = tuple("median" if each == 0.5 else f"{100.0 * each:g} % below" for each in SHOWN)
"""Heads of their columns."""

TRUE = "true 99 % in"
"""Head of the column that says where the quantile of all possible runs lies."""


@dataclass(frozen=True)
class Quantile:
    """A quantile of a metric with its interval; a side is None where there are too few runs to bound it."""

    probability: float
    value: float
    low: float | None
    high: float | None


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
        sensitivity: rank correlation with each input, the strongest first.
        echoes: of these the inputs that only follow a stronger one: they correlate with it in these runs, beyond
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
    sensitivity: tuple[tuple[str, float], ...]
    echoes: tuple[tuple[str, str, float], ...]

    @property
    def drivers(self) -> tuple[tuple[str, float], ...]:
        """The sensitivities without the echoes of stronger ones."""
        only_follow = {name for name, _, _ in self.echoes}
        return tuple(pair for pair in self.sensitivity if pair[0] not in only_follow)


@dataclass(frozen=True)
class Summary:
    """What became of all runs.

    Attributes:
        runs: number of them.
        passed: of those that met every requirement.
        pass_rate: their part of all.
        pass_low: lower end of its interval, for all possible runs.
        pass_high: upper end.
        failed: the numbers of runs that did not pass, the first `MOST_FAILURES` of them.
        errors: numbers and texts of runs that could not be flown, likewise.
        noise: the size that a rank correlation has by chance alone in 5 % of cases.
        metrics: each of them.
    """

    runs: int
    passed: int
    pass_rate: float
    pass_low: float
    pass_high: float
    failed: tuple[int, ...]
    errors: tuple[tuple[int, str], ...]
    noise: float
    metrics: tuple[MetricSummary, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON: what is no finite number is None."""
        found: dict[str, Any] = _finite(asdict(self))
        return found


MOST_FAILURES = 1000

_RUNS_AN_INPUT = 10


def summarise(campaign: Campaign, rows: Columns) -> Summary:
    """Return what `rows` show."""
    import numpy as np

    from rb_dynamics.study.campaign.metric_units import unit_of

    good = rows["passed"]
    runs, passed = len(good), int(np.count_nonzero(good))
    low, high = proportion_interval(passed, runs)
    ranks = {each.name: _ranks(rows[each.name]) for each in campaign.inputs}
    noise = min(1.0, 1.96 / math.sqrt(max(1, runs - 1)))
    errors = [(int(run), text) for run, text in zip(rows["run"], rows["error"], strict=True) if text]
    return Summary(
        runs,
        passed,
        passed / runs,
        low,
        high,
        tuple(rows["run"][~good][:MOST_FAILURES].tolist()),
        tuple(errors[:MOST_FAILURES]),
        noise,
        tuple(_metric(each.name, unit_of(each), rows[each.name], ranks, noise) for each in campaign.metrics),
    )


def quantile_interval(values: Numbers, probability: float) -> Quantile:
    """Return a quantile of sorted `values` with an interval between order statistics, free of any distribution.

    Of n values so many lie below the true quantile as a binomial number says: the r-th and the s-th bound it with at
    least `CONFIDENCE` (David and Nagaraja, Order Statistics, section 7.1).
    """
    from scipy.stats import binom

    count, tail = len(values), 0.5 * (1.0 - CONFIDENCE)
    below = int(binom.ppf(tail, count, probability))
    above = int(binom.ppf(1.0 - tail, count, probability)) + 1
    return Quantile(
        probability,
        float(values[min(count - 1, math.ceil(probability * count) - 1 if probability * count > 1.0 else 0)]),
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


def _metric(name: str, unit: str, column: Numbers, ranks: Mapping[str, Numbers], noise: float) -> MetricSummary:
    import numpy as np

    is_number = np.isfinite(column)
    values = np.sort(column[is_number])
    count = len(values)
    if count == 0:
        return MetricSummary(name, unit, 0, len(column), math.nan, math.nan, math.nan, math.nan, (), (), ())
    sensitivity = _sensitivity(column, is_number, ranks)
    return MetricSummary(
        name,
        unit,
        count,
        len(column) - count,
        float(values.mean()),
        float(values.std(ddof=1)) if count > 1 else 0.0,
        float(values[0]),
        float(values[-1]),
        tuple(quantile_interval(values, probability) for probability in PROBABILITIES),
        sensitivity,
        _echoes(sensitivity, ranks, noise),
    )


def _sensitivity(
    column: Numbers, is_number: npt.NDArray[np.bool_], ranks: Mapping[str, Numbers]
) -> tuple[tuple[str, float], ...]:
    """Return Spearman's correlation with each input; what is no number ranks above all numbers."""
    import numpy as np

    own = _ranks(np.where(is_number, column, math.inf))
    found = [(name, _correlation(own, other)) for name, other in ranks.items()]
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


def as_text(campaign: Campaign, summary: Summary, options: Sequence[str] = (), most: int = 5) -> str:
    """Return the summary for a person at a terminal; `options` as in `rerun_commands`."""
    from rb_dynamics.study.campaign.metric_units import titled

    lines = [
        f"runs        {summary.runs}, seed {campaign.seed}, {campaign.sampling.replace('_', ' ')}",
        f"passed      {summary.passed} of {summary.runs}: {_percents(summary)}",
        f"  {'metric':24}{''.join(f'{head:>12}' for head in BELOW)}  {TRUE:24}no value",
    ]
    for metric in summary.metrics:
        at = {each.probability: each for each in metric.quantiles}
        cells = "".join(f"{at[p].value:>12.4g}" for p in SHOWN) if at else f"{'-':>12}" * 4
        name = titled(metric.name, metric.unit)
        lines.append(f"  {name:24}{cells}  {interval_text(at.get(0.99)):24}{metric.missing or ''}".rstrip())
    lines += [
        f"  99 % below: so many of the runs have a smaller value. {TRUE}: where it lies for all possible runs, with",
        f"  {CONFIDENCE:.0%} confidence. no value: runs that never met the condition, or could not be flown.",
    ]
    for metric in summary.metrics:
        strongest = [f"{name} {value:+.2f}" for name, value in metric.drivers[:3] if abs(value) > summary.noise]
        if strongest:
            lines.append(f"depends     {metric.name} on {', '.join(strongest)} (rank correlation, -1 to 1)")
        lines += [
            f"            not told apart: {name}, which goes with {stronger} in these runs by {shared:+.2f}"
            for name, stronger, shared in metric.echoes[:3]
        ]
    if few := few_runs(campaign, summary):
        lines.append(f"note        {few}")
    lines += [f"not flown   run {run}: {text}" for run, text in summary.errors[:most]]
    if summary.failed:
        some = f", the first {most} of them" if len(summary.failed) > most else ""
        lines.append(f"failed      {summary.runs - summary.passed}; to fly one again with a full log{some}:")
    lines += [f"            {command}" for command in rerun_commands(campaign, summary.failed[:most], options)]
    return "\n".join(lines)


def few_runs(campaign: Campaign, summary: Summary) -> str:
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


def _percents(summary: Summary) -> str:
    rate, low, high = (percent(part, summary.runs) for part in (summary.pass_rate, summary.pass_low, summary.pass_high))
    return f"{rate}; of all possible runs {low} to {high}, with {CONFIDENCE:.0%} confidence"


def interval_text(quantile: Quantile | None) -> str:
    """Return where the true quantile lies, "-" where so few runs do not tell."""
    if quantile is None or quantile.low is None:
        return "-"
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
