"""The page of a `Comparison`: both motions in one figure, their differences in another, and what else differs."""

from __future__ import annotations

import os

import numpy as np

from rb_dynamics.analysis.interpolated_signal import Signal
from rb_dynamics.analysis.recording_differences import MOTION, UNITS, Comparison, Difference
from rb_dynamics.report import comparison_text as text
from rb_dynamics.report import plots
from rb_dynamics.report.html import Figure, Report, Section, Table, Tile, made_by
from rb_dynamics.report.path_figure import path_in_space
from rb_dynamics.report.svg import Array, Panel, far_off

_TITLES = {
    "attitude": "Attitude, quaternion from body to world",
    "position": "Position of the body origin{less}, world axes [m]",
    "angular_velocity": "Angular velocity, body axes [rad/s]",
    "linear_velocity": "Velocity of the body origin, {axes} axes [m/s]",
    "angular_momentum": "Angular momentum, world axes [kg m²/s]",
    "linear_momentum": "Linear momentum, world axes [kg m/s]",
    "kinetic_energy": "Kinetic energy [J]",
}


def comparison_report(found: Comparison) -> Report:
    """Return the page about a comparison."""
    names = [os.path.basename(side.path) for side in (found.a, found.b)]
    lead = (
        f"A: {names[0]}, B: {names[1]}, {found.samples} samples over {found.compared_s:.6g} s{text.part(found)}; "
        f"{text.alignment_sentence(found.alignment)}. {text.verdict(found).capitalize()}."
    )
    sections = [
        Section("At a glance", tiles=_tiles(found)),
        *_notes(found),
        Section(
            "Both motions",
            f"t is {found.clock}.",
            figures=[
                Figure(plots.overlays(_panels(found, MOTION)), "A solid, B dashed in the same colours."),
                *_paths(found),
            ],
        ),
        _differences(found),
        *_momenta(found),
        _other(found),
    ]
    return Report(f"{names[0]} and {names[1]} compared", lead, sections, made_by())


def _tiles(found: Comparison) -> list[Tile]:
    tiles = []
    for name in MOTION:
        each = found.differences.get(name)
        if each is None:
            bad = "bad" if name in found.limits else ""
            tiles.append(Tile(f"Largest difference of {text.label(name)}", "unknown", "not in both", bad))
            continue
        judged = "" if name not in found.limits else "bad" if name in found.beyond else "good"
        note = f"{UNITS[name]}, at {found.seconds(each.max_ns):.6g} s; rms {each.rms:.3g}"
        tiles.append(Tile(f"Largest difference of {text.label(name)}", f"{each.max:.3g}", note, judged))
    return tiles


def _notes(found: Comparison) -> list[Section]:
    told = [*found.notes, *(f"Not compared: {part}." for part in found.not_compared)]
    return [Section("Notes", "\n\n".join(told))] if told else []


def _panels(found: Comparison, names: tuple[str, ...]) -> list[Panel]:
    return [_panel(found, each) for name in names if (each := found.differences.get(name)) is not None]


def _panel(found: Comparison, each: Difference) -> Panel:
    first, second = _shown(each)
    place, less = far_off(np.concatenate([first, second])) if each.name == "position" else (0.0, "")
    times = [found.seconds(side.time_ns) for side in each.recorded]
    return plots.overlay(
        _TITLES[each.name].format(axes=each.axes, less=less),
        (times[0], first - place),
        (times[1], second - place),
        {4: "xyzw", 3: "xyz", 1: [""]}[first.shape[1]],
    )


def _paths(found: Comparison) -> list[Figure]:
    position, attitude = found.differences.get("position"), found.differences.get("attitude")
    if position is None:
        return []
    places, unknown = position.recorded, [np.full((len(side.values), 4), np.nan) for side in position.recorded]
    turned = unknown[0] if attitude is None else attitude.recorded[0].at(places[0].time_ns)[0]
    times = [found.seconds(side.time_ns) for side in places]
    path = path_in_space([("A", times[0], places[0].values, turned), ("B", times[1], places[1].values, unknown[1])])
    return [Figure(path, "The dots are the starts; at some places stand the body axes of A.")] if path else []


def _shown(each: Difference) -> tuple[Array, Array]:
    """Return what both recorded; of attitudes with continuous signs, and those of B next to those of A."""
    first, second = each.recorded
    if not first.turns:
        return first.values, second.values
    # Where A has a gap, the signs follow B.
    alone = ~first.at(second.time_ns)[1]
    times = np.concatenate([first.time_ns, second.time_ns[alone]])
    order = np.argsort(times, kind="stable")
    signed = plots.continuous(np.concatenate([first.values, second.values[alone]])[order])

    def next_to_it(side: Signal) -> Array:
        near = signed[np.minimum(times[order].searchsorted(side.time_ns), len(signed) - 1)]
        same: Array = side.values * np.where(np.sum(near * side.values, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        return same

    return next_to_it(first), next_to_it(second)


def _differences(found: Comparison) -> Section:
    caption = (
        "Size of the difference, on a logarithmic axis; where the two are the same to the last bit there is no line. "
        "Steady growth suggests a method, a step or mass properties; a jump a command or a frame."
    )
    drawn: dict[bytes, dict[str, Array]] = {}
    times: dict[bytes, Array] = {}
    for each in found.differences.values():
        if each.max == 0.0:
            continue
        title = f"Difference of {text.label(each.name)} [{UNITS[each.name]}]"
        key = each.time_ns.tobytes()
        drawn.setdefault(key, {})[title] = each.size
        times[key] = found.seconds(each.time_ns)
    if same := [text.label(name) for name, each in found.differences.items() if each.max == 0.0]:
        caption += f" No difference: {', '.join(same)}."
    shown = [Figure(plots.comparison(times[key], sizes), caption) for key, sizes in drawn.items()]
    rows = [[text.label(name), *row] for name, row in text.rows(found)]
    return Section("Differences", figures=shown, table=Table(["", "largest", "at t [s]", "rms", "unit"], rows))


def _momenta(found: Comparison) -> list[Section]:
    panels = _panels(found, ("angular_momentum", "linear_momentum", "kinetic_energy"))
    if not panels:
        return []
    return [Section("Momenta and energy", figures=[Figure(plots.overlays(panels), "A solid, B dashed.")])]


def _other(found: Comparison) -> Section:
    rows, listed = (
        [],
        [
            ("commands", text.command_lines(found), found.commands),
            ("mass properties", text.body_lines(found), found.body),
        ],
    )
    if found.a.own and found.b.own:
        listed.append(("run", text.named_lines(found.run), found.run))
    for head, lines, known in listed:
        told = lines or ["unknown" if known is None else "the same"]
        rows += [[head if number == 0 else "", line] for number, line in enumerate(told)]
    return Section("What else differs", table=Table(["", ""], rows, numeric=False))
