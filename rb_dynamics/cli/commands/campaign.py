"""Run a scene many times with dispersed numbers, and print statistics over the runs.

Blocks of runs are computed by dask processes on this machine (extra: scale), or behind --scheduler. Rows are stored as
they are finished: the same command resumes an interrupted campaign, and ends with the same file. Results do not depend
on workers and blocks. --rerun repeats one run alone, with a full log, and compares it with its row. Exit code 1: some
runs could not be completed, or the repeated run differs from its row; runs that miss a requirement do not change it.
"""

from __future__ import annotations

import argparse
import contextlib
from typing import TYPE_CHECKING

from rb_dynamics.cli.parser import require_with
from rb_dynamics.cli.scene_arguments import add_set, overrides_of
from rb_dynamics.numerics.command_line_numbers import whole

if TYPE_CHECKING:
    from pathlib import Path

    from rb_dynamics.study.campaign.block_of_runs import Columns
    from rb_dynamics.study.campaign.model import Campaign
    from rb_dynamics.study.campaign.store import Store
    from rb_dynamics.study.campaign.summary import CampaignSummary

HELP = "run a scene many times with dispersed numbers"

_COUNT = whole("a whole number of 0 or more", lambda value: value >= 0)
_POSITIVE = whole("a whole number of 1 or more", lambda value: value >= 1)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `campaign`."""
    parser.add_argument("campaign", metavar="CAMPAIGN", help="campaign file (YAML)")
    parser.add_argument("--runs", type=_POSITIVE, metavar="N", help="number of runs, instead of the campaign's")
    parser.add_argument("--seed", type=_COUNT, metavar="N", help="seed, instead of the campaign's")
    add_set(
        parser,
        "override any key of the scene, such as duration=60 or actuators.wheel_x.max_torque=0.002, or of the campaign, "
        "such as control.delay=0.1; may be repeated",
    )
    parser.add_argument("--out", metavar="F", help="Parquet file for the rows; default: out/<name>.parquet")
    parser.add_argument("--html", metavar="F", help="page of the results; default: beside the rows (extra: plot)")
    parser.add_argument("--overwrite", action="store_true", help="start again and replace existing rows")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="dask scheduler of a cluster, such as tcp://host:8786")
    where.add_argument(
        "--workers",
        type=_COUNT,
        metavar="N",
        help="processes on this machine; 0: threads of this process; default: one per core, or 0 if that is faster",
    )
    parser.add_argument("--block", type=_POSITIVE, metavar="N", help="runs in a block; default: chosen")
    parser.add_argument("--rerun", type=_COUNT, metavar="RUN", help="repeat this run alone, with a full log")
    parser.add_argument("--mcap", metavar="F", help="log of --rerun; default: out/<name>-RUN.mcap")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object, floats in full")


def run(args: argparse.Namespace) -> int:
    """Run and print; exit code 0, or 1 if a run could not be completed or differs from its row."""
    from pathlib import Path

    from rb_dynamics.errors import LogError
    from rb_dynamics.study.campaign.read import read_campaign

    require_with(args, "--mcap", bool(args.mcap), "--rerun", args.rerun is not None)
    overrides = overrides_of(args)
    overrides |= {name: value for name in ("runs", "seed") if (value := getattr(args, name)) is not None}
    campaign = read_campaign(args.campaign, overrides)
    out = Path(args.out or Path("out", f"{Path(args.campaign).stem}.parquet"))
    if out.suffix.lower() != ".parquet":
        raise LogError(f"--out {out}: expected a name that ends in .parquet, as rows are written as Parquet")
    return _run_again(args, campaign, out) if args.rerun is not None else _run_all(args, campaign, out)


def _run_all(args: argparse.Namespace, campaign: Campaign, out: Path) -> int:
    from rb_dynamics.cli.output import prepare
    from rb_dynamics.study.campaign.read import files_of
    from rb_dynamics.study.campaign.store import Store

    rows, page = [str(out), str(out.with_suffix(".json"))], str(_page(args, out))
    # The name that was given comes first: nothing is made beside it if it cannot be.
    prepare([page, *rows] if args.html else [*rows, page], *files_of(campaign))
    with contextlib.closing(Store(out, campaign, args.overwrite)) as store:
        return _fly(args, campaign, store)


def _fly(args: argparse.Namespace, campaign: Campaign, store: Store) -> int:
    """Run what `store` does not have yet, and print statistics over all rows."""
    import json

    from rb_dynamics.cli.output import counting, note, show, written_page
    from rb_dynamics.formats.output_file import OutputFile
    from rb_dynamics.study.campaign.engine import goes_alone, run_campaign
    from rb_dynamics.study.campaign.loop_stability import remarks
    from rb_dynamics.study.campaign.store import read_rows
    from rb_dynamics.study.campaign.summary import as_text, summarise

    out = store.path
    if store.done:
        note(f"{store.done} of {campaign.runs} runs are on disk already")
    for remark in remarks(campaign):
        note(remark)
    if goes_alone(campaign):
        note(
            "these runs go one by one, some hundred times slower than side by side; docs/campaigns.md says which "
            "scenes go so: as a rule, under a law, those with a solver.step of which all delays are whole multiples "
            "(step: in the distribution), or with reaction wheels, and without rotors and scheduled wrenches"
        )
    with counting(args.campaign, "run", store.done, campaign.runs) as progress:
        run_campaign(
            campaign, store, workers=args.workers, scheduler=args.scheduler, block=args.block, progress=progress
        )
    rows = read_rows(out)
    summary = summarise(campaign, rows)
    found = summary.as_dict()
    with OutputFile.whole(out.with_suffix(".json")) as file:
        file.write(json.dumps(found, allow_nan=False).encode())
    show(args, lambda: found, lambda: as_text(campaign, summary, _options(args), str(out)))
    page = _write_page(args, campaign, rows, out, summary)
    if not args.json:
        for path in (out, out.with_suffix(".json")):
            print(f"wrote {path}")
        if page is not None:
            print(written_page(str(page)))
    return 1 if summary.errors else 0


def _options(args: argparse.Namespace) -> list[str]:
    """Return the words of the command line that --rerun also needs, to repeat the same run and find its row."""
    given = {name: getattr(args, name) for name in ("runs", "seed", "out")}
    words = [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]
    return [*words, *(word for each in args.set for word in ("--set", each))]


def _page(args: argparse.Namespace, out: Path) -> Path:
    from pathlib import Path

    return Path(args.html) if args.html else out.with_suffix(".html")


def _write_page(
    args: argparse.Namespace, campaign: Campaign, rows: Columns, out: Path, summary: CampaignSummary
) -> Path | None:
    """Write the page; unless it was requested, missing libraries are only a note."""
    from rb_dynamics.cli.output import note
    from rb_dynamics.errors import MissingExtraError
    from rb_dynamics.report.campaign_page import campaign_report
    from rb_dynamics.report.html import write_html

    page = _page(args, out)
    try:
        write_html(page, campaign_report(campaign, rows, _options(args), summary))
    except MissingExtraError as error:
        if args.html:
            raise
        note(f"no page: {error}")
        return None
    return page


def _run_again(args: argparse.Namespace, campaign: Campaign, out: Path) -> int:
    from pathlib import Path

    from rb_dynamics.cli.output import note, prepare, show
    from rb_dynamics.study.campaign.read import files_of
    from rb_dynamics.study.campaign.repeated_run import rerun

    log = Path(args.mcap or out.with_name(f"{out.stem}-{args.rerun}.mcap"))
    prepare([str(log)], str(out), *files_of(campaign))
    found = rerun(campaign, args.rerun, log, out)
    show(args, found.as_dict, found.as_text)
    if found.row is None:
        note(f"no row of run {args.rerun} in {out} to compare with")
    return 1 if found.differs or found.error else 0
