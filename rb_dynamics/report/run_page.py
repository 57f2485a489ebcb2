"""The report of one recorded run: sections, figures and tables of a `RunSummary` and its `Track`.

Every number comes from `summary`, so the page and the terminal agree. Must not read a scene or simulate.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rb_dynamics.analysis.checks import BOUND
from rb_dynamics.analysis.inspection import inspect
from rb_dynamics.analysis.momentum_energy_balance import Balance
from rb_dynamics.analysis.summary import HALF, RunSummary
from rb_dynamics.analysis.track import Array, TimeSeries, Track, motion_of
from rb_dynamics.body.plausibility import Symmetry, symmetry
from rb_dynamics.formats.log_metadata import RUN, unlogged
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.report import inspection_text as text
from rb_dynamics.report import plots
from rb_dynamics.report.html import Figure, Report, Section, Table, Tile, write_html
from rb_dynamics.report.path_figure import path_in_space
from rb_dynamics.report.poinsot_figure import poinsot_view

if TYPE_CHECKING:
    from rb_dynamics.scene.model import Scene


def write_run_report(
    log: str | os.PathLike[str],
    html: str | os.PathLike[str],
    *,
    scene: Scene | None = None,
    bound: float = BOUND,
    extra: Sequence[Section] = (),
) -> RunSummary:
    """Write the report of the MCAP file `log` to `html` and return its numbers.

    Args:
        log: of this package, or any bag of pose, twist and wrench.
        html: the output file.
        scene: mass properties and frames for a bag that has none.
        bound: the largest accepted defect, relative to the largest energy or momentum.
        extra: sections shown after the numbers at a glance.

    Raises:
        LogError: `log` cannot be read or `html` cannot be written.
        MissingExtraError: matplotlib or jinja2 is not installed.
    """
    found = inspect(log, scene, bound)
    write_html(html, run_report(found.track, found.summary, extra))
    return found.summary


def run_report(track: Track, summary: RunSummary, extra: Sequence[Section] = ()) -> Report:
    """Return the page about one run."""
    name = os.path.basename(summary.path)
    source = "logged by rb_dynamics" if summary.own else "recorded"
    lead = (
        f"{summary.duration_s:.6g} s in {summary.samples} samples, {source}"
        f"{f'; {summary.lacks}' if summary.lacks else ''}; {summary.clock}. "
        f"{f'Every check passed{summary.reservation}.' if summary.passed else _failures(summary)}"
    )
    sections = [
        Section("At a glance", tiles=[*_run_tiles(summary), *_check_tiles(summary), *_size_tiles(summary)]),
        *_warnings(summary),
        *extra,
        *_subject(track, summary),
        *_motion(track),
        *_onboard(track, summary),
        *_residual(track, summary),
        *_poinsot(track),
        *_conservation(track, summary),
        *_wrenches(track, summary),
        *_tables(summary),
        *_provenance(track),
    ]
    version = f" {summary.version}" if summary.version else ""
    return Report(summary.scene or name, lead, sections, f"{name} · rb_dynamics{version}")


def comparison_section(
    time_s: Array, differences: Mapping[str, Array], heading: str = "Comparison with the recording", lead: str = ""
) -> Section:
    """Return a section on the differences between a run and a reference.

    Args:
        time_s: s.
        differences: by title with unit; numbers, or rows of a vector.
        heading: of the section.
        lead: introductory sentence.
    """
    rows = []
    for title, values in differences.items():
        sizes = np.abs(values) if values.ndim == 1 else np.linalg.norm(values, axis=1)
        worst = int(sizes.argmax())
        rows.append([title, f"{sizes[worst]:.3e}", f"{time_s[worst]:.6g}", f"{sizes[-1]:.3e}"])
    caption = (
        "Magnitude of the difference. In a good run it stays near round-off; a steadily growing difference suggests "
        "the method or its step, a jump suggests a command or a frame."
    )
    figure = Figure(plots.comparison(time_s, differences), caption)
    return Section(heading, lead, figures=[figure], table=Table(["", "worst", "at t [s]", "at the end"], rows))


def _failures(summary: RunSummary) -> str:
    failed = [check.name for check in summary.checks if not check.passed]
    return f"Failed: {'; '.join(failed)}."


def _run_tiles(summary: RunSummary) -> list[Tile]:
    rate = next((topic.rate for topic in summary.topics if topic.rate and topic.count == summary.samples), 0.0)
    samples = f"{summary.samples} samples" + (f", {rate:.4g} Hz" if rate else "")
    tiles = [Tile("Duration", f"{summary.duration_s:.6g} s", samples)]
    if summary.method:
        asked = f"{summary.asked}; " if summary.asked != summary.method else ""
        steps = (
            "number of steps unknown" if summary.steps is None else f"{summary.steps} step{'s' * (summary.steps != 1)}"
        )
        tiles.append(Tile("Method", summary.method, f"{asked}{steps}"))
    return tiles


def _check_tiles(summary: RunSummary) -> list[Tile]:
    """Return one tile for the data checks, one for each that failed, and one for each balance."""
    judged = (" balance", "explains the motion")
    data = [check for check in summary.checks if not check.name.endswith(judged)]
    failed = [Tile(check.name, "failed", check.detail, "bad") for check in data if not check.passed]
    judgements = [check.passed for check in summary.checks if check.judged]
    count = "all" if all(judgements) else f"{sum(judgements)} of"
    tiles = failed or [Tile("Log", "whole", f"{count} {len(judgements)} checks passed", "good")]
    if summary.residual is not None:
        left = summary.residual
        given = left.explained or left.explainable
        label = f"Motion, by {'the inertia given' if given else 'any inertia'}"
        value, colour = ("explained", "good") if left.explained else ("not explained", "bad")
        value, colour = (value, colour) if left.told else ("cannot tell", "")
        tiles.append(Tile(label, value, f"{left.relative:.2g} left over", colour))
    for check in summary.checks:
        balance = summary.balance(check.name.removesuffix(" balance"))
        if balance is not None and check.name.endswith(" balance"):
            known = "" if balance.covered == 1.0 else f"; known for {100.0 * balance.covered:.3g} % of the time"
            note = f"relative; {balance.worst:.2g} of {balance.scale:.3g} {balance.unit}{known}"
            verdict = "bad" if not check.passed else "good" if check.share >= HALF else ""
            tiles.append(Tile(f"{_capital(balance.name)} defect", f"{balance.relative:.2g}", note, verdict))
    return tiles


def _size_tiles(summary: RunSummary) -> list[Tile]:
    shown = ("angular rate", "angular momentum", "linear momentum", "kinetic energy")
    return [
        Tile(f"Largest {name}", f"{r.high:.4g}", f"{r.unit}, at {r.high_at_s:.4g} s; smallest {text.smallest(r, 4)}")
        for r in summary.ranges
        for name in shown
        if r.name.startswith(name)
    ]


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _subject(track: Track, summary: RunSummary) -> list[Section]:
    """Return the body, the method, and remarks on the data."""
    facts = [
        ["scene", summary.scene],
        ["method", summary.method],
        ["solver", summary.solver],
        ["rb_dynamics", summary.version],
    ]
    body = track.body
    if body is not None:
        facts += [
            ["mass", f"{body.mass:g} kg"],
            ["centre of mass", f"{_numbers(body.center_of_mass)} m, from the body origin in body axes"],
            ["principal moments", f"{_numbers(body.principal_moments)} kg m²"],
            ["mass properties from", track.body_from],
        ]
    facts.append(["effects", track.bag.metadata.get(RUN, {}).get("effects", "")])
    facts.append(["momenta and energy from", summary.momenta_from])
    scenes = [content for name, content in sorted(track.bag.attachments.items()) if name.endswith((".yaml", ".yml"))]
    return [
        Section(
            "What was simulated" if summary.own else "What was recorded",
            "\n\n".join((*summary.missing, *summary.notes)),
            table=Table(["", ""], [fact for fact in facts if fact[1]], numeric=False),
            source=scenes[0].decode("utf-8", "replace") if scenes else "",
            source_title="The scene",
        )
    ]


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


def _motion(track: Track) -> list[Section]:
    figures = []
    if track.pointing is not None:
        time_s = track.seconds(track.pointing.time_ns)
        figures.append(Figure(plots.pointing(time_s, track.pointing.values), "The angle of one turn to the target."))
    if track.pose is not None:
        time_s, rows = track.seconds(track.pose.time_ns), track.pose.values
        caption = (
            f"{track.pose.topic}: in a good run both are smooth; a jump in position or attitude means lost data "
            "or a reset. The sign of the quaternion is chosen to be continuous: q and -q are the same attitude."
        )
        figures.append(Figure(plots.position_and_attitude(time_s, rows[:, :3], rows[:, 3:]), caption))
        if path := path_in_space([("path", time_s, rows[:, :3], rows[:, 3:])]):
            figures.append(Figure(path, "The dot is the start; at some places stand the body axes x, y and z."))
    if track.moving is not None:
        time_s, rows = track.seconds(track.moving.time_ns), track.moving.values
        axes = "world" if track.twist_in_world else "body"
        source = track.moving.topic or "Computed from the pose"
        caption = f"{source}: in a good run these are continuous, with kinks only where a wrench changes."
        figures.append(Figure(plots.rates_and_velocity(time_s, rows[:, 3:], rows[:, :3], axes), caption))
    if track.specific_force is not None:
        time_s = track.seconds(track.specific_force.time_ns)
        caption = (
            f"{track.specific_force.topic}: acceleration of the sensor minus gravity. A body that falls freely without "
            "turning shows zero, one at rest 9.8 m/s² upwards."
        )
        figures.append(Figure(plots.specific_force(time_s, track.specific_force.values), caption))
    return [Section("Motion", figures=figures)] if figures else []


def _warnings(summary: RunSummary) -> list[Section]:
    found = summary.warnings
    return [Section("Warnings", "\n\n".join(found))] if found else []


def _residual(track: Track, summary: RunSummary) -> list[Section]:
    left = summary.residual
    if left is None:
        return []
    time_s = track.seconds(left.time_ns)
    caption = (
        "Mean force and torque that the recorded wrenches do not explain, with the given mass properties: between two "
        "samples or, if they are noisy, between means of several samples. In a good recording this is noise around "
        "zero. A wrong inertia shows as a torque throughout, an unrecorded torque as a limited stretch; that of a "
        "thruster is constant in body axes."
    )
    figure = Figure(plots.residual_wrench(time_s, left.force_world, left.torque_world, left.torque_body), caption)
    return [
        Section(
            "Does the given body explain the motion?",
            text.residual_sentence(left, summary.zero_ns),
            figures=[figure],
            table=Table.of(text.inertia_rows(summary, track.body)),
        )
    ]


def _poinsot(track: Track) -> list[Section]:
    pose, twist, body = track.pose, track.twist, track.body
    if pose is None or twist is None or body is None:
        return []
    motion = motion_of(pose, twist, track.twist_in_world)
    view = poinsot_view(body, track.seconds(motion.time_ns), motion.orientation_xyzw, motion.angular_velocity_body)
    caption = (
        "Paths of the point in which the ellipsoid of inertia touches the plane perpendicular to the body's angular "
        "momentum, which is the tip of the angular velocity: on the ellipsoid and in the plane, each starting at its "
        "dot. While no torque acts and nothing rotates inside the body, the plane is invariable and the ellipsoid "
        "rolls on it without slipping: the left curve is closed, the right one lies between two circles."
    )
    if symmetry(body) is Symmetry.TRIAXIAL:
        caption += (
            " The grey lines on the ellipsoid cross at the middle axis; rotation near a crossing is unstable, and "
            "the body flips."
        )
    return [Section("Poinsot's construction", figures=[Figure(view, caption)])] if view else []


def _conservation(track: Track, summary: RunSummary) -> list[Section]:
    figures = []
    angular, linear, kinetic = track.angular_momentum, track.linear_momentum, track.kinetic_energy
    if angular is not None and linear is not None:
        caption = "In a good run each is a horizontal line, to the last digit, while no load acts."
        figures.append(Figure(plots.momenta(*_shared(track, angular, linear)), caption))
    if kinetic is not None:
        figures.append(_energy(track, kinetic))
    figures += _defects(track, summary)
    parts = [f"{_capital(balance.name)}: {balance.basis}." for balance in summary.balances]
    basis = "\n\n".join([*parts, text.DEFECT] if parts else [])
    rows = text.balance_rows(summary)
    table = Table.of(rows) if rows else None
    return [Section("Momentum and energy", basis, figures=figures, table=table)] if figures or table else []


def _energy(track: Track, kinetic: TimeSeries) -> Figure:
    if track.work is None:
        caption = "In a good run this is a horizontal line while no load acts."
        return Figure(plots.energy(track.seconds(kinetic.time_ns), kinetic.values), caption)
    caption = "In a good run kinetic energy coincides with initial energy + work: it changes only by the work done."
    parts = {"motor work": track.motor_work, "friction heat": track.friction_heat}
    shown = {name: (track.seconds(part.time_ns), part.values) for name, part in parts.items() if part is not None}
    caption += " The work includes that of the wheels' motors, less the heat of their friction." if shown else ""
    return Figure(plots.energy(*_shared(track, kinetic, track.work), shown), caption)


def _shared(track: Track, first: TimeSeries, second: TimeSeries) -> tuple[Array, Array, Array]:
    """Return the common times (s), with the values of both: a log that was cut off may end between two topics."""
    time_ns, at_first, at_second = np.intersect1d(first.time_ns, second.time_ns, return_indices=True)
    return track.seconds(time_ns), first.values[at_first], second.values[at_second]


def _defects(track: Track, summary: RunSummary) -> list[Figure]:
    figures = []
    energy = summary.balance("energy")
    if energy is not None:
        caption = (
            "The change of energy that the work does not explain. In a good run it stays far below the largest energy, "
            f"{energy.scale:.3g} J; steady growth is the accumulated error of the method."
        )
        figures.append(Figure(plots.energy_defect(*_series(track, energy)), caption))
    angular, linear = summary.balance("angular momentum"), summary.balance("linear momentum")
    if angular is not None or linear is not None:
        caption = (
            "The change of the momenta that the impulses do not explain, from the start of each stretch for which it "
            "is known. In a good run it stays far below the largest momentum."
        )
        given = [None if balance is None else _series(track, balance) for balance in (angular, linear)]
        figures.append(Figure(plots.momentum_defects(*given), caption))
    return figures


def _series(track: Track, balance: Balance) -> tuple[Array, Array, float]:
    return track.seconds(balance.time_ns), balance.defect, balance.scale


def _wrenches(track: Track, summary: RunSummary) -> list[Section]:
    panels, idle = [], []
    for steps in track.acting:
        name = steps.topic.removesuffix(APPLIED)
        world = steps.world[steps.known]
        axes = "world" if world.all() else "mixed" if world.any() else "body"
        about = f"Torque of {name} about the centre of mass"
        for kind, unit, vectors in ((f"Force of {name}", "N", steps.force), (about, "N m", steps.torque)):
            if vectors.any():
                shown = np.where(steps.known[:, None], vectors, np.nan)
                panels.append((f"{kind}, {axes} axes [{unit}]", track.seconds(steps.time_ns), shown))
            else:
                idle.append(f"{kind[0].lower()}{kind[1:]}".removesuffix(" about the centre of mass"))
    rows = text.channel_rows(summary)
    if not rows:
        return []
    if came := text.command_rows(summary):
        rows = [[*row, *times] for row, (_, *times) in zip(rows, came, strict=True)]
    told = track.own or any(steps.topic.endswith(APPLIED) for steps in track.wrenches)
    zero = f" Zero throughout: {', '.join(idle)}." if idle else ""
    caption = (
        f"What {'acted' if told else 'was commanded'}, each value held until the next. {text.TORQUE} In a good run "
        f"this is what was meant: no spike, and no channel that falls silent, which the warnings name.{zero}"
    )
    figures = [Figure(plots.wrench_history(panels, track.seconds(np.array(track.span_ns))), caption)] if panels else []
    paragraph = "" if panels else "No command came with a force or a torque, and no effect held one."
    if effects := unlogged(track.bag.metadata, next((each.topic for each in track.motion), "")):
        paragraph = f"{paragraph} What these effects did is in no wrench: {effects}.".strip()
    return [Section("Wrenches", paragraph, figures=figures, table=Table.of(rows))]


def _onboard(track: Track, summary: RunSummary) -> list[Section]:
    """Return what wheels, actuators and sensors did."""
    used, sections = summary.onboard, []
    if rows := text.wheel_rows(summary):
        speeds = [(each.name, track.seconds(each.time_ns), each.speed, each.max_speed) for each in used.wheels]
        figure = Figure(
            plots.wheel_speeds(speeds), "Relative to the body; dashed: max_speed, of wheels that come near."
        )
        sections.append(Section("Reaction wheels", figures=[figure], table=Table.of(rows)))
    if rows := text.actuator_rows(summary):
        commands = [
            (
                f"{_capital(each.kind.replace('_', ' '))}s [{each.unit.replace('^2', '²')}]",
                each.name,
                track.seconds(each.time_ns),
                each.values,
            )
            for each in used.actuators
        ]
        span_s = track.seconds(np.array(track.span_ns))
        caption = (
            "As received, before any limit, each shown until the next. An on-time opens its thruster for that long."
        )
        figures = [Figure(plots.actuator_commands(commands, span_s), caption)]
        sections.append(Section("Commands to actuators", figures=figures, table=Table.of(rows)))
    if rows := text.sensor_rows(summary):
        panels = [
            (f"{each.name}: error of {each.words}", track.seconds(each.time_ns), each.errors) for each in used.sensors
        ]
        caption = "In a good run this is the noise and the bias that the scene gives the sensor, and no more."
        figures = [Figure(plots.sensor_errors(panels), caption)]
        sections.append(Section("Sensors", text.sensor_note(summary), figures=figures, table=Table.of(rows)))
    return sections


def _tables(summary: RunSummary) -> list[Section]:
    judged = [[c.name, text.verdict(c, "passed", "FAILED", "not judged"), c.detail] for c in summary.checks]
    checks = Table(["check", "result", "detail"], judged, numeric=False)
    named = [("First and last state", text.state_rows(summary)), ("Extremes", text.range_rows(summary))]
    sections = [Section("Checks", table=checks)]
    sections += [Section(title, table=Table.of(rows)) for title, rows in named if rows]
    rows = text.topic_rows(summary)
    sections.append(Section("Topics", text.topics_sentence(summary), table=Table.of(rows)))
    if summary.health is not None:
        values = Table(["", ""], [list(pair) for pair in summary.health.values], numeric=False)
        sections.append(Section("Diagnostics", text.health_sentence(summary), table=values if values.rows else None))
    return sections


def _provenance(track: Track) -> list[Section]:
    """Return every metadata record of the file, named at its first fact; facts of several lines follow as they are.

    For example rosbag2 stores a bag's metadata.yaml there.
    """
    facts, texts = [], []
    for name, record in sorted(track.bag.metadata.items()):
        told = [[key, value] for key, value in record.items() if value]
        texts += [f"{name}: {key}\n\n{value.strip()}" for key, value in told if "\n" in value.strip()]
        short = [[key, "below" if "\n" in value.strip() else value] for key, value in told]
        facts += [["" if number else name, *fact] for number, fact in enumerate(short)]
    table = Table(["record", "fact", ""], facts, numeric=False)
    source = "\n\n\n".join(texts)
    return [Section("Provenance", table=table, source=source, source_title="Longer facts")] if facts else []
