"""The page of an `Identification`: what was found, measured and fitted motion, residuals, ellipses of errors."""

from __future__ import annotations

import itertools
import math
import os
from typing import TYPE_CHECKING

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import ATTITUDE, UNITS
from rb_dynamics.analysis.identification.identify import Identification, Parameter
from rb_dynamics.analysis.identification.measurement_model import Predicted
from rb_dynamics.analysis.identification.parameters import AXES, rows_of
from rb_dynamics.report import plots
from rb_dynamics.report.html import Figure, Report, Section, Table, Tile, made_by
from rb_dynamics.report.interactive_plots import Picture
from rb_dynamics.report.svg import COLORS, TEXT, Array, Line, Panel, components, draw, picture, quiet

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# More recordings than these are not drawn.
_MOST = 4
# Ellipses of pairs, in rows of three.
_PAIRS = 6
_DRAWS = 40
# Of the inertia: how far drawn ellipsoids lie apart, so that it can be seen.
_SEEN = 0.05
# sqrt of the 95 % quantile of chi-squared with two degrees of freedom.
_ELLIPSE = 2.4477
_VIEWS = (("x", "y"), ("x", "z"), ("y", "z"))


def identification_report(found: Identification) -> Report:
    """Return the page about an identification."""
    names = ", ".join(os.path.basename(name) for name in found.recordings)
    sections = [
        Section("At a glance", tiles=_tiles(found)),
        *_unknown(found),
        Section("Parameters", table=_parameters(found)),
        *_motions(found),
        Section("Residuals by sensor", table=_residuals(found)),
        *_ellipses(found),
        *_ellipsoid(found),
        Section("Fitted scene", "With what was found; it runs.", source=found.scene.text, source_title="scene"),
    ]
    return Report(f"Identified from {names}", _lead(found), sections, made_by())


def _lead(found: Identification) -> str:
    known = sum(each.known for each in found.parameters)
    rest = "converged" if found.converged else "did not converge"
    return (
        f"{known} of {len(found.parameters)} numbers are determined by {len(found.recordings)} "
        f"recording{'s' * (len(found.recordings) > 1)}; the fit {rest}, and {found.agreeing} of {found.starts} starts "
        "found this minimum." + "".join(f" {each[0].upper()}{each[1:]}." for each in found.unexplained)
    )


def _tiles(found: Identification) -> list[Tile]:
    tiles = []
    by_name = {each.name: each for each in found.parameters}
    if "mass" in by_name:
        tiles.append(_tile("Mass", by_name["mass"].value, by_name["mass"].standard_error, "kg"))
    for number, (moment, error) in enumerate(
        zip(sorted(found.body.principal_moments), found.principal_errors, strict=True)
    ):
        tiles.append(_tile(f"Principal moment {number + 1}", moment, error if math.isfinite(error) else None, "kg m²"))
    for each in found.residuals:
        judged = "good" if each.only_noise else "bad"
        white = each.whiteness + ("" if each.explained else f"; {each.times_noise:.3g} times the noise")
        note = f"{each.unit}; {white}"
        tiles.append(Tile(f"Residual of {each.topic} {each.kind}, rms", f"{each.rms:.3g}", note, judged))
    return tiles


def _tile(label: str, value: float, error: float | None, unit: str) -> Tile:
    if error is None:
        return Tile(label, "not determined", f"value used: {value:.6g} {unit}")
    return Tile(label, f"{value:.6g}", f"± {error:.2g} {unit}")


def _unknown(found: Identification) -> list[Section]:
    told = [*(f"Not determined by these recordings: {each}." for each in found.unknown_combinations)]
    told += [f"What would determine it: {each}." for each in found.advice]
    notes = [f"{note.removesuffix('.')}." for note in found.notes]
    headed = (("What these recordings do not determine", told), ("Notes", notes))
    return [Section(heading, "\n\n".join(each)) for heading, each in headed if each]


def _parameters(found: Identification) -> Table:
    rows = []
    for each in found.parameters:
        if each.interval is None or each.standard_error is None:
            rows.append([each.name, f"not determined ({each.taken}: {each.value:.6g})", "", "", each.unit])
        else:
            low, high = each.interval
            digits = _digits(each.value, high - low)
            value, *interval = (f"{number:.{digits}g}" for number in (each.value, low, high))
            rows.append([each.name, value, f"{each.standard_error:.2g}", " … ".join(interval), each.unit])
    return Table(["", "value", "± s.e.", "95 % interval", "unit"], rows)


def _digits(value: float, width: float) -> int:
    """Return how many digits show a value to a hundredth of the width of its interval: 7 or more."""
    if not value or not width:
        return 7
    return min(max(7, 3 + math.ceil(math.log10(abs(value) / width))), 17)


def _residuals(found: Identification) -> Table:
    rows = []
    for each in (*found.residuals, *found.validation):
        held = "" if each in found.residuals else " (held out)"
        white = each.whiteness if each.white is None else "yes" if each.white else f"no, {each.correlation:.2f}"
        row = [str(each.count), f"{each.rms:.4g}", each.unit, f"{each.times_noise:.3g}", white]
        rows.append([f"{each.topic} {each.kind}{held}", *row])
    return Table(["", "samples", "rms", "unit", "times noise", "white"], rows)


def _motions(found: Identification) -> list[Section]:
    sections = []
    for number, name in list(enumerate(found.recordings))[:_MOST]:
        mine = [each for each in found.predicted if each.flight == number]
        heading = "Measured and fitted" + (
            f", recording {number + 1}: {os.path.basename(name)}" if len(found.recordings) > 1 else ""
        )
        figures = [
            Figure(draw([_overlay(each) for each in mine], heading), "Measured solid, fitted dashed, same colours."),
            Figure(
                draw([_left(each) for each in mine], f"Residuals of {name}"),
                "Fitted less measured. What is left should be noise: waves or a drift are a torque, a force or an "
                "error of a sensor that the scene does not have.",
            ),
        ]
        sections.append(Section(heading, figures=figures))
    more = len(found.recordings) - _MOST
    if more > 0:
        sections.append(Section("Other recordings", f"{more} more recordings were fitted and are not drawn."))
    return sections


def _overlay(each: Predicted) -> Panel:
    seconds = _seconds(each)
    topic, kind, _ = each.key
    if kind == ATTITUDE:
        measured = plots.continuous(each.measured)
        fitted = rotations.products(measured, rotations.quaternions(each.left))
        title, labels = f"{topic}: attitude, quaternion", "xyzw"
    else:
        measured, fitted = each.measured, each.measured + each.left
        title, labels = f"{topic}: {kind} [{UNITS[kind]}]", "xyz"
    lines = [
        Line(f"{label} {side}", seconds, column, dashed=side == "fitted", color=place)
        for side, rows in (("measured", measured), ("fitted", fitted))
        for place, (label, column) in enumerate(zip(labels, np.asarray(rows, np.float64).T, strict=True))
    ]
    return Panel(title, lines)


def _seconds(each: Predicted) -> Array:
    return np.asarray(each.time_ns * 1e-9, dtype=np.float64)


def _left(each: Predicted) -> Panel:
    topic, kind, _ = each.key
    return Panel(f"{topic}: residual of {kind} [{UNITS[kind]}]", components(_seconds(each), each.left))


def _ellipses(found: Identification) -> list[Section]:
    """Return the pairs of numbers of the body, effects and sensors whose errors are most correlated."""
    names = {each.name for each in found.parameters if each.known}
    absolute = any(name.startswith("inertia.") for name in names)
    shown = [
        k
        for k, each in enumerate(found.parameters)
        if each.known and found.covariance[k, k] > 0.0
        if not each.name.startswith("initial") and not (absolute and each.name.startswith("inertia_ratios"))
    ]
    pairs = sorted(itertools.combinations(shown, 2), key=lambda pair: -abs(_correlation(found.covariance, *pair)))
    if not pairs:
        return []
    pairs = pairs[:_PAIRS]
    text = "The numbers whose errors are most correlated, with the region that holds both in 95 of 100 cases."
    parts = found.parameters
    told = [f"{parts[i].name} and {parts[j].name} {_correlation(found.covariance, i, j):+.2f}" for i, j in pairs]
    figure = Figure(_ellipse_figure(found, pairs), f"Correlations: {', '.join(told)}.")
    return [Section("Ellipses of errors", text, figures=[figure])]


def _correlation(covariance: Array, i: int, j: int) -> float:
    return float(covariance[i, j] / np.sqrt(covariance[i, i] * covariance[j, j]))


def _ellipse_figure(found: Identification, pairs: list[tuple[int, int]]) -> Picture:
    rows = -(-len(pairs) // 3)

    def fill(figure: Canvas, _most: int) -> None:
        for number, (i, j) in enumerate(pairs):
            axes = figure.add_subplot(rows, 3, number + 1)
            curve = _ellipse(found.covariance[np.ix_([i, j], [i, j])])
            one, other = found.parameters[i], found.parameters[j]
            axes.plot(curve[:, 0], curve[:, 1], color=COLORS[2], linewidth=1.3)
            axes.plot([0.0], [0.0], "o", color=COLORS[0], markersize=3.0)
            axes.set_xlabel(_offset(one), color=TEXT)
            axes.set_ylabel(_offset(other), color=TEXT)
            axes.locator_params(nbins=4)
            quiet(axes)

    titles = [f"{found.parameters[i].name}, {found.parameters[j].name}" for i, j in pairs]
    size, columns = (690.0, 215.0 * rows), min(3, len(pairs))
    return picture(fill, size, "Ellipses of errors", titles, layout="constrained", columns=columns)


def _offset(each: Parameter) -> str:
    sign = "+" if each.value < 0.0 else "−"
    return f"{each.name} {sign} {abs(each.value):.4g}" + (f" [{each.unit}]" if each.unit else "")


def _ellipse(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    found: Array = _ELLIPSE * _circle() * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return found


def _circle() -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _ellipsoid(found: Identification) -> list[Section]:
    """Return the ellipsoid of inertia with others as likely, along the body axes."""
    group = next((g for g in ("inertia", "inertia_ratios") if _of(found, g)), "")
    if not group:
        asked = any(each.name.startswith("inertia") for each in found.parameters)
        text = "These recordings do not determine the shape of the inertia."
        return [Section("Ellipsoid of inertia", text)] if asked else []
    at = _of(found, group)
    six = np.array([found.parameters[k].value for k in at])
    covariance = found.covariance[np.ix_(at, at)]
    values, vectors = np.linalg.eigh(covariance)
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, 6)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    here = rows_of(six)
    moments, axes = np.linalg.eigh(here)
    root = axes / np.sqrt(moments)
    apart = float(np.mean([np.linalg.norm(root.T @ rows_of(each) @ root) for each in drawn])) + 1e-300
    magnified = 10.0 ** max(0, math.floor(math.log10(_SEEN / apart) + 0.5))
    others = [here + magnified * rows_of(each) for each in drawn]
    others = [each for each in others if np.linalg.eigvalsh(each)[0] > 0.0]

    reach = 1.05 / float(np.sqrt(min(np.linalg.eigvalsh(each)[0] for each in [here, *others])))

    def fill(figure: Canvas, _most: int) -> None:
        for number, (right, up) in enumerate(_VIEWS):
            canvas = figure.add_axes((number / 3.0 + 0.02, 0.08, 0.30, 0.78))
            plane = ["xyz".index(right), "xyz".index(up)]
            for other in others:
                canvas.plot(*_outline(other, plane).T, color="#808080", linewidth=0.4, alpha=0.6)
            canvas.plot(*_outline(here, plane).T, color=COLORS[1], linewidth=1.6)
            for moment, axis in zip(moments, axes.T, strict=True):
                canvas.plot(*np.outer([-1.0, 1.0], axis[plane] / np.sqrt(moment)).T, color=COLORS[2], linewidth=0.8)
            canvas.set_axis_off()
            canvas.set_aspect("equal")
            canvas.set_xlim(-reach, reach)
            canvas.set_ylim(-reach, reach)
            canvas.set_title(f"{right} to the right, {up} up", color=TEXT, fontsize=11.0)

    caption = (
        "Ellipsoid of inertia, x · I x = 1, in body axes: green; blue its principal axes. Gray: ellipsoids as likely, "
        + (f"their differences {magnified:g} times as large as they are." if magnified > 1.0 else "to scale.")
        + (" Only its shape is determined, not its size." if group == "inertia_ratios" else "")
    )
    view = picture(fill, (690.0, 250.0), "Ellipsoid of inertia with its uncertainty", columns=3)
    return [Section("Ellipsoid of inertia", figures=[Figure(view, caption)])]


def _of(found: Identification, group: str) -> list[int]:
    """Return the places of the six numbers of an inertia, none if one is not known."""
    places = {each.name: k for k, each in enumerate(found.parameters) if each.known}
    at = [places.get(f"{group}.{axis}", -1) for axis in AXES]
    return at if min(at) >= 0 else []


def _outline(inertia: Array, plane: list[int]) -> Array:
    """Return the outline of x . I x = 1 seen along the axis that is not in `plane`."""
    values, vectors = np.linalg.eigh(np.linalg.inv(inertia)[np.ix_(plane, plane)])
    found: Array = _circle() * np.sqrt(values) @ vectors.T
    return found
