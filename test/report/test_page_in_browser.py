"""A page in a browser: its plots answer to zoom, pointer and legend."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.report.run_page import write_run_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

TOUCH = """<script>
addEventListener("load", async () => {
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  while (!document.documentElement.dataset.plots) await wait(50);
  let all = [];
  while (all.length !== document.querySelectorAll("h3").length || !all.length) {
    all = [...document.querySelectorAll(".canvas")].filter((each) => each.layout);
    await wait(500);
  }
  const first = all[0], box = first.getBoundingClientRect();
  document.querySelectorAll(".key")[1].click();
  await Plotly.relayout(first, { "xaxis.range[0]": 0, "xaxis.range[1]": 2 });
  await wait(500);
  const at = { clientX: box.left + box.width / 2, clientY: box.top + 20, bubbles: true };
  first.dispatchEvent(new PointerEvent("pointermove", at));
  const said = {
    visible: first.data.map((curve) => curve.visible !== false),
    ranges: all.map((each) => each.layout.xaxis && each.layout.xaxis.range),
    time: document.querySelector(".bar output").value,
    values: [...document.querySelectorAll(".key output")].map((each) => each.value),
  };
  document.body.dataset.said = JSON.stringify(said);
});
</script></body>"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs Chromium")
def test_plots_answer_together(flight: Any, tmp_path: Path) -> None:
    import html
    import json

    pytest.importorskip("plotly", reason="extra 'interactive' is not installed")
    page = tmp_path / "run.html"
    write_run_report(flight.log, page)
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", TOUCH), encoding="utf-8")
    options = ["--headless=new", "--no-sandbox", "--window-size=1280,9000", "--virtual-time-budget=20000"]
    assert BROWSER is not None
    command = [BROWSER, *options, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True).stdout
    found = re.search(r'data-said="([^"]*)"', shown)
    assert found is not None
    said = json.loads(html.unescape(found[1]))
    assert said["visible"] == [True, False, True]
    times = [span for span in said["ranges"] if span == [0, 2]]
    assert len(times) >= 8
    assert said["time"].startswith("t = ")
    assert sum(bool(re.search(r"\d", value)) for value in said["values"]) >= 20


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs Chromium")
def test_tables_fit_a_phone(flight: Any, tmp_path: Path) -> None:
    import html

    page, outer = tmp_path / "run.html", tmp_path / "phone.html"
    write_run_report(flight.log, page)
    told = html.escape(page.read_text(encoding="utf-8"))
    measure = (
        "document.body.dataset.said = [...frame.contentDocument.querySelectorAll('table')]"
        ".map((each) => each.parentElement).filter((each) => each.scrollWidth > each.clientWidth).length"
    )
    outer.write_text(
        f'<body><iframe id="frame" style="width:400px;height:900px" srcdoc="{told}"></iframe>'
        f'<script>frame.addEventListener("load", () => {{ {measure} }})</script></body>',
        encoding="utf-8",
    )
    options = ["--headless=new", "--no-sandbox", "--window-size=800,1000", "--virtual-time-budget=5000"]
    assert BROWSER is not None
    command = [BROWSER, *options, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", outer.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True).stdout
    assert re.findall(r'data-said="(\d+)"', shown) == ["0"]
