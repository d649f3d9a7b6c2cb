"use strict";
// The list of runs: filters, order, links from cells and points, pages of rows.

const ROWS = 50;
const FLIES = typeof flyRun === "function"; // a server flies runs that are not in the page, see `mavfi serve`
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
    Object.assign(this, { stored, page: 0, chosen: {}, members: null, order: { name: "", descending: false } });
    this.form = document.querySelector(".filters");
    this.bind();
    this.take(data);
  }

  /** Take other data, e.g. of a campaign that has gone on; the form is left alone while it is in use. */
  take(data) {
    this.data = data;
    this.searchTexts = [];
    const differs = (name) => data.texts[name].values.filter((value) => value !== "").length > 1;
    this.shownFilters = Object.keys(data.filters).filter(differs);
    if (!this.form.contains(document.activeElement)) this.buildForm();
  }

  bind() {
    this.form.addEventListener("input", () => this.choose(Object.fromEntries(new FormData(this.form)), null));
    this.form.addEventListener("reset", () => setTimeout(() => this.choose({}, null)));
    this.form.addEventListener("submit", (event) => event.preventDefault());
    document.querySelector(".runs tbody").addEventListener("click", (event) => {
      const isSelecting = String(getSelection()) !== "";
      if (!isSelecting && !event.target.closest("a")) event.target.closest("tr").querySelector("a").click();
    });
  }

  text(name, run) {
    const column = this.data.texts[name];
    return column.values[column.codes[run]];
  }

  buildForm() {
    this.form.replaceChildren();
    for (const name of this.shownFilters) {
      const select = element("select", { name });
      select.append(new Option("all", ""));
      const values = this.data.texts[name].values.filter((value) => value !== "");
      values.sort((a, b) => (name === "bit" ? a - b : a.localeCompare(b)));
      select.append(...values.map((value) => new Option(value, value)));
      this.form.append(element("label", {}, this.data.filters[name], select));
    }
    this.form.append(element("label", {}, "search", element("input", { type: "search", name: "text" })));
    if (this.stored.size) {
      const box = element("select", { name: "flight" });
      box.append(new Option("all", ""), new Option("with flight", "yes"));
      this.form.append(element("label", {}, "page", box));
    }
    const reset = element("button", { type: "reset" }, "All runs");
    const csv = element("button", { type: "button" }, "CSV");
    csv.addEventListener("click", () => download("runs.csv", this.csv()));
    this.form.append(reset, csv);
    this.fillForm();
  }

  fillForm() {
    for (const control of this.form.elements) if (control.name) control.value = this.chosen[control.name] ?? "";
  }

  buildHead() {
    const heads = ["run", ...this.columns, ...Object.keys(NUMBER_HEADINGS)].map((name) => this.head(name));
    document.querySelector(".runs thead").replaceChildren(element("tr", {}, ...heads));
  }

  head(name) {
    const button = element("button", { type: "button" }, this.data.filters[name] ?? NUMBER_HEADINGS[name] ?? name);
    button.addEventListener("click", () => this.sortBy(name));
    const head = element("th", { scope: "col", "data-column": name }, button);
    if (this.order.name === name) head.setAttribute("aria-sort", this.order.descending ? "descending" : "ascending");
    return head;
  }

  /** Sort by a column: ascending, descending, then in the order of the plan again. */
  sortBy(name) {
    if (this.order.name !== name) this.order = { name, descending: false };
    else if (!this.order.descending) this.order.descending = true;
    else this.order = { name: "", descending: false };
    this.page = 0;
    this.list();
    document.querySelector(`.runs th[data-column="${name}"] button`).focus();
  }

  /** Show the runs of a set (place in `sets`, null = all) that meet filters, given by column. */
  choose(chosen, set) {
    this.chosen = Object.fromEntries(Object.entries(chosen).filter(([, value]) => value !== ""));
    this.members = set === null ? null : new Set(rangesOf(this.data.sets[set]).map((run) => this.data.ids[run]));
    this.fillForm();
    this.page = 0;
    this.list();
  }

  list() {
    this.found = this.sorted(this.candidates().filter((run) => this.meets(run)));
    this.show();
  }

  candidates() {
    const runs = this.data.ids.map((_, run) => run);
    return this.members === null ? runs : runs.filter((run) => this.members.has(this.data.ids[run]));
  }

  /** Runs in the chosen order; those without a value come last. */
  sorted(runs) {
    const { name, descending } = this.order;
    if (name === "") return runs;
    const values = runs.map((run) => [run, this.sortValue(name, run)]);
    const sign = descending ? -1 : 1;
    values.sort(([, a], [, b]) => {
      if (a === b) return 0;
      if (a === null || b === null) return a === null ? 1 : -1;
      return a < b ? -sign : sign;
    });
    return values.map(([run]) => run);
  }

  sortValue(name, run) {
    if (name === "run") return this.data.ids[run];
    if (this.data.numbers[name]) return this.data.numbers[name][run];
    const text = this.text(name, run);
    if (text === "") return null;
    return name === "bit" ? Number(text) : text;
  }

  /** Id and all texts of a run in lower case, which the search looks at. */
  searchText(run) {
    const texts = () => [this.data.ids[run], ...Object.keys(this.data.filters).map((name) => this.text(name, run))];
    this.searchTexts[run] ??= texts().join(" ").toLowerCase();
    return this.searchTexts[run];
  }

  meets(run) {
    return Object.entries(this.chosen).every(([name, value]) => {
      if (name === "text") return value.toLowerCase().split(" ").every((word) => this.searchText(run).includes(word));
      if (name === "flight") return this.stored.has(this.data.ids[run]);
      return !this.data.texts[name] || this.text(name, run) === value;
    });
  }

  show() {
    const chosen = { ...this.shared(), ...this.chosen };
    const filters = Object.entries(chosen).map(([name, value]) => `${this.data.filters[name] ?? name} ${value}`);
    const source = this.members === null ? "" : " behind the chosen cell or point";
    const flights = FLIES ? " A click on a run flies it again." : ` ${this.stored.size} have their flight in this file (●); the commands above show the others.`;
    document.getElementById("runs-summary").textContent =
      `${this.found.length} of ${this.data.ids.length} runs${source}${filters.length ? `; ${filters.join(", ")}` : ""}.${flights}`;
    const rows = this.found.slice(ROWS * this.page, ROWS * (this.page + 1));
    const isOpen = (name) => !(name in this.chosen) && this.found.some((run) => this.text(name, run) !== "");
    this.columns = this.shownFilters.filter(isOpen); // without those that a filter makes equal in all rows
    this.buildHead();
    document.querySelector(".runs tbody").replaceChildren(...rows.map((run) => this.row(run)));
    this.showPager();
  }

  /** The values that all runs of a set have in common. */
  shared() {
    if (this.members === null || !this.found.length) return {};
    const values = this.shownFilters.map((name) => [name, this.text(name, this.found[0])]);
    return Object.fromEntries(values.filter(([name, value]) => (
      value !== "" && this.found.every((run) => this.text(name, run) === value))));
  }

  row(run) {
    const id = this.data.ids[run];
    const link = element("a", { href: `#run/${encodeURIComponent(id)}`, title: id }, id);
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
