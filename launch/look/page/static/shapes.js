/** The solids of the drawing in space: things, obstacles, arrows, springs, contacts and the grid, for three.js. */

import { solidOf } from "./contacts.js";
import * as THREE from "./three/three.module.min.js";

const UP = new THREE.Vector3(0, 1, 0);
const FINE = 22; // segments around a sphere
const TURNS = 9; // of a drawn spring
const ROUND = new THREE.SphereGeometry(1, FINE, FINE / 2);
const CUBE = new THREE.BoxGeometry(1, 1, 1);
const DISC = new THREE.CircleGeometry(1, 24).rotateX(-Math.PI / 2);
const RING = new THREE.TorusGeometry(1, 0.22, 8, 28).rotateX(Math.PI / 2);
const SHAFT = new THREE.CylinderGeometry(1, 1, 1, 12).translate(0, 0.5, 0);
const HEAD = new THREE.ConeGeometry(1, 1, 16).translate(0, -0.5, 0);
const HELIX = new THREE.BufferGeometry().setFromPoints(
  Array.from({ length: 20 * TURNS + 1 }, (_, i) => {
    const part = i / (20 * TURNS);
    const wide = Math.min(1, 12 * part, 12 * (1 - part)); // the ends are on the axis
    const angle = 2 * Math.PI * TURNS * part;
    return new THREE.Vector3(wide * Math.cos(angle), part, wide * Math.sin(angle));
  }),
);

const BEHIND = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }; // of the lines on it
const CLEAR = { transparent: true, depthWrite: false };

/** The colours of the drawing, by their names in the style sheet; they change with the scheme. */
export class Palette {
  constructor() {
    this.materials = new Map();
    const named = (name, make, colour = name) => this.materials.set(name, { colour: `--${colour}`, material: make() });
    named("accent", () => new THREE.MeshLambertMaterial());
    const through = (opacity) => new THREE.MeshBasicMaterial({ ...CLEAR, opacity, depthTest: false }); // seen through what is in front
    named("hidden", () => through(0.3), "accent");
    named("ghost", () => through(0.22), "accent");
    named("arc", () => through(0.4), "trace-1");
    named("thing", () => new THREE.MeshLambertMaterial());
    named("solid", () => new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, ...BEHIND }));
    named("trace-1", () => new THREE.MeshLambertMaterial());
    named("trace-3", () => new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.85, depthTest: false })); // contacts are inside of things
    named("lattice", () => new THREE.LineBasicMaterial());
    named("line", () => new THREE.LineBasicMaterial());
    named("dim", () => new THREE.LineBasicMaterial());
    named("raised", () => new THREE.MeshBasicMaterial({ side: THREE.BackSide, ...BEHIND }));
    named("pane", () => new THREE.MeshBasicMaterial({ side: THREE.DoubleSide, ...CLEAR, opacity: 0.5 }));
    named("shade", () => new THREE.MeshBasicMaterial({ ...CLEAR, opacity: 0.22 }));
    this.recolour();
  }

  recolour() {
    const style = getComputedStyle(document.documentElement);
    this.ground = new THREE.Color(style.getPropertyValue("--ground").trim());
    for (const { colour, material } of this.materials.values()) material.color.set(style.getPropertyValue(colour).trim());
  }

  of(name) {
    return this.materials.get(name).material;
  }

  dispose() {
    for (const { material } of this.materials.values()) material.dispose();
  }
}

export const lights = () => {
  const sun = new THREE.DirectionalLight(0xffffff, 1.9);
  sun.position.set(0.5, 1, 0.8);
  return [new THREE.HemisphereLight(0xffffff, 0x8890a0, 1.9), sun];
};

function ball(radius, material) {
  const mesh = new THREE.Mesh(ROUND, material);
  mesh.scale.setScalar(radius);
  return mesh;
}

/** A solid about the origin: a box, a sphere or a capsule. */
export function solid({ box, half, radius }, material) {
  const group = new THREE.Group();
  if (box) return group.add(block(half.map((h) => -h), half, material));
  const ends = [half.map((h) => -h), half];
  if (half.every((h) => h === 0)) return group.add(ball(radius, material));
  const middle = new THREE.Mesh(SHAFT, material);
  span(middle, ends[0], ends[1], radius);
  return group.add(middle, ...ends.map((end) => placed(ball(radius, material), end)));
}

/** The shadow of a thing on the ground, straight below it. */
export class Shade {
  constructor({ half, radius }, ground, palette) {
    this.mesh = new THREE.Mesh(DISC, palette.of("shade"));
    const [wide, high, deep] = half.map((h) => Math.abs(h) + radius);
    Object.assign(this, { wide, high, deep, ground });
  }

  put([x, y, z]) {
    const above = Math.max(0, y - this.high - this.ground) / this.high;
    const spread = 0.9 + 0.15 * Math.min(4, above);
    this.mesh.visible = y > this.ground;
    this.mesh.position.set(x, this.ground + 0.01 * this.high, z);
    this.mesh.scale.set(spread * this.wide, 1, spread * this.deep);
  }
}

const direction = new THREE.Vector3(); // of whatever is put now: nothing is allocated for a picture

/** Put an object that is made along y between two places, so many m thick. */
function span(object, [ax, ay, az], [bx, by, bz], thickness) {
  direction.set(bx - ax, by - ay, bz - az);
  const length = direction.length();
  object.visible = length > 0;
  if (!object.visible) return;
  object.position.set(ax, ay, az);
  object.quaternion.setFromUnitVectors(UP, direction.divideScalar(length));
  object.scale.set(thickness, length, thickness);
}

/** An arrow whose thickness does not depend on its length. */
export class Arrow {
  constructor(thickness, palette) {
    this.thickness = thickness;
    this.shaft = new THREE.Mesh(SHAFT, palette.of("trace-1"));
    this.head = new THREE.Mesh(HEAD, palette.of("trace-1"));
    this.group = new THREE.Group().add(this.shaft, this.head);
    this.ends = [[0, 0, 0], [0, 0, 0]];
  }

  /** From a place along a vector, m; nothing is drawn of one that is shorter than its head is wide. */
  put(from, along) {
    const length = Math.hypot(...along);
    this.group.visible = length > 2 * this.thickness;
    this.ends = [from, this.group.visible ? from.map((x, i) => x + along[i]) : from];
    if (!this.group.visible) return;
    const high = Math.min(6.5 * this.thickness, 0.6 * length);
    const end = [from[0] + along[0], from[1] + along[1], from[2] + along[2]];
    span(this.shaft, from, end.map((x, i) => x - (high / length) * along[i] * 0.9), this.thickness);
    span(this.head, from, end, 2.4 * this.thickness);
    this.head.position.set(end[0], end[1], end[2]);
    this.head.scale.y = high;
  }
}

const ARC_PARTS = 96; // of a whole circle of an arc
const ARC_SIDES = 8; // of its round

/** An arrow on an arc about an axis, whose thickness does not depend on its length. */
export class Arc {
  constructor(radius, thickness, palette) {
    Object.assign(this, { radius, thickness, high: 6 * thickness });
    const material = palette.of("trace-1");
    this.shaft = new THREE.Mesh(hoop(radius, thickness), material);
    this.head = new THREE.Mesh(HEAD, material);
    for (const one of [this.shaft, this.head]) one.add(new THREE.Mesh(one.geometry, palette.of("arc")));
    this.group = new THREE.Group().add(this.shaft, this.head);
    this.angle = 0;
  }

  /** About a place and an axis, by an angle; nothing is drawn of one that is shorter than its head. */
  put(at, axis, angle) {
    const head = this.high / this.radius;
    this.group.visible = angle > head;
    this.angle = this.group.visible ? angle : 0;
    if (!this.group.visible) return;
    this.group.position.fromArray(at);
    this.group.quaternion.setFromUnitVectors(UP, direction.fromArray(axis).normalize());
    const parts = Math.max(1, Math.round(((angle - 0.9 * head) / (2 * Math.PI)) * ARC_PARTS));
    this.shaft.geometry.setDrawRange(0, 6 * ARC_SIDES * Math.min(parts, ARC_PARTS));
    this.head.position.set(this.radius * Math.sin(angle), 0, this.radius * Math.cos(angle));
    this.head.quaternion.setFromUnitVectors(UP, direction.set(Math.cos(angle - head / 2), 0, -Math.sin(angle - head / 2)));
    this.head.scale.set(2.4 * this.thickness, this.high, 2.4 * this.thickness);
  }

  /** Places along it, so many at most. */
  along(count) {
    if (this.angle === 0) return [];
    return Array.from({ length: count }, (_, i) => {
      const part = (this.angle * i) / (count - 1);
      return new THREE.Vector3(this.radius * Math.sin(part), 0, this.radius * Math.cos(part)).applyQuaternion(this.group.quaternion).add(this.group.position).toArray();
    });
  }
}

/** A ring about y, whose triangles follow each other from z on towards x. */
function hoop(radius, thickness) {
  const [points, corners] = [[], []];
  for (let i = 0; i <= ARC_PARTS; i += 1) {
    const along = (2 * Math.PI * i) / ARC_PARTS;
    for (let j = 0; j < ARC_SIDES; j += 1) {
      const about = (2 * Math.PI * j) / ARC_SIDES;
      const far = radius + thickness * Math.cos(about);
      points.push(new THREE.Vector3(far * Math.sin(along), thickness * Math.sin(about), far * Math.cos(along)));
      const [here, beside] = [i * ARC_SIDES + j, i * ARC_SIDES + ((j + 1) % ARC_SIDES)];
      if (i < ARC_PARTS) corners.push(here, here + ARC_SIDES, beside, beside, here + ARC_SIDES, beside + ARC_SIDES);
    }
  }
  const geometry = new THREE.BufferGeometry().setFromPoints(points);
  geometry.setIndex(corners);
  geometry.computeVertexNormals();
  return geometry;
}

export const RODS = [1, 0.75, 0.5]; // parts of the longest: along x, y and z of a thing

/** Rods along the axes of a thing from its origin, the longest `length` long. */
export function rods(length, thickness, material) {
  const group = new THREE.Group();
  RODS.forEach((part, axis) => {
    const rod = new THREE.Mesh(SHAFT, material);
    span(rod, [0, 0, 0], [0, 0, 0].map((_, i) => (i === axis ? part * length : 0)), thickness);
    group.add(rod);
  });
  return group;
}

/** A spring between two places. */
export class Spring {
  constructor(thickness, palette) {
    this.line = new THREE.Line(HELIX, palette.of("dim"));
    this.thickness = thickness;
  }

  put(a, b) {
    span(this.line, a, b, this.thickness);
  }
}

/** Rings at the contacts; as many as there were at once are kept. */
export class Marks {
  constructor(size, palette) {
    Object.assign(this, { size, palette, group: new THREE.Group() });
  }

  put(contacts) {
    while (this.group.children.length < contacts.length) {
      const ring = new THREE.Mesh(RING, this.palette.of("trace-3"));
      ring.scale.setScalar(this.size);
      this.group.add(ring);
    }
    this.group.children.forEach((ring, i) => {
      ring.visible = i < contacts.length;
      if (!ring.visible) return;
      ring.position.fromArray(contacts[i].at);
      ring.quaternion.setFromUnitVectors(UP, direction.fromArray(contacts[i].normal));
    });
  }
}

function block(low, high, material) {
  const mesh = new THREE.Mesh(CUBE, material);
  mesh.position.set(...low.map((x, i) => (x + high[i]) / 2));
  mesh.scale.set(...low.map((x, i) => high[i] - x));
  return mesh;
}

function edges(low, high, palette) {
  const lines = new THREE.LineSegments(new THREE.EdgesGeometry(CUBE), palette.of("line"));
  const { position, scale } = block(low, high, null);
  lines.position.copy(position);
  lines.scale.copy(scale);
  return lines;
}

/** What is drawn of an obstacle that is no solid, by its shape; `around` has the middle of the scene and its radius. */
const OBSTACLES = {
  room: ({ points: [low, high] }, palette) => [block(low, high, palette.of("raised")), edges(low, high, palette)],
  mesh({ points, triangles }, palette) {
    const geometry = new THREE.BufferGeometry().setFromPoints(points.map((point) => new THREE.Vector3(...point)));
    geometry.setIndex(triangles.flat());
    const flat = geometry.toNonIndexed(); // each triangle with a normal of its own
    flat.computeVertexNormals();
    return [new THREE.Mesh(flat, palette.of("solid"))];
  },
  wall({ points: [at, normal] }, palette, { middle, radius }) {
    const unit = new THREE.Vector3(...normal).normalize();
    const foot = new THREE.Vector3(...middle);
    foot.addScaledVector(unit, -unit.dot(foot.clone().sub(new THREE.Vector3(...at))));
    const pane = new THREE.Mesh(new THREE.PlaneGeometry(2, 2).rotateX(-Math.PI / 2), palette.of("pane"));
    pane.position.copy(foot);
    pane.quaternion.setFromUnitVectors(UP, unit);
    pane.scale.setScalar(radius);
    return [pane];
  },
};

const ROD = new THREE.CylinderGeometry(1, 1, 2, 24).rotateX(Math.PI / 2); // along z

/** What is drawn of a shape of an engine, by its name: meshes about its own origin, along its own axes. */
const SHAPES = {
  box: ({ size }, material) => [scaled(CUBE, size.map((s) => 2 * s), material)],
  sphere: ({ size }, material) => [scaled(ROUND, size, material)],
  ellipsoid: ({ size }, material) => [scaled(ROUND, size, material)],
  cylinder: ({ size }, material) => [scaled(ROD, size, material)],
  capsule: ({ size: [radius, , half] }, material) => [
    scaled(ROD, [radius, radius, half], material),
    ...[half, -half].map((z) => placed(ball(radius, material), [0, 0, z])),
  ],
  plane: ({ size }, material, far) => [scaled(new THREE.PlaneGeometry(2, 2), size.map((s) => s || far), material)],
  mesh: ({ points, triangles }, material) => OBSTACLES.mesh({ points, triangles }, { of: () => material }),
};

function scaled(geometry, scale, material) {
  const mesh = new THREE.Mesh(geometry, material);
  mesh.scale.set(...scale.map((s) => s || 1e-9)); // a scale of 0 has no inverse
  return mesh;
}

/** A group of shapes of an engine in a frame whose axes are turned by `turn`; `far` is the size of what has no end, m. */
export function shapesOf(shapes, turn, material, far) {
  const group = new THREE.Group();
  const quaternion = ([w, x, y, z]) => new THREE.Quaternion(x, y, z, w);
  group.quaternion.copy(quaternion(turn));
  for (const shape of shapes) {
    const own = placed(new THREE.Group(), shape.at).add(...SHAPES[shape.shape](shape, material(shape), far));
    own.quaternion.copy(quaternion(shape.turn));
    group.add(own);
  }
  return group;
}

function placed(mesh, at) {
  mesh.position.set(...at);
  return mesh;
}

/** The objects of an obstacle; none of a shape that is not known here. */
export function obstacle(given, palette, around) {
  const known = solidOf(given);
  if (known === null) return OBSTACLES[given.shape]?.(given, palette, around) ?? [];
  const outline = known.box ? [edges(given.points[0], given.points[1], palette)] : [];
  return [placed(solid(known, palette.of("solid")), known.place), ...outline];
}

/** A grid of squares of side `step` on the ground between two corners. */
export function grid(low, high, ground, step, palette) {
  const points = [];
  const [left, right, far, near] = [low[0], high[0], low[2], high[2]].map((x, i) => (i % 2 ? Math.ceil : Math.floor)(x / step - (i % 2 ? 1e-6 : -1e-6)) * step);
  for (let x = left; x <= right + step / 2; x += step) points.push(new THREE.Vector3(x, ground, far), new THREE.Vector3(x, ground, near));
  for (let z = far; z <= near + step / 2; z += step) points.push(new THREE.Vector3(left, ground, z), new THREE.Vector3(right, ground, z));
  return new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(points), palette.of("lattice"));
}

/** The canvas with its camera and all that is drawn. */
export class Stage {
  constructor(canvas, context, palette) {
    this.renderer = new THREE.WebGLRenderer({ canvas, context });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.palette = palette;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera();
  }

  resize(width, height) {
    this.renderer.setSize(width, height, false);
  }

  draw(orbit, field) {
    const { camera, scene, renderer } = this;
    camera.fov = (field * 180) / Math.PI;
    camera.aspect = orbit.width / orbit.height;
    camera.near = orbit.distance / 100;
    camera.far = orbit.distance + 30 * orbit.radius;
    camera.updateProjectionMatrix();
    camera.position.fromArray(orbit.eye);
    camera.lookAt(...orbit.target);
    renderer.setClearColor(this.palette.ground);
    renderer.render(scene, camera);
  }

  dispose() {
    this.scene.traverse((object) => object.geometry?.dispose());
    this.palette.dispose();
    this.renderer.dispose();
  }
}
