"use strict";
// Runs are flown again by the server when their page is opened.

const COMPILES_AFTER_S = 6;
const served = document.getElementById("served").dataset;
const servedPath = served.key.split("/").map(encodeURIComponent).join("/");
const flownPages = new Map();

/** Fly a run and show its flight, if its page is still open then. */
async function flyRun(id, place) {
  if (flownPages.has(id)) {
    showFlight(flownPages.get(id));
    return;
  }
  const note = element("p", { class: "flying", role: "status" });
  place.replaceChildren(note);
  const begin = performance.now();
  const tell = () => { note.textContent = waitingText((performance.now() - begin) / 1000); };
  tell();
  const clock = setInterval(tell, 1000);
  try {
    const answer = await fetch(`/flight/${servedPath}?${new URLSearchParams({ run: id })}`);
    const text = await answer.text();
    if (answer.ok) flownPages.set(id, JSON.parse(text));
    if (!place.isConnected) return;
    if (answer.ok) showFlight(flownPages.get(id));
    else place.replaceChildren(element("p", { class: "refused" }, text));
  } catch (error) {
    place.replaceChildren(element("p", { class: "refused" }, `No flight (${error}): is mavfi serve still running?`));
  } finally {
    clearInterval(clock);
  }
}

function waitingText(seconds) {
  const text = `Flying it again, with its golden run and the same fault in another setting … ${Math.round(seconds)} s`;
  if (seconds < COMPILES_AFTER_S) return text;
  return `${text}. The first flight of a pipeline compiles its kernels for this machine, once: up to a minute.`;
}
