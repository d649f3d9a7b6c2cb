"use strict";
// A flight on a page: joins scene, time lines, controls and text.

class Player {
  /** Fill a copy of the flight's markup with a flight. */
  constructor(root, flight) {
    Object.assign(this, { root, flight: flight.data, time: 0, playing: false });
    this.paths = this.flight.paths.map((path) => new Path(path));
    this.end = Math.max(...this.paths.map((path) => path.end));
    this.find = (selector) => root.querySelector(selector);
    this.fillTexts(flight);
    this.tellLines();
    this.find(".stage").insertAdjacentHTML("beforeend", planView(this.flight.world, this.paths));
    this.scene = this.makeScene(flight);
    this.charts = new Charts(this.find(".charts"), this.flight, this.paths, (time) => this.seek(time));
    this.bind();
    this.seek(this.flight.fault ?? this.end);
  }

  makeScene(flight) {
    const canvas = this.find("canvas");
    canvas.setAttribute("aria-label", `Flight in three dimensions. ${flight.title}. ${flight.verdict}`);
    try {
      return new FlightScene(canvas, this.flight.world, this.paths, this.flight.fault);
    } catch (error) { // no WebGL: the plan says the same in two dimensions
      this.find(".stage").classList.add("flat");
      this.find(".views").hidden = true;
      this.find(".turning").hidden = true;
      return { setTime() {}, show() {}, view() {}, build() {}, dispose() {} };
    }
  }

  fillTexts(flight) {
    this.find(".flights tbody").replaceChildren(...this.paths.map((path) => this.flightRow(path)));
    this.find(".story").replaceChildren(...flight.story.flatMap(([heading, sentence]) => [
      element("dt", {}, heading), element("dd", {}, sentence)]));
    this.find(".commands").replaceChildren(...flight.commands.flatMap(([what, command]) => [
      element("p", {}, what), element("code", { class: "command", tabindex: "0" }, command)]));
  }

  tellLines() {
    if (!this.flight.lines.length) return;
    this.find(".lines-title").textContent = "Around the fault";
    this.find(".lines-caption").hidden = false;
  }

  flightRow(path) {
    const box = element("input", { type: "checkbox", checked: "", "aria-label": `show ${path.label}` });
    box.addEventListener("change", () => this.scene.show(path.role, box.checked));
    const label = element("label", {}, box, " ", element("i", { class: `swatch ${path.role}` }), path.label);
    const end = element("td", { class: path.success ? "good" : "bad" }, `${path.success ? "✓" : "✗"} ${path.status}`);
    const alarms = element("td", {}, path.alarms.length ? String(path.alarms.length) : "none");
    return element("tr", {}, element("td", {}, label), end, element("td", {}, `${path.end.toFixed(2)} s`), alarms);
  }

  bind() {
    const slider = this.find(".track input");
    slider.max = this.end;
    slider.addEventListener("input", () => this.seek(Number(slider.value)));
    this.find(".play").addEventListener("click", () => this.toggle());
    const toFault = this.find(".to-fault");
    toFault.disabled = this.flight.fault === null;
    toFault.addEventListener("click", () => this.seek(this.flight.fault));
    for (const button of this.root.querySelectorAll(".views button")) {
      button.addEventListener("click", () => this.choose(button));
    }
    this.root.addEventListener("keydown", (event) => this.key(event));
    if (this.flight.fault !== null) this.tick(this.flight.fault, "fault");
    for (const path of this.paths) for (const [time, near] of path.alarms) if (near) this.tick(time, "alarm");
  }

  tick(time, kind) {
    const mark = element("i", { class: kind, "aria-hidden": "true" });
    mark.style.left = `${(100 * time) / this.end}%`;
    this.find(".track").append(mark);
  }

  choose(chosen) {
    for (const button of this.root.querySelectorAll(".views button")) {
      button.setAttribute("aria-pressed", String(button === chosen));
    }
    this.scene.view(chosen.dataset.view);
  }

  key(event) {
    if (event.target.closest("input, select, button, a, summary")) return;
    const step = event.shiftKey ? 1 : 0.1;
    const actions = {
      " ": () => this.toggle(), ArrowLeft: () => this.seek(this.time - step), ArrowRight: () => this.seek(this.time + step),
      Home: () => this.seek(0), End: () => this.seek(this.end), f: () => this.seek(this.flight.fault ?? this.time),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  }

  seek(time) {
    this.time = Math.min(this.end, Math.max(0, time));
    const slider = this.find(".track input");
    slider.value = this.time;
    slider.setAttribute("aria-valuetext", `${this.time.toFixed(2)} seconds`);
    this.find(".controls output").textContent = `${this.time.toFixed(2)} s`;
    this.scene.setTime(this.time);
    this.charts.setTime(this.time);
  }

  toggle() {
    this.playing = !this.playing;
    this.find(".play").textContent = this.playing ? "❚❚ Pause" : "▶ Play";
    if (!this.playing) return;
    if (this.time >= this.end) this.seek(0);
    this.last = performance.now();
    requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    if (!this.playing) return;
    const speed = Number(this.find(".speed").value);
    this.seek(this.time + (speed * (now - this.last)) / 1000);
    this.last = now;
    if (this.time >= this.end) this.toggle(); else requestAnimationFrame((next) => this.step(next));
  }

  recolour() {
    this.scene.build();
    this.charts.build();
    this.seek(this.time);
  }

  dispose() {
    this.playing = false;
    this.scene.dispose();
    this.charts.dispose();
  }
}
