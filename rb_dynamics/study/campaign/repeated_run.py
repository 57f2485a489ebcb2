"""Repeat one run of a campaign alone, through `Simulation` and with a full log, and compare it with its row."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.campaign.block_of_runs import simulate_alone
from rb_dynamics.study.campaign.compatibility import check_same
from rb_dynamics.study.campaign.loop_stability import remarks
from rb_dynamics.study.campaign.model import NO_VALUE, Campaign
from rb_dynamics.study.campaign.store import read_facts, read_row
from rb_dynamics.study.campaign.user_functions import FunctionError


@dataclass(frozen=True)
class SingleRun:
    """Result of a repeated run.

    Attributes:
        run: its number.
        metrics: by name; empty if the run failed.
        row: the metrics in its row, None if there is no row.
        log: path of its log.
        error: why it failed.
        row_error: why it failed according to its row.
        if_nan: what is said of a metric that is NaN, by name.
    """

    run: int
    metrics: Mapping[str, float]
    row: Mapping[str, float] | None
    log: Path
    error: str = ""
    row_error: str = ""
    if_nan: Mapping[str, str] = field(default_factory=dict)

    @property
    def differs(self) -> bool:
        """Whether a metric differs from the row in any bit, or only one of the two failed."""
        if self.row is None:
            return False
        if bool(self.error) != bool(self.row_error):
            return True
        return any(
            not (value == self.row[name] or (math.isnan(value) and math.isnan(self.row[name])))
            for name, value in self.metrics.items()
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON; numbers that are not finite are None."""
        metrics = {name: value if math.isfinite(value) else None for name, value in self.metrics.items()}
        same = None if self.row is None else not self.differs
        return {"run": self.run, "metrics": metrics, "error": self.error, "same_as_row": same, "log": str(self.log)}

    def as_text(self) -> str:
        """Return the result as text."""
        lines = [f"run {self.run}"]
        if self.error:
            lines.append(f"  did not complete: {self.error}")
        if self.row_error:
            lines.append(f"  its row says: {self.row_error}")
        for name, value in self.metrics.items():
            nothing = self.if_nan.get(name, NO_VALUE)
            line = f"  {name:24}{_shown(value, nothing):>26}"
            if self.row is not None:
                line += f"{_shown(self.row[name], NO_VALUE if self.row_error else nothing):>26} in its row"
            lines.append(line)
        if self.row is not None and not (self.error and self.row_error):
            lines.append("differs from its row" if self.differs else "the same as its row, to the bit")
        return "\n".join([*lines, f"wrote {self.log}"])


def _shown(value: float, if_nan: str) -> str:
    return if_nan if math.isnan(value) else repr(value)


def rerun(campaign: Campaign, run: int, log: Path, rows: Path) -> SingleRun:
    """Repeat `run` with a log at `log`, and compare it with its row if `rows` has one.

    Raises:
        SceneError: there is no such run, or the scene is not valid with its inputs.
        LogError: a file cannot be read or written, or `rows` belongs to another campaign.
    """
    if not 0 <= run < campaign.runs:
        raise SceneError(f"--rerun: found {run}, expected a run from 0 to {campaign.runs - 1}; correct the number")
    compared = rows.exists()
    if compared:
        check_same(read_facts(rows), rows, campaign, "give --runs and --seed as they were given then, or another --out")
    metrics, error = {}, ""
    try:
        metrics = simulate_alone(campaign, run, [McapSink(log)], warnings=remarks(campaign))
    except (ConvergenceError, FunctionError) as problem:
        # The run failed: the log ends there.
        error = str(problem)
    found = read_row(rows, run) if compared else None
    row = None if found is None else {each.name: float(found[each.name]) for each in campaign.metrics}
    if_nan = {each.name: each.if_nan for each in campaign.metrics}
    return SingleRun(run, metrics, row, log, error, "" if found is None else str(found["error"]), if_nan)
