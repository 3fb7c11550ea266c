/** The moving virtual world in space: what three.js draws, and above it rings of devices, names and scale as SVG. */

import { Contacts } from "./contacts.js";
import { Engine } from "./engine.js";
import { buttons, height, html, place, say, showPressed, svg } from "./elements.js";
import { fitted, quantity, rounded } from "./format.js";
import { Labels } from "./labels.js";
import { FIELD, Orbit, steer } from "./orbit.js";
import { Arc, Arrow, Marks, Palette, RODS, Shade, Spring, Stage, grid, lights, obstacle, rods, solid } from "./shapes.js";
import { turned } from "./turns.js";

const AXES = ["x", "y", "z"];
const LEAST_FORCE = 0.1; // N, the smallest that may fill the drawing
const LEAST_TORQUE = 0.002; // N·m, likewise
const HALF_TURN = Math.PI; // rad, the arc of the greatest torque
const ROD = 1.5; // of a thing's radius: the longest rod along its axes
const ARC = 1.25; // of a thing's radius: that of the arc of a torque
const [THIN, THICK] = [0.008, 0.012]; // parts of the scene's radius: half of the thickness of a rod, and of an arc
const ARC_PLACES = 13; // of the arc, for the names that avoid it
const LEAST_ARC = 0.1; // parts of the scene's radius, likewise
const LOOK = 500; // ms between two updates of the scale
const MOTION = 0.2; // parts of a device's greatest displacement that the first view has room for
const ROOM = 0.1; // of the size of all that is drawn, at most as much: limits may be far beyond it
const POINT = 0.012; // parts of the scene's radius: the radius of a sphere that stands for a point
const CORE = 0.8; // parts of a thing's radius that names of other things avoid
const TRIAD = 24; // px, the length of an axis
const RING = 11; // px, the radius of a device's ring

export class Space {
  /** Draw into `holder`, on a canvas with its context of WebGL. */
  constructor(holder, session, grips, canvas, context) {
    Object.assign(this, { parent: holder, session, grips, canvas });
    this.world = session.about.drawing ? new Engine(session) : new Scene(session);
    this.things = this.world.things;
    this.around = around(session.about, this.world);
    this.mostForce = this.mostTorque = 0;
    this.hands = this.things.filter(({ pivot }) => pivot); // the tools that hands turn
    this.foot = this.hands.length ? 42 : 26; // px below that the scales fill
    this.looked = -Infinity;
    this.drawn = ""; // the picture that the canvas shows: its instant and the camera's motions
    this.orbit = new Orbit(this.around.corners, this.around.radius, this.world.from);
    this.palette = new Palette();
    this.stage = new Stage(canvas, context, this.palette);
    this.build();
    this.overlay = svg("svg", { role: "group", "aria-label": "Devices, bodies and scale" });
    this.frame = html(
      "div",
      {
        class: "space",
        tabindex: "0",
        role: "application",
        "aria-label": "The virtual world in space. Arrow keys turn the view, with Shift they move it; plus and minus zoom; Home shows the first view",
      },
      canvas,
      this.overlay,
    );
    this.write();
    holder.replaceChildren(this.frame);
    steer(this.orbit, this.frame, canvas, (event) => grips.beside(event));
    new ResizeObserver(() => this.arrange()).observe(holder);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => {
      this.palette.recolour();
      this.drawn = "";
    };
    this.scheme.addEventListener("change", this.recolour);
    this.arrange();
  }

  /** The solids. */
  build() {
    const { about } = this.session;
    const { palette, around, things } = this;
    const { scene } = this.stage;
    scene.add(...lights(), grid(around.low, around.high, around.ground, around.step, palette));
    for (const one of this.world.standing(palette, around)) scene.add(one);
    for (const thing of things) {
      const drawn = thing.size > 0 ? thing : { ...thing, radius: POINT * around.radius };
      thing.drawnRadius = thing.size || drawn.radius;
      thing.mesh = this.world.solid(drawn, palette.of(thing.tool ? "accent" : "thing"));
      thing.shade = new Shade(drawn, around.ground, palette);
      scene.add(thing.mesh, thing.shade.mesh);
      if (!thing.tool) continue;
      thing.mesh.add(...this.world.solid(drawn, palette.of("hidden")).children); // seen through what is in front
      thing.arrow = new Arrow(0.014 * around.radius, palette);
      scene.add(thing.arrow.group);
      if (!thing.pivot) continue;
      thing.ghost = this.world.solid(drawn, palette.of("ghost"));
      for (const [one, colour] of [[thing.mesh, "accent"], [thing.mesh, "hidden"], [thing.ghost, "ghost"]]) {
        one.add(rods(ROD * thing.drawnRadius, THIN * around.radius, palette.of(colour)));
      }
      thing.arc = new Arc(Math.max(ARC * thing.drawnRadius, LEAST_ARC * around.radius), THICK * around.radius, palette);
      scene.add(thing.ghost, thing.arc.group);
    }
    this.springs = joinedBy(about.springs, things).map((ends) => ({ ends, spring: new Spring(0.02 * around.radius, palette) }));
    for (const { spring } of this.springs) scene.add(spring.line);
    this.marks = new Marks(0.03 * around.radius, palette);
    scene.add(this.marks.group);
  }

  /** Rings, names and scale. */
  write() {
    const axes = () => [this.orbit.right, this.orbit.up, this.orbit.back].map((axis) => this.world.inModel(axis));
    const drag = (thing) => ({ start: (event, x) => this.drag(event, x, thing), most: () => this.around.radius, axes });
    for (const thing of this.things) {
      thing.label = svg("text", { [thing.tool ? "data-tool" : "data-mass"]: thing.name }, thing.name);
      if (!thing.tool) continue;
      thing.lag = svg("line", { class: "lag" });
      thing.target = svg("path", { class: "target" });
      thing.pressed = svg("circle", { class: "pressed", r: 7 });
      thing.handle = this.grips.handle(thing.name, drag(thing));
      this.overlay.append(thing.lag, thing.target, thing.pressed);
    }
    this.tools = this.things.filter(({ tool }) => tool);
    this.axes = AXES.map((axis, i) => ({ along: this.world.axes[i], line: svg("line", { class: "axis" }), label: svg("text", { class: "dim" }, axis) }));
    this.scaleText = svg("text", { class: "dim" });
    this.arcText = svg("text", { class: "dim" });
    const labels = [...this.things.map(({ label }) => label), ...this.axes.map(({ label }) => label)];
    this.overlay.append(...this.axes.map(({ line }) => line), ...labels, this.scaleText, this.arcText, ...this.tools.map(({ handle }) => handle));
    this.labels = new Labels(labels);
  }

  arrange() {
    const width = Math.floor(this.parent.clientWidth);
    if (width === 0) return; // it is not shown
    const high = height(this.parent);
    this.orbit.resize(width, high);
    this.stage.resize(width, high);
    Object.assign(this.frame.style, { width: `${width}px`, height: `${high}px` });
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${high}`);
    this.draw();
  }

  /** A scale of forces that fits the latest ones. */
  rescale(now) {
    if (now - this.looked < LOOK) return;
    this.looked = now;
    this.mostForce = fitted(this.mostForce, Math.max(LEAST_FORCE, this.session.greatest(["force"])));
    if (this.hands.length) this.mostTorque = fitted(this.mostTorque, Math.max(LEAST_TORQUE, this.session.greatest(["torque"], null)));
  }

  /** Whether the camera has moved since the latest picture. */
  get moved() {
    return !this.drawn.endsWith(` ${this.orbit.moves}`);
  }

  draw() {
    if (this.orbit.width <= 1) return;
    for (const thing of this.things) this.locate(thing);
    const picture = `${this.session.head} ${this.mostForce} ${this.mostTorque} ${this.orbit.moves}`;
    if (picture !== this.drawn) {
      this.drawn = picture;
      this.drawSolids();
    }
    this.drawOverlay();
  }

  /** Where a thing is now, and where its device is. */
  locate(thing) {
    const { session } = this;
    thing.columns.forEach((column, port) => {
      const value = session.now(thing.track, column);
      thing.moved[port] = Number.isNaN(value) ? 0 : value - (thing.from?.[port] ?? 0);
    });
    Object.assign(thing, this.world.pose(thing, thing.moved));
    if (!thing.tool) return;
    const device = this.world.pose(thing, this.grips.position(thing.name), "orientation");
    Object.assign(thing, { device: device.place, deviceTurn: device.turn });
  }

  drawSolids() {
    for (const thing of this.things) {
      thing.mesh.position.fromArray(thing.place);
      if (thing.turn) thing.mesh.quaternion.set(thing.turn[1], thing.turn[2], thing.turn[3], thing.turn[0]);
      thing.shade.put(thing.place);
      if (thing.tool) this.drawForce(thing);
      if (thing.pivot) this.drawTurn(thing);
    }
    for (const { ends, spring } of this.springs) spring.put(ends[0].place, ends[1].place);
    this.marks.put(this.world.contacts());
    this.stage.draw(this.orbit, FIELD);
    const { turned, target, distance } = this.orbit;
    this.frame.dataset.camera = [turned.azimuth, turned.elevation, distance, ...target].map((x) => x.toFixed(6)).join(" ");
  }

  /** The force on a hand: two sides of the grid for the greatest. */
  drawForce({ name, pointing: directions, place: at, drawnRadius, arrow }) {
    const force = sum([0, 0, 0], directions, directions.map((_, port) => this.session.known(`${name}/force`, port)));
    const size = Math.hypot(...force);
    const scale = size ? (2 * this.around.step * Math.min(1.2, size / (this.mostForce || size))) / size : 0;
    const along = force.map((f) => scale * f);
    arrow.put(at.map((x, i) => x + (size ? (drawnRadius * force[i]) / size : 0)), along);
  }

  /** A device that a hand turns, and the torque on the hand: half a turn for the greatest. */
  drawTurn({ name, device, deviceTurn: [w, x, y, z], centre, ghost, arc }) {
    ghost.position.fromArray(device);
    ghost.quaternion.set(x, y, z, w);
    const torque = this.world.vector(AXES.map((_, axis) => this.session.known(`${name}/torque`, axis)));
    const size = Math.hypot(...torque);
    arc.put(centre, torque, HALF_TURN * Math.min(1.2, size / (this.mostTorque || size || 1)));
  }

  drawOverlay() {
    const { orbit } = this;
    const seen = this.things.map((thing) => orbit.project(thing.place));
    const rings = this.tools.map((thing) => this.drawDevice(thing, orbit.project(thing.device)));
    say(this.scaleText, `a side of the grid: ${quantity(this.around.step, "m")}, or ${quantity(this.mostForce / 2, "N")}`);
    place(this.scaleText, { x: 10, y: orbit.height - 10 });
    if (this.hands.some(({ name }) => this.session.feelsTurns(name))) say(this.arcText, `a quarter turn of an arc: ${quantity(this.mostTorque / 2, "N·m")}`);
    place(this.arcText, { x: 10, y: orbit.height - 26 });
    const boxes = this.things.map((thing, i) => seen[i] && boxAround(seen[i], CORE * seen[i].pixels * thing.drawnRadius));
    const taken = [[0, orbit.height - this.foot, 260, orbit.height], buttons(orbit.width), ...rings.filter((box) => box)];
    this.labels.begin(orbit.width, orbit.height, taken, boxes, this.lines());
    this.things.forEach((thing, i) => {
      const far = seen[i] && Math.max(thing.tool ? RING : 0, seen[i].pixels * thing.drawnRadius) + 3;
      this.labels.place(seen[i], far);
      place(thing.label, { "data-at": thing.moved.join(" "), "data-turn": (thing.turn ?? []).join(" ") });
    });
    this.drawAxes();
  }

  /** The lines that no label may be on, in the picture: coupling, force, springs and axes. */
  lines() {
    const pairs = this.tools.flatMap((thing) => [[thing.device, thing.place, 2], [...thing.arrow.ends, 7]]);
    for (const { ends } of this.springs) pairs.push([ends[0].place, ends[1].place, 6]);
    for (const thing of this.hands) {
      for (const [at, turn] of [[thing.place, thing.turn], [thing.device, thing.deviceTurn]]) {
        RODS.forEach((part, axis) => pairs.push([at, sum(at, [turned(turn, UNITS[axis])], [part * ROD * thing.drawnRadius]), 1, THIN * this.around.radius]));
      }
      const places = thing.arc.along(ARC_PLACES);
      places.slice(1).forEach((to, i) => pairs.push([places[i], to, 1, 2.4 * THICK * this.around.radius]));
    }
    const seen = pairs.map(([from, to, aside, thick = 0]) => [this.orbit.project(from), this.orbit.project(to), aside, thick]);
    const whole = seen.filter(([from, to]) => from && to);
    return [...whole.map(([from, to, aside, thick]) => [from, to, aside + thick * Math.max(from.pixels, to.pixels)]), ...this.axes.map((_, axis) => [...this.axis(axis), 1])];
  }

  /** The ring of a device, how far its tool is from it, and where a person wants it; returns the ring's box. */
  drawDevice(thing, here) {
    const tool = here && this.orbit.project(thing.place);
    this.grips.show(thing.handle, thing.name, this.around.radius);
    thing.handle.style.display = thing.lag.style.display = tool ? "" : "none";
    if (!tool) {
      showPressed(thing.pressed, [], here);
      return null;
    }
    if (thing.pivot) place(thing.handle, { "data-turn": thing.deviceTurn.join(" ") });
    thing.handle.setAttribute("transform", `translate(${here.x.toFixed(1)} ${here.y.toFixed(1)})`);
    place(thing.lag, { x1: here.x, y1: here.y, x2: tool.x, y2: tool.y });
    showPressed(thing.pressed, this.session.pressed(thing.name), tool);
    const wanted = this.grips.held.get(thing.name);
    const to = wanted && this.orbit.project(this.wantedPlace(thing, wanted));
    thing.target.setAttribute("d", to ? `M${to.x - 9} ${to.y}h18M${to.x} ${to.y - 9}v18` : "");
    return boxAround(here, RING);
  }

  wantedPlace(thing, wanted) {
    return this.world.pose(thing, wanted).place;
  }

  /** The directions of the axes, at a corner of the picture. */
  drawAxes() {
    this.axes.forEach(({ line }, axis) => {
      const [from, to] = this.axis(axis);
      place(line, { x1: from.x, y1: from.y, x2: to.x, y2: to.y });
      this.labels.place(to, 1);
    });
  }

  /** Where the line of an axis begins and ends in the picture. */
  axis(axis) {
    const { right, up, height: high } = this.orbit;
    const from = { x: 42, y: high - this.foot - 36 };
    const { along } = this.axes[axis];
    return [from, { x: from.x + TRIAD * dot(right, along), y: from.y - TRIAD * dot(up, along) }];
  }

  /** Where a device that is at x shall be while the pointer is dragged, in the plane through it that is parallel to the picture. */
  drag(event, x, thing) {
    let [left, top] = [event.clientX, event.clientY];
    const start = this.wantedPlace(thing, x);
    const point = [...start];
    return (later) => {
      const moved = this.orbit.across(later.clientX - left, later.clientY - top, this.orbit.depth(point));
      [left, top] = [later.clientX, later.clientY];
      moved.forEach((d, i) => (point[i] += d));
      const away = point.map((value, i) => value - start[i]);
      return x.map((value, port) => value + dot(away, thing.pointing[port]));
    };
  }

  /** How the ring of a device looks that can be held. */
  get ring() {
    return "blue";
  }

  /** What the signs mean. */
  legend() {
    return (
      "Ring: device (x). Blue: its tool in the world (x_e), pale where it is behind something. Dashed: the difference that its coupling permits. Yellow: bodies. Grey: what stands still. Arrow: the force on the hand (f). Violet circle at a tool: a button is pressed. " +
      this.world.remark() +
      "Drag the background to turn the view, with Shift to move it; two fingers, or the wheel after a click, zoom; or focus it and press arrow keys, + and −. Home shows the first view."
    );
  }

  dispose() {
    this.scheme.removeEventListener("change", this.recolour);
    this.stage.dispose();
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** A place, moved so far along each direction. */
const sum = (at, directions, far) => at.map((x, i) => directions.reduce((total, along, port) => total + far[port] * along[i], x));

const UNITS = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** The world of a scene: its things, what stands still, and where two of them touch. */
class Scene {
  constructor(session) {
    this.about = session.about;
    this.things = thingsOf(session);
    this.axes = UNITS;
    this.touching = new Contacts(session.about.scene, this.things);
  }

  standing(palette, around) {
    return Object.values(this.about.scene.obstacles).flatMap((given) => obstacle(given, palette, around));
  }

  solid(thing, material) {
    return solid(thing, material);
  }

  /** The place of a thing whose axes have these displacements; nothing turns. */
  pose({ at, along }, values) {
    return { place: sum(at, along, values), pointing: along };
  }

  inModel(v) {
    return v;
  }

  contacts() {
    return this.touching.now();
  }

  remark() {
    return "Violet ring: a contact. ";
  }

  /** Places that the first view shows, of what stands still; the ground, m, where there is one; corners of its grid. */
  bounds() {
    const obstacles = Object.values(this.about.scene.obstacles);
    const seen = obstacles.filter(({ shape }) => shape !== "wall");
    const room = obstacles.find(({ shape }) => shape === "room")?.points;
    const floor = obstacles.find(({ shape, points: [, normal] }) => shape === "wall" && normal[1] > 0.9 * Math.hypot(...normal));
    return { places: seen.flatMap(({ points, radius }) => points.map((point) => [point, radius ?? 0])), room, ground: room?.[0][1] ?? floor?.points[0][1] };
  }
}

const boxAround = ({ x, y }, far) => [x - far, y - far, x + far, y + far];

/** Tools, then bodies, with the track and the columns that have their displacements. */
function thingsOf({ about, tracks }) {
  const columns = (track, names) => names.map((name) => tracks.get(track).columns.indexOf(name));
  const moving = ([name, given], tool, track, axes, names) => {
    const { at, radius, half = [0, 0, 0], shape, motion } = given;
    return {
      ...{ name, names, tool, at, radius, half, box: shape === "box", driven: motion !== undefined },
      ...{ size: radius + Math.hypot(...half), track, along: axes.map((axis) => UNITS[axis]), columns: columns(track, names) },
      ...{ place: [...at], device: [...at], moved: names.map(() => 0) },
    };
  };
  return [
    ...Object.entries(about.scene.tools).map((tool) =>
      moving(tool, true, "environment/tools", tool[1].axes.map((axis) => AXES.indexOf(axis)), tool[1].ports),
    ),
    ...Object.entries(about.scene.bodies).map((body) =>
      moving(body, false, "environment/masses", [0, 1, 2], AXES.map((axis) => `${body[0]}.${axis}`)),
    ),
  ];
}

/** The pairs of things that springs join, each once; springs to the ground are not among them. */
function joinedBy(springs, things) {
  const owner = new Map();
  const pairs = new Map();
  for (const thing of things) for (const name of thing.names) owner.set(name, thing);
  for (const { ends } of springs) {
    const pair = ends.map((end) => owner.get(end));
    if (pair[0] && pair[1] && pair[0] !== pair[1]) pairs.set(pair.map((thing) => things.indexOf(thing)).join(), pair);
  }
  return [...pairs.values()];
}

/** What the first view shows: its middle and its radius; the ground with the corners of its grid, and a side of it, m. */
function around({ reach, turning }, world) {
  const { things } = world;
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  const include = (point, radius) => {
    for (let i = 0; i < 3; i += 1) {
      low[i] = Math.min(low[i], point[i] - radius);
      high[i] = Math.max(high[i], point[i] + radius);
    }
  };
  const { places, room, ground } = world.bounds();
  for (const { at, size } of things) include(at, size);
  for (const [point, radius] of places) include(point, radius);
  const lowest = low[1];
  const most = ROOM * Math.hypot(...low.map((x, i) => high[i] - x)) || Infinity;
  for (const { tool, at, names } of things) if (tool) include(at, Math.min(most, MOTION * Math.max(0, ...names.filter((port) => !turning.includes(port)).map((port) => reach[port] ?? 0))));
  const middle = low.map((x, i) => (x + high[i]) / 2);
  const radius = Math.max(1e-3, Math.hypot(...low.map((x, i) => high[i] - x)) / 2);
  const corners = room ?? [middle.map((x) => x - radius), middle.map((x) => x + radius)];
  const ends = [low, high];
  const outer = [0, 1, 2, 3, 4, 5, 6, 7].map((n) => low.map((_, i) => ends[(n >> i) & 1][i]));
  return { middle, radius, ground: ground ?? lowest, low: corners[0], high: corners[1], corners: outer, step: rounded(radius / 8) };
}
