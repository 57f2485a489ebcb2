"""Units of metrics, and how they are printed beside a name."""

from __future__ import annotations

from rb_dynamics.study.campaign.metrics import QUANTITIES
from rb_dynamics.study.campaign.model import Metric


def unit_of(metric: Metric) -> str:
    """Return the unit of a metric, "" if it is a user function."""
    if metric.reduction == "time_to":
        return "s"
    return QUANTITIES.get(metric.quantity, ("", ""))[1]


def titled(name: str, unit: str) -> str:
    """Return a name with its unit in brackets, if it has one."""
    return f"{name} [{unit}]" if unit else name
