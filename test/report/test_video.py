"""The video has the right number of frames, which move, and clear errors where it cannot be made."""

from __future__ import annotations

import itertools
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rb_dynamics import Wrench, parse_scene, simulate
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.track import Track
from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.report import video
from rb_dynamics.report.video import write_video
from rb_dynamics.sinks.mcap_sink import McapSink


@pytest.fixture
def track(coasting: Any) -> Track:
    return read_track(read_bag(coasting.log))


def test_gif_shows_a_body_that_moves(track: Track, tmp_path: Path) -> None:
    from PIL import Image, ImageSequence

    target = tmp_path / "new" / "run.gif"
    assert write_video(target, track, rate=2) == 10
    with Image.open(target) as picture:
        assert picture.n_frames == 10
        assert picture.size == (960, 540)
        frames = [np.asarray(frame.convert("RGB"), dtype=int) for frame in ImageSequence.Iterator(picture)]
    for half in (slice(0, 480), slice(480, 960)):
        assert all(np.abs(b - a)[50:500, half].max() > 50 for a, b in itertools.pairwise(frames))


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
def test_mp4_is_one_that_a_decoder_takes(track: Track, tmp_path: Path) -> None:
    target = tmp_path / "run.mp4"
    frames = write_video(target, track, rate=2)
    decoded = subprocess.run(
        ["ffmpeg", "-loglevel", "error", "-i", target, "-f", "rawvideo", "-pix_fmt", "gray", "-"],
        capture_output=True,
        check=True,
    )
    assert len(decoded.stdout) == frames * 960 * 540


def test_without_ffmpeg_the_extra_is_named(track: Track, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError, match="extra 'video'"):
        write_video(tmp_path / "run.mp4", track, rate=2)
    assert list(tmp_path.iterdir()) == [], "no empty video, nor a part of one"


def test_unknown_ending_is_named_and_nothing_written(track: Track, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"run\.avi.*ends in \.mp4 or \.gif"):
        write_video(tmp_path / "run.avi", track)
    assert list(tmp_path.iterdir()) == []


def test_a_recording_without_mass_properties_says_what_to_give(example_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="--scene SCENE"):
        write_video(tmp_path / "run.gif", read_track(read_bag(example_dir / "slew.mcap")))


def test_a_path_that_cannot_be_written_is_one_clear_error(track: Track, tmp_path: Path) -> None:
    (tmp_path / "run.gif").mkdir()
    with pytest.raises(LogError, match="cannot write"):
        write_video(tmp_path / "run.gif", track, rate=2)


def test_no_plane_is_shown_as_invariable_while_a_torque_acts(tmp_path: Path) -> None:
    """A torque for the first half of a run: the disc appears with its end, and both curves begin there."""
    from PIL import Image, ImageSequence

    scene = parse_scene(
        "body: {frame: body, mass: 1, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: wrench}]\n"
        "initial: {angular_velocity_body: [0.1, 2, 0.1]}\nduration: 6\noutput_rate: 20\n"
    )
    none = (0.0, 0.0, 0.0)
    commands = [("wrench", Wrench(none, torque, "body", t)) for torque, t in (((0.3, 0.0, 0.0), 0), (none, 3 * 10**9))]
    simulate(scene, commands, [McapSink(tmp_path / "run.mcap")])
    write_video(tmp_path / "run.gif", read_track(read_bag(tmp_path / "run.mcap")), rate=2)
    disc = np.array([0x33, 0x3D, 0x4A])
    with Image.open(tmp_path / "run.gif") as picture:
        frames = [np.asarray(frame.convert("RGB"), dtype=int) for frame in ImageSequence.Iterator(picture)]
    shown = [int((np.abs(frame[50:500, 480:] - disc).max(axis=2) < 6).sum()) > 2000 for frame in frames]
    assert shown == [False] * 6 + [True] * 6


def test_parallel_arrows_stand_side_by_side() -> None:
    momentum = np.array([1.0, 0.0])
    assert abs(video._beside(momentum, np.array([0.5, 0.01]))) == video._BESIDE
    assert video._beside(momentum, np.array([0.5, 0.01])) == -video._beside(momentum, np.array([0.5, -0.01]))
    assert video._beside(momentum, np.array([0.0, 1.0])) == 0.0
    assert video._beside(momentum, np.zeros(2)) == 0.0
