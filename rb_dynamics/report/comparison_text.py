"""A `Comparison` as text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from rb_dynamics.analysis.recording_differences import MOTION, PARTS, UNITS, Comparison, Difference, Side
from rb_dynamics.analysis.time_alignment import Alignment
from rb_dynamics.report.html import printable

# Of the longer one: the first and last samples of two recordings are never at one time.
_ALL = 0.99


def as_text(found: Comparison) -> str:
    """Return the comparison as text."""
    lines = [
        f"A         {_side(found.a)}",
        f"B         {_side(found.b)}",
        f"times     {alignment_sentence(found.alignment)}",
        f"          t is {found.clock}",
        f"compared  {found.samples} samples of the motion, {found.compared_s:.9g} s{part(found)}",
        *(f"not       {part}" for part in found.not_compared),
        "",
        _row("difference", ("largest", "at t [s]", "rms", "")),
        *(_row(label(name), row) for name, row in rows(found)),
        "",
        "largest difference by time",
        *growth_lines(found.differences, found.span_ns, found.zero_ns),
        "",
        *_listed("commands", command_lines(found), found.commands),
        *_listed("body", body_lines(found), found.body),
    ]
    if found.run:
        lines += _listed("run", named_lines(found.run), found.run)
    lines += [f"note      {note}" for note in found.notes]
    lines.append(f"result    {verdict(found)}")
    return printable("\n".join(lines))


def part(found: Comparison) -> str:
    """Return which part of the longer one is compared, in words; "" for all of it."""
    return "" if found.share >= _ALL else f", {100.0 * found.share:.3g} % of the longer one"


def label(name: str) -> str:
    """Return the name of a quantity in words."""
    return name.replace("_", " ")


def rows(found: Comparison) -> list[tuple[str, tuple[str, str, str, str]]]:
    """Return for each quantity: name, and largest difference, its time, rms and unit with remarks."""
    result = []
    for name, each in found.differences.items():
        remark = f" {each.axes} axes" * bool(each.axes)
        if each.interpolated:
            remark += f", interpolation adds up to about {each.interpolation:.1g}"
        numbers = (f"{each.max:.4g}", f"{found.seconds(each.max_ns):.9g}", f"{each.rms:.4g}")
        result.append((name, (*numbers, f"{UNITS[name]}{',' * bool(remark)}{remark}".replace(",,", ","))))
    return result


def growth_lines(found: Mapping[str, Difference], span_ns: tuple[int, int], zero_ns: int) -> list[str]:
    """Return a table of the largest difference of each quantity of the motion in equal parts of the time."""
    names = [name for name in MOTION if name in found]
    head = f"{'from t [s]':>14}" + "".join(f"{label(name)} [{UNITS[name]}]".rjust(26) for name in names)
    begin, end = ((time - zero_ns) / 1e9 for time in span_ns)
    parts = zip(*(found[name].growth(span_ns) for name in names), strict=True)
    return [
        head,
        *(
            f"{begin + (end - begin) * number / PARTS:14.6g}"
            + "".join(("-" if math.isnan(size) else f"{size:.3g}").rjust(26) for size in sizes)
            for number, sizes in enumerate(parts)
        ),
    ]


def alignment_sentence(alignment: Alignment) -> str:
    """Return how the times are related, and how certain that is."""
    offset = alignment.offset_ns
    moved = f"B's clock is {seconds(abs(offset))} s {'ahead of' if offset > 0 else 'behind'} A's" if offset else ""
    said = {
        "stamp": "aligned by stamps",
        "start": f"aligned by the starts of the motion: {moved or 'the same stamp'}",
        "seconds": f"aligned as asked: {moved or 'no offset'}",
        "commands": f"aligned by the commands that were flown: {moved}",
        "lag": f"aligned by the lag that fits best: {moved or 'none'}",
    }[alignment.by]
    if alignment.by != "lag":
        return said
    uncertain = alignment.uncertainty_s
    if uncertain is not None:
        said += f", +- {uncertain:.2g} s" if math.isfinite(uncertain) else ", which nothing confirms"
    return said


def seconds(time_ns: int) -> str:
    """Return a time in s with all its digits."""
    whole, rest = divmod(time_ns, 10**9)
    return f"{whole}.{rest:09d}".rstrip("0").rstrip(".")


def command_lines(found: Comparison) -> list[str]:
    """Return one line for each channel on which the commands differ."""
    lines = []
    for each in found.commands or ():
        counts = ", ".join(
            f"{side}: {_count(count, 'commands' if each.unit else 'changes')}"
            for side, count in (("A", each.a), ("B", each.b))
        )
        axes = "; one in world, the other in body axes" if each.axes else ""
        size = f"{each.value:.4g} {each.unit}" if each.unit else f"{each.force:.4g} N and {each.torque:.4g} N m"
        since = found.seconds(each.first_ns)
        lines.append(f"{each.topic} differs from t = {since:.9g} s on, by up to {size} ({counts}){axes}")
    return lines


def _count(count: int | None, what: str) -> str:
    return f"no such {'actuator' if what == 'commands' else 'channel'}" if count is None else f"{count} {what}"


def body_lines(found: Comparison) -> list[str]:
    """Return one line for each mass property that differs, or those of the one whose body is known."""
    if found.body is not None:
        return named_lines(found.body)
    known = [(name, side.body) for name, side in (("A", found.a), ("B", found.b)) if side.body is not None]
    return [
        f"of {name} alone: mass {_value(body.mass)} kg, center of mass {_value(body.center_of_mass)} m, inertia "
        f"{_value(body.inertia)} kg m^2"
        for name, body in known
    ]


def named_lines(differing: Any) -> list[str]:
    """Return one line for each fact that differs."""
    return [f"{label(name)}: {_value(a)} in A, {_value(b)} in B" for name, a, b in differing]


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    return str(value) or "none"


def _listed(head: str, lines: list[str], known: Any) -> list[str]:
    return [f"{head:10}{line}" for line in lines or ["unknown" if known is None else "the same"]]


def verdict(found: Comparison) -> str:
    """Return the result in one sentence."""
    first = found.first_ns
    if first is None:
        bits = f"the same to the last bit at every sample compared ({found.samples})"
    elif all(each.first_recorded_ns is None for each in _motion(found)):
        larger = [each.name for each in _motion(found) if not each.explained]
        size = (
            f"by more than interpolation is estimated to add in {_each(larger)}"
            if larger
            else "by no more than interpolation adds"
        )
        bits = f"the motions differ at interpolated samples only, {size}"
    else:
        bits = f"the motions differ from t = {found.seconds(first):.9g} s on"
    limits = found.limits
    if found.share < found.least_share:
        bits += (
            f"; ONLY {100.0 * found.share:.3g} % of the longer one compared, asked {100.0 * found.least_share:.3g} %"
        )
    if not limits:
        return bits
    if not found.beyond:
        return f"{bits}; {_each(limits)} within {_most(found)}{part(found).replace(',', ' over', 1)}"
    beyond = [name for name in found.beyond if name in found.differences]
    missing = _each(name for name in found.beyond if name not in found.differences)
    judged = f"; BEYOND {_most(found)}: {_each(beyond)}" if beyond else ""
    if beyond and all(found.differences[name].explained for name in beyond):
        judged += ", by no more than interpolation adds: compare at times that both have"
    return bits + judged + (f"; CANNOT JUDGE what is not in both: {missing}" if missing else "")


def _motion(found: Comparison) -> list[Difference]:
    return [each for name, each in found.differences.items() if name in MOTION]


def _each(names: Iterable[str]) -> str:
    return ", ".join(map(label, names))


def _most(found: Comparison) -> str:
    if isinstance(found.bound, Mapping):
        return " and ".join(f"{most:g} {UNITS[name]}" for name, most in found.limits.items())
    return f"{found.bound:g}"


def _side(side: Side) -> str:
    kind = "flown for this comparison" if side.flown else "log of rb_dynamics" if side.own else "recorded"
    return f"{side.path}: {kind}, t = {side.span_s[0]:.9g} to {side.span_s[1]:.9g} s"


def _row(head: str, cells: tuple[str, str, str, str]) -> str:
    return f"{head:20}{cells[0]:>12}{cells[1]:>14}{cells[2]:>12}  {cells[3]}".rstrip()
