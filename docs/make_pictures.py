"""Draw the pictures of the documentation: out/demo.rrd as the real Rerun viewer opens it -> docs/images/demo.png.

The viewer runs on a screen in memory, with a software renderer where there is no graphics card: no display is needed.
Never makes the recording: `make demo` does.

    python docs/make_pictures.py [RECORDING.rrd [PICTURE.png]]
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
WINDOW = "1500x960"  # in points; the viewer draws them finer, and they become the pixels of the picture
WIDTH = 1500
MAX_BYTES = 400_000
LIMIT_S = 300
INSTALL = (
    "on Debian or Ubuntu: sudo apt install xvfb xauth libvulkan1 mesa-vulkan-drivers libgl1 libegl1 "
    "libxkbcommon-x11-0 libxcursor1 libxi6 libxrandr2"
)


def main(arguments: list[str]) -> None:
    recording = Path(arguments[0]) if arguments else ROOT / "out" / "demo.rrd"
    picture = Path(arguments[1]) if len(arguments) > 1 else ROOT / "docs" / "images" / "demo.png"
    if not recording.is_file():
        sys.exit(f"{recording}: no such file, expected a Rerun recording; say `make demo` first")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        take_screenshot(recording, shot)
        with Image.open(shot) as image:
            png = compress(image)
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(png)
    print(f"{picture}: {len(png) // 1000} kB")


def take_screenshot(recording: Path, shot: Path) -> None:
    missing = [program for program in ("xvfb-run", "xauth", "timeout") if shutil.which(program) is None]
    if missing:
        sys.exit(f"{' and '.join(missing)} not found, needed for a screen in memory; {INSTALL}")
    screen = ["xvfb-run", "--auto-servernum", f"--server-args=-screen 0 {WINDOW}x24"]
    # The limit stands inside, so that xvfb-run ends its screen too. A port of its own: a viewer that is open already
    # would take the recording and no picture would come.
    viewer = ["timeout", str(LIMIT_S), sys.executable, "-m", "rerun", "--renderer=vulkan", "--port=auto"]
    task = ["--window-size", WINDOW, "--screenshot-to", str(shot), str(recording)]
    plain = {**os.environ, "NO_COLOR": "1"}
    done = subprocess.run([*screen, *viewer, *task], env=plain, capture_output=True, text=True, check=False)
    if done.returncode or not shot.exists():
        reason = f"did not finish in {LIMIT_S} s" if done.returncode == 124 else "could not draw"
        said = "\n".join((done.stdout + done.stderr).splitlines()[-5:])
        sys.exit(f"{said}\nthe Rerun viewer {reason} (exit code {done.returncode}); it needs Vulkan, {INSTALL}")


def compress(image: Image.Image) -> bytes:
    """Return a PNG of `WIDTH` pixels' width, in full colour if that is within `MAX_BYTES`, else in fewer colours."""
    size = (WIDTH, round(image.height * WIDTH / image.width))
    small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    png = encode(small)
    for colors in (256, 128, 64):
        if len(png) <= MAX_BYTES:
            return png
        png = encode(small.quantize(colors, dither=Image.Dither.NONE))
    return png


def encode(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


if __name__ == "__main__":
    main(sys.argv[1:])
