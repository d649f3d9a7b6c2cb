"use strict";
// Time lines under the scene: speed and height of the whole flight, published fields around the fault.

const STROKES = { golden: 4, injected: 2, recovered: 1.6 };
const ORDER = ["golden", "injected", "recovered"];
const APART = 12;

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
    const off = roles.map((role) => beyond(line.data[role], range));
    const said = roles.flatMap((role, place) => (off[place].length ? [`${this.labelOf(role)} ${reach(off[place])}`] : []));
    if (said.length) box.append(element("p", {}, `Off the scale (▴ ▾): ${said.join("; ")}.`));
    this.root.append(box);
    const times = line.window || bounds(roles.flatMap((role) => line.data[role][0]));
    const plot = new uPlot(this.options(roles, range, stepped, times, off), joined(roles, line, range), box);
    const fault = element("i", { class: "faultline" });
    const head = element("i", { class: "playhead" });
    plot.over.append(fault, head);
    plot.over.addEventListener("click", (event) => this.seek(plot.posToVal(event.offsetX, "x")));
    this.plots.push({ plot, head, times, box });
    placeAt(fault, times, this.flight.fault);
  }

  labelOf(role) {
    return this.paths.find((path) => path.role === role).label;
  }

  options(roles, range, stepped, times, off) {
    const axis = { stroke: css("soft"), grid: { stroke: css("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const paths = stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
    return {
      width: this.width(), height: 150, legend: { show: false }, cursor: { y: false, drag: { x: false } },
      scales: { x: { time: false, range: times }, y: { range } },
      axes: [{ ...axis, size: 26, values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(3)} s`) },
        { ...axis, size: 52, values: (_, ticks) => ticks.map((tick) => String(+tick.toPrecision(6))) }],
      hooks: { draw: [(plot) => roles.forEach((role, place) => markBeyond(plot, css(role), off[place]))] },
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

/** Stretches of a line off the scale: instant of the first sample, and the value farthest away. */
function beyond([times, values], [low, high]) {
  const found = [];
  let last = 0;
  values.forEach((value, place) => {
    const side = value === null ? last : Math.sign(Math.max(0, value - high) - Math.max(0, low - value));
    if (side && side !== last) found.push({ time: times[place], side, value });
    if (side && value !== null) found.at(-1).value = side * Math.max(side * found.at(-1).value, side * value);
    last = side;
  });
  return found;
}

/** Farthest values of the stretches in words. */
function reach(stretches) {
  const ends = [[-1, "down to", Math.min], [1, "up to", Math.max]].map(([side, words, farthest]) => {
    const values = stretches.filter((one) => one.side === side).map((one) => one.value);
    return values.length ? `${words} ${short(farthest(...values))}` : "";
  });
  return ends.filter(Boolean).join(", ");
}

function short(value) {
  return value.toPrecision(3).replaceAll("-", "−");
}

/** Draw a triangle and its value at the edge where a line leaves the scale; where they would overlap, the first. */
function markBeyond(plot, colour, stretches) {
  const { ctx, bbox } = plot;
  const ratio = devicePixelRatio;
  const free = { "-1": -Infinity, 1: -Infinity };
  const freeText = { ...free };
  ctx.save();
  Object.assign(ctx, { fillStyle: colour, font: `${10 * ratio}px system-ui`, textAlign: "left", textBaseline: "middle" });
  for (const { time, side, value } of stretches) {
    const x = Math.min(plot.valToPos(time, "x", true) + 6 * ratio, bbox.left + bbox.width - 5 * ratio);
    if (x < free[side]) continue;
    free[side] = x + APART * ratio;
    const [edge, inward] = side > 0 ? [bbox.top, ratio] : [bbox.top + bbox.height, -ratio];
    ctx.beginPath();
    ctx.moveTo(x, edge + inward);
    ctx.lineTo(x - 4 * ratio, edge + 8 * inward);
    ctx.lineTo(x + 4 * ratio, edge + 8 * inward);
    ctx.fill();
    const wide = ctx.measureText(short(value)).width;
    if (x < freeText[side] || x + 6 * ratio + wide > bbox.left + bbox.width) continue;
    freeText[side] = x + 12 * ratio + wide;
    ctx.fillText(short(value), x + 6 * ratio, edge + 6 * inward);
  }
  ctx.restore();
}

/** One table of all instants.  A value off the scale leaves the frame, which cuts it, instead of following its edge. */
function joined(roles, line, [low, high]) {
  const outside = high - low;
  const clip = (value) => (value === null ? null : Math.min(high + outside, Math.max(low - outside, value)));
  return uPlot.join(roles.map((role) => [line.data[role][0], line.data[role][1].map(clip)]));
}

function describe(line, roles) {
  const values = roles.map((role) => {
    const [low, high] = bounds(line.data[role][1].filter((value) => value !== null));
    return `${role} flight from ${low.toPrecision(4)} to ${high.toPrecision(4)} ${line.unit}`;
  });
  return `${line.label}: ${values.join(", ")}`;
}
