"use strict";
// The page of a campaign follows its ledger.

const FOLLOW_MS = 2000;
let isRenewing = false;

async function follow() {
  try {
    if (!document.hidden) {
      const answer = await fetch(`/state/${servedPath}`);
      if (answer.ok) {
        const state = await answer.json();
        showPace(state);
        if (state.stamp !== served.stamp && !isRenewing && !isRead()) renew(); // meanwhile the progress goes on
      }
    }
  } catch {
    document.querySelector(".pace").hidden = false;
    document.querySelector(".pace span").textContent = "No answer: is mavfi serve still running?";
  }
  setTimeout(follow, FOLLOW_MS);
}

function showPace(state) {
  const pace = document.querySelector(".pace");
  pace.hidden = state.complete && !state.running;
  pace.querySelector("progress").max = state.total;
  pace.querySelector("progress").value = state.done;
  pace.querySelector("span").textContent = state.text;
}

/** Whether the focus is in a part that `renew` would replace. */
function isRead() {
  const focus = document.activeElement;
  return focus.closest("#report > section:not(#runs)") !== null && !focus.matches(".theme");
}

/** Replace tables, figures and runs by those of the ledger now; filters, order, position and open parts stay. */
async function renew() {
  isRenewing = true;
  try {
    const answer = await fetch(`/campaign/${servedPath}`);
    if (answer.ok) replaceBy(new DOMParser().parseFromString(await answer.text(), "text/html"));
  } finally {
    isRenewing = false;
  }
}

function replaceBy(page) {
  served.stamp = page.getElementById("served").dataset.stamp;
  const place = scrollY;
  const openParts = new Map(Array.from(document.querySelectorAll("#report summary"), (summary) => [summary.textContent, summary.parentElement.open]));

  // sections other than the runs, with the button that has listeners
  const runs = document.getElementById("runs");
  const top = document.querySelector(".headline .top");
  for (const section of document.querySelectorAll("#report > section:not(#runs)")) section.remove();
  const sections = Array.from(page.querySelectorAll("#report > section"));
  const index = sections.findIndex((section) => section.id === "runs");
  sections[0].querySelector(".top").replaceWith(top);
  runs.before(...sections.slice(0, index));
  runs.after(...sections.slice(index + 1));
  document.querySelector(".toc ol").replaceWith(page.querySelector(".toc ol"));
  for (const summary of document.querySelectorAll("#report summary")) {
    const wasOpen = openParts.get(summary.textContent);
    if (wasOpen !== undefined) summary.parentElement.open = wasOpen;
  }
  scrollTo(0, place);
  watchSections();

  // the runs, and the tables as CSV
  const data = (id) => JSON.parse(page.getElementById(id).textContent);
  Object.assign(csvTexts, data("csv-data"));
  runList.take(data("runs-data"));
  runList.list();
}
setTimeout(follow, FOLLOW_MS);
