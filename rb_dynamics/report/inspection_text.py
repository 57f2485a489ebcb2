"""A `RunSummary` as plain text for a terminal: aligned, at most 100 columns, without control characters."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np

from rb_dynamics.analysis.checks import Check
from rb_dynamics.analysis.latency import EDGES_S, CommandLatency
from rb_dynamics.analysis.summary import Range, RunSummary
from rb_dynamics.analysis.track import frame_names
from rb_dynamics.analysis.unexplained_wrench import TELLS, Residual
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.report.html import printable
from rb_dynamics.run.sample import told_speed

WIDTH = 100

DEFECT = (
    "Defect: residual of the balance; relative: to the largest value, which for a momentum is the larger of its "
    "maximum and the sum of its impulses."
)
TORQUE = "Torques are about the centre of mass, the lever arm of the force included."
UNKNOWN = "-: not in the recording."

_CHANNEL_WIDTHS = (25, 10, 10, 9, 10, 10, 12, 14)


def as_text(summary: RunSummary) -> str:
    """Return the summary as lines of at most `WIDTH` columns."""
    lines = [*_wrap(headline(summary))]
    lines += _wrap(f"solver: {summary.solver}") if summary.solver else []
    lines += [line for fact in summary.body for line in _wrap(fact)]
    lines += [""]
    lines += _table("topic", topic_rows(summary), (21, 16, 9, 10, 16, 9, 19))
    lines[-1:] = [*_wrap(f"  {topics_sentence(summary)}", "    "), ""]
    lines += _table("state", state_rows(summary), (37, 6, 14, 14, 14, 14))
    lines += _table("extremes", range_rows(summary), (35, 16, 16, 16, 16))
    lines += _table("balance", balance_rows(summary), (30, 14, 14, 14, 14, 14))
    lines += _wrap(f"  {DEFECT}", "    ") if summary.balances else []
    lines += [line for row in summary.balances for line in _wrap(f"  {row.name}: {row.basis}", "    ")]
    lines += [""] if summary.balances else []
    rows, apart = _frames_apart(channel_rows(summary))
    lines += _table("wrench channel", rows, _CHANNEL_WIDTHS)
    if summary.channels:
        unknown = [UNKNOWN] if any("-" in row for row in rows) else []
        lines[-1:] = [*(line for each in (*apart, TORQUE, *unknown) for line in _wrap(f"  {each}", "    ")), ""]
    lines += _table("commands", command_rows(summary), (36, 16, 16, 16, 16))
    lines += _table("latency", latency_rows(summary), (31, 10, 16, 16, 9, 9, 15))
    lines += [line for each in summary.latencies for line in histogram(each)]
    lines += _table("reaction wheel", wheel_rows(summary), (25, 15, 15, 15, 15, 15))
    lines += _table("actuator", actuator_rows(summary), (25, 17, 12, 18, 14, 14))
    lines += _table("sensor error", sensor_rows(summary), (37, 21, 14, 14, 14))
    lines += [*_wrap(f"  {sensor_note(summary)}", "    "), ""] if summary.onboard.sensors else []
    if summary.health:
        lines += [*_wrap(f"diagnostics: {health_sentence(summary)}"), ""]
    for remark in (*summary.missing, *summary.notes):
        lines += _wrap(f"note: {remark}", "  ")
    lines += [""] if summary.missing or summary.notes else []
    for check in summary.checks:
        lines += _wrap(f"{verdict(check, 'ok  ', 'FAIL', '--  ')}  {check.name}: {check.detail}", "      ")
    if summary.residual:
        lines += ["", *_wrap(residual_sentence(summary.residual, summary.zero_ns)), ""]
    lines += [line for warning in summary.warnings for line in _wrap(f"warning: {warning}", "  ")]
    failed, count = sum(not check.passed for check in summary.checks), sum(check.judged for check in summary.checks)
    told = f"{failed} of {count} checks failed" if failed else f"all {count} checks passed{summary.reservation}"
    return "\n".join([*lines, *_wrap(told)])


def verdict(check: Check, passed: str, failed: str, unknown: str) -> str:
    """Return the result of a check as a word."""
    if not check.judged:
        return unknown
    return passed if check.passed else failed


def headline(summary: RunSummary) -> str:
    """Return the type of the file, in one or two sentences."""
    own = f"log of rb_dynamics {summary.version}".rstrip()
    source = own if summary.own else "sensors of a simulated run" if summary.sensed else "recording by another program"
    scene = f", scene {summary.scene}" if summary.scene else ""
    samples = f"{summary.duration_s:.9g} s in {summary.samples} samples" if summary.samples else "no motion recorded"
    asked = f" ({summary.asked})" if summary.asked != summary.method else ""
    method = f"; {summary.method}{asked}" if summary.method else ""
    steps = "" if summary.steps is None else f", {summary.steps} step{'' if summary.steps == 1 else 's'}"
    state = f"; {summary.lacks}" if summary.lacks else ""
    return f"{summary.path}: {source}{scene}: {samples}{method}{steps}{state}; {summary.clock}"


def topic_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: topics."""
    rows = [["", "type", "messages", "rate [Hz]", "longest gap [s]", "at t [s]", "used for"]]
    for t in summary.topics:
        rate = _short(t.rate) if t.rate else ""
        longest = [_short(t.longest_s), _short(round(t.longest_at_s, 3))] if t.count > 1 else ["", ""]
        rows.append([t.name, t.type_name.rpartition("/")[2], str(t.count), rate, *longest, t.use])
    return rows


def topics_sentence(summary: RunSummary) -> str:
    """Return which clock the table of topics uses."""
    if summary.own:
        return "Rates and gaps are by log time, which is simulation time."
    return (
        "Rates and gaps in this table are by log time, when a message was recorded; everything else is by header.stamp."
    )


def state_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: first and last state; empty if there is no motion."""
    rows = [["", "", "x", "y", "z", "w"]]
    for m in summary.moments:
        for when, values in (("first", m.first), ("last", m.last)):
            name = m.name + (f" [{m.unit}]" if m.unit else "") if when == "first" else ""
            rows.append([name, when, *(f"{value:.7g}" for value in values), *[""] * (4 - len(values))])
    return rows if summary.moments else []


def range_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: extremes; empty if there is no motion."""
    rows = [["", "smallest", "at t [s]", "largest", "at t [s]"]]
    rows += [
        [f"{r.name} [{r.unit}]", smallest(r, 8), _short(r.low_at_s), f"{r.high:.8g}", _short(r.high_at_s)]
        for r in summary.ranges
    ]
    return rows if summary.ranges else []


def smallest(found: Range, digits: int) -> str:
    """Return the smallest value; where it would look like the largest, how much less than that it is."""
    if found.low == found.high:
        return "the same"
    alike = f"{found.low:.{digits}g}" == f"{found.high:.{digits}g}"
    return f"{found.high - found.low:.2g} less" if alike else f"{found.low:.{digits}g}"


def balance_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: defects; empty if there are no balances."""
    rows = [["", "worst defect", "at t [s]", "largest value", "relative", "of the run"]]
    for b in summary.balances:
        worst = [_size(b.worst), _short((b.worst_ns - summary.zero_ns) * 1e-9)] if b.covered else ["", ""]
        relative = _size(b.relative) if b.covered else ""
        rows.append([f"{b.name} [{b.unit}]", *worst, f"{b.scale:.4g}", relative, f"{100.0 * b.covered:.3g} %"])
    return rows if summary.balances else []


def channel_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: statistics of each wrench channel; empty without channels."""
    rows = [["", "frame", "received", "applied", "timeouts", "rejected", "max |F| [N]", "max |τ| [N m]"]]
    for c in summary.channels:
        counts = ["-" if n is None else str(n) for n in (c.received, c.applied, c.timeouts, c.rejected)]
        sizes = ["-" if size is None else f"{size:.5g}" for size in (c.largest_force, c.largest_torque)]
        rows.append([c.topic, frame_names(c.frames), *counts, *sizes])
    return rows if summary.channels else []


def command_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: times of the commands on each wrench channel, in order; empty without commands."""
    rows = [["", "first at t [s]", "last at t [s]", "usual gap [s]", "then held [s]"]]
    for c in summary.channels:
        times = (c.first_s, c.last_s, c.usual_s, c.held_s)
        rows.append([c.topic, *("" if time is None else _short(time) for time in times)])
    return rows if any(c.first_s is not None for c in summary.channels) else []


def latency_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: latencies of commands; empty if they were not logged."""
    rows = [["", "commands", "to receiving", "then to acting", "median", "p99", "largest [ms]"]]
    for each in summary.latencies:
        times = each.transport_s, each.waiting_s, each.median_s, each.p99_s, each.largest_s
        rows.append([each.topic, str(each.count), *(f"{1e3 * time:.3f}" for time in times)])
    return rows if summary.latencies else []


def wheel_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: the speeds of reaction wheels; empty without wheels."""
    rows = [["", "first [rad/s]", "last", "largest", "of max_speed", "at limit [s]"]]
    for each in summary.onboard.wheels:
        limited = math.isfinite(each.max_speed)
        speeds = each.first, each.last, each.largest
        limit = [f"{100.0 * each.largest / each.max_speed:.3g} %", _short(each.at_limit_s)] if limited else ["", ""]
        rows.append([each.name, *(_short(told_speed(speed, each.rate)) for speed in speeds), *limit])
    return rows if len(rows) > 1 else []


def actuator_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: the commands to actuators; empty if there were none."""
    rows = [["", "type", "commands", "largest", "limited", "rejected"]]
    for each in summary.onboard.actuators:
        largest = f"{_short(each.largest)} {each.unit}".strip().replace("^2", "²")
        rows.append([each.name, each.kind, str(each.commands), largest, str(each.limited), str(each.rejected)])
    return rows if len(rows) > 1 else []


def sensor_rows(summary: RunSummary) -> list[list[str]]:
    """Return header and rows: measured minus true, about each axis; empty if nothing can be compared."""
    rows = [["", "", "x", "y", "z"]]
    for each in summary.onboard.sensors:
        for what, values in (("mean", each.mean), ("standard deviation", each.deviation)):
            name = f"{each.name}, {each.words}"
            rows.append(
                [name if what == "mean" else "", what, *("unknown" if math.isnan(v) else f"{v:.4g}" for v in values)]
            )
    return rows if len(rows) > 1 else []


def sensor_note(summary: RunSummary) -> str:
    """Return what the errors of sensors are computed from."""
    counts = {each.name: f"{each.compared} of {each.count} of {each.name}" for each in summary.onboard.sensors}
    return f"Measured minus true, over the samples that fall on an output: {', '.join(counts.values())}."


def histogram(latency: CommandLatency) -> list[str]:
    """Return the histogram of the latency of a channel, a line for each interval from the first to the last."""
    used = [place for place, count in enumerate(latency.counts) if count]
    lines = [f"  {latency.topic}, from sending to acting; {latency.skipped} sequence numbers are missing:"]
    for place in range(used[0], used[-1] + 1):
        count, low, high = latency.counts[place], 1e3 * EDGES_S[place], 1e3 * EDGES_S[place + 1]
        interval = f"from {low:g} ms" if math.isinf(high) else f"{low:g} to {high:g} ms"
        interval = interval if math.isfinite(low) else f"below {high:g} ms"
        bar = "#" * math.ceil(50 * count / max(latency.counts))
        lines.append(f"    {interval:<16} {count:>8}  {bar}".rstrip())
    return [*lines, ""]


def residual_sentence(left: Residual, zero_ns: int) -> str:
    """Return how well the given body explains the motion, and what would explain it; times from `zero_ns`."""
    force, torque = left.root_mean_square
    noisy = "" if left.with_rates else ", of differences of the pose, their noise included"
    # Without a position nothing is known of a force.
    pushing = "" if math.isnan(force) else f"force {force:.3g} N and "
    size = f"Residual {pushing}torque {torque:.3g} N m (root mean square{noisy})."
    if not left.told and (not left.explained or left.fitted_ns is None or not left.noise):
        verdict = f"CANNOT TELL whether the inertia given explains the motion: {left.untold}."
    elif not left.told:
        verdict = (
            "CANNOT TELL at this noise whether the inertia given explains the motion: it is "
            f"{_noise(left)}, and {_unseen(left)}."
        )
    elif left.explained and left.noise:
        verdict = (
            f"The inertia given explains the motion up to its noise, {_noise(left)}. At this noise {_unseen(left)}."
        )
    elif left.explained:
        verdict = "The inertia given explains the motion."
    elif left.explainable:
        verdict = (
            f"The inertia given does NOT explain the motion. The best fit, {_moments(left)}, leaves {left.best:.3g} of "
            f"the angular momentum without a cause.{_bias(left, 'would explain it too')}{_factor(left)}"
        )
    elif left.bias is not None:
        verdict = f"NO inertia explains the motion.{_bias(left, 'does')}"
    else:
        given, causes = "without a torque, and none is recorded", "a torque that was not recorded"
        if left.recorded:
            given = "with the commands as recorded"
            causes = "a torque that was not commanded, commands of another sign, frame or time"
        verdict = (
            f"NO inertia explains the motion {given}. {_strongest(left, zero_ns)} Possible causes: {causes}, or a body "
            "that changed: inspect its parts with --from and --to."
        )
    return f"{verdict}{_part(left, zero_ns)}{_one_axis(left)} {size}{_mass(left)}"


def _part(left: Residual, zero_ns: int) -> str:
    """Return which part of a long recording was fitted."""
    if left.fitted_ns is None or not len(left.time_ns):
        return ""
    begin, end = left.fitted_ns
    if end - begin > 0.99 * (left.time_ns[-1] - left.start_ns[0]):
        return ""
    rest = "is judged by its momentum alone" if left.with_rates else "is not judged"
    return f" Fitted: t = {(begin - zero_ns) * 1e-9:.6g} to {(end - zero_ns) * 1e-9:.6g} s; the rest {rest}."


def _factor(left: Residual) -> str:
    return "" if left.factor is None else f" A factor of {left.factor:.4g} on all torques would explain it too."


def _moments(left: Residual) -> str:
    """Return the principal moments of the best-fitting inertia."""
    errors = left.moment_errors or (0.0, 0.0, 0.0)
    moments = zip(np.linalg.eigvalsh(left.inertia), errors, strict=True)
    told = ", ".join(f"{moment:.6g} ± {error:.2g}" for moment, error in moments)
    scale = "" if left.scaled else " (up to a factor, as no torque tells the scale)"
    return f"principal moments of {told} kg m²{scale}"


def _one_axis(left: Residual) -> str:
    """Return what cannot be known of a body that turns about one axis only, such as a robot on the ground."""
    if left.axis is None:
        return ""
    about = f"The body turns about one axis only, {_vector(left.axis.tolist())} in body axes: "
    if left.scaled:
        return f" {about}the recording tells the moment about it, and nothing of the other moments and products."
    return (
        f" {about}without recorded torques, the recording tells nothing of its inertia, and any other would do as well."
    )


def _noise(left: Residual) -> str:
    return f"{left.noise:.2g} of the angular momentum in a sample" if np.isfinite(left.noise) else "not known"


def _unseen(left: Residual) -> str:
    told = [f"{100.0 * part:.2g} %" if part < TELLS else "any size" for part in left.unseen]
    return f"errors of the principal moments of {told[0]}, {told[1]} and {told[2]} would not be seen"


def _bias(left: Residual, does: str) -> str:
    if left.bias is None:
        return ""
    return f" A constant error of the measured rates of {_vector(left.bias.tolist())} rad/s, as gyros have, {does}."


def _mass(left: Residual) -> str:
    if told := left.mass_words:
        return f" {told[0].upper()}{told[1:]}."
    hidden = " The forces do not tell the mass: noise, another centre of mass, or what acted beside them, hides it."
    return hidden if np.isfinite(left.mass_error) else ""


def _strongest(left: Residual, zero_ns: int) -> str:
    found = left.strongest
    begin, end = (_short((time_ns - zero_ns) * 1e-9) for time_ns in (found.start_ns, found.end_ns))
    body, world = (_vector(mean.tolist()) for mean in (found.torque_body, found.torque_world))
    return (
        f"The torque that would was strongest from t = {begin} to {end} s: {body} N m in body axes on "
        f"average, {world} in world axes; at most {found.peak:.3g} N m."
    )


def _vector(values: Sequence[float]) -> str:
    """Return three numbers, with as many decimals as give the largest three digits."""
    largest = max(map(abs, values))
    decimals = 2 - math.floor(math.log10(largest)) if largest > 0.0 else 0
    return f"({', '.join(f'{round(value, decimals) + 0.0:.3g}' for value in values)})"


def inertia_rows(summary: RunSummary, body: RigidBody | None) -> list[list[str]]:
    """Return header and rows: the given inertia and the best-fitting one, if any; empty if it is not judged."""
    left = summary.residual
    if left is None or body is None:
        return []
    columns = [("given", np.array(body.inertia))]
    columns += [("fits best", left.inertia)] if left.moment_errors else []
    rows = [["kg m², body axes", *(name for name, _ in columns)]]
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        rows.append([f"I{'xyz'[i]}{'xyz'[j]}", *(f"{inertia[i, j]:.6g}" for _, inertia in columns)])
    return rows


def health_sentence(summary: RunSummary) -> str:
    """Return the worst level and the last message of the diagnostics."""
    if summary.health is None:
        return ""
    return f"worst level {summary.health.level}; last message: {summary.health.message or 'none'}"


def _size(value: float) -> str:
    return f"{value:.3e}" if value else "0"


def _short(value: float) -> str:
    return f"{value:.6g}"


def _table(title: str, rows: Sequence[Sequence[str]], widths: Sequence[int]) -> list[str]:
    if not rows:
        return []
    header, *body = rows
    lines = [_line([title.upper(), *header[1:]], widths)]
    for name, *rest in body:
        if len(printable(name)) + 2 < widths[0]:
            lines.append(_line([f"  {name}" if name else "", *rest], widths))
        else:
            # A long name is not shortened; it gets a line of its own.
            lines += [f"  {_fit(name, WIDTH - 2)}", _line(["", *rest], widths)]
    return [*lines, ""]


def _frames_apart(rows: list[list[str]]) -> tuple[list[list[str]], list[str]]:
    """Return the rows of the channels, and a sentence for each whose frames do not fit in the table."""
    told, apart = [], []
    for name, frames, *rest in rows:
        fits = len(printable(frames)) < _CHANNEL_WIDTHS[1]
        apart += [] if fits else [f"Frames of {name}: {frames}."]
        told.append([name, frames if fits else "below", *rest])
    return told, apart


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    first, *rest = (_fit(cell, width) for cell, width in zip(cells, widths, strict=True))
    return (first.ljust(widths[0]) + "".join(c.rjust(w) for c, w in zip(rest, widths[1:], strict=True))).rstrip()


def _fit(cell: str, width: int) -> str:
    """Return `cell` with its middle left out if it is too wide; one column stays free."""
    text = printable(cell)
    if len(text) < width:
        return text
    half = (width - 2) // 2
    return f"{text[: width - 2 - half]}…{text[len(text) - half :]}"


def _wrap(text: str, indent: str = "  ") -> Iterable[str]:
    flat = " ".join(printable(text).split("\n"))
    return textwrap.wrap(flat, WIDTH, subsequent_indent=indent, break_on_hyphens=False)
