"""Print results as JSON or text, and progress: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    import argparse

    from rb_dynamics.logs.wrench_bags import RecordedWrenches
    from rb_dynamics.report.html import Report
    from rb_dynamics.run.simulate import Run
    from rb_dynamics.scene.model import Scene
    from rb_dynamics.study.covariance import Covariance

_TELL_S = 10.0
"""Least time between two lines of progress."""

# Less than this part of the largest is rounding.
_NOTHING = 1e-9


def as_dict(run: Run, spread: Covariance | None = None) -> dict[str, Any]:
    """Return plain values for JSON; floats in full precision can be read back to the same bits."""
    sample = _known(run)
    facts = {**sample, "method": run.method, "steps": run.steps, "wall_time_s": run.wall_time_s}
    if spread is not None:
        facts["uncertainty"] = spread.as_dict()
    return facts


def as_text(run: Run, spread: Covariance | None = None) -> str:
    """Return the final state and the balances as text, and how uncertain the motion is."""
    from rb_dynamics.run.sample import told_speed, unit_of

    sample = _known(run)
    if speeds := sample.get("wheel_speeds"):
        rate = max(map(abs, run.sample.angular_velocity_body))
        sample["wheel_speeds"] = tuple(told_speed(speed, rate) for speed in speeds)
    seconds = sample.pop("time_ns") / 1e9
    steps = f"{run.steps} step{'' if run.steps == 1 else 's'}"
    lines = [f"after {seconds:.9g} s: {steps} of {run.method} in {run.wall_time_s:.3g} s of computing"]
    for name, value in sample.items():
        numbers = value if isinstance(value, tuple) else (value,)
        lines.append(f"  {name:30}{''.join(f'{number:>18.9g}' for number in numbers)}  {unit_of(name)}".rstrip())
    return "\n".join([*lines, *(_spread_lines(spread) if spread is not None else ())])


def _spread_lines(spread: Covariance) -> Iterator[str]:
    """Yield how the standard deviations grow, what they come from, and how far that is true."""
    from rb_dynamics.study.covariance import QUANTITIES

    labels = [
        f"{name.removesuffix('_body').removesuffix('_world').replace('_', ' ')} [{unit}]"
        for name, unit in QUANTITIES.items()
    ]
    yield ""
    yield "standard deviations by linear growth, along the worst axis"
    yield f"{'t [s]':>14}" + "".join(f"{label:>26}" for label in labels)
    last = len(spread.time_ns) - 1
    columns = [spread.largest(name) for name in QUANTITIES]
    for at in sorted({round(last * k / 6) for k in range(7)}):
        yield f"{spread.time_ns[at] / 1e9:14.6g}" + "".join(f"{column[at]:26.4g}" for column in columns)
    yield "at the end, from each alone"
    for name, sigma, row in zip(spread.names, spread.sigmas, spread.alone.tolist(), strict=True):
        if sigma == 0.0:
            continue
        sizes = zip(row, QUANTITIES.values(), spread.alone.max(axis=0), strict=True)
        yield f"  {name} +- {sigma:.4g}: " + (
            ", ".join(f"{size:.4g} {unit}" for size, unit, most in sizes if size > _NOTHING * most) or "nothing"
        )
    if spread.exact:
        yield f"not determined by the fit, and taken as exact: {', '.join(spread.exact)}"
    flown = "flights that are one standard deviation off"
    if spread.linear_until_ns is None:
        yield f"linear: {flown} depart from this by at most {100.0 * spread.departure:.3g} % of it"
        return
    size = f"by up to {100.0 * spread.departure:.3g} % of it" if spread.departure < 10.0 else "altogether"
    if spread.departure == float("inf"):
        yield "NOT LINEAR: a body that is one standard deviation off cannot exist; a campaign shows the true spread"
    else:
        yield (
            f"NOT LINEAR from t = {spread.linear_until_ns / 1e9:.6g} s on: {flown} depart from this {size}; a campaign "
            "shows the true spread"
        )


def _known(run: Run) -> dict[str, Any]:
    """Return the fields of the sample; a potential energy only if an effect has one."""
    return {name: value for name, value in asdict(run.sample).items() if value is not None}


def say(text: str) -> None:
    """Print `text`; characters that the terminal lacks are escaped."""
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)


def show(args: argparse.Namespace, as_dict: Callable[[], object], as_text: Callable[[], str]) -> None:
    """Print a result as text, or with `--json` as one JSON object."""
    say(json.dumps(as_dict(), allow_nan=False) if args.json else as_text())


def note_of(args: argparse.Namespace) -> TextIO:
    """Return where to print what was written: with `--json`, stdout has only one JSON object."""
    return sys.stderr if args.json else sys.stdout


def prepare(written: Iterable[str | None], *inputs: str | None) -> None:
    """Make the folders of the files to write.

    Raises:
        LogError: two are the same file, or one would replace an input.
    """
    from pathlib import Path

    from rb_dynamics.formats.output_file import make_folder, require_apart, require_other

    names = [*filter(None, written)]
    require_apart(names)
    for name in names:
        require_other(name, *filter(None, inputs))
        if not _in_viewer(name):
            make_folder(Path(name))


def write_page(args: argparse.Namespace, report: Report) -> None:
    """Write the page of `--html`, and say so."""
    from rb_dynamics.report.html import write_html

    write_html(args.html, report)
    print(written_page(args.html), file=note_of(args))


def _in_viewer(name: str) -> bool:
    return name == "spawn" or "://" in name


def written(name: str) -> str:
    """Return the message about a finished output: a file, or what a viewer shows."""
    return "shown in the Rerun viewer" if _in_viewer(name) else f"wrote {name}"


def written_page(name: str) -> str:
    """Return the message about a finished page with figures, and whether they are interactive."""
    from rb_dynamics.report.interactive_plots import EXTRA, library

    interactive = f"pip install 'rb_dynamics[{EXTRA}]', or '.[{EXTRA}]' in the source tree, makes them interactive"
    return written(name) + ("" if library() else f"; its figures are pictures: {interactive}")


def note(text: str) -> None:
    """Print a note on stderr."""
    print(f"note: {text}", file=sys.stderr, flush=True)


def warn(text: str) -> None:
    """Print a warning on stderr."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


def note_coasting(scene: Scene) -> None:
    """Note on stderr that nothing acts, if the scene has channels."""
    if scene.channels and not scene.effects and "wrenches" in scene.text and scene.past is None:
        topics = ", ".join(channel.topic for channel in scene.channels)
        note(f"no commands on {topics}: the body coasts; give a bag of commands with --wrench")


def note_open_end(scene: Scene) -> None:
    """Note on stderr that the bits are not those of a log without a duration."""
    from rb_dynamics.run.plan import OPEN_END_HORIZON

    note(
        f"{scene.source} is of a run without a duration, whose accuracy was for {OPEN_END_HORIZON:g} s; here it is for "
        f"the {scene.duration:.9g} s of the log, so the last digits may differ: replay has the bits of the log"
    )


def note_remarks(scene: Scene) -> None:
    """Note on stderr what is known to be wrong before the run."""
    from rb_dynamics.run.scene_remarks import scene_remarks

    for remark in scene_remarks(scene):
        note(remark)


def note_start(commands: RecordedWrenches) -> None:
    """Print on stderr which time of the bags is time 0 of the run, if it is not that of the stamps."""
    for remark in commands.notes:
        note(remark)


def warn_outside(commands: RecordedWrenches, scene: Scene) -> None:
    """Warn on stderr of commands before the start of the run, and after its end."""
    if commands.superseded:
        warn(commands.superseded_words)
    if commands.prolonged and scene.past is None:
        warn(
            f"{', '.join(commands.prolonged)}: the last command before time 0 acts for the whole timeout from there "
            "on, and not from its own time; let the run begin with it by --wrench-start first, or between two"
        )
    slow = [each.topic for each in scene.channels if each.topic in commands.early and (each.delay or each.lag)]
    if slow and scene.past is None:
        warn(
            f"{', '.join(slow)}: commands before time 0 count as received then, so delay and lag begin at time 0; let "
            "the run begin with the first by --wrench-start first"
        )
    if commands.late and commands.first_ns is not None:
        first = commands.first_ns / 1e9
        clocks = (
            "; their times are of another clock than those of the others, as of Wrench, which has no stamp, beside "
            "WrenchStamped in simulation time; record both with stamps of one clock"
        )
        warn(
            f"{commands.late} of {len(commands)} commands lie after the end of the run at {scene.duration:g} s and "
            f"have no effect (the first of all is at simulation time {first:.9g} s)"
            f"{clocks if commands.two_clocks else ''}"
        )


def warn_rejected(run: Run, commands: int) -> None:
    """Warn on stderr of rejected commands, with the reason for the first, and of clipped ones."""
    if run.rejected:
        rejected = f"{len(run.rejected)} of {commands} commands were rejected and had no effect"
        warn(f"{rejected}; the first: {run.rejected[0]}")
    if run.clipped:
        of = ", ".join(f"{topic} ({count})" for topic, count in sorted(run.clipped_on.items()))
        note(f"{run.clipped} of {commands} commands were clipped to the limits of their channel or actuator: {of}")


@contextlib.contextmanager
def progress(what: str) -> Iterator[Callable[[float], None] | None]:
    """Yield a function that shows the fraction done as a bar on a terminal; yield None in a pipe or without tqdm."""
    with _bar(
        desc=what, total=100, unit="%", bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    ) as move:
        yield None if move is None else lambda fraction: move(round(100.0 * fraction))


@contextlib.contextmanager
def counting(what: str, unit: str, done: int, total: int) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of (done, total) that also shows units per second and the time left; elsewhere by lines."""
    with _bar(desc=what, total=total, unit=unit, initial=done, smoothing=0.1) as move:
        yield _lines(what, unit, done) if move is None else lambda done, _: move(done)


def _lines(what: str, unit: str, first: int) -> Callable[[int, int], None]:
    begun = told = time.monotonic()

    def tell(done: int, total: int) -> None:
        nonlocal told
        now = time.monotonic()
        if first < done < total and now - told >= _TELL_S:
            told, passed = now, now - begun
            left = passed * (total - done) / (done - first)
            print(f"{what}: {done} of {total} {unit}s after {passed:.0f} s, some {left:.0f} s left", file=sys.stderr)

    return tell


@contextlib.contextmanager
def _bar(**options: Any) -> Iterator[Callable[[int], None] | None]:
    """Yield a function that moves a bar of tqdm with these `options` to a position."""
    if not sys.stderr.isatty():
        yield None
        return
    try:
        from tqdm import tqdm
    except ImportError:
        yield None
        return
    with tqdm(leave=False, **options) as bar:
        yield lambda place: bar.update(place - bar.n)
