"use strict";
// What an address of the page shows: the report, its runs with filters, or one run.

const stored = new Map(Array.from(document.querySelectorAll(".flight-data"), (node) => [node.dataset.run, node]));
const runList = new RunList(pageData("runs-data"), stored);
const csvTexts = pageData("csv-data");
let shownPlayer = null;
const REACH = 6;

function route() {
  const [name, rest = ""] = location.hash.slice(1).split(/[/?](.*)/s);
  const isRun = name === "run" && rest !== "";
  document.getElementById("report").hidden = isRun;
  document.getElementById("run").hidden = !isRun;
  if (shownPlayer) shownPlayer.dispose();
  shownPlayer = null;
  if (isRun) showRun(decodeURIComponent(rest));
  if (name === "runs") showRuns(new URLSearchParams(rest));
}

function showRuns(query) {
  const { set = null, ...filters } = Object.fromEntries(query);
  if ([...query].length) runList.choose(filters, set === null ? null : Number(set));
  document.getElementById("runs").scrollIntoView();
  document.getElementById("runs-title").focus({ preventScroll: true });
}

function showRun(id) {
  const run = runList.data.ids.indexOf(id);
  const article = document.getElementById("run-template").content.cloneNode(true);
  const flight = stored.has(id) ? JSON.parse(stored.get(id).textContent) : null;
  article.querySelector(".over").textContent = id;
  article.querySelector("h1").textContent = run < 0 ? "No such run" : "Run";
  if (run >= 0) article.querySelector(".row").append(...rowFacts(run));
  document.getElementById("run").replaceChildren(article);
  const place = document.querySelector("#run .place");
  if (flight) showFlight(flight);
  else if (run >= 0 && FLIES) flyRun(id, place);
  else if (run >= 0) place.append(...repeating("This flight is not stored in this file. The first command shows any run that is clicked, the others fly this one again:", run));
  scrollTo(0, 0);
  document.querySelector("#run h1").focus({ preventScroll: true });
}

/** Show a flight on the page of its run, which is open. */
function showFlight(flight) {
  const page = document.getElementById("run");
  page.querySelector("h1").textContent = flight.title;
  page.querySelector(".lead").textContent = `${flight.verdict[0].toUpperCase()}${flight.verdict.slice(1)}.`;
  page.querySelector(".place").replaceChildren(document.getElementById("flight-template").content.cloneNode(true));
  shownPlayer = new Player(page.querySelector(".flight"), flight);
}

/** A sentence, and the commands that fly a run again. */
function repeating(sentence, run) {
  const folder = runList.text("folder", run);
  const id = runList.data.ids[run];
  const commands = [`mavfi serve ${folder}`, `mavfi replay ${folder} ${id}`, `mavfi explain ${folder} ${id} --html flight.html`];
  const lines = commands.map((command) => element("code", { class: "command", tabindex: "0" }, command));
  return [element("p", {}, sentence), ...lines];
}

function rowFacts(run) {
  const texts = Object.entries(runList.data.filters).map(([name, heading]) => [heading, runList.text(name, run)]);
  const numbers = Object.entries(NUMBER_HEADINGS).map(([name, heading]) => [heading, runList.number(name, run)]);
  const shown = [...texts, ...numbers].filter(([, value]) => value !== "" && value !== "—");
  return shown.map(([heading, value]) => element("div", {}, element("dt", {}, heading), element("dd", {}, value)));
}

/** Mark the section that is read in the table of contents. */
function watchSections() {
  const links = new Map(Array.from(document.querySelectorAll(".toc a"), (link) => [link.hash.slice(1), link]));
  const observer = new IntersectionObserver((entries) => {
    for (const entry of entries.filter((one) => one.isIntersecting)) {
      document.querySelector(".toc a[aria-current]")?.removeAttribute("aria-current");
      links.get(entry.target.id || "main")?.setAttribute("aria-current", "true");
    }
  }, { rootMargin: "0px 0px -75% 0px" });
  document.querySelectorAll("#report > section").forEach((section) => observer.observe(section));
}

/** Run of the dot at a click within a linked set, at most REACH pixels away; undefined = none. */
function runOfDot(event) {
  let [nearest, found] = [REACH, undefined];
  for (const group of event.target.closest("svg").querySelectorAll("g.dots")) {
    const runs = rangesOf(group.dataset.runs);
    group.querySelectorAll("use").forEach((dot, place) => {
      const box = dot.getBoundingClientRect();
      const away = Math.hypot(box.x + box.width / 2 - event.clientX, box.y + box.height / 2 - event.clientY);
      if (away < nearest) [nearest, found] = [away, runs[place]];
    });
  }
  return found;
}

document.addEventListener("click", (event) => {
  const set = event.target.closest('svg a[href^="#runs?"]');
  const run = set && event.detail > 0 ? runOfDot(event) : undefined;
  if (run !== undefined) {
    event.preventDefault();
    location.hash = `run/${runList.data.ids[run]}`;
  }
  const button = event.target.closest("button.csv");
  if (button) download(button.dataset.file, csvTexts[button.dataset.table]);
});
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((details) => { details.open = true; }));
startTheme();
themeListeners.push(() => shownPlayer?.recolour());
runList.choose({}, null);
watchSections();
addEventListener("hashchange", route);
route();
