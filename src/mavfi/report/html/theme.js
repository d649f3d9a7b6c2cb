"use strict";
// Light or dark: as the system has it, until the reader chooses.

const themeListeners = [];

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  const button = document.querySelector(".theme");
  button.textContent = name === "dark" ? "☀ Light" : "☾ Dark";
  button.setAttribute("aria-label", `Switch to ${name === "dark" ? "light" : "dark"} colours`);
  themeListeners.forEach((listener) => listener());
}

function startTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  setTheme(dark.matches ? "dark" : "light");
  dark.addEventListener("change", () => setTheme(dark.matches ? "dark" : "light"));
  document.querySelector(".theme").addEventListener("click", () => {
    setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  });
}
