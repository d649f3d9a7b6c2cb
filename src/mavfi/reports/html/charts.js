"use strict";
// Time lines under the scene: speed and height of the whole flight, published fields around the fault.

const STROKES = { golden: 4, injected: 2, recovered: 1.6 };
const ORDER = ["golden", "injected", "recovered"];

class Charts {
  constructor(root, flight, paths, seek) {
    Object.assign(this, { root, flight, paths, seek, plots: [] });
    this.build();
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(root);
  }

  build() {
    for (const { plot } of this.plots) plot.destroy();
    this.plots = [];
    this.root.replaceChildren();
    for (const line of this.flight.lines) this.add(line, true);
    this.add({ label: "speed", unit: "m/s", data: this.columns(4) }, false);
    this.add({ label: "height", unit: "m", data: this.columns(3) }, false);
  }

  columns(place) {
    return Object.fromEntries(this.paths.map((path) => [path.role, [path.column(0), path.column(place)]]));
  }

  add(line, stepped) {
    const roles = ORDER.filter((role) => line.data[role] && line.data[role][0].length);
    const range = rangeOf(roles.map((role) => line.data[role][1]));
    const heading = element("h4", {}, line.label, " ", element("small", {}, line.unit));
    if (line.site) heading.append(element("small", { class: "injected-field" }, " injected field"));
    const box = element("div", { class: "chart", role: "img", "aria-label": describe(line, roles) }, heading);
    const off = Math.max(...roles.flatMap((role) => line.data[role][1].map((value) => beyond(value, range))));
    if (off > 0) box.append(element("p", {}, `Off the scale: up to ${off.toPrecision(3)}.`));
    this.root.append(box);
    const times = bounds(roles.flatMap((role) => line.data[role][0]));
    const plot = new uPlot(this.options(roles, range, stepped, times), joined(roles, line, range), box);
    const fault = element("i", { class: "faultline" });
    const head = element("i", { class: "playhead" });
    plot.over.append(fault, head);
    plot.over.addEventListener("click", (event) => this.seek(plot.posToVal(event.offsetX, "x")));
    this.plots.push({ plot, head, times, box });
    placeAt(fault, times, this.flight.fault);
  }

  options(roles, range, stepped, times) {
    const axis = { stroke: css("soft"), grid: { stroke: css("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const paths = stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
    return {
      width: this.width(), height: 150, legend: { show: false }, cursor: { y: false, drag: { x: false } },
      scales: { x: { time: false, range: times }, y: { range } },
      axes: [{ ...axis, size: 26, values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(3)} s`) },
        { ...axis, size: 52, values: (_, ticks) => ticks.map((tick) => String(+tick.toPrecision(6))) }],
      series: [{}, ...roles.map((role) => ({
        stroke: css(role), width: STROKES[role], paths, spanGaps: true, points: { show: false },
        dash: role === "recovered" ? [6, 4] : undefined,
      }))],
    };
  }

  width() {
    const columns = getComputedStyle(this.root).gridTemplateColumns.split(" ");
    return Math.max(200, Math.floor(parseFloat(columns[0]) || this.root.clientWidth));
  }

  setTime(time) {
    for (const { times, head } of this.plots) placeAt(head, times, time);
  }

  resize() {
    for (const { plot, box } of this.plots) plot.setSize({ width: box.clientWidth, height: 150 });
  }

  dispose() {
    this.observer.disconnect();
    for (const { plot } of this.plots) plot.destroy();
  }
}

/** Place an upright line at an instant (s) of a chart. */
function placeAt(node, [first, last], time) {
  node.hidden = time === null || time < first || time > last;
  node.style.left = `${(100 * (time - first)) / (last - first)}%`;
}

/** Bounds of the y axis: the golden run's values and, where they are not far away, those of the others. */
function rangeOf(series) {
  const finite = series.map((values) => values.filter((value) => value !== null));
  let [low, high] = bounds(finite[0]);
  const span = Math.max(high - low, 1e-3 * Math.abs(high), 1e-3);
  const near = finite.slice(1).flat().filter((value) => value > low - 4 * span && value < high + 4 * span);
  [low, high] = bounds([low, high, ...near]);
  const margin = 0.08 * Math.max(high - low, 1e-3);
  return [low - margin, high + margin];
}

function bounds(values) {
  return values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
}

function beyond(value, [low, high]) {
  return value === null || (value >= low && value <= high) ? -Infinity : Math.abs(value);
}

/** One table of all instants; values off the scale stay at its edge. */
function joined(roles, line, [low, high]) {
  const clip = (value) => (value === null ? null : Math.min(high, Math.max(low, value)));
  return uPlot.join(roles.map((role) => [line.data[role][0], line.data[role][1].map(clip)]));
}

function describe(line, roles) {
  const values = roles.map((role) => {
    const [low, high] = bounds(line.data[role][1].filter((value) => value !== null));
    return `${role} flight from ${low.toPrecision(4)} to ${high.toPrecision(4)} ${line.unit}`;
  });
  return `${line.label}: ${values.join(", ")}`;
}
