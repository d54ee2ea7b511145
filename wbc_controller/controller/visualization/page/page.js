"use strict";
/* Connects motion view, controls and plots of a page through a common time. A single pose has no time bar.
   URL fragment: t (time, s; paused), az and el (camera angles, degrees), zoom, only=replay. */
(() => {
  const read = id => JSON.parse(document.getElementById(id)?.textContent ?? "null");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const motion = read("motion-data"), plots = read("plot-data");
  const player = motion && makePlayer(motion);
  if (plots) drawPlots(plots);
  window.replay = player;

  /** Phases of the motion above the slider and the plots. */
  function phaseStrip(strip, range) {
    const [low, high] = range;
    strip.replaceChildren(...motion.phases.map(([start, end, name]) => {
      const span = document.createElement("span");
      const a = Math.max(start, low), b = Math.min(end, high);
      span.textContent = span.title = name;
      span.style.left = 100 * (a - low) / (high - low) + "%";
      span.style.width = Math.max(0, 100 * (b - a) / (high - low)) + "%";
      if (b <= a) span.hidden = true;
      return span;
    }));
  }

  function makePlayer(data) {
    const box = document.getElementById("replay");
    const find = selector => box.querySelector(selector);
    const canvas = find("canvas"), slider = find("input[type=range]"), play = find(".play"), clock = find(".clock");
    const view = new Replay.View(canvas, new Replay.Scene(data));
    const state = { time: data.start, playing: false, speed: 1, seen: true };
    const listeners = [];  // called with the time
    const last = (list, t) => list.filter(item => item[0] <= t + 1e-9).pop();
    const moves = data.phases.length > 0 || data.duration - data.start > 2;

    function seek(time) {
      state.time = Math.min(Math.max(time, data.start), data.duration);
      state.dirty = true;
    }
    function setPlaying(on) {
      if (on && state.time >= data.duration) seek(data.start);
      state.playing = on;
      play.classList.toggle("on", on);
    }
    function paint() {
      state.dirty = false;
      view.draw(state.time);
      slider.value = state.time;
      clock.textContent = state.time.toFixed(2) + " / " + data.duration.toFixed(1) + " s";
      const phase = last(data.phases, state.time), mode = last(data.modes, state.time);
      find(".phase").textContent = phase ? phase[2] : "";
      find(".mode").textContent = mode ? "mode: " + mode[1] : "";
      const spans = find(".track .phases").children;
      for (let i = 0; i < spans.length; i++) spans[i].classList.toggle("now", data.phases[i] === phase);
      for (const listener of listeners) listener(state.time);
    }
    let before = 0;
    function tick(now) {
      const passed = Math.min(0.1, (now - before) / 1000);
      before = now;
      if (state.playing && state.seen) {
        const next = state.time + passed * state.speed;
        seek(next > data.duration ? data.start : next);
      }
      if (state.dirty && state.seen) paint();
      requestAnimationFrame(tick);
    }
    function readHash() {
      const hash = new URLSearchParams(location.hash.slice(1));
      const number = (name, otherwise) => (hash.has(name) && Number.isFinite(Number(hash.get(name)))
        ? Number(hash.get(name)) : otherwise);
      document.body.classList.toggle("only-replay", hash.get("only") === "replay");
      view.azimuth = number("az", view.azimuth * 180 / Math.PI) * Math.PI / 180;
      view.elevation = number("el", view.elevation * 180 / Math.PI) * Math.PI / 180;
      view.zoom = number("zoom", view.zoom);
      seek(number("t", state.time));
      setPlaying(moves && !hash.has("t") && !matchMedia("(prefers-reduced-motion: reduce)").matches);
    }

    find(".bar").hidden = !moves;
    find("[name=true]").closest("label").hidden = !data.forces_are_true;
    slider.min = data.start;
    slider.max = data.duration;
    slider.addEventListener("input", () => { setPlaying(false); seek(Number(slider.value)); });
    play.addEventListener("click", () => setPlaying(!state.playing));
    find("select").addEventListener("change", event => { state.speed = Number(event.target.value); });
    find(".reset").addEventListener("click", () => { view.reset(); state.dirty = true; });
    for (const input of box.querySelectorAll(".key input")) {
      input.addEventListener("change", () => { view.show[input.name] = input.checked; state.dirty = true; });
    }
    view.steer(() => { state.dirty = true; });
    canvas.addEventListener("keydown", event => {
      if (event.key === " ") setPlaying(moves && !state.playing);
      else if (event.key === "ArrowLeft" || event.key === "ArrowRight") seek(state.time + (event.key === "ArrowLeft" ? -0.1 : 0.1));
      else return;
      event.preventDefault();
    });
    new ResizeObserver(() => { state.dirty = true; }).observe(canvas);
    new IntersectionObserver(entries => { state.seen = entries[entries.length - 1].isIntersecting; }).observe(box);
    dark.addEventListener("change", () => { state.dirty = true; });
    phaseStrip(find(".track .phases"), [data.start, data.duration]);
    addEventListener("hashchange", readHash);
    readHash();
    paint();
    requestAnimationFrame(now => { before = now; tick(now); });
    return { view, seek, setPlaying, listeners, now: () => state.time };
  }

  function drawPlots(figures) {
    const charts = [];
    for (const figure of document.querySelectorAll("[data-plot]")) {
      const { data: traces, layout } = figures[figure.dataset.plot];
      const chart = figure.querySelector(".chart");
      const options = { responsive: true, displayModeBar: false };
      Plotly.newPlot(chart, traces, { ...layout, ...themed(layout) }, options).then(() => {
        charts.push(chart);
        drawLegend(figure, chart);
        if (player && figure.dataset.overTime === "true") followTime(figure, chart);
      });
    }
    dark.addEventListener("change", () => {
      for (const chart of charts) Plotly.relayout(chart, themed(chart.layout));
    });
  }
  function themed(layout) {
    const style = getComputedStyle(document.documentElement);
    const color = name => style.getPropertyValue("--" + name).trim();
    const changes = { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
                      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: color("soft") },
                      hoverlabel: { bgcolor: color("card"), bordercolor: color("line"), font: { color: color("text") } } };
    for (const key of Object.keys(layout)) {
      if (!/^[xy]axis\d*$/.test(key)) continue;
      changes[key] = { ...layout[key], gridcolor: color("line"), linecolor: color("line"), zerolinecolor: color("line"),
                       zerolinewidth: 1, tickcolor: color("line"), ticks: "outside", ticklen: 4 };
      if (key[0] === "x") Object.assign(changes[key], { showgrid: false, showline: true });
    }
    return changes;
  }
  function drawLegend(figure, chart) {
    const entries = new Map();
    chart.data.forEach((trace, i) => {
      if (!trace.name) return;
      const group = trace.legendgroup || trace.name;
      if (!entries.has(group)) entries.set(group, { trace, members: [] });
      entries.get(group).members.push(i);
    });
    for (const { trace, members } of entries.values()) {
      const button = document.createElement("button"), mark = document.createElement("i");
      button.type = "button";
      mark.style.setProperty("--c", (trace.mode === "lines" && trace.line.color) || trace.marker.color);
      if (trace.line && trace.line.dash) mark.className = trace.line.dash;
      button.append(mark, trace.name);
      button.addEventListener("click", () => {
        const off = button.classList.toggle("off");
        Plotly.restyle(chart, { visible: !off }, members);
      });
      figure.querySelector(".legend").append(button);
    }
  }
  function followTime(figure, chart) {
    const strip = figure.querySelector(".phases"), cursor = document.createElement("div");
    cursor.className = "cursor";
    chart.append(cursor);
    const axis = () => chart.layout.xaxis.range.map(Number);
    const place = time => {
      const [low, high] = axis(), share = (time - low) / (high - low), margin = chart.layout.margin;
      cursor.hidden = !(share >= 0 && share <= 1);
      cursor.style.left = margin.l + share * (chart.clientWidth - margin.l - margin.r) + "px";
    };
    const refresh = () => { phaseStrip(strip, axis()); place(player.now()); };
    player.listeners.push(place);
    chart.on("plotly_relayout", refresh);
    chart.on("plotly_click", event => { player.setPlaying(false); player.seek(event.points[0].x); });
    new ResizeObserver(() => place(player.now())).observe(chart);
    refresh();
  }
})();
