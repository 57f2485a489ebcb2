"""Campaigns on the command line and on workers give the same file."""

from __future__ import annotations

import html
import json
import math
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import CAMPAIGN, SCENE, write

from rb_dynamics.cli import main
from rb_dynamics.errors import LogError
from rb_dynamics.formats.log_metadata import RESULT, RUN
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.study.campaign import engine
from rb_dynamics.study.campaign.block_of_runs import simulate_block
from rb_dynamics.study.campaign.engine import goes_alone, goes_side_by_side, run_campaign, simulate_on_worker
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.repeated_run import SingleRun
from rb_dynamics.study.campaign.store import Store, read_row, read_rows

pytest.importorskip("pyarrow")
pytestmark = pytest.mark.filterwarnings("default::DeprecationWarning")

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))


@pytest.fixture
def _no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Omit the page, which takes thirty times as long as the runs; test_summary.py tests it."""
    monkeypatch.setattr("rb_dynamics.cli.commands.campaign._write_page", lambda *_: None)


def fly(campaign: Path, out: Path, **arguments: Any) -> bytes:
    read = read_campaign(campaign)
    run_campaign(read, Store(out, read), **{"workers": 0, **arguments})
    return out.read_bytes()


def test_the_file_does_not_depend_on_blocks(tmp_path: Path) -> None:
    campaign = write(tmp_path)
    whole = fly(campaign, tmp_path / "whole.parquet")
    for block in (1, 7, 24):
        assert fly(campaign, tmp_path / f"{block}.parquet", block=block) == whole
    rows = read_rows(tmp_path / "whole.parquet")
    assert rows["run"].tolist() == list(range(24))
    assert set(rows["seed"].tolist()) == {7}
    assert not Path(f"{tmp_path / 'whole.parquet'}.parts").exists()


def test_one_that_was_interrupted_goes_on(tmp_path: Path) -> None:
    class StoppedError(Exception):
        pass

    def stop(done: int, _: int) -> None:
        if done >= 12:
            raise StoppedError

    campaign, out = write(tmp_path), tmp_path / "broken.parquet"
    with pytest.raises(StoppedError):
        fly(campaign, out, block=5, progress=stop)
    seen: list[int] = []
    again = fly(campaign, out, block=4, progress=lambda done, _: seen.append(done))

    assert seen == [19, 23, 24]
    assert again == fly(campaign, tmp_path / "whole.parquet")
    fly(campaign, out, progress=lambda done, _: seen.append(done))
    assert seen == [19, 23, 24]


def test_a_campaign_of_one_block_tells_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_TELL_S", 0.0)
    seen: list[int] = []

    fly(write(tmp_path), tmp_path / "rows.parquet", block=24, progress=lambda done, _: seen.append(done))

    assert len(set(seen)) > 5
    assert seen == sorted(seen)
    assert seen[-1] == 24


@pytest.mark.parametrize(("full_at", "place"), [(12, r"broken\.parquet\.parts"), (24, r"broken\.parquet")])
def test_a_full_disk_keeps_what_is_on_it(tmp_path: Path, full_at: int, place: str) -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(done: int, _: int) -> None:
        if done >= full_at:
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))

    campaign, out = write(tmp_path), tmp_path / "broken.parquet"
    try:
        with pytest.raises(
            LogError, match=rf"^cannot write (to )?\S+/{place}: .*File too large; make room and run again$"
        ):
            fly(campaign, out, block=6, progress=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.rglob("*.new"))
    assert Store(out, read_campaign(campaign)).done == full_at
    assert fly(campaign, out) == fly(campaign, tmp_path / "whole.parquet")


def test_runs_in_turn_do_not_go_alone() -> None:
    rotor = read_campaign(ROOT / "config" / "campaigns" / "rotor.yaml")
    assert not goes_side_by_side(rotor)
    assert not goes_alone(rotor)


def test_few_runs_start_no_other_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def start(*_: object) -> None:
        raise AssertionError("workers were started")

    monkeypatch.setattr("rb_dynamics.study.campaign.engine._on_workers", start)
    assert len(fly(write(tmp_path), tmp_path / "rows.parquet", workers=2)) > 0


def test_runs_that_stay_in_plain_python_say_once_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    campaign = write(tmp_path)
    monkeypatch.setattr(engine, "_PLAIN_S", 0.0)
    for names, told in (([], 0), (["lanes_rk4", "_rates"], 1)):
        monkeypatch.setattr(engine, "waited_for", lambda names=names: names)
        fly(campaign, tmp_path / f"{told}.parquet", block=6)
        assert [record.getMessage().count("`rb-dynamics compile _rates lanes_rk4`") for record in caplog.records] == (
            [1] * told
        )


@pytest.mark.parametrize(("start_s", "elsewhere"), [(math.inf, []), (0.0, [(6, 12), (12, 18), (18, 24)])])
def test_workers_are_started_where_that_is_sooner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start_s: float, elsewhere: list[tuple[int, int]]
) -> None:
    """Without a given number of workers, the time of the first block decides."""
    pytest.importorskip("distributed")
    flown: list[tuple[int, int]] = []

    def note(campaign: Campaign, blocks: Iterator[tuple[int, int]], *_: object) -> Iterator[Any]:
        for block in blocks:
            flown.append(block)
            yield simulate_block(campaign, *block)

    monkeypatch.setattr("rb_dynamics.study.campaign.engine._on_workers", note)
    monkeypatch.setattr("rb_dynamics.study.campaign.engine._START_S", start_s)
    monkeypatch.setattr("rb_dynamics.study.campaign.engine.cores", lambda: 4)
    campaign = write(tmp_path)
    rows = fly(campaign, tmp_path / "rows.parquet", workers=None, block=6)
    assert flown == elsewhere
    assert rows == fly(campaign, tmp_path / "here.parquet")


def test_runs_of_another_campaign_are_not_mixed(tmp_path: Path) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    fly(campaign, out)
    write(tmp_path, CAMPAIGN.replace("seed: 7", "seed: 8"))
    with pytest.raises(LogError, match=r"another campaign: seed is 7 there and 8 here; .* --overwrite to start again"):
        fly(campaign, out)
    read = read_campaign(campaign)
    assert not Store(out, read, overwrite=True).complete


def changed(text: str) -> str:
    """Swap two dispersed inputs, so that each gets the other's random numbers."""
    first, second = "  body.mass: {uniform: {low: 1.5, high: 2.5}}\n", "  initial.orientation: any\n"
    assert first in text
    return text.replace(first, "").replace(second, second + first)


@pytest.mark.parametrize(
    ("text", "scene", "message"),
    [
        (CAMPAIGN.replace("deviation: 0.2", "deviation: 0.3"), SCENE, r"deviation is 0.2 there and 0.3 here; "),
        (CAMPAIGN, SCENE.replace("mass: 2.0", "mass: 2.1"), r"scene.body.mass is 2 there and 2.1 here; "),
        (CAMPAIGN.replace("scene.yaml\n", "scene.yaml\nset: {duration: 1}\n"), SCENE, r": scene.duration is 2 there"),
        (CAMPAIGN.replace("gain: 1.0}\n", "gain: 1.0}\nobserve_rate: 2\n"), SCENE, r"observe_rate is absent"),
        (changed(CAMPAIGN), SCENE, "the keys are in another order; "),
    ],
)  # fmt: skip
def test_what_differs_is_said(tmp_path: Path, text: str, scene: str, message: str) -> None:
    out = tmp_path / "rows.parquet"
    Store(out, read_campaign(write(tmp_path)))
    with pytest.raises(LogError, match=message):
        Store(out, read_campaign(write(tmp_path, text, scene)))


def test_words_of_the_file_do_not_count(tmp_path: Path) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    fly(campaign, out)
    read = read_campaign(write(tmp_path, "# Said better.\n" + CAMPAIGN.replace("runs: 24", "runs: 2.4e+1")))
    assert Store(out, read).complete


def test_rows_of_no_campaign(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({"run": [1]}), tmp_path / "rows.parquet")
    with pytest.raises(LogError, match=r"found no facts of a campaign in .*rows.parquet, expected its rows; give an"):
        fly(write(tmp_path), tmp_path / "rows.parquet")


@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_a_campaign_grows(tmp_path: Path, sampling: str) -> None:
    campaign, out = write(tmp_path, CAMPAIGN.replace("random", sampling)), tmp_path / "rows.parquet"
    whole = fly(campaign, tmp_path / "whole.parquet")

    def grow(runs: int) -> list[int]:
        seen: list[int] = []
        read = read_campaign(campaign, {"runs": runs} if runs < 24 else {})
        run_campaign(read, Store(out, read), workers=0, block=10, progress=lambda done, _: seen.append(done))
        return seen

    assert grow(11) == [10, 11]
    assert grow(24) == [21, 24]
    assert out.read_bytes() == whole
    with pytest.raises(
        LogError, match=r"holds rows up to run 23 of this campaign, which has 11 runs now; give at leas"
    ):
        grow(11)
    assert out.read_bytes() == whole


def test_growing_rows_keep_whose_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a kill when the finished file has become a block, another campaign must not continue from it."""

    class KilledError(Exception):
        pass

    def killed(source: Path, target: Path) -> None:
        replace(source, target)
        if Path(target).name.startswith("runs-"):
            raise KilledError

    campaign, out, replace = write(tmp_path), tmp_path / "rows.parquet", os.replace
    read = read_campaign(campaign, {"runs": 11})
    run_campaign(read, Store(out, read), workers=0)
    with monkeypatch.context() as patched:
        patched.setattr("rb_dynamics.study.campaign.store.os.replace", killed)
        with pytest.raises(KilledError):
            Store(out, read_campaign(campaign))
    assert not out.exists()
    with pytest.raises(LogError, match="seed is 7 there and 8 here"):
        Store(out, read_campaign(campaign, {"seed": 8}))
    assert fly(campaign, out) == fly(campaign, tmp_path / "whole.parquet")


def test_rows_that_were_filtered_or_sorted_are_not_taken_by_their_place(tmp_path: Path) -> None:
    """A filtered file was counted as the first runs; a rerun was compared with the row of another run."""
    import pyarrow as pa
    from pyarrow import compute, parquet

    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    fly(campaign, out)
    whole = parquet.read_table(out)
    changed = {
        "holds run 2 in row 1, expected the runs 0 to 22 in order": whole.filter(compute.field("run") != 1),
        "holds run 23 in row 0, expected the runs 0 to 23 in order": whole.sort_by([("run", "descending")]),
        "holds run 0 in row 1, expected the runs 0 to 24 in order": pa.concat_tables([whole.slice(0, 1), whole]),
    }
    for message, table in changed.items():
        parquet.write_table(table, out)
        with pytest.raises(LogError, match=message):
            Store(out, read_campaign(campaign))
        row = read_row(out, 3)
        assert row is not None
        assert row["run"] == 3
        assert row["final_rate"] == whole["final_rate"][3].as_py()
    parquet.write_table(whole.drop_columns("run"), out)
    with pytest.raises(LogError, match=r"cannot read .*rows.parquet: .*run.*; check the path|expected the rows of a "):
        Store(out, read_campaign(campaign))


def test_a_block_removed_while_others_are_flown_is_missed(tmp_path: Path) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    read = read_campaign(campaign)
    store = Store(out, read)

    def remove(done: int, _: int) -> None:
        if done == 24:
            Path(f"{out}.parts", "runs-000000000008-000000000016.parquet").unlink()

    with pytest.raises(LogError, match=r"the rows of the runs 8 to 15 were removed from .*rows.parquet.parts after"):
        run_campaign(read, store, workers=0, block=8, progress=remove)
    store.close()
    assert fly(campaign, out) == fly(campaign, tmp_path / "whole.parquet")


def test_blocks_left_beside_a_complete_file_go(tmp_path: Path) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    whole, left = fly(campaign, out), Path(f"{out}.parts")
    left.mkdir()
    (left / "runs-000000000000-000000000024.parquet").write_bytes(whole)
    assert fly(campaign, out) == whole
    assert not left.exists()


def interrupted(campaign: Path, out: Path, block: int = 7) -> Path:
    """Fly all but the last block; return the folder of the parts."""
    read = read_campaign(campaign)
    store = Store(out, read)
    for first, last in list(store.missing(block))[:-1]:
        store.write(simulate_block(read, first, last))
    return Path(f"{out}.parts")


@pytest.mark.usefixtures("_no_page")
def test_one_process_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    arguments = ["campaign", str(campaign), "--out", str(out), "--workers", "0"]
    code = f"import sys, time\nfrom rb_dynamics.study.campaign.lock import lock\nlock({str(out)!r})\n"
    with process(tmp_path, sys.executable, "-c", code + "print('locked', flush=True)\ntime.sleep(60)") as other:
        wait_for("the lock", lambda: "locked" in (tmp_path / "log.txt").read_text())
        for more in ([], ["--overwrite"]):
            assert main([*arguments, *more]) == 2
            error = capsys.readouterr().err
            assert f"{out} is being written by process {other.pid} on {platform.node()}; wait until it is d" in error
        assert not Path(f"{out}.parts").exists()
        other.kill()
        other.wait()
        assert main(arguments) == 0
    assert not Path(f"{out}.lock").exists()
    assert out.read_bytes() == fly(campaign, tmp_path / "whole.parquet")


def test_no_output_replaces_an_input_or_another_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    scene = tmp_path / "scene.yaml"
    before = campaign.read_text(), scene.read_text()
    arguments = ["campaign", str(campaign), "--out", str(out), "--workers", "0"]
    for read in (campaign, scene):
        for more in (["--html", str(read)], ["--rerun", "0", "--mcap", str(read)]):
            assert main([*arguments, *more]) == 2
            assert "is, or holds, what is read" in capsys.readouterr().err
    assert (campaign.read_text(), scene.read_text()) == before
    for page in (out, out.with_suffix(".json")):
        assert main([*arguments, "--html", str(page)]) == 2
        assert "more than once, expected a file of its own" in capsys.readouterr().err


def test_a_store_that_is_held_here(tmp_path: Path) -> None:
    read = read_campaign(write(tmp_path))
    held = Store(tmp_path / "rows.parquet", read)
    with pytest.raises(LogError, match=f"is being written by process {os.getpid()} on "):
        Store(tmp_path / "rows.parquet", read)
    held.close()
    Store(tmp_path / "rows.parquet", read)


def copied(parts: Path) -> None:
    shutil.copy(parts / "runs-000000000000-000000000007.parquet", parts / "runs-000000000003-000000000010.parquet")


def renamed(parts: Path) -> None:
    (parts / "runs-000000000014-000000000021.parquet").rename(parts / "runs-000000000014-000000000023.parquet")


def moved(parts: Path) -> None:
    (parts / "runs-000000000014-000000000021.parquet").rename(parts / "runs-000000000015-000000000022.parquet")


def truncated(parts: Path) -> None:
    path = parts / "runs-000000000007-000000000014.parquet"
    path.write_bytes(path.read_bytes()[:-100])


def flipped(parts: Path) -> None:
    path = parts / "runs-000000000007-000000000014.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 1
    path.write_bytes(data)


def emptied(parts: Path) -> None:
    (parts / "campaign.json").write_bytes(b"")


def no_mapping(parts: Path) -> None:
    (parts / "campaign.json").write_text("[1, 2]")


def no_texts(parts: Path) -> None:
    (parts / "campaign.json").write_text('{"campaign": 1, "scene": null, "version": []}')


def no_campaign(parts: Path) -> None:
    (parts / "campaign.json").write_text('{"campaign": "[", "scene": "1", "version": "1"}')


def binary(parts: Path) -> None:
    (parts / "campaign.json").write_bytes(b"\xff\xfe\0")


def removed(parts: Path) -> None:
    (parts / "campaign.json").unlink()


@pytest.mark.usefixtures("_no_page")
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (copied, r"runs-0+-0+7.parquet and runs-0+3-0+10.parquet in .*.parts both hold run 3; remove one of them, "),
        (renamed, r"0+14-0+23.parquet holds 7 of the runs 14 to 20, expected all of 14 to 22 as its name says; remove"),
        (moved, r"runs-0+15-0+22.parquet holds 7 of the runs 14 to 20, expected all of 15 to 21 as its name says"),
        (truncated, r"cannot read .*/runs-0+7-0+14.parquet: .*; it is damaged, remove the file, so that its runs are "),
        (flipped, r"cannot read .*/runs-0+7-0+14.parquet: .*; it is damaged, remove the file, so that its runs are "),
        (emptied, r"cannot read .*/campaign.json: .*; it is damaged, give another file with --out, or --overwrite to"),
        (binary, r"cannot read .*/campaign.json: .*; it is damaged, give another file with --out, or --overwrite to"),
        (no_mapping, r"found no facts of a campaign in .*.parts, expected its rows; give another"),
        (no_texts, r"what .*.parts says of its campaign is damaged .*; give another"),
        (no_campaign, r"what .*.parts says of its campaign is damaged .*; give another"),
        (removed, r"found rows in .*.parts, but no campaign.json that says of which campaign; give another"),
    ],
)
def test_damaged_parts_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Any, message: str
) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    damage(interrupted(campaign, out))
    arguments = ["campaign", str(campaign), "--out", str(out), "--workers", "0"]
    assert main(arguments) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert re.search(message, error), error
    assert not out.exists()
    assert main([*arguments, "--overwrite"]) == 0
    assert out.read_bytes() == fly(campaign, tmp_path / "whole.parquet")


@pytest.mark.usefixtures("_no_page")
@pytest.mark.parametrize("more", [[], ["--runs", "30"], ["--rerun", "5"]])
def test_damaged_rows_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]) -> None:
    """A bit in a number would give other statistics, in silence."""
    parquet = pytest.importorskip("pyarrow.parquet")
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    data = bytearray(fly(campaign, out))
    rows, group = parquet.read_table(out), parquet.read_metadata(out).row_group(0)
    column = group.column(rows.column_names.index("worst_energy"))
    data[column.data_page_offset + column.total_compressed_size - 5] ^= 1
    out.write_bytes(data)
    assert parquet.read_table(out) != rows
    assert main(["campaign", str(campaign), "--out", str(out), "--workers", "0", *more]) == 2
    assert "rb-dynamics: cannot read" in capsys.readouterr().err


def test_a_damaged_part_that_is_removed_is_flown_again(tmp_path: Path) -> None:
    campaign, out = write(tmp_path), tmp_path / "rows.parquet"
    parts = interrupted(campaign, out)
    truncated(parts)
    (parts / "runs-000000000007-000000000014.parquet").unlink()
    assert fly(campaign, out) == fly(campaign, tmp_path / "whole.parquet")


def test_what_is_written_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def noted_fsync(descriptor: int) -> None:
        name = Path(os.readlink(f"/proc/self/fd/{descriptor}")).name
        done.append(f"disk {re.sub('[.][0-9a-f]+[.][0-9]+[.][0-9a-f]+[.]part', '.part', name)}")
        fsync(descriptor)

    def noted_replace(source: Path, target: Path) -> None:
        done.append(f"name {Path(target).name}")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(os, "replace", noted_replace)
    interrupted(write(tmp_path), tmp_path / "rows.parquet", 12)
    part = "runs-000000000000-000000000012.parquet"
    assert done == [
        f"{step} {name}"
        for file in ("campaign.json", part)
        for step, name in (
            ("disk", f".{Path(file).stem}.part{Path(file).suffix}"),
            ("name", file),
            ("disk", "rows.parquet.parts"),
        )
    ]


def test_a_latin_hypercube_does_not_grow(tmp_path: Path) -> None:
    campaign, out = write(tmp_path, CAMPAIGN.replace("random", "latin_hypercube")), tmp_path / "rows.parquet"
    fly(campaign, out)
    more = read_campaign(campaign, {"runs": 30})
    with pytest.raises(LogError, match=r"runs is 24 there and 30 here; a Latin hypercube .* with another --seed "):
        Store(out, more)


def test_rows_in_many_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rb_dynamics.study.campaign.store.ROWS", 10)
    campaign = write(tmp_path)
    assert fly(campaign, tmp_path / "a.parquet", block=3) == fly(campaign, tmp_path / "b.parquet", block=24)
    found = [read_row(tmp_path / "a.parquet", run) for run in range(25)]
    assert [None if row is None else row["run"] for row in found] == [*range(24), None]
    read = read_campaign(campaign, {"runs": 17})
    run_campaign(read, Store(tmp_path / "c.parquet", read), workers=0)
    assert fly(campaign, tmp_path / "c.parquet") == (tmp_path / "a.parquet").read_bytes()


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "rb_dynamics", "campaign", *map(str, arguments)]


def test_a_table_of_another_kind_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rows.csv"
    assert main(["campaign", str(write(tmp_path)), "--workers", "0", "--out", str(out)]) == 2
    assert f"--out {out}: expected a name that ends in .parquet" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.usefixtures("_no_page")
def test_the_command_and_a_rerun(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = SCENE.replace("body:\n", "body:\n  frame: bus\n")
    campaign, out = write(tmp_path, scene=scene), tmp_path / "out" / "rows.parquet"
    assert main(["campaign", str(campaign), "--workers", "0", "--out", str(out), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["runs"] == 24
    assert summary == json.loads(out.with_suffix(".json").read_text())

    failed = summary["failed"][0]
    assert main(["campaign", str(campaign), "--rerun", str(failed), "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["same_as_row"] is True
    assert found["metrics"]["final_rate"] == read_rows(out)["final_rate"][failed]
    # What was flown is in the log, and it alone gives the same run again.
    assert main(["replay", found["log"]]) == 0
    assert "the same to the last bit" in capsys.readouterr().out
    # It says which run it is, and in which axes the controller commands.
    log = read_bag(found["log"])
    assert log.metadata[RUN]["scene_file"] == f"campaign.yaml, run {failed}, seed 7"
    assert log.topics["/control"].texts == [(0, ("bus",))]

    assert main(["campaign", str(campaign), "--rerun", "24", "--out", str(out)]) == 2
    assert "found 24, expected a run from 0 to 23" in capsys.readouterr().err


def test_the_command_printed_for_a_failed_run_flies_that_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The numbers of a run in a Latin hypercube depend on the number of runs, so the options must be given."""
    campaign = write(tmp_path, CAMPAIGN.replace("sampling: random", "sampling: latin_hypercube"))
    out = tmp_path / "the rows" / "it's.parquet"
    assert main(["campaign", str(campaign), "--workers", "0", "--runs", "12", "--seed", "5", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    line = next(line for line in text.splitlines() if "--rerun" in line).strip()
    words = shlex.split(line)
    assert words[0] == "rb-dynamics"
    assert main(words[1:]) == 0
    assert "the same as its row, to the bit" in capsys.readouterr().out
    page = out.with_suffix(".html")
    if page.exists():
        assert line in html.unescape(page.read_text(encoding="utf-8"))

    without = [word for word in words[1:] if word not in ("--runs", "12")]
    log = tmp_path / "another.mcap"
    assert main([*without, "--mcap", str(log)]) == 2
    assert f"{out} holds runs of another campaign: runs is 12 there and 24 here; " in capsys.readouterr().err
    assert not log.exists()


def test_a_rerun_without_a_row_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = CAMPAIGN.replace("below: 0.4}", "below: 1.0e-9}")
    out = tmp_path / "rows.parquet"
    assert main(["campaign", str(write(tmp_path, text)), "--rerun", "3", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert printed.err == f"note: no row of run 3 in {out} to compare with\n"
    assert next(line.split() for line in printed.out.splitlines() if "settled" in line) == ["settled", "never"]
    assert "nan" not in printed.out


@pytest.mark.parametrize(("row_error", "in_row"), [("", "never"), ("too fast", "no value")])
def test_a_rerun_says_never_only_of_a_time(row_error: str, in_row: str) -> None:
    metrics = {"settled": math.nan, "rate": math.nan}
    found = SingleRun(3, metrics, metrics, Path("run.mcap"), "", row_error, {"settled": "never", "rate": "no value"})
    lines = [re.split(r" {2,}", line.strip()) for line in found.as_text().splitlines()]
    told = {words[0]: words[1:] for words in lines if len(words) == 3}
    assert told == {"settled": ["never", f"{in_row} in its row"], "rate": ["no value", "no value in its row"]}


LAW = "def law(parameters):\n    return lambda measured: -{gain} * measured.angular_velocity_body\n"


@pytest.mark.usefixtures("_no_page")
def test_values_of_set_go_into_every_run_and_into_its_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    campaign = write(tmp_path, CAMPAIGN.replace("runs: 24", "set: {duration: 3, solver.step: 0.025}\nruns: 24"))
    written = CAMPAIGN.replace("runs: 24", "set: {duration: 1, solver.accuracy: 1.0e-7}\nruns: 24")
    (tmp_path / "written.yaml").write_text(written.replace("gain: 1.0}", "gain: 1.5}"), encoding="utf-8")
    out = tmp_path / "rows.parquet"
    arguments = ["campaign", str(campaign), "--workers", "0", "--out", str(out)]
    given = ["--set", "duration=1", "--set", "solver.accuracy=1e-7", "--set", "control.parameters.gain=1.5"]
    assert main([*arguments, *given]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "--rerun" in line).strip()
    expected = read_rows(out)
    fly(tmp_path / "written.yaml", tmp_path / "written.parquet")
    for name, column in read_rows(tmp_path / "written.parquet").items():
        np.testing.assert_array_equal(column, expected[name])
    # The command that is printed repeats the run, and other values are of another campaign.
    assert main(shlex.split(line)[1:]) == 0
    assert "the same as its row, to the bit" in capsys.readouterr().out
    assert main([*arguments, *given[2:], "--set", "duration=2"]) == 2
    assert "scene.duration is 1 there and 2 here" in capsys.readouterr().err
    assert main([*arguments, *given]) == 0
    for wrong, message in (("body.masss=2", "did you mean mass?"), ("duration", "expected KEY=VALUE")):
        assert main([*arguments, "--set", wrong]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.usefixtures("_no_page")
def test_rows_of_another_law_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whether the law has changed, or only what it imports."""
    campaign = write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: own.law.law"))
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "law.py").write_text("from .gain import GAIN\n" + LAW.format(gain="GAIN"))
    (tmp_path / "own" / "gain.py").write_text("GAIN = 1.0\n")
    arguments = ["campaign", str(campaign), "--out", str(tmp_path / "rows.parquet"), "--workers", "0"]
    assert main(arguments) == 0
    assert main([*arguments, "--rerun", "3"]) == 0
    capsys.readouterr()
    (tmp_path / "own" / "gain.py").write_text("GAIN = 1.0000001\n")
    message = r"another campaign: .*the source of the module own.gain is \w{12} there and \w{12} here; "
    for more in ([], ["--runs", "30"], ["--rerun", "3"]):
        assert main([*arguments, *more]) == 2
        assert re.search(message, capsys.readouterr().err)
    assert main([*arguments, "--overwrite"]) == 0
    assert main([*arguments, "--rerun", "3"]) == 0


@pytest.mark.usefixtures("_no_page")
def test_a_rerun_that_differs_is_seen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here a law depends on what the campaign cannot know."""
    gain = "float(__import__('os').environ['OWN_GAIN'])"
    (tmp_path / "changing_law.py").write_text(LAW.format(gain=gain))
    campaign = write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: changing_law.law"))
    arguments = ["campaign", str(campaign), "--out", str(tmp_path / "r.parquet"), "--workers", "0"]
    monkeypatch.setenv("OWN_GAIN", "1.0")
    assert main(arguments) == 0
    monkeypatch.setenv("OWN_GAIN", "1.0000001")
    assert main([*arguments[:-2], "--rerun", "3"]) == 1
    assert "differs from its row" in capsys.readouterr().out


@pytest.mark.usefixtures("_no_page")
def test_runs_that_a_law_fails_are_rows_and_the_exit_code_tells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    law = LAW.format(gain="(1.0 + 0.0 * (check(measured) or 1.0))")
    check = "def check(measured):\n    if abs(measured.angular_velocity_body[:, 0]).max() > 0.6:\n        [][0]\n"
    (tmp_path / "own_check.py").write_text(f"{check}\n\n{law}")
    campaign = write(tmp_path, CAMPAIGN.replace("law: rate_damping", "law: own_check.law"))
    out = tmp_path / "rows.parquet"
    arguments = ["campaign", str(campaign), "--out", str(out), "--workers", "0"]
    for _ in range(2):
        # Whether they have just been flown or are on disk.
        assert main([*arguments, "--json"]) == 1
        printed = json.loads(capsys.readouterr().out)
    failed, why = printed["errors"][0]
    assert 0 < len(printed["errors"]) < 24
    assert why == "control.law: own_check.law raised IndexError: list index out of range, own_check.py:3"
    assert main([*arguments, "--rerun", str(failed)]) == 1
    found = capsys.readouterr()
    assert f"did not complete: {why}\n  its row says: {why}\n" in found.out
    assert "differs" not in found.out
    # The log has it as far as it went.
    assert read_bag(tmp_path / f"rows-{failed}.mcap").metadata[RESULT]["end_time_ns"] != "2000000000"


def wait_for(what: str, condition: Any, timeout: float = 60.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"waited {timeout} s for {what}"
        time.sleep(0.02)


@contextmanager
def process(folder: Path, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    with (folder / "log.txt").open("ab") as log:
        child = subprocess.Popen(list(map(str, arguments)), cwd=folder, stdout=log, stderr=log)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[Path]:
    """Start a scheduler; return the file that has its address."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    run = (sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--host", "127.0.0.1")
    with process(tmp_path, *run, "--no-dashboard", "--scheduler-file", file):
        wait_for("the scheduler", lambda: file.exists() and file.read_text().endswith("}"))
        yield file


@contextmanager
def worker(folder: Path, file: Path) -> Iterator[subprocess.Popen[bytes]]:
    run = (sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard")
    with process(folder, *run, "--scheduler-file", file) as child:
        yield child


@pytest.mark.slow
def test_workers_of_a_cluster_one_of_which_is_killed(tmp_path: Path, scheduler: Path) -> None:
    campaign = write(tmp_path, CAMPAIGN.replace("runs: 24", "runs: 200"))
    out, parts = tmp_path / "cluster.parquet", tmp_path / "cluster.parquet.parts"
    address = json.loads(scheduler.read_text())["address"]
    run = command(campaign, "--scheduler", address, "--out", out, "--block", 5)

    def on_disk(count: int) -> bool:
        return parts.exists() and len(list(parts.glob("runs-*.parquet"))) > count

    with worker(tmp_path, scheduler) as doomed, process(tmp_path, *run) as child:
        wait_for("blocks of the first worker", lambda: on_disk(1))
        with worker(tmp_path, scheduler), worker(tmp_path, scheduler):
            wait_for("more blocks", lambda: on_disk(4))
            doomed.send_signal(signal.SIGKILL)
            assert child.wait(timeout=90) == 0, (tmp_path / "log.txt").read_text()
    assert out.read_bytes() == fly(campaign, tmp_path / "here.parquet")


@pytest.mark.slow
def test_killed_half_way_and_started_again(tmp_path: Path) -> None:
    """With local processes: the campaign continues after a kill, and the file equals that of an undisturbed run."""
    pytest.importorskip("distributed")
    campaign = write(tmp_path, CAMPAIGN.replace("runs: 24", "runs: 200"))
    out, parts = tmp_path / "killed.parquet", tmp_path / "killed.parquet.parts"
    with process(tmp_path, *command(campaign, "--workers", 2, "--block", 5, "--out", out)) as child:
        wait_for("some blocks", lambda: parts.exists() and len(list(parts.glob("runs-*.parquet"))) > 8)
        child.kill()
        child.wait()
    left = len(list(parts.glob("runs-*.parquet")))
    assert 8 < left < 40
    with process(tmp_path, *command(campaign, "--workers", 2, "--block", 10, "--out", out)) as child:
        assert child.wait(timeout=90) == 0, (tmp_path / "log.txt").read_text()
    assert f"note: {5 * left} of 200 runs are on disk already" in (tmp_path / "log.txt").read_text()
    assert out.read_bytes() == fly(campaign, tmp_path / "here.parquet")


@pytest.mark.slow
def test_a_law_that_ends_each_worker(tmp_path: Path, scheduler: Path) -> None:
    campaign = write(tmp_path, CAMPAIGN.replace("rate_damping", "own_law.law"))
    (tmp_path / "own_law.py").write_text("import os\n\n\ndef law(parameters):\n    os._exit(9)\n")
    address = json.loads(scheduler.read_text())["address"]
    with ExitStack() as stack:
        for _ in range(4):
            stack.enter_context(worker(tmp_path, scheduler))
        with pytest.raises(LogError, match=r"^the runs 0 to 23 ended each worker that ran them, 4 in turn: "):
            fly(campaign, tmp_path / "rows.parquet", scheduler=address, block=24)


@pytest.mark.slow
def test_no_worker_is_left_for_a_while(tmp_path: Path, scheduler: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    address, campaign = json.loads(scheduler.read_text())["address"], write(tmp_path)
    with worker(tmp_path, scheduler) as doomed, ExitStack() as stack:

        def kill(done: int, runs: int) -> None:
            if doomed.poll() is None:
                doomed.kill()
                doomed.wait()
                monkeypatch.setattr(engine, "_PATIENCE_S", 0.5)

        def join(text: str, *_: object) -> None:
            said.append(text)
            stack.enter_context(worker(tmp_path, scheduler))

        said: list[str] = []
        monkeypatch.setattr(engine._log, "warning", join)
        found = fly(campaign, tmp_path / "rows.parquet", scheduler=address, block=1, progress=kill)
    assert [text[:17] for text in said] == ["no worker is left"]
    assert found == fly(campaign, tmp_path / "here.parquet")


@pytest.mark.slow
def test_a_scheduler_that_is_lost(tmp_path: Path, scheduler: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_PATIENCE_S", 10)
    distributed = pytest.importorskip("distributed")
    address, campaign = json.loads(scheduler.read_text())["address"], write(tmp_path)
    other = None

    def shut_down(*_: object) -> None:
        nonlocal other
        if other is None:
            other = distributed.Client(address, set_as_default=False)
            other.shutdown()

    with worker(tmp_path, scheduler), pytest.raises(LogError, match=f"^lost the scheduler at {address}; start it"):
        fly(campaign, tmp_path / "rows.parquet", scheduler=address, block=1, progress=shut_down)


def test_a_scheduler_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("rb_dynamics.study.campaign.engine._PATIENCE_S", 0.5)
    with pytest.raises(LogError, match=r"no scheduler with workers at tcp://127.0.0.1:9 "):
        fly(write(tmp_path), tmp_path / "rows.parquet", scheduler="tcp://127.0.0.1:9")


def test_a_worker_of_another_version_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"has rb_dynamics \S+, expected 0\.0\.0 as here; install the same"):
        simulate_on_worker(read_campaign(write(tmp_path)), "0.0.0", 0, 1)


def test_a_cluster_flies_the_law_of_each_study(tmp_path: Path, scheduler: Path) -> None:
    """Two studies with modules of the same names, and one of them edited, on the same worker."""
    address = json.loads(scheduler.read_text())["address"]
    folders = [tmp_path / name for name in ("A", "B")]
    for folder, gain in zip(folders, (0.5, -0.5), strict=True):
        folder.mkdir()
        write(folder, CAMPAIGN.replace("rate_damping", "own_law.law"))
        (folder / "own_law.py").write_text("from own_gain import GAIN\n" + LAW.format(gain="GAIN"))
        (folder / "own_gain.py").write_text(f"GAIN = {gain}\n")
    with worker(tmp_path, scheduler):
        first, second = (
            fly(folder / "campaign.yaml", tmp_path / f"{folder.name}.parquet", scheduler=address, block=6)
            for folder in folders
        )
        (folders[0] / "own_gain.py").write_text("GAIN = 0.6\n")
        edited = fly(folders[0] / "campaign.yaml", tmp_path / "edited.parquet", scheduler=address, block=6)
    assert edited == fly(folders[0] / "campaign.yaml", tmp_path / "edited_here.parquet")
    assert second == fly(folders[1] / "campaign.yaml", tmp_path / "B_here.parquet")
    rates = [read_rows(tmp_path / f"{name}.parquet")["final_rate"].mean() for name in ("A", "B", "edited")]
    assert rates[2] < rates[0] < 0.6 < rates[1]
    assert len({first, second, edited}) == 3
