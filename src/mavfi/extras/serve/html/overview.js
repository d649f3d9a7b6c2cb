"use strict";
// The overview: rows are asked for one after the other, those of running campaigns again and again.

const REPEAT_MS = 5000;

async function fill(row) {
  const key = row.dataset.key.split("/").map(encodeURIComponent).join("/");
  try {
    const answer = await fetch(`/row/${key}`);
    const cells = await answer.text();
    row.querySelectorAll("td").forEach((cell) => cell.remove());
    row.insertAdjacentHTML("beforeend", cells);
  } catch {
    row.querySelector("td:last-child").textContent = "no answer: is mavfi serve still running?";
  }
}

async function fillAll(selector) {
  for (const row of document.querySelectorAll(selector)) await fill(row);
  setTimeout(() => fillAll(".campaigns tr:has(td.running)"), REPEAT_MS);
}
fillAll(".campaigns tr[data-key]");
