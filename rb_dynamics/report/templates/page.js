// Copy buttons, and plots in place of the pictures if the page has plotly.js; without it the page stays as it is.
(() => {
  "use strict";
  const LEFT = 62, RIGHT = 14, TOP = 4;
  const make = (tag, name, text, parent) => {
    const made = document.createElement(tag);
    if (name) made.className = name;
    if (text) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  };

  for (const line of document.querySelectorAll("pre.copy")) {
    const text = line.textContent;
    const button = make("button", "", "Copy", line);
    button.type = "button";
    button.addEventListener("click", async () => {
      let done = false;
      try {
        await navigator.clipboard.writeText(text);
        done = true;
      } catch {
        // Without permission, or from a server without encryption.
        const area = make("textarea", "", "", document.body);
        area.value = text;
        area.select();
        done = document.execCommand("copy");
        area.remove();
      }
      button.textContent = done ? "Copied" : "Select it";
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
  }

  const packed = document.getElementById("plotly-script");
  if (!packed || !window.DecompressionStream) return;
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const data = JSON.parse(document.getElementById("plot-data").textContent);
  const arrays = data.arrays.map((text) => new Float64Array(bytes(text).buffer));
  const coarse = matchMedia("(pointer: coarse)").matches;
  // What is shown of time, in seconds; null: each plot its own whole.
  let span = null, dragging = !coarse, busy = false;
  const shown = [];
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  const bar = make("div", "bar away", "", null);
  const clock = make("output", "", "", bar);
  const whole = make("button", "", "Show all", bar);
  const drag = make("button", "", "Drag zooms", bar);
  whole.type = drag.type = "button";

  function traces(plot) {
    const keys = plot.axes.length === 3 ? ["x", "y", "z"] : ["x", "y"];
    return plot.curves.map((curve) => {
      const trace = { name: curve.label.replace(/</g, "&lt;"), showlegend: false };
      if (plot.second) trace.hoverinfo = "skip";
      keys.forEach((key, k) => { trace[key] = arrays[curve.points[k]]; });
      if (curve.look === "bars") return Object.assign(trace, { type: "bar" }, curve.more);
      trace.type = keys.length === 3 ? "scatter3d" : "scatter";
      trace.mode = curve.look === "dots" ? "markers" : "lines";
      trace.line = { color: curve.color, width: keys.length === 3 ? 4 : 1.4, simplify: false };
      if (curve.look === "dash") trace.line.dash = "dash";
      if (curve.look === "step") trace.line.shape = "hv";
      if (curve.look === "dots") trace.marker = { color: curve.color, size: keys.length === 3 ? 5 : plot.equal ? 3 : 4 };
      if (curve.look === "fill") Object.assign(trace, { fill: "toself", hoverinfo: "skip", opacity: 0.3 });
      if (curve.look === "fill") trace.line.width = 0;
      return Object.assign(trace, curve.more);
    });
  }

  function axisOf(plot, k, last) {
    const grid = "rgba(128, 128, 128, 0.25)";
    const axis = {
      title: { text: plot.axes[k], font: { size: 11 }, standoff: 4 }, gridcolor: grid, zeroline: false,
      linecolor: "#808080", exponentformat: "e", tickfont: { size: 11 }, automargin: false,
    };
    if (plot.axes.length === 3) return Object.assign(axis, { gridcolor: "#999999", showbackground: false });
    axis.type = plot.log[k] ? "log" : "linear";
    axis.range = plot.log[k] ? plot.limits[k].map(Math.log10) : plot.limits[k].slice();
    // Numbers of many digits have to fit beside the plot.
    const [low, high] = plot.limits[k];
    if (high - low < 1e-3 * Math.max(Math.abs(low), Math.abs(high))) axis.tickfont = { size: 9 };
    if (plot.log[k]) axis.dtick = Math.max(1, Math.ceil((axis.range[1] - axis.range[0]) / 5));
    if (plot.equal) Object.assign(axis, { visible: false });
    if (plot.second) {
      Object.assign(axis, k ? { nticks: 5 } : { showgrid: false, showticklabels: last, ticks: "outside", ticklen: 3 });
      if (!last) axis.title = { text: "" };
    }
    if (plot.notes.length) Object.assign(axis, k ? { showticklabels: false } : {});
    return axis;
  }

  // Axes of one scale in a box whose longest edge is 1, so that flat and long paths fill the view, too.
  function inSpace(plot) {
    const ends = [0, 1, 2].map((k) => {
      let low = Infinity, high = -Infinity;
      for (const curve of plot.curves) {
        for (const value of arrays[curve.points[k]]) {
          if (value < low) low = value;
          if (value > high) high = value;
        }
      }
      return [low, high];
    });
    const most = Math.max(...ends.map(([low, high]) => high - low));
    const edges = ends.map(([low, high]) => 1.06 * Math.max(high - low, 0.1 * most));
    const scene = { aspectmode: "manual", aspectratio: {} };
    ["x", "y", "z"].forEach((name, k) => {
      const middle = (ends[k][0] + ends[k][1]) / 2;
      const range = [middle - edges[k] / 2, middle + edges[k] / 2];
      scene[`${name}axis`] = { ...axisOf(plot, k), range, exponentformat: "none", separatethousands: false, nticks: edges[k] < 0.3 * most ? 3 : 6 };
      scene.aspectratio[name] = edges[k] / (1.06 * most);
    });
    return scene;
  }

  // The eye so far from the box that it fills the view, narrow or wide, and no label is cut.
  function eyeOf(box, width, height) {
    const far = Math.max(1.15 * Math.hypot(box.x, box.y, box.z), 1.6 * box.z) * Math.max(1, (1.35 * height) / width);
    return { eye: { x: 0.69 * far, y: 0.52 * far, z: 0.5 * far }, center: { x: 0, y: 0, z: -0.08 } };
  }

  function layoutOf(plot, last, width) {
    const three = plot.axes.length === 3;
    const bottom = plot.equal || (plot.second && !last) ? 12 : plot.axes[0] ? 40 : 26;
    const layout = {
      margin: { l: plot.notes.length || plot.equal ? 14 : LEFT, r: RIGHT, t: TOP, b: bottom },
      paper_bgcolor: "rgba(0, 0, 0, 0)", plot_bgcolor: "rgba(0, 0, 0, 0)",
      font: { color: style("--text"), size: 11, family: getComputedStyle(document.body).fontFamily },
      hovermode: plot.second ? false : "closest", dragmode: three ? "turntable" : dragging ? "zoom" : false,
      barmode: "overlay", shapes: plot.shapes.map((shape) => ({ ...shape, line: { color: style("--soft"), ...shape.line } })),
      annotations: plot.notes,
    };
    layout.height = (three ? 420 : plot.second ? 132 : plot.log[0] ? 420 : 220) + (layout.margin.b - 12);
    if (three) {
      const space = inSpace(plot);
      layout.scene = { ...space, camera: eyeOf(space.aspectratio, width, layout.height) };
      layout.margin = { l: 0, r: 0, t: 0, b: 0 };
      return layout;
    }
    layout.xaxis = axisOf(plot, 0, last);
    layout.yaxis = axisOf(plot, 1, last);
    if (plot.equal) layout.yaxis.scaleanchor = "x";
    if (plot.second && span) layout.xaxis.range = span.map((t) => t * plot.second);
    return layout;
  }

  // Place of the sample at or before `t`, or of the nearest; -1 where there is none.
  function sampleAt(time, t, step) {
    let low = 0, high = time.length - 1;
    if (high === -1 || !(t >= time[0])) return -1;
    if (t > time[high]) return step ? high : -1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (time[middle] > t) high = middle; else low = middle;
    }
    if (time[high] <= t) return high;
    return !step && time[high] - t < t - time[low] ? high : low;
  }

  function written(value, range) {
    if (!(Math.abs(value) >= 0)) return "\u2014";
    const digits = Math.ceil(Math.log10(Math.abs(value) / Math.abs(range[1] - range[0]) || 1)) + 4;
    const text = value.toPrecision(Math.min(Math.max(digits, 5), 16));
    return (/e/.test(text) ? text : String(Number(text))).replace(/-/g, "\u2212");
  }

  // Show the values at `t` seconds in all plots over time.
  function point(t) {
    const unit = shown.find((one) => one.plot.second && one.plot.second !== 1);
    const name = unit && (unit.plot.second < 1 / 80000 ? "d" : "h");
    clock.value = t === null ? "" : `t = ${written(t, [0, 1])} s${unit ? ` = ${(t * unit.plot.second).toFixed(4)} ${name}` : ""}`;
    for (const { plot, canvas, hair, outputs } of shown) {
      if (!plot.second) continue;
      const [first, end] = canvas.layout.xaxis.range;
      const at = t === null ? NaN : t * plot.second;
      const place = (at - first) / (end - first);
      hair.hidden = !(place >= 0 && place <= 1);
      hair.style.left = `${LEFT + place * (canvas.clientWidth - LEFT - RIGHT)}px`;
      plot.curves.forEach((curve, k) => {
        if (!outputs[k]) return;
        const step = curve.look === "step";
        const found = t === null ? -1 : sampleAt(arrays[curve.points[0]], at, step);
        outputs[k].value = found === -1 ? (t === null ? "" : "\u2014") : written(arrays[curve.points[1]][found], canvas.layout.yaxis.range);
      });
    }
  }

  async function zoom(to, from) {
    span = to;
    busy = true;
    const redrawn = shown.filter((one) => one.plot.second && one !== from).map((one) => {
      const range = to ? to.map((t) => t * one.plot.second) : one.plot.limits[0];
      const change = { "xaxis.range": [...range] };
      if (!to) change["yaxis.range"] = axisOf(one.plot, 1, true).range;
      return Plotly.relayout(one.canvas, change);
    });
    await Promise.all(redrawn);
    busy = false;
  }

  async function draw(figure, number) {
    const { plots, columns } = data.figures[number];
    const box = make("div", "plots", "", figure);
    figure.prepend(box);
    box.style.setProperty("--columns", matchMedia("(max-width: 40rem)").matches ? 1 : columns);
    figure.classList.add("touched");
    for (const plot of plots) {
      const last = plot === plots[plots.length - 1];
      const part = make("div", "plot", "", box);
      make("h3", "", plot.title, part);
      const keys = make("div", "keys", "", part);
      const canvas = make("div", "canvas", "", part);
      const one = { plot, canvas, outputs: [], last };
      await Plotly.newPlot(canvas, traces(plot), layoutOf(plot, last, canvas.clientWidth), { displayModeBar: false, responsive: true, doubleClick: false });
      one.hair = make("div", "hair", "", canvas);
      one.hair.hidden = true;
      one.hair.style.bottom = `${canvas.layout.margin.b}px`;
      plot.curves.forEach((curve, k) => {
        if (!curve.label) {
          if (plot.second) one.outputs[k] = make("output", "", "", keys);
          return;
        }
        const key = make("button", "key", "", keys);
        key.type = "button";
        key.setAttribute("aria-pressed", "true");
        const swatch = make("i", curve.look, "", key);
        swatch.style.color = curve.color;
        make("span", "", curve.label, key);
        if (plot.second && curve.look !== "fill") one.outputs[k] = make("output", "", "", key);
        key.addEventListener("click", () => {
          const on = key.getAttribute("aria-pressed") !== "true";
          key.setAttribute("aria-pressed", String(on));
          Plotly.restyle(canvas, { visible: on }, [k]);
        });
      });
      shown.push(one);
      if (plot.axes.length === 2) canvas.on("plotly_doubleclick", () => (plot.second ? zoom(null) : Plotly.relayout(canvas, { "xaxis.range": axisOf(plot, 0, last).range, "yaxis.range": axisOf(plot, 1, last).range })));
      if (!plot.second) continue;
      canvas.on("plotly_relayout", (change) => {
        if (!busy && "xaxis.range[0]" in change) zoom([change["xaxis.range[0]"], change["xaxis.range[1]"]].map((x) => x / plot.second), one);
      });
      const look = (event) => {
        const [first, end] = canvas.layout.xaxis.range;
        const box = canvas.getBoundingClientRect();
        const at = first + ((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)) * (end - first);
        // To the nearest sample, whose values are shown.
        const curve = plot.curves.find((each) => each.look !== "fill");
        const time = arrays[curve.points[0]];
        const found = sampleAt(time, at, false);
        point((found === -1 || curve.look === "step" ? at : time[found]) / plot.second);
      };
      canvas.addEventListener("pointermove", look);
      canvas.addEventListener("pointerdown", look);
    }
  }

  function restyle() {
    for (const { plot, canvas, last } of shown) {
      const layout = layoutOf(plot, last);
      Plotly.relayout(canvas, { "font.color": layout.font.color, shapes: layout.shapes, dragmode: layout.dragmode });
    }
    drag.setAttribute("aria-pressed", String(dragging));
    drag.textContent = dragging ? "Drag: zooms" : "Drag: scrolls";
  }

  async function start() {
    const stream = new Blob([bytes(packed.textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = make("script", "", await new Response(stream).text(), null);
    document.head.append(script);
    const canTurn = Boolean(document.createElement("canvas").getContext("webgl"));
    const figures = [...document.querySelectorAll("figure")];
    const watcher = new IntersectionObserver((seen) => {
      for (const { target, isIntersecting } of seen) {
        if (!isIntersecting) continue;
        watcher.unobserve(target);
        draw(target, figures.indexOf(target)).catch(() => target.classList.remove("touched"));
      }
    }, { rootMargin: "600px" });
    // The bar covers text: it is there only with a plot.
    const inView = new Set();
    const looker = new IntersectionObserver((seen) => {
      for (const { target, isIntersecting } of seen) inView[isIntersecting ? "add" : "delete"](target);
      bar.classList.toggle("away", !inView.size);
    }, { rootMargin: "-80px" });
    figures.forEach((figure, number) => {
      const { plots } = data.figures[number];
      if (plots.length && (canTurn || plots.every((plot) => plot.axes.length === 2))) {
        watcher.observe(figure);
        looker.observe(figure);
      }
    });
    document.querySelector("main").append(bar);
    whole.addEventListener("click", () => zoom(null));
    drag.addEventListener("click", () => { dragging = !dragging; restyle(); });
    restyle();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", restyle);
    document.documentElement.dataset.plots = "ready";
  }
  start();
})();
