"""Read the `wrenches` section of a scene: the command channels and their topics."""

from __future__ import annotations

import math

from rb_dynamics.formats.yaml.fields import Field, Rule, Section
from rb_dynamics.loads.number_ranges import TIME
from rb_dynamics.loads.wrench_channels import ON_EXCESS, topic_fault
from rb_dynamics.numerics.nanoseconds import LONGEST, SHORTEST
from rb_dynamics.scene.model import Channel

_TIMEOUT = Rule(
    f"0 (hold for ever) or a number from {SHORTEST:g} to {LONGEST:.1e} (s)",
    TIME.holds,
    "write 0 or the time after which the channel drops to zero",
)

_LIMITS = {
    name: Rule(f"a number greater than 0 ({unit})", lambda v: v > 0.0, "leave it out for no limit")
    for name, unit in (("max_force", "N"), ("max_torque", "N m"))
}
_DELAY = Rule(TIME.expected, TIME.holds, "write 0 or the time from a command to its effect")
_LAG = Rule(TIME.expected, TIME.holds, "write 0 or the time constant of the actuator")
_BIAS = {name: Rule(f"a finite number ({unit})") for name, unit in (("force", "N"), ("torque", "N m"))}
_KEYS = ("topic", "timeout", "optional", *_LIMITS, "on_excess", "delay", "bias", "lag")


def channels(field: Field | None, taken: dict[str, str]) -> tuple[Channel, ...]:
    """Return the channels in the order of the scene; one named `wrench` if the section is absent.

    Their topics are added to `taken`, each with its key.
    """
    if field is None:
        taken[Channel().topic] = "wrenches"
        return (Channel(),)
    entries = field.items("a list of channels", "write a list such as [{topic: wrench}], or [] for none")
    return tuple(_channel(entry.section(_KEYS), taken) for entry in entries)


def _channel(section: Section, taken: dict[str, str]) -> Channel:
    optional, bias = section.get("optional"), section.section("bias", tuple(_BIAS))
    return Channel(
        _topic(section, taken),
        section.number("timeout", _TIMEOUT, 0.0),
        optional is not None and optional.flag(default=False),
        section.number("max_force", _LIMITS["max_force"], math.inf),
        section.number("max_torque", _LIMITS["max_torque"], math.inf),
        _on_excess(section),
        section.number("delay", _DELAY, 0.0),
        bias.vector("force", _BIAS["force"]),
        bias.vector("torque", _BIAS["torque"]),
        section.number("lag", _LAG, 0.0),
    )


def _on_excess(section: Section) -> str:
    """Return what happens to a command beyond a limit; records a problem if there is no limit."""
    field = section.get("on_excess")
    if field is None:
        return ON_EXCESS[0]
    if not any(section.get(name) for name in _LIMITS):
        field.reject(" or ".join(_LIMITS), "add one of them, or remove on_excess", "no limit")
    expected = " or ".join(ON_EXCESS)
    return field.text(expected, lambda text: text in ON_EXCESS, f"write {expected}", ON_EXCESS[0])


def _topic(section: Section, taken: dict[str, str]) -> str:
    return topic_in(section, "topic", "wrench", taken) or Channel().topic


def topic_in(section: Section, key: str, example: str, taken: dict[str, str], end: str = "") -> str:
    """Return the name of a topic at `key`; "" after a problem: it is no ROS name, or, with `end`, in `taken`."""
    field = section.get(key)
    if field is None:
        section.missing(key, "the name of a topic", f"add {key}: {example}")
        return ""
    topic = field.text("a ROS topic name", lambda text: text != "", f"write one, such as {example}", "")
    # In the root namespace wrench and /wrench are one topic, and a bag knows only /wrench.
    name = topic.removeprefix("/") + end
    if fault := topic and topic_fault(topic + end):
        field.reject(*fault)
        return ""
    if topic and name in taken:
        field.reject("each topic once", "rename one of the two or remove it", f"{topic} again, first in {taken[name]}")
    elif topic:
        taken[name] = field.key
    return topic
