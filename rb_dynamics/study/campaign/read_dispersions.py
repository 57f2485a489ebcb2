"""Read the `disperse` and `correlate` sections of a campaign: which numbers differ from run to run, and how."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.document import Node
from rb_dynamics.formats.yaml.fields import Field, Rule, Section
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.overrides import find, unknown_item
from rb_dynamics.study.campaign.control import NOT_NEGATIVE, NUMBER, POSITIVE
from rb_dynamics.study.campaign.distributions import (
    Choice,
    Distribution,
    LogNormal,
    LogUniform,
    Normal,
    Stepped,
    Uniform,
)
from rb_dynamics.study.campaign.model import Input
from rb_dynamics.study.campaign.scenes import ANYHOW, AXES, FACTORS, INERTIA, ORIENTATION, TURNS

_FORMS = ("normal", "uniform", "log_uniform", "choice")
_FACTOR = Rule("a number from 0 to 80", lambda v: 0.0 <= v <= 80.0, "write a deviation of the logarithm, such as 0.05")
_COEFFICIENT = Rule("a number between -1 and 1", lambda v: -1.0 < v < 1.0, "write a correlation such as 0.5")


def inputs(field: Field | None, base: Scene, control: Mapping[str, float]) -> tuple[Input, ...]:
    """Return the inputs of a run, one for each dispersed number."""
    if field is None:
        return ()
    tree = document.parse(base.text, Problems(base.source))
    found: list[Input] = []
    entries = field.mapping("distributions by dotted key")
    for key, entry in entries.items():
        if any(key.startswith((f"{other}.", f"{other}[")) for other in entries):
            entry.reject("each number once", "remove one of them", "a key of what another entry disperses as a whole")
        if key == INERTIA:
            found += _inertia(entry, base)
        elif key == "seed":
            entry.reject("another key", "each run has a seed of its own, from that of the campaign", "the seed")
        elif key == ORIENTATION:
            found += _orientation(entry)
        elif unknown := unknown_item(tree, key):
            entry.reject(unknown[1], "correct the name", unknown[0])
        else:
            found += _numbers(key, entry, _values(key, tree, control))
    names = [each.name for each in found]
    # Items of lists are known by place and by name.
    places = [id(find(tree, each.name)) if find(tree, each.name) else each.name for each in found]
    if len(names) != len(set(names)) or len(places) != len(set(places)):
        field.reject("each number once", "remove one of them", "a number and the list that contains it")
    return tuple(found)


def _inertia(entry: Field, base: Scene) -> list[Input]:
    section = entry.section(("second_moments", "axes"))
    if base.body.is_particle:
        entry.reject("a body that turns", "add body.inertia to the scene", "the inertia of a particle")
    if not section.values:
        entry.reject("second_moments or axes", "write for example {second_moments: 0.05, axes: 0.02}")
    spread, turn = section.number("second_moments", _FACTOR, 0.0), section.number("axes", NOT_NEGATIVE, 0.0)
    factors = [Input(name, LogNormal(spread), INERTIA) for name in FACTORS]
    return factors + [Input(name, Normal(0.0, turn), INERTIA) for name in AXES]


def _orientation(entry: Field) -> list[Input]:
    if entry.node.value == "any":
        return [Input(name, Uniform(0.0, 1.0), ORIENTATION) for name in ANYHOW]
    if not isinstance(entry.node.value, dict):
        entry.reject("any, or {turn: deviation in rad}", "write any for uniformly distributed attitudes")
        return []
    turn = entry.section(("turn",)).number("turn", NOT_NEGATIVE, 0.0, required=True)
    return [Input(name, Normal(0.0, turn), ORIENTATION) for name in TURNS]


def _values(key: str, tree: Node, control: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers below `key` in the scene or the controller, each by its own key."""
    found = {name: value for name, value in control.items() if name == key or name.startswith(f"{key}[")}
    if found or key.startswith("control."):
        return found
    node = find(tree, key)
    if node is None:
        return {}
    if isinstance(node.value, list):
        parts = {f"{key}[{i}]": item.value for i, item in enumerate(node.value)}
        return {name: value for name, value in parts.items() if isinstance(value, float)}
    return {key: node.value} if isinstance(node.value, float) else {}


def _numbers(key: str, entry: Field, values: Mapping[str, float]) -> list[Input]:
    if not values:
        entry.reject(
            "the dotted key of a number, or of a list of numbers, in the scene or in control",
            "correct the key, or give it a value in the scene or in set",
            f"no number under {key}",
        )
        return []
    section = entry.section(_FORMS)
    given = [form for form in _FORMS if form in section.values]
    if len(given) != 1:
        entry.reject(f"exactly one of {', '.join(_FORMS)}", "write for example {normal: {deviation: 0.1}}")
        return []
    form, read, before = section.fields()[given[0]], _READERS[given[0]], entry.problems.count
    found: list[Input] = []
    for name, value in values.items():
        found.append(Input(name, read(form, value)))
        # What is wrong for one number of a list is wrong for the others: it is said once.
        if entry.problems.count > before:
            break
    return found


def _normal(field: Field, value: float) -> Distribution:
    section = field.section(("mean", "deviation", "relative", "low", "high", "step"))
    mean = section.number("mean", NUMBER, value)
    if ("deviation" in section.values) == ("relative" in section.values) and isinstance(field.node.value, dict):
        field.reject("exactly one of deviation and relative", "write deviation, or relative as a fraction of the mean")
    deviation = section.number("deviation", NOT_NEGATIVE, 0.0)
    relative = section.number("relative", NOT_NEGATIVE, 0.0)
    low, high = _edges(section, -math.inf, math.inf)
    deviation = deviation or relative * abs(mean)
    if not math.isfinite(abs(mean) + _FARTHEST * deviation):
        field.reject("numbers within the range of double precision", "write a smaller mean or deviation")
    distribution = Normal(mean, deviation, low, high)
    if not distribution.possible:
        field.reject("low and high between which such values occur", "correct mean, deviation, low or high")
    return _stepped(section, distribution)


def _uniform(field: Field, value: float) -> Distribution:
    section = field.section(("low", "high", "half_width", "step"))
    if "half_width" in section.values:
        if {"low", "high"} & section.values.keys():
            field.reject("half_width alone, or low and high", "remove half_width")
        width = section.number("half_width", NOT_NEGATIVE, 0.0)
        low, high = value - width, value + width
    else:
        _both(section)
        low, high = _edges(section, 0.0, 1.0)
    if not math.isfinite(high - low):
        field.reject("a width within the range of double precision", "move low and high together")
    return _stepped(section, Uniform(low, high))


def _log_uniform(field: Field, _: float) -> Distribution:
    section = field.section(("low", "high", "step"))
    _both(section)
    low, high = _edges(section, 1.0, 10.0, POSITIVE)
    if not math.isfinite(high / low):
        field.reject("a ratio of high to low within the range of double precision", "move low and high together")
    return _stepped(section, LogUniform(low, high))


def _stepped(section: Section, distribution: Normal | Uniform | LogUniform) -> Distribution:
    """Return `distribution`, rounded to multiples of `step` if the section has one."""
    field = section.get("step")
    if field is None:
        return distribution
    step = field.number(POSITIVE, 1.0)
    for edge in (distribution.low, distribution.high):
        # Otherwise rounding would exceed the bounds, or give a bound half its probability.
        steps = edge / step
        if math.isfinite(edge) and not (math.isfinite(steps) and math.isclose(steps, round(steps), abs_tol=1e-9)):
            field.reject("a step of which the lowest and the highest value are whole multiples", "write another step")
            break
    return Stepped(distribution, step)


def _choice(field: Field, _: float) -> Distribution:
    section = field.section(("values", "weights"))
    listed, weighed = section.get("values"), section.get("weights")
    if listed is None:
        section.missing("values", "a list of numbers", "add values: [1, 2]")
        return Uniform(0.0, 1.0)
    values = [item.number(NUMBER, 0.0) for item in listed.items("a list of numbers", "write [1, 2]")]
    weights = [1.0] * len(values)
    if weighed is not None:
        weights = [item.number(NOT_NEGATIVE, 0.0) for item in weighed.items("a list of numbers", "write [1, 2]")]
    if not values or len(weights) != len(values) or not 0.0 < sum(weights) < math.inf:
        expected = "at least one value, and as many weights, of which one is greater than 0, with a sum that is finite"
        field.reject(expected, "correct the lists")
        return Uniform(0.0, 1.0)
    total = math.fsum(weights)
    return Choice(tuple(values), tuple(weight / total for weight in weights))


_FARTHEST = 9.0
"""Limit of a normal number in deviations: probabilities are at least 2^-54."""

_READERS: Mapping[str, Callable[[Field, float], Distribution]] = {
    "normal": _normal,
    "uniform": _uniform,
    "log_uniform": _log_uniform,
    "choice": _choice,
}


def _both(section: Section) -> None:
    for name in ("low", "high"):
        if name not in section.values:
            section.missing(name, "a number", f"add {name}:")


def _edges(section: Section, low: float, high: float, rule: Rule = NUMBER) -> tuple[float, float]:
    low, high = section.number("low", rule, low), section.number("high", rule, max(high, low))
    if not low < high and not section.field.problems:
        section.field.reject("low less than high", "exchange them")
    return low, high


def correlations(field: Field | None, found: Sequence[Input]) -> tuple[tuple[float, ...], ...]:
    """Return the lower triangular rows that mix independent normal scores; empty if none are correlated."""
    if field is None:
        return ()
    names = [each.name for each in found]
    matrix = [[float(i == j) for j in range(len(names))] for i in range(len(names))]
    for entry in field.items("a list of correlations", "write [{between: [a, b], coefficient: 0.5}]"):
        section = entry.section(("between", "coefficient"))
        pair = section.get("between")
        items = pair.items("two inputs", "write [a, b]") if pair else []
        if pair is None:
            section.missing("between", "two inputs", "add between: [a, b]")
        keys = [
            item.text("a dispersed number", names.__contains__, f"choose from {', '.join(names)}", "") for item in items
        ]
        coefficient = section.number("coefficient", _COEFFICIENT, 0.0, required=True)
        if len(keys) != 2 or keys[0] == keys[1]:
            entry.reject("two different inputs", "write between: [a, b]")
        elif all(keys):
            i, j = names.index(keys[0]), names.index(keys[1])
            matrix[i][j] = matrix[j][i] = coefficient
    if field.problems:
        return ()
    rows = _cholesky(matrix)
    if rows is None:
        field.reject(
            "correlations that are possible together (a positive definite matrix)", "make some of them smaller"
        )
        return ()
    return rows


def _cholesky(matrix: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...] | None:
    """Return the lower triangular L with L L^T = `matrix`, None if it is not positive definite."""
    rows: list[list[float]] = []
    for i, row in enumerate(matrix):
        new: list[float] = []
        for j in range(i + 1):
            rest = row[j] - math.fsum(a * b for a, b in zip(new, rows[j] if j < i else new, strict=False))
            if j == i and rest < 1e-12:
                return None
            new.append(math.sqrt(rest) if j == i else rest / rows[j][j])
        rows.append(new)
    return tuple(map(tuple, rows))
