"use strict";
// The 3-D scene of a flight: world, paths, vehicles, marks.  It draws when something has changed.

const WIDTHS = { golden: 6, injected: 3.5, recovered: 3 };
const DRONE_SIZE = 0.02; // of the distance to the camera, so that vehicles and marks are seen from afar

class FlightScene {
  constructor(canvas, world, paths, fault) {
    Object.assign(this, { canvas, world, paths, fault, marks: [], drones: new Map(), lines: new Map(), labels: [] });
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.camera = new THREE.PerspectiveCamera(38, 2, 0.1, 2000);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = 0.495 * Math.PI;
    this.controls.addEventListener("change", () => this.draw());
    this.controls.enableZoom = false; // a wheel scrolls the page until the scene was clicked
    canvas.addEventListener("pointerdown", () => { this.controls.enableZoom = true; });
    canvas.addEventListener("pointerleave", () => { this.controls.enableZoom = false; });
    this.build();
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(canvas);
    this.view("overview");
  }

  /** Make everything again, e.g. in the colours of the other theme. */
  build() {
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(css("sky"));
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8090a0, 2.4));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(-40, -60, 90);
    this.scene.add(sun);
    for (const label of this.labels) label.node.remove();
    this.marks = [];
    this.labels = [];
    this.addGround();
    if (this.world.voxels) this.addVoxels(); else this.addBoxes();
    this.paths.forEach((path) => this.addPath(path));
    this.addMarks();
  }

  addGround() {
    const [x0, y0, z0, x1, y1] = this.world.arena;
    const level = this.world.voxels ? z0 : 0;
    const ground = new THREE.Mesh(
      new THREE.PlaneGeometry(x1 - x0, y1 - y0), new THREE.MeshBasicMaterial({ color: css("ground") }));
    ground.position.set((x0 + x1) / 2, (y0 + y1) / 2, level - 0.02);
    const corners = [];
    for (let x = x0; x <= x1 + 1e-6; x += 10) corners.push(x, y0, level, x, y1, level);
    for (let y = y0; y <= y1 + 1e-6; y += 10) corners.push(x0, y, level, x1, y, level);
    this.scene.add(ground, this.segments(corners, css("grid")));
  }

  segments(corners, color) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
    return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color }));
  }

  addBoxes() {
    const corners = decoded(this.world.boxes, "f4");
    const count = corners.length / 6;
    const boxes = Array.from({ length: count }, (_, index) => corners.subarray(6 * index, 6 * index + 6));
    this.addInstances(boxes);
    this.scene.add(this.segments(boxes.flatMap(edgesOf), css("edge")));
  }

  addVoxels() {
    const cells = decoded(this.world.voxels, "i2");
    const { origin, edge } = this.world;
    this.addInstances(Array.from({ length: cells.length / 3 }, (_, index) => {
      const low = origin.map((value, axis) => value + cells[3 * index + axis] * edge);
      return [...low, ...low.map((value) => value + edge)];
    }));
  }

  addInstances(boxes) {
    const material = new THREE.MeshLambertMaterial({ color: css("solid") });
    const mesh = new THREE.InstancedMesh(new THREE.BoxGeometry(1, 1, 1), material, boxes.length);
    const matrix = new THREE.Matrix4();
    boxes.forEach(([x0, y0, z0, x1, y1, z1], index) => {
      matrix.makeScale(x1 - x0, y1 - y0, z1 - z0).setPosition((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2);
      mesh.setMatrixAt(index, matrix);
    });
    this.scene.add(mesh);
  }

  /** The whole path pale, what was flown so far strong, and the vehicle. */
  addPath(path) {
    const group = new THREE.Group();
    const flown = this.line(path, 1);
    group.add(this.line(path, 0.35), flown);
    const drone = droneOf(css(path.role));
    group.add(drone);
    this.marks.push(drone);
    this.drones.set(path.role, drone);
    this.lines.set(path.role, { group, flown });
    this.scene.add(group);
  }

  /** A path; the pale one is seen through obstacles, and narrow paths lie on wide ones. */
  line(path, opacity) {
    const place = 1 + Object.keys(WIDTHS).indexOf(path.role);
    const geometry = new THREE.LineGeometry();
    geometry.setPositions(path.points().flat());
    const dashes = path.role === "recovered" && { dashed: true, dashSize: 1.2, gapSize: 0.7 };
    const material = new THREE.LineMaterial({
      color: css(path.role), linewidth: WIDTHS[path.role], transparent: opacity < 1, opacity, depthTest: opacity === 1,
      polygonOffset: true, polygonOffsetFactor: -4 * place, polygonOffsetUnits: -4 * place, ...dashes });
    const line = new THREE.Line2(geometry, material);
    if (dashes) line.computeLineDistances();
    line.renderOrder = place;
    return line;
  }

  addMarks() {
    this.addMark(new THREE.SphereGeometry(0.45), css("ink"), this.world.start, "start");
    this.addMark(new THREE.BoxGeometry(0.8, 0.8, 0.8), css("ink"), this.world.goal, "goal");
    const injected = this.paths.find((path) => path.fault !== null);
    if (injected) this.addRing(injected.at(this.fault));
    for (const path of this.paths) {
      if (!path.success) this.addCross(path);
      const diamond = new THREE.OctahedronGeometry(0.5);
      for (const [time, near] of path.alarms) {
        this.addMark(diamond, near ? css("purple") : css("soft"), path.at(time), "", path.role);
      }
    }
  }

  addMark(geometry, color, point, text = "", role = "") {
    const mark = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color }));
    mark.position.set(...point);
    this.marks.push(mark);
    (role ? this.lines.get(role).group : this.scene).add(mark);
    if (text) this.addLabel(text, point);
    return mark;
  }

  addRing(point) {
    const ring = this.addMark(new THREE.TorusGeometry(1.3, 0.16, 10, 40), css("amber"), point, "fault");
    this.scene.add(this.segments([...point, point[0], point[1], 0], css("amber")));
    this.labels[this.labels.length - 1].node.classList.add("fault");
    return ring;
  }

  /** A cross that faces the camera, in front of the obstacle that it is in. */
  addCross(path) {
    const point = path.point(path.n - 1);
    const cross = new THREE.Group();
    const material = new THREE.MeshBasicMaterial({ color: css(path.role), depthTest: false, transparent: true });
    for (const angle of [Math.PI / 4, -Math.PI / 4]) {
      const bar = new THREE.Mesh(new THREE.BoxGeometry(3, 0.45, 0.45), material);
      bar.rotation.z = angle;
      bar.renderOrder = 9; // after all that is tested for depth
      cross.add(bar);
    }
    cross.position.set(...point);
    cross.userData.facesCamera = true;
    this.marks.push(cross);
    this.lines.get(path.role).group.add(cross);
    this.addLabel(path.status, point);
  }

  addLabel(text, point) {
    const node = element("span", { class: "label", "aria-hidden": "true" }, text);
    this.canvas.parentElement.append(node);
    this.labels.push({ node, point: new THREE.Vector3(...point) });
  }

  setTime(time) {
    for (const path of this.paths) {
      const drone = this.drones.get(path.role);
      drone.position.set(...path.at(time));
      drone.quaternion.set(...path.attitudeAt(time)).normalize();
      const rows = Math.min(path.rowAt(time) + 1, path.n - 1);
      this.lines.get(path.role).flown.geometry.instanceCount = Math.max(0, rows);
    }
    if (this.following) this.follow();
    this.draw();
  }

  show(role, visible) {
    this.lines.get(role).group.visible = visible;
    this.draw();
  }

  /** Move camera and target with the vehicle. */
  follow() {
    const role = ["injected", "recovered", "golden"].find((name) => this.drones.has(name));
    const move = this.drones.get(role).position.clone().sub(this.controls.target);
    this.controls.target.add(move);
    this.camera.position.add(move);
    this.controls.update();
  }

  view(name) {
    const { low, high } = this.bounds();
    const middle = low.map((value, axis) => (value + high[axis]) / 2);
    const narrow = Math.max(1, 1.75 / this.camera.aspect);
    const span = narrow * Math.max(high[0] - low[0], 1.5 * (high[1] - low[1]), 20);
    const offsets = {
      overview: [-0.28 * span, -0.8 * span, 0.52 * span], above: [0, -0.01, 1.2 * span],
      side: [0, -1.2 * span, 0.08 * span], follow: [-14, -9, 9],
    };
    this.following = name === "follow";
    this.controls.target.set(...middle);
    this.camera.position.set(...middle.map((value, axis) => value + offsets[name][axis]));
    if (this.following) {
      this.camera.position.sub(this.controls.target);
      this.controls.target.set(0, 0, 0);
      this.follow();
    }
    this.controls.update();
    this.draw();
  }

  /** Corners of what was flown, within the arena. */
  bounds() {
    const points = [this.world.start, this.world.goal, ...this.paths.flatMap((path) => path.points())];
    const arena = this.world.arena;
    const clip = (value, axis) => Math.min(arena[axis + 3] + 10, Math.max(arena[axis] - 10, value));
    const of = (pick) => [0, 1, 2].map((axis) => clip(pick(...points.map((point) => point[axis])), axis));
    return { low: of(Math.min), high: of(Math.max) };
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const narrow = (this.camera.aspect < 1.3) !== (width / height < 1.3);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (narrow && !this.following) this.view("overview");
    this.draw();
  }

  draw() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = 0;
      for (const mark of this.marks) {
        const size = DRONE_SIZE * this.camera.position.distanceTo(mark.position);
        mark.scale.setScalar(Math.min(3.5, Math.max(0.5, size)));
        if (mark.userData.facesCamera) mark.quaternion.copy(this.camera.quaternion);
      }
      this.renderer.render(this.scene, this.camera);
      this.placeLabels();
    });
  }

  /** Labels above their points; one that would cover another is raised above it. */
  placeLabels() {
    const placed = [];
    for (const { node, point } of this.labels) {
      const seen = point.clone().project(this.camera);
      node.hidden = seen.z > 1;
      if (node.hidden) continue;
      const x = (0.5 + 0.5 * seen.x) * this.canvas.clientWidth;
      let y = (0.5 - 0.5 * seen.y) * this.canvas.clientHeight;
      const width = node.offsetWidth;
      const height = node.offsetHeight;
      const isCovering = (other) => Math.abs(other.x - x) < (other.width + width) / 2 && Math.abs(other.y - y) < height;
      while (height > 0 && placed.some(isCovering)) y -= height;
      placed.push({ x, y, width });
      node.style.transform = `translate(${x}px, ${y}px) translate(-50%, -230%)`;
    }
  }

  dispose() {
    this.observer.disconnect();
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

/** The twelve edges of a box as pairs of corners. */
function edgesOf([x0, y0, z0, x1, y1, z1]) {
  const upright = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
  return upright.flatMap(([x, y], place) => {
    const [nextX, nextY] = upright[(place + 1) % 4];
    return [x, y, z0, x, y, z1, x, y, z0, nextX, nextY, z0, x, y, z1, nextX, nextY, z1];
  });
}

/** A quadrotor, about 1 m across. */
function droneOf(color) {
  const material = new THREE.MeshLambertMaterial({ color });
  const drone = new THREE.Group();
  drone.add(new THREE.Mesh(new THREE.BoxGeometry(0.5, 0.3, 0.16), material));
  for (const [x, y] of [[0.45, 0.45], [0.45, -0.45], [-0.45, 0.45], [-0.45, -0.45]]) {
    const rotor = new THREE.Mesh(new THREE.TorusGeometry(0.3, 0.06, 6, 20), material);
    rotor.position.set(x, y, 0.08);
    drone.add(rotor);
  }
  return drone;
}
