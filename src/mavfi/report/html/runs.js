"use strict";
// The list of runs: filters, links from cells and points, pages of rows.

const ROWS = 50;
const NUMBER_HEADINGS = { flight_time_s: "flight time", inflation: "against golden", alarms_total: "alarms" };

/** Numbers of a text of ranges, in order: "0-2 45" = [0, 1, 2, 45]. */
function rangesOf(text) {
  return text.split(" ").flatMap((range) => {
    const [low, high = low] = range.split("-").map(Number);
    return Array.from({ length: high - low + 1 }, (_, place) => low + place);
  });
}

class RunList {
  constructor(data, stored) {
    Object.assign(this, { data, stored, page: 0, chosen: {}, set: null });
    this.form = document.querySelector(".filters");
    const differs = (name) => data.texts[name].values.filter((value) => value !== "").length > 1;
    this.shownFilters = Object.keys(data.filters).filter(differs);
    this.buildForm();
  }

  text(name, run) {
    const column = this.data.texts[name];
    return column.values[column.codes[run]];
  }

  buildForm() {
    for (const name of this.shownFilters) {
      const select = element("select", { name });
      select.append(new Option("all", ""));
      const values = this.data.texts[name].values.filter((value) => value !== "");
      values.sort((a, b) => (name === "bit" ? a - b : a.localeCompare(b)));
      select.append(...values.map((value) => new Option(value, value)));
      this.form.append(element("label", {}, this.data.filters[name], select));
    }
    this.form.append(element("label", {}, "run id contains", element("input", { type: "search", name: "id" })));
    if (this.stored.size) {
      const box = element("select", { name: "flight" });
      box.append(new Option("all", ""), new Option("with flight", "yes"));
      this.form.append(element("label", {}, "page", box));
    }
    const reset = element("button", { type: "reset" }, "All runs");
    const csv = element("button", { type: "button" }, "CSV");
    csv.addEventListener("click", () => download("runs.csv", this.csv()));
    this.form.append(reset, csv);
    this.form.addEventListener("input", () => this.choose(Object.fromEntries(new FormData(this.form)), null));
    this.form.addEventListener("reset", () => setTimeout(() => this.choose({}, null)));
    this.form.addEventListener("submit", (event) => event.preventDefault());
  }

  buildHead() {
    const headings = ["run", ...this.columns.map((name) => this.data.filters[name]), ...Object.values(NUMBER_HEADINGS)];
    const cells = headings.map((heading) => element("th", { scope: "col" }, heading));
    document.querySelector(".runs thead").replaceChildren(element("tr", {}, ...cells));
  }

  /** Show the runs of a set (place in `sets`, null = all) that meet filters, given by column. */
  choose(chosen, set) {
    this.chosen = Object.fromEntries(Object.entries(chosen).filter(([, value]) => value !== ""));
    this.set = set;
    for (const control of this.form.elements) if (control.name) control.value = this.chosen[control.name] ?? "";
    this.page = 0;
    this.found = this.candidates().filter((run) => this.meets(run));
    this.show();
  }

  candidates() {
    if (this.set === null) return this.data.ids.map((_, run) => run);
    return rangesOf(this.data.sets[this.set]);
  }

  meets(run) {
    return Object.entries(this.chosen).every(([name, value]) => {
      if (name === "id") return this.data.ids[run].includes(value);
      if (name === "flight") return this.stored.has(this.data.ids[run]);
      return !this.data.texts[name] || this.text(name, run) === value;
    });
  }

  show() {
    const chosen = { ...this.shared(), ...this.chosen };
    const filters = Object.entries(chosen).map(([name, value]) => `${this.data.filters[name] ?? name} ${value}`);
    const source = this.set === null ? "" : " behind the chosen cell or point";
    document.getElementById("runs-summary").textContent =
      `${this.found.length} of ${this.data.ids.length} runs${source}${filters.length ? `; ${filters.join(", ")}` : ""}.`
      + ` ${this.stored.size} have their flight in this file (●); the commands above show the others.`;
    const rows = this.found.slice(ROWS * this.page, ROWS * (this.page + 1));
    this.columns = this.shownFilters.filter((name) => this.found.some((run) => this.text(name, run) !== ""));
    this.buildHead();
    document.querySelector(".runs tbody").replaceChildren(...rows.map((run) => this.row(run)));
    this.showPager();
  }

  /** The values that all runs of a set have in common. */
  shared() {
    if (this.set === null || !this.found.length) return {};
    const values = this.shownFilters.map((name) => [name, this.text(name, this.found[0])]);
    return Object.fromEntries(values.filter(([name, value]) => (
      value !== "" && this.found.every((run) => this.text(name, run) === value))));
  }

  row(run) {
    const id = this.data.ids[run];
    const link = element("a", { href: `#run/${encodeURIComponent(id)}` }, id);
    const mark = this.stored.has(id) ? element("span", { class: "has", title: "with its flight" }, " ●") : "";
    const texts = this.columns.map((name) => {
      const bad = name === "status" && this.text(name, run) !== "success";
      return element("td", bad ? { class: "bad" } : {}, this.text(name, run));
    });
    const numbers = Object.keys(NUMBER_HEADINGS).map((name) => element("td", { class: "number" }, this.number(name, run)));
    return element("tr", {}, element("td", {}, link, mark), ...texts, ...numbers);
  }

  number(name, run) {
    const value = this.data.numbers[name][run];
    if (value === null) return "—";
    if (name === "inflation") return `${value >= 0 ? "+" : "−"}${(100 * Math.abs(value)).toFixed(1)} %`;
    return name === "flight_time_s" ? `${value.toFixed(1)} s` : String(value);
  }

  showPager() {
    const last = Math.max(0, Math.ceil(this.found.length / ROWS) - 1);
    const button = (text, page, label) => {
      const made = element("button", { type: "button", "aria-label": label }, text);
      made.disabled = page < 0 || page > last;
      made.addEventListener("click", () => { this.page = page; this.show(); });
      return made;
    };
    document.querySelector(".pager").replaceChildren(
      button("←", this.page - 1, "previous page"), `page ${this.page + 1} of ${last + 1}`,
      button("→", this.page + 1, "next page"));
  }

  csv() {
    const names = [...Object.keys(this.data.filters), ...Object.keys(this.data.numbers)];
    const lines = this.found.map((run) => [this.data.ids[run], ...names.map((name) => (
      this.data.texts[name] ? this.text(name, run) : this.data.numbers[name][run] ?? ""))]);
    return [["run_id", ...names], ...lines].map((line) => line.map(quoted).join(",")).join("\n") + "\n";
  }
}

function quoted(value) {
  const text = String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

function download(name, text) {
  const link = element("a", { download: name, href: URL.createObjectURL(new Blob([text], { type: "text/csv" })) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
