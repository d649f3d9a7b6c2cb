"use strict";
// The flight from above as SVG: for print, and where there is no WebGL.

const DASHES = { golden: "", injected: "", recovered: "1.6 0.9" };

function planView(world, paths) {
  const [x0, y0, , x1, y1] = world.arena;
  const parts = world.voxels ? voxelSquares(world) : boxRectangles(world);
  for (const path of paths) {
    const width = path.role === "golden" ? 1.1 : 0.55;
    const points = path.points().map(([x, y]) => `${x.toFixed(1)},${(-y).toFixed(1)}`).join(" ");
    parts.push(`<polyline points="${points}" fill="none" stroke="var(--${path.role})" stroke-width="${width}"`
      + ` stroke-dasharray="${DASHES[path.role]}" opacity="${path.role === "golden" ? 0.6 : 1}"/>`);
    if (!path.success) parts.push(cross(path.point(path.n - 1), path.role));
  }
  const injected = paths.find((path) => path.fault !== null);
  if (injected) parts.push(circle(injected.at(injected.fault), 1.6, "none", "var(--amber)"));
  parts.push(circle(world.start, 0.8, "var(--ink)"), circle(world.goal, 0.8, "none", "var(--ink)"));
  return `<svg class="plan" viewBox="${x0} ${-y1} ${x1 - x0} ${y1 - y0}" role="img" aria-label="The flight from above">`
    + `${parts.join("")}</svg>`;
}

function boxRectangles(world) {
  const corners = decoded(world.boxes, "f4");
  return Array.from({ length: corners.length / 6 }, (_, index) => {
    const [x0, y0, , x1, y1] = corners.subarray(6 * index, 6 * index + 6);
    return rectangle(x0, -y1, x1 - x0, y1 - y0);
  });
}

function voxelSquares({ voxels, origin, edge }) {
  const cells = decoded(voxels, "i2");
  const columns = new Set();
  for (let place = 0; place < cells.length; place += 3) columns.add(`${cells[place]},${cells[place + 1]}`);
  return Array.from(columns, (column) => {
    const [i, j] = column.split(",").map(Number);
    return rectangle(origin[0] + i * edge, -(origin[1] + (j + 1) * edge), edge, edge);
  });
}

function rectangle(x, y, width, height) {
  return `<rect x="${x}" y="${y}" width="${width}" height="${height}" fill="var(--solid)"/>`;
}

function circle([x, y], radius, fill, stroke = "none") {
  return `<circle cx="${x}" cy="${-y}" r="${radius}" fill="${fill}" stroke="${stroke}" stroke-width="0.5"/>`;
}

function cross([x, y], role) {
  const d = `M${x - 1},${-y - 1}l2,2m0,-2l-2,2`;
  return `<path d="${d}" stroke="var(--${role})" stroke-width="0.6" fill="none"/>`;
}
