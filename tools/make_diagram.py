"""Draw docs/images/data-flow.svg: the path of the data from scene to log.

    python tools/make_diagram.py            # --check: exit code 1 if the figure on disk is out of date

Colours follow the reader's system, light or dark. Fails if a file named in a box does not exist.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parent.parent
FIGURE = ROOT / "docs" / "images" / "data-flow.svg"
WIDTH, HEIGHT = 960, 800

STYLE = """
  text { font: 13px system-ui, sans-serif; fill: #1c2733; text-anchor: middle }
  .name { font-weight: 600 }
  .word { font-size: 12px; fill: #55636f }
  rect { fill: #eef2f5; stroke: #8899a6 }
  .edge { fill: none; stroke: #8899a6; stroke-dasharray: 4 3 }
  .loop { fill: #fbe3d6; stroke: #d2622a }
  path { fill: none; stroke: #55636f; stroke-width: 1.4 }
  marker path { fill: #55636f; stroke: none }
  @media (prefers-color-scheme: dark) {
    text { fill: #e3e8ec } .word { fill: #a4b1bb } rect { fill: #28323b; stroke: #6d7f8c } .edge { stroke: #6d7f8c }
    .edge { fill: none } .loop { fill: #56301b; stroke: #e0824f } path { stroke: #a4b1bb } marker path { fill: #a4b1bb }
  }
"""


class Box(NamedTuple):
    """A box centred at (x, y): name, subtitle, width, style, and the files in rb_dynamics that it represents."""

    x: float
    y: float
    name: str
    below: str = ""
    width: float = 210.0
    style: str = ""
    files: tuple[str, ...] = ()

    @property
    def half(self) -> float:
        return 25.0 if self.below else 16.0


BOXES = {
    "yaml": Box(160, 30, "scene.yaml, mesh, URDF", style="edge"),
    "bag": Box(480, 30, "bag of wrenches", style="edge"),
    "topic": Box(800, 30, "WrenchStamped", style="edge"),
    "read": Box(160, 115, "scene/read.py", "every key checked; one error", files=("scene/read.py",)),
    "source": Box(480, 115, "formats/bag_source.py", "commands by their stamps", files=("formats/bag_source.py",)),
    "arrivals": Box(
        800,
        115,
        "ros/command_statistics.py",
        "commands as they come",
        files=("ros/command_statistics.py", "ros/conversions.py"),
    ),
    "parts": Box(160, 210, "body/   loads/   motion/", "what a Scene is made of", files=("body", "loads", "motion")),
    "compile": Box(160, 305, "run/plan.py", "method, step control", files=("run/plan.py",)),
    "loop": Box(
        480,
        400,
        "run/simulation.py",
        "the only loop: from edge to edge, command, output, end",
        600,
        "loop",
        ("run/simulation.py",),
    ),
    "sample": Box(480, 490, "run/sample.py", "Sample: state, momenta, energy, defects", 290, "", ("run/sample.py",)),
    "memory": Box(100, 595, "memory_sink.py", "arrays", 150, files=("sinks/memory_sink.py",)),
    "hash": Box(290, 595, "state_hash.py", "SHA-256 of all states", 150, files=("sinks/state_hash.py",)),
    "mcap": Box(480, 595, "mcap_sink.py", "run.mcap, bag folder", 150, files=("sinks/mcap_sink.py",)),
    "rerun": Box(670, 595, "rerun_sink.py", "run.rrd", 150, files=("sinks/rerun_sink.py",)),
    "publish": Box(860, 595, "ros/publishers.py", "pose, twist, odom, ...", 150, files=("ros/publishers.py",)),
    "report": Box(370, 720, "analysis/   report/", "inspect: findings, HTML, video", 210, files=("analysis", "report")),
    "replay": Box(600, 720, "study/replay.py", "runs the log again, to the bit", 210, files=("study/replay.py",)),
}

ARROWS = [
    ("yaml", "read"), ("bag", "source"), ("topic", "arrivals"), ("read", "parts"), ("parts", "compile"),
    ("compile", "loop"), ("source", "loop"), ("arrivals", "loop"), ("loop", "sample"), ("sample", "memory"),
    ("sample", "hash"), ("sample", "mcap"), ("sample", "rerun"), ("sample", "publish"), ("mcap", "report"),
    ("mcap", "replay"),
]  # fmt: skip


def arrow(start: Box, end: Box) -> str:
    """Return a line from the lower edge of one box to the upper edge of another."""
    reach = end.width / 2 - 20
    x = min(max(start.x, end.x - reach), end.x + reach)
    top, bottom = start.y + start.half, end.y - end.half - 7
    middle = (top + bottom) / 2
    return f'<path d="M{start.x:g} {top:g} C{start.x:g} {middle:g} {x:g} {middle:g} {x:g} {bottom:g}" {HEAD}/>'


HEAD = 'marker-end="url(#head)"'


def draw() -> str:
    """Return the figure."""
    for box in BOXES.values():
        for file in box.files:
            if not (ROOT / "rb_dynamics" / file).exists():
                raise FileNotFoundError(f"rb_dynamics/{file}: the diagram names it, and it is not there")
    marks = [arrow(BOXES[start], BOXES[end]) for start, end in ARROWS]
    marks.append('<rect class="edge" x="15" y="552" width="930" height="86" rx="8"/>')
    marks.append('<text class="word" x="108" y="656">sinks: open, write, close</text>')
    for box in BOXES.values():
        left, top = box.x - box.width / 2, box.y - box.half
        kind = f' class="{box.style}"' if box.style else ""
        size = f'width="{box.width:g}" height="{2 * box.half:g}"'
        marks.append(f'<rect{kind} x="{left:g}" y="{top:g}" {size} rx="6"/>')
        lift = 3 if box.below else -4
        marks.append(f'<text class="name" x="{box.x:g}" y="{box.y - lift:g}">{escape(box.name)}</text>')
        if box.below:
            marks.append(f'<text class="word" x="{box.x:g}" y="{box.y + 15:g}">{escape(box.below)}</text>')
    body = "\n".join(marks)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT - 40}" role="img">
<title>From scene to log</title>
<style>{STYLE}</style>
<defs><marker id="head" viewBox="0 0 8 8" refX="1" refY="4" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0 L8 4 L0 8 z"/></marker></defs>
{body}
</svg>
"""


def main(arguments: list[str]) -> int:
    """Write the figure, or check that the one on disk is up to date."""
    if "--check" in arguments:
        same = FIGURE.exists() and FIGURE.read_text(encoding="utf-8") == draw()
        if not same:
            print("docs/images/data-flow.svg is not what its script draws; run `python tools/make_diagram.py`")
        return 0 if same else 1
    FIGURE.write_text(draw(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
