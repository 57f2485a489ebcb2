"""Make the pictures of the README and docs/logs.md in docs/images: Rerun scenes, a report, a video.

    python tools/make_pictures.py

Uses the Rerun viewer without a window (software rendering if there is no graphics card), and Chromium for the report,
with the extra `interactive`.
The recording is that of `make demo`; the flip of a free body is run here. Look at the pictures before committing them.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from PIL import Image, ImageSequence
from rerun.experimental import ViewerClient

import rb_dynamics as rb
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.report.run_page import write_run_report
from rb_dynamics.report.video import write_video
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.rerun_sink import RerunSink

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
WIDTH, HEIGHT = 1500, 960
TITLE_BAR = 36  # of the viewer, px: says what machine it runs on
REPORT_SIZE = (1000, 1250)
MAX_BYTES, MAX_GIF_BYTES = 400_000, 1_000_000
LIMIT_S = 120.0
DEMO_S = 3.0  # both forces and torques act
FLIP_S = 17.0  # the tip of the angular velocity has been round once and begins again
GIF_WIDTH, GIF_EVERY = 480, 4
INSTALL = "on Debian or Ubuntu: sudo apt install libvulkan1 mesa-vulkan-drivers chromium"


def main() -> None:
    demo = ROOT / "out" / "demo.rrd"
    if not demo.is_file():
        sys.exit(f"{demo}: no such file, expected the recorded flight; say `make demo` first")
    IMAGES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        mcap, rrd, page = (Path(folder) / name for name in ("flip.mcap", "flip.rrd", "flip.html"))
        scene = rb.read_scene(ROOT / "config" / "dzhanibekov.yaml", {"duration": FLIP_S + 3.0})
        rb.simulate(scene, sinks=[McapSink(mcap), RerunSink(rrd)])
        save(viewed(demo, DEMO_S), "demo.png")
        save(viewed(rrd, FLIP_S), "flip.png")
        write_run_report(mcap, page)
        # The facts of the run are left out, so that figures come into view, and the bar that floats above the text.
        page.write_text(page.read_text().replace("</head>", "<style>#section-2, .bar { display: none }</style></head>"))
        save(browsed(page, Path(folder) / "page.png"), "report.png")
        make_video(mcap, Path(folder) / "flip.gif")


def viewed(recording: Path, time_s: float) -> Image.Image:
    """Return a screenshot of the viewer with a recording at a given time."""
    with viewer(recording) as client:
        client.set_time("sim_time", duration=time_s, play_state="paused")
        before, picture = b"", client.take_screenshot()
        while picture != before:
            time.sleep(1.0)
            before, picture = picture, client.take_screenshot()
    with Image.open(io.BytesIO(picture)) as image:
        return image.convert("RGB").crop((0, TITLE_BAR, image.width, image.height))


@contextlib.contextmanager
def viewer(recording: Path) -> Iterator[ViewerClient]:
    """Yield a viewer that has loaded `recording`."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    task = ["--headless", f"--window-size={WIDTH}x{HEIGHT}", "--renderer=vulkan", f"--port={port}", str(recording)]
    with tempfile.TemporaryFile("w+") as said:
        # A group of its own, as the module starts the viewer as another process.
        process = subprocess.Popen(
            [sys.executable, "-m", "rerun", *task], stdout=said, stderr=said, start_new_session=True
        )
        give_up = time.monotonic() + LIMIT_S
        try:
            client = None
            while client is None:
                with contextlib.suppress(Exception):
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                    state = client.get_state()
                    if state.active_recording is None or state.loading:
                        client = None
                if time.monotonic() > give_up or process.poll() is not None:
                    said.seek(0)
                    sys.exit(f"{said.read()[-1000:]}\nthe Rerun viewer could not draw; it needs Vulkan, {INSTALL}")
                time.sleep(0.5)
            yield client
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def browsed(page: Path, shot: Path) -> Image.Image:
    """Return a screenshot of the top of a page in a browser, in light colours."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        sys.exit(f"no Chromium found, needed to show the report; {INSTALL}")
    width, height = REPORT_SIZE
    task = [
        "--headless",
        "--no-sandbox",
        "--hide-scrollbars",
        "--virtual-time-budget=20000",  # until figures have become those that answer when touched
        f"--window-size={width},{height}",
        f"--screenshot={shot}",
    ]
    subprocess.run([browser, *task, page.as_uri()], check=True, capture_output=True, timeout=LIMIT_S)
    with Image.open(shot) as image:
        return image.convert("RGB")


def make_video(mcap: Path, video: Path) -> None:
    """Render the flip, reduced to a size suitable for a page."""
    write_video(video, read_track(read_bag(mcap)))
    with Image.open(video) as film:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(film)][::GIF_EVERY]
        period_ms = GIF_EVERY * film.info["duration"]
    size = (GIF_WIDTH, round(frames[0].height * GIF_WIDTH / frames[0].width))
    small = [frame.resize(size, Image.Resampling.LANCZOS) for frame in frames]
    # One palette for all frames, so that static parts are stored once.
    some = Image.new("RGB", (GIF_WIDTH, 4 * size[1]))
    for k in range(4):
        some.paste(small[k * len(small) // 4], (0, k * size[1]))
    palette = some.quantize(64, method=Image.Quantize.FASTOCTREE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    target = IMAGES / "flip.gif"
    small[0].save(target, save_all=True, append_images=small[1:], duration=period_ms, loop=0)
    report(target, MAX_GIF_BYTES)


def save(image: Image.Image, name: str) -> None:
    """Save a PNG, in full colour if that is within `MAX_BYTES`, else in fewer colours."""
    target = IMAGES / name
    image.save(target, optimize=True)
    for colors in (256, 128, 64):
        if target.stat().st_size > MAX_BYTES:
            image.quantize(colors, dither=Image.Dither.NONE).save(target, optimize=True)
    report(target, MAX_BYTES)


def report(target: Path, most: int) -> None:
    size = target.stat().st_size
    print(f"{target.relative_to(ROOT)}: {size // 1000} kB")
    if size > most:
        sys.exit(f"{target}: {size} bytes, expected at most {most}")


if __name__ == "__main__":
    main()
