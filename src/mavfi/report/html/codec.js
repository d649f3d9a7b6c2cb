"use strict";
// Binary arrays in the page's data, and the paths that are made of them.

const KINDS = { f4: Float32Array, i1: Int8Array, i2: Int16Array };

function decoded(text, kind) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new KINDS[kind](bytes.buffer);
}

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function pageData(id) {
  return JSON.parse(document.getElementById(id).textContent);
}

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** A flown path; rows are time, x, y, z, speed. */
class Path {
  constructor(data) {
    Object.assign(this, data);
    this.values = decoded(data.rows, "f4");
    this.quaternions = decoded(data.attitude, "i1");
  }

  time(row) { return this.values[5 * row]; }
  point(row) { return Array.from(this.values.subarray(5 * row + 1, 5 * row + 4)); }

  points() {
    return Array.from({ length: this.n }, (_, row) => this.point(row));
  }

  column(place) {
    return Array.from({ length: this.n }, (_, row) => this.values[5 * row + place]);
  }

  /** Last row that is not later than an instant (s). */
  rowAt(time) {
    let low = 0;
    let high = this.n - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.time(middle) <= time) low = middle; else high = middle - 1;
    }
    return low;
  }

  /** Where the vehicle was at an instant (s), between two rows on a straight line. */
  at(time) {
    const row = this.rowAt(time);
    const next = Math.min(row + 1, this.n - 1);
    const span = this.time(next) - this.time(row);
    const share = span > 0 ? Math.min(1, Math.max(0, (time - this.time(row)) / span)) : 0;
    const [from, to] = [this.point(row), this.point(next)];
    return from.map((value, axis) => value + share * (to[axis] - value));
  }

  attitudeAt(time) {
    const [w, x, y, z] = this.quaternions.subarray(4 * this.rowAt(time));
    return [x / 127, y / 127, z / 127, w / 127];
  }
}
