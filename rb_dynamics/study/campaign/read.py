"""Read a campaign file: YAML to a validated `Campaign`. Keys, defaults and limits of a campaign are defined here.

Nothing is guessed: an error names file, line, key, value, what was expected and the remedy, as for a scene.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from types import MappingProxyType
from typing import cast

from rb_dynamics.errors import SceneError, did_you_mean
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.fields import Field, Rule, Section
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.formats.yaml.text_file import read_text
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.numerics.nanoseconds import LONGEST, NANOSECONDS, exact_period_ns
from rb_dynamics.numerics.rotation import IDENTITY, unit
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.overrides import apply_overrides, merged, root_of
from rb_dynamics.scene.read import parse_scene, read_scene
from rb_dynamics.study.campaign import laws
from rb_dynamics.study.campaign.block_propagation import CHANNEL, FORCE, TORQUE, step_ns
from rb_dynamics.study.campaign.control import DELAY, NOT_NEGATIVE, NUMBER, POSITIVE, RULES, sharing
from rb_dynamics.study.campaign.metrics import LARGEST, OF_ACTUATORS, QUANTITIES, REDUCTIONS, MetricAccumulator
from rb_dynamics.study.campaign.model import SAMPLINGS, Campaign, Control, Metric, Requirement
from rb_dynamics.study.campaign.read_dispersions import correlations, inputs
from rb_dynamics.study.campaign.user_functions import find_function
from rb_dynamics.study.campaign.user_modules import read_modules

_NO_OVERRIDES: Mapping[str, object] = MappingProxyType({})

_ROOT_KEYS = (
    "scene", "set", "runs", "seed", "sampling", "disperse", "correlate", "control", "observe_rate", "metrics",
    "require",
)  # fmt: skip
_CONTROL_KEYS = ("law", "rate", "delay", "through", "saturation", "bias", "noise", "parameters")

_COLUMNS = ("run", "seed", "passed", "error")

_RUNS = Rule(
    "a whole number from 1 to 1e12", lambda v: v == int(v) and 1 <= v <= 1e12, "write how many runs, such as 10000"
)
_SEED = Rule("a whole number from 0 to 9e15", lambda v: v == int(v) and 0 <= v <= 9e15, "write a seed such as 1")
_RATE = Rule(
    f"a number from {1.0 / LONGEST:.1e} to {NANOSECONDS:g} (Hz)",
    lambda v: 1.0 / LONGEST <= v <= NANOSECONDS,
    "write how many times per second, such as 10",
)

_MOST_SOBOL = 2**30
_ROUNDING = Fraction(1, 2**52)


def read_campaign(path: str | os.PathLike[str], overrides: Mapping[str, object] = _NO_OVERRIDES) -> Campaign:
    """Return the campaign in the YAML file `path`.

    `overrides` replace its own keys, such as `runs`, and keys of the scene, such as `body.mass`, as its `set` does.

    Raises:
        SceneError: the file or the scene it names cannot be read or is not valid; one line for each problem.
    """
    return parse_campaign(read_text(path, "campaign"), os.fspath(path), overrides)


def parse_campaign(text: str, source: str = "<campaign>", overrides: Mapping[str, object] = _NO_OVERRIDES) -> Campaign:
    """Return the campaign in the YAML `text`; paths in it are relative to the folder of `source`.

    Raises:
        SceneError: it is not valid; one line for each problem.
    """
    problems = Problems(source)
    tree = document.parse(text, problems, "campaign", "scene")
    if document.holds(tree, ("body",), "scene"):
        raise SceneError(
            f"{source}: found a scene, expected a campaign; run it with rb-dynamics simulate {source}, or write "
            "a campaign with scene, runs and metrics (docs/campaigns.md)"
        )
    of_scene = {key: value for key, value in overrides.items() if root_of(key) not in _ROOT_KEYS}
    apply_overrides(tree, {key: value for key, value in overrides.items() if key not in of_scene}, problems)
    if of_scene and isinstance(tree.value, dict):
        given = document.plain(tree.value["set"]) if "set" in tree.value else {}
        apply_overrides(tree, {"set": merged(given, of_scene) if isinstance(given, dict) else given}, problems)
    if overrides:
        text = document.to_text(tree, f"{source} with overrides of {', '.join(overrides)}")
    root = Field(tree, "", problems).section(_ROOT_KEYS)
    folder = os.path.dirname(os.path.abspath(source))
    control = _control(root.get("control"))
    base = _base(root, control is not None, problems)
    if base is None:
        raise problems.error()
    if control is not None and not problems:
        control = _on_board(root.section("control", _CONTROL_KEYS), control, base)
    seed, sampling = root.whole("seed", _SEED, 0), _sampling(root.get("sampling"))
    runs = root.whole("runs", _RUNS, 1, required=True)
    found = inputs(root.get("disperse"), base, dict(control.numbers) if control else {})
    if sampling == "sobol" and runs > _MOST_SOBOL and (field := root.get("runs")):
        field.reject(f"at most {_MOST_SOBOL} with sobol", "write fewer, or sampling: random")
    mixing = correlations(root.get("correlate"), found)
    metrics = _metrics(root, control, base, {*_COLUMNS, *(each.name for each in found)})
    period_ns = control.period_ns if control else _period_ns(base.output_rate or 1.0)
    observe = root.get("observe_rate")
    if observe is not None:
        period_ns = _period_ns(observe.number(_RATE, 1.0))
    dispersed = any(each.name == "duration" for each in found)
    longest = math.inf if dispersed or base.duration is None else base.duration
    requirements = _requirements(root.get("require"), metrics, longest)
    _check_grid(root, base, control)
    if problems:
        raise problems.error()
    names = [each.quantity for each in metrics if each.quantity not in QUANTITIES]
    if control is not None and control.law not in laws.LAWS:
        names.append(control.law)
    modules = read_modules(names, folder)
    campaign = Campaign(
        text, source, modules, base.text, runs, seed, sampling, found, mixing, control, period_ns, metrics, requirements
    )  # fmt: skip
    # Look user functions up now: an error should not come after hours of computing.
    MetricAccumulator(campaign, 1)
    if control is not None:
        try:
            find_function(control.law, laws.LAWS, modules)
        except SceneError as error:
            raise SceneError(f"{source}: control.law: {error}") from error
    return campaign


def files_of(campaign: Campaign) -> tuple[str, ...]:
    """Return the files that `campaign` was read from: its own, its scene, and the modules beside it."""
    tree = document.plain(document.parse(campaign.text, Problems(campaign.source)))
    scene = str(cast("dict[str, object]", tree)["scene"])
    beside = (each.file for each in campaign.modules.beside)
    return campaign.source, os.path.join(os.path.dirname(campaign.source), scene), *beside


def _base(root: Section, controlled: bool, problems: Problems) -> Scene | None:
    """Return the base scene with the values of `set`, and a channel for the controller."""
    field = root.get("scene")
    if field is None:
        root.missing("scene", "the path of a scene file", "add scene: with a path relative to the campaign file")
        return None
    name = field.text("the path of a scene file", bool, "write a path relative to the campaign file", "")
    if not name:
        return None
    settings = root.get("set")
    changes: dict[str, object] = {}
    for key, value in settings.mapping("values of the scene by dotted key").items() if settings else ():
        changes[key] = document.plain(value.node)
    path = os.path.join(os.path.dirname(problems.source), name)
    if not os.path.isfile(path):
        field.reject("the path of a scene file", "correct the path, which is relative to the campaign file")
        return None
    base = read_scene(path, changes)
    if base.duration is None:
        field.reject("a scene that ends", "add duration to the scene, or to set", "no duration in it")
        return None
    # Leave the folder of the scene out of its text: the same campaign must be the same everywhere.
    title, tree = os.path.basename(name), document.parse(base.text, Problems(base.source))
    if controlled:
        if base.body.is_particle:
            field.reject("a body that turns", "add body.inertia to the scene, or remove control", "a particle")
            return None
        if CHANNEL not in {each.topic for each in base.channels}:
            listed = tree.value.get("wrenches") if isinstance(tree.value, dict) else None
            given = listed.value if listed is not None and isinstance(listed.value, list) else None
            entries = [{"topic": Channel().topic}] if given is None else [document.plain(each) for each in given]
            apply_overrides(tree, {"wrenches": [*entries, {"topic": CHANNEL}]}, problems)
    return parse_scene(document.to_text(tree, f"{title}, as a campaign runs it"), title)


def _sampling(field: Field | None) -> str:
    if field is None:
        return "random"
    text = field.node.value if isinstance(field.node.value, str) else ""
    remedy = did_you_mean(text, SAMPLINGS, "write one of them")
    return field.text(f"one of {', '.join(SAMPLINGS)}", SAMPLINGS.__contains__, remedy, "random")


def _control(field: Field | None) -> Control | None:
    if field is None:
        return None
    section = field.section(_CONTROL_KEYS)
    law = section.get("law")
    if law is None:
        known = ", ".join(laws.LAWS)
        section.missing("law", f"one of {known}, or module.function", "add law: rate_damping")
    name = "" if law is None else _name(law, tuple(laws.LAWS))
    rate = section.get("rate")
    if rate is None:
        section.missing("rate", _RATE.expected, "add rate: 10")
    period_ns = _period_ns(rate.number(_RATE, 1.0) if rate else 1.0)
    noise = section.section("noise", ("attitude", "rate"))
    saturation = section.get("saturation")
    numbers = {
        DELAY: section.number("delay", RULES[DELAY], 0.0),
        "control.saturation": math.inf if saturation is None else saturation.number(POSITIVE, 1.0),
        **{f"control.bias[{i}]": value for i, value in enumerate(section.vector("bias", NUMBER))},
        "control.noise.attitude": noise.number("attitude", NOT_NEGATIVE, 0.0),
        "control.noise.rate": noise.number("rate", NOT_NEGATIVE, 0.0),
    }
    given = section.get("parameters")
    parameters = given.mapping("parameters of the law") if given else {}
    for key, value in parameters.items():
        numbers.update(_parameter(value, f"control.parameters.{key}"))
    _check_parameters(section, name, parameters)
    through = section.get("through")
    names = (
        [each.node.value for each in through.items("names of reaction wheels", "write [wheel_x]")] if through else []
    )
    return Control(name, period_ns, tuple(numbers.items()), tuple(map(str, names)))


def _on_board(section: Section, control: Control, base: Scene) -> Control:
    """Return `control` without the errors that sensors and actuators of the scene have themselves."""
    numbers, through = dict(control.numbers), section.get("through")
    if base.sensors:
        _refuse(section, "noise", "the noise of the scene's sensors, which the law receives", _noise_lines(control))
        numbers = {key: value for key, value in numbers.items() if not key.startswith("control.noise.")}
        measured = {name for sensor in base.sensors for name in sensor.values}
        for name, kind in laws.HEARS.get(control.law, {}).items():
            if name not in measured:
                section.field.reject(f"{kind} in the scene for {control.law}", "add it to sensors", f"no {name}")
    if base.actuators and through is None and control.law in laws.LAWS:
        names = ", ".join(wheel.name for wheel in base.wheels)
        section.field.reject(
            "what gives the torque of the law",
            f"add through: [{names}], or through: [] for a torque that acts by itself",
            f"{control.law} and actuators in the scene",
        )
    if base.actuators and (through is None or control.through):
        limit = numbers["control.saturation"]
        lines = f"max_torque: {limit!r} for reaction wheels, or wrenches: [{{topic: {CHANNEL}, max_torque: {limit!r}, "
        _refuse(section, "saturation", "the limits of the scene's actuators and channels", lines + "on_excess: clip}]")
        bias = [numbers[f"control.bias[{i}]"] for i in range(3)]
        lines = f"wrenches: [{{topic: {CHANNEL}, bias: {{torque: {bias!r}}}}}]"
        _refuse(section, "bias", "the bias of a channel of the scene", lines)
        numbers = {key: value for key, value in numbers.items() if not key.startswith(_OF_TORQUE)}
    for each in base.actuators:
        if each.name in (TORQUE, FORCE):
            section.field.reject(f"no actuator called {TORQUE} or {FORCE}", "rename it", f"an actuator {each.name}")
    if through is not None:
        try:
            sharing(base, control.through)
        except SceneError as error:
            through.reject(str(error), "correct the names")
    return replace(control, numbers=tuple(numbers.items()))


_OF_TORQUE = ("control.saturation", "control.bias[")


def _refuse(section: Section, name: str, expected: str, lines: str) -> None:
    """Refuse a key of `control` for which the scene has better ones."""
    field = section.get(name)
    if field is not None:
        field.reject(expected, f"remove {name}, and write in the scene {lines}")


def _noise_lines(control: Control) -> str:
    """Return sensors with the noise of `control`."""
    numbers, rate = dict(control.numbers), float(NANOSECONDS / control.period_ns)
    density, noise = numbers["control.noise.rate"] / math.sqrt(rate), numbers["control.noise.attitude"]
    return (
        f"sensors: [{{type: imu, name: imu, rate: {rate:.6g}, gyro: {{noise_density: {density:.6g}}}}}, "
        f"{{type: star_tracker, name: tracker, rate: {rate:.6g}, noise: {noise:.6g}}}]"
    )


def _name(field: Field, known: Sequence[str]) -> str:
    """Return a known name, or one with a dot, which is looked up later."""
    text = field.node.value if isinstance(field.node.value, str) else ""
    remedy = did_you_mean(text, known, "write one of them, or the dotted name of a function of your own")
    expected = f"one of {', '.join(known)}, or module.function"
    dotted = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")
    return field.text(expected, lambda value: value in known or dotted.fullmatch(value) is not None, remedy, known[0])


def _parameter(field: Field, key: str) -> dict[str, float]:
    """Return a number, or the elements of a list or a quaternion, by key."""
    value = field.node.value
    if isinstance(value, list):
        items = field.items("a list", "write numbers")
        return {f"{key}[{i}]": item.number(NUMBER, 0.0) for i, item in enumerate(items)}
    if isinstance(value, dict):
        return {f"{key}[{i}]": part for i, part in enumerate(field.quaternion())}
    return {key: field.number(NUMBER, 0.0)}


def _check_parameters(section: Section, law: str, parameters: Mapping[str, Field]) -> None:
    if law not in laws.LAWS:
        return
    required, optional = laws.REQUIRED[law], laws.OPTIONAL.get(law, ())
    place = section.get("parameters") or section.field
    for name in required:
        if name not in parameters:
            place.reject(f"the parameter {name} of {law}", f"add parameters: {{{name}: ...}}", "no such parameter")
    for name, field in parameters.items():
        if name not in (*required, *optional):
            field.reject(f"one of {', '.join((*required, *optional))}", "remove it", f"an unknown parameter of {law}")
        elif name == "target":
            if not isinstance(field.node.value, dict):
                field.quaternion()
        elif isinstance(field.node.value, (list, dict)):
            field.number(NUMBER, 0.0)


def _period_ns(rate: float) -> Fraction:
    """Return the period (ns) of a rate (Hz): whole where the rate is one rounded to a double, as 33.333333333333336."""
    period = exact_period_ns(rate)
    whole = Fraction(round(period))
    return whole if abs(period - whole) <= _ROUNDING * period else period


def _check_grid(root: Section, base: Scene, control: Control | None) -> None:
    """Refuse a loop whose samples do not coincide with fixed steps."""
    if (
        control is None
        or base.solver.step is None
        or (rate := root.section("control", _CONTROL_KEYS).get("rate")) is None
    ):
        return
    step = step_ns(base)
    if step is None or control.period_ns % step:
        rate.reject(
            f"a period that is a whole multiple of the step of {base.solver.step!r} s, in whole nanoseconds",
            "change the rate, or solver.step in set",
            f"a period of {float(control.period_ns):.12g} ns",
        )


def _metrics(root: Section, control: Control | None, base: Scene, taken: Container[str]) -> tuple[Metric, ...]:
    field = root.get("metrics")
    if field is None:
        root.missing("metrics", "a mapping from names to metrics", "add metrics: {final_rate: {final: rate}}")
        return ()
    numbers = control.numbers if control else ()
    target = tuple(value for key, value in numbers if key.startswith("control.parameters.target["))
    found = []
    for name, entry in field.mapping("{reduction: quantity}").items():
        section = entry.section((*REDUCTIONS, "target", "below", "above", "stays"))
        given = [each for each in REDUCTIONS if each in section.values]
        if len(given) != 1:
            entry.reject(f"exactly one of {', '.join(REDUCTIONS)}", "write for example {final: rate}")
            continue
        if name in taken:
            entry.reject("a name that no other column has", "rename the metric", f"the name {name}")
        quantity = section.get(given[0])
        # Whatever was written may be a list, which no mapping can look up; `_name` refuses it.
        kind = OF_ACTUATORS.get(str(quantity.node.value)) if quantity else None
        if quantity and kind and not any(isinstance(a, kind) for a in base.actuators):
            quantity.reject("a quantity that the scene has", "list what it is of under actuators of the scene")
        aim, stays = section.get("target"), section.get("stays")
        if not aim and target and quantity and quantity.node.value == "attitude" and not _is_attitude(target):
            entry.reject(
                "an attitude in control.parameters.target, or a target of its own",
                "add target: {x:, y:, z:, w:} to the metric",
                f"{list(target)} as the target of the law",
            )
        of = "" if quantity is None else _name(quantity, tuple(QUANTITIES))
        above, below = _limits(section, of, *_values_of(of))
        if given[0] == "time_to" and not ({"below", "above"} & section.values.keys()):
            entry.reject("a threshold for time_to", "add below: or above:", "no threshold")
        _refuse_idle(section, given[0], of)
        stay = stays is None or stays.flag(default=True)
        found.append(Metric(name, given[0], of, aim.quaternion() if aim else target or IDENTITY, below, above, stay))
    if not found and not root.field.problems:
        field.reject("at least one metric", "add one, such as final_rate: {final: rate}")
    return tuple(found)


def _is_attitude(numbers: Sequence[float]) -> bool:
    return len(numbers) == 4 and unit((numbers[0], numbers[1], numbers[2], numbers[3])) is not None


def _refuse_idle(section: Section, reduction: str, quantity: str) -> None:
    """Refuse keys of a metric that change nothing, as a limit does that was meant for `require`."""
    for key in ("below", "above", "stays"):
        if reduction != "time_to" and (field := section.get(key)):
            mend = "remove it" if key == "stays" else "write the limit under require, or take time_to"
            field.reject(f"no {key} in a metric that is not time_to", mend)
    if quantity in QUANTITIES and quantity != "attitude" and (field := section.get("target")):
        field.reject("no target, as only attitude has one", "remove it")


def _values_of(quantity: str) -> tuple[float, float]:
    """Return the least and the largest possible value of a quantity; infinite for a function of the user."""
    return (0.0, LARGEST.get(quantity, math.inf)) if quantity in QUANTITIES else (-math.inf, math.inf)


def _limits(section: Section, name: str, least: float, largest: float) -> tuple[float, float]:
    """Return `above` and `below` of a section; they are refused if no value from `least` to `largest` is between."""
    above, below = section.number("above", NUMBER, -math.inf), section.number("below", NUMBER, math.inf)
    if not (above < below and below > least and above < largest):
        possible = f"{name} is " + (
            f"at least {least:g}" if math.isinf(largest) else f"from {least:g} to {largest:.9g}"
        )
        why = "nothing lies between" if above >= below else possible
        section.field.reject(f"limits that {name} can meet", f"{why}: correct above or below")
    return above, below


def _requirements(field: Field | None, metrics: Sequence[Metric], longest: float) -> tuple[Requirement, ...]:
    """Return the requirements of runs that last at most `longest` s."""
    if field is None:
        return ()
    by_name = {metric.name: metric for metric in metrics}
    section = field.section(list(by_name))
    found = []
    for name in section.values:
        limits = section.section(name, ("below", "above"))
        if not limits.values:
            limits.field.reject("below or above", "write for example {below: 0.01}")
        metric = by_name.get(name)
        if metric is None:
            values = -math.inf, math.inf
        else:
            # Without an upper limit, what never happens in the run meets any lower one.
            last = longest if "below" in limits.values else math.inf
            values = (0.0, last) if metric.reduction == "time_to" else _values_of(metric.quantity)
        above, below = _limits(limits, name, *values)
        found.append(Requirement(name, below, above))
    return tuple(found)
