/** The moving virtual world in its plane: tools, masses and springs, and the devices that move the tools through their couplings. */

import { buttons, height, place, say, showPressed, svg } from "./elements.js";
import { axisOf, fitted, quantity, unitsOf } from "./format.js";
import { Labels } from "./labels.js";
import { layout } from "./layout.js";

const LEAST = 2e-3; // m or rad, the smallest motion that may fill the drawing: numerical noise must not look like motion
const LEAST_FORCE = { false: 0.1, true: 0.01 }; // N, and N·m of what turns, the same for forces
const LIFT = 26; // px at least that a device of one axis is drawn above its tool
const ROW = 64; // px at least that a row of bodies is high
const SWING = 220; // px at most from a body's middle to its greatest displacement
const TOP = 26; // px above the rows, for the name of the first
const FOOT = 58; // px below the rows, for the scales
const COIL = 7; // px, half the width of a spring
const TURN = 26; // px of one turn of a spring where its ends are at rest
const ARROW = 60; // px, length of the arrow for the greatest force
const PLANE = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]; // to the right, upwards and towards the eye
const LOOK = 500; // ms between two updates of the scale

export class World {
  constructor(parent, session, grips) {
    Object.assign(this, { parent, session, grips });
    const { bodies, pairs, columns, rows } = layout(session.about);
    Object.assign(this, { bodies, pairs, columns, rows });
    // the greatest motion and force that fill the drawing, of what does not turn (false) and of what does (true)
    this.most = { false: 0, true: 0 };
    this.mostForce = { false: 0, true: 0 };
    const ports = Object.values(session.about.nodes).flatMap((node) => node.ports);
    this.kinds = [false, true].filter((turns) => ports.some((port) => session.turns(port) === turns));
    this.looked = -Infinity;
    this.planar = [...bodies.values()].some((body) => body.planar);
    this.drawing = svg("svg", { role: "group", "aria-label": "The virtual world" });
    this.parts = this.build();
    parent.replaceChildren(this.drawing);
    this.arrange();
    new ResizeObserver(() => this.arrange()).observe(parent);
  }

  build() {
    const springs = this.pairs.map((ends) => ({ ends, path: svg("path", { class: "spring" }) }));
    const lanes = [...this.bodies.values()].filter((b) => b.kind === "tool").map((body) => ({ body, line: svg("line", { class: "lane" }) }));
    this.drawing.append(...lanes.map(({ line }) => line), ...springs.map(({ path }) => path));
    const bodies = [...this.bodies].map(([id, body]) => this[body.kind](id, body));
    this.bar = svg("path", { class: "hatch", fill: "none" });
    this.barText = svg("text", { class: "dim" });
    this.forceBar = svg("path", { class: "force" });
    this.forceHead = svg("path", { class: "force-head" });
    this.forceText = svg("text", { class: "dim" });
    this.drawing.append(this.bar, this.barText, this.forceBar, this.forceHead, this.forceText);
    const named = bodies.filter(({ label }) => label);
    this.labels = new Labels([...named.map(({ label }) => label), ...bodies.flatMap(({ axes }) => axes ?? [])]);
    return { springs, lanes, bodies, named };
  }

  ground(id, body) {
    const path = svg("path", { class: "hatch", fill: "none" });
    this.drawing.append(path);
    return { id, body, path };
  }

  mass(id, body) {
    const box = svg("rect", { class: "mass", width: 34, height: 26, rx: 3, "data-mass": body.name });
    const label = svg("text", {}, body.name);
    this.drawing.append(box, label);
    return { id, body, box, label };
  }

  tool(id, body) {
    const lag = svg("line", { class: "lag" });
    const tool = svg("rect", { class: "tool", width: 14, height: 14, rx: 2, "data-tool": body.name });
    const target = svg("path", { class: "target" });
    const pressed = svg("circle", { class: "pressed", r: 9 });
    const force = svg("path", { class: "force" });
    const head = svg("path", { class: "force-head" });
    const label = svg("text", {}, body.name);
    const shown = body.ports.slice(0, 2);
    const axes = shown.map((port) => svg("text", { class: "dim" }, axisOf(port, this.session.turns(port))));
    const upright = svg("path", { class: "axis" });
    const handle = this.grips.handle(body.name, {
      start: (event, x) => this.drag(event, x, body.ports),
      most: () => this.most[this.session.turns(body.ports[0])],
      axes: () => PLANE,
    });
    this.drawing.append(upright, ...axes, lag, tool, pressed, target, force, head, label, handle);
    return { id, body, lag, tool, pressed, target, force, head, label, axes, upright, handle };
  }

  /** Where a device that is at x shall be while the pointer is dragged from where it is. */
  drag(event, x, ports) {
    const from = this.point(event);
    return (later) => {
      const to = this.point(later);
      const moved = [to.x - from.x, from.y - to.y];
      return x.map((value, axis) => value + (moved[axis] ?? 0) / this.pixels(ports[axis]));
    };
  }

  /** The position of an event in the drawing's own units. */
  point(event) {
    return new DOMPoint(event.clientX, event.clientY).matrixTransform(this.drawing.getScreenCTM().inverse());
  }

  /** The positions of columns and rows, so that they fill the present width and height; a crowd is higher. */
  arrange() {
    if (!this.parent.isConnected) return; // it is not shown
    const width = Math.max(280, Math.floor(this.parent.clientWidth));
    const spread = this.columns > 1 ? (width - 60) / this.columns : width / 2;
    const rowHeight = Math.max(ROW, (height(this.parent) - FOOT) / this.rows);
    this.swing = Math.min(SWING, 0.36 * spread);
    if (this.planar) this.swing = Math.min(this.swing, Math.max(64, (rowHeight - 56) / 2));
    this.rowHeight = this.planar ? Math.max(rowHeight, 2 * this.swing + 56) : rowHeight;
    this.lift = Math.max(LIFT, Math.min(60, this.rowHeight / 6));
    this.spots = new Map();
    const left = this.swing + 34;
    const last = width - (this.bodies.has("ground") ? 24 : this.swing + 36);
    const far = this.columns > 1 ? (last - left) / (this.columns - 1) : 0;
    for (const [id, body] of this.bodies) {
      this.spots.set(id, { x: left + body.column * far, y: this.rowHeight * (body.row + 0.5) + TOP });
    }
    this.height = Math.round(this.rowHeight * this.rows + FOOT);
    this.width = width;
    this.drawing.setAttribute("viewBox", `0 0 ${width} ${this.height}`);
    for (const spring of this.parts.springs) {
      const [a, b] = this.ends(spring.ends, this.spots);
      spring.turns = 2 * Math.max(4, Math.round(Math.hypot(a.x - b.x, a.y - b.y) / TURN)); // as many, however it is stretched
    }
    if (this.kinds.every((turns) => this.most[turns])) this.draw();
  }

  /** Scales that fit the latest motions: they grow at once, shrink when a third would do, and stay while a device is held. */
  rescale(now) {
    if (now - this.looked < LOOK) return;
    this.looked = now;
    const { about } = this.session;
    // where a hand can move a device, its motion has room
    for (const turns of this.kinds) {
      const held = about.grips.map((d) => about.nodes[d].ports[0]).filter((port) => this.session.turns(port) === turns);
      const gripped = held.length ? Math.min(turns ? 0.5 : 0.02, Math.max(...held.map((port) => about.reach[port] ?? 0))) : 0;
      const moved = this.session.greatest(["sample", "tools", "masses"], turns);
      if (this.grips.held.size === 0) this.most[turns] = fitted(this.most[turns], Math.max(LEAST, gripped, moved));
      const force = Math.max(LEAST_FORCE[turns], this.session.greatest(["force"], turns));
      this.mostForce[turns] = fitted(this.mostForce[turns], force);
    }
  }

  /** Pixels a metre, or a radian, of a port or a body. */
  pixels(name) {
    const most = this.most[this.session.turns(name)];
    return most ? this.swing / most : 0;
  }

  /** The present position of a body, px. */
  at(id) {
    const body = this.bodies.get(id);
    const spot = this.spots.get(id);
    const moved = [0, 0];
    if (body.kind === "tool") {
      body.ports.slice(0, 2).forEach((port, axis) => (moved[axis] = this.pixels(port) * this.tool_of(port)));
    } else if (body.kind === "mass") {
      const { columns } = this.session.tracks.get("environment/masses");
      for (const { axis, index } of body.axes) {
        if (axis < 2) moved[axis] = this.pixels(columns[index]) * this.session.known("environment/masses", index);
      }
    }
    return offset(spot, moved);
  }

  tool_of(port) {
    const track = this.session.tracks.get("environment/tools");
    return this.session.known("environment/tools", track.columns.indexOf(port));
  }

  draw() {
    const places = new Map([...this.bodies.keys()].map((id) => [id, this.at(id)]));
    for (const { body, line } of this.parts.lanes) {
      const [from, to] = this.lane(body);
      place(line, { x1: from.x, x2: to.x, y1: from.y, y2: to.y });
    }
    this.lines = this.parts.lanes.map(({ body }) => this.lane(body));
    this.taken = [[0, this.height - 26, this.swing + (this.kinds.length > 1 ? 330 : 200), this.height], buttons(this.width)];
    for (const { ends, path, turns } of this.parts.springs) {
      const [a, b] = this.ends(ends, places);
      path.setAttribute("d", zigzag(a, b, turns));
      this.lines.push([a, b, COIL]);
    }
    for (const part of this.parts.bodies) this[`draw_${part.body.kind}`](part, places.get(part.id));
    this.drawScale();
    this.drawLabels(places);
  }

  ends(ends, places) {
    const [a, b] = ends.map((id) => ({ ...places.get(id), ground: id === "ground" }));
    if (a.ground) a.y = b.y;
    if (b.ground) b.y = a.y;
    return [a, b];
  }

  /** The line along which a tool moves. */
  lane({ name }) {
    const { x, y } = this.spots.get(`tool ${name}`);
    return [{ x: x - this.swing - 12, y }, { x: x + this.swing + 12, y }, 0];
  }

  /** The names of tools and masses, and then of the axes, where no line is. */
  drawLabels(places) {
    const boxes = this.parts.named.map(({ id, body }) => (body.kind === "mass" ? around(places.get(id), 17, 13) : null));
    this.labels.begin(this.width, this.height, this.taken, boxes, this.lines);
    for (const { id, body } of this.parts.named) {
      const spot = this.spots.get(id);
      if (body.kind === "mass") this.labels.place(places.get(id), 15);
      else this.labels.place({ x: spot.x - this.swing, y: spot.y - (body.planar ? this.swing : this.lift) - 21 }, 0);
    }
    for (const { body, axes, id } of this.parts.named) {
      const { x, y } = this.spots.get(id);
      axes?.forEach((_, axis) => this.labels.place(axis ? { x, y: y - this.swing - 12 } : { x: x + this.swing + 12, y }, 3));
    }
  }

  draw_ground({ path }, { x }) {
    const [top, bottom] = [buttons(this.width)[3], this.rowHeight * this.rows + 10];
    let d = `M${x} ${top}V${bottom}`;
    for (let y = top + 10; y <= bottom; y += 10) d += `M${x} ${y - 10}l9 10`;
    path.setAttribute("d", d);
    this.lines.push([{ x, y: top }, { x, y: bottom }, 9]);
  }

  draw_mass({ box, body }, at) {
    place(box, { x: at.x - 17, y: at.y - 13 });
    box.setAttribute("data-at", body.axes.map(({ index }) => this.session.now("environment/masses", index)).join(" "));
  }

  draw_tool({ body, lag, tool, pressed, target, force, head, upright, handle }, at) {
    const spot = this.spots.get(`tool ${body.name}`);
    const lift = body.planar ? 0 : this.lift;
    const on = (position) => {
      const px = position.map((value, axis) => value * this.pixels(body.ports[axis]));
      return offset({ x: spot.x, y: spot.y - lift }, [px[0], body.planar ? (px[1] ?? 0) : 0]);
    };
    const here = on(this.grips.position(body.name));
    const forces = body.ports.map((_, axis) => this.session.known(`${body.name}/force`, axis));
    place(tool, { x: at.x - 7, y: at.y - 7, "data-at": body.ports.map((port) => this.tool_of(port)).join(" ") });
    place(lag, { x1: here.x, y1: here.y, x2: at.x, y2: at.y });
    showPressed(pressed, this.session.pressed(body.name), at);
    this.lines.push([here, at, 2]);
    this.taken.push(around(here, 12, 12), around(at, 8, 8));
    const arrow = this.arrow(force, head, here, forces.map((f, axis) => f / (this.mostForce[this.session.turns(body.ports[axis])] || 1)));
    if (arrow) this.lines.push(arrow);
    if (body.planar) {
      upright.setAttribute("d", `M${spot.x} ${spot.y - this.swing - 12}V${spot.y + this.swing + 12}`);
      this.lines.push([{ x: spot.x, y: spot.y - this.swing - 12 }, { x: spot.x, y: spot.y + this.swing + 12 }, 0]);
    }
    handle.setAttribute("transform", `translate(${here.x.toFixed(1)} ${here.y.toFixed(1)})`);
    this.grips.show(handle, body.name, this.most[this.session.turns(body.ports[0])]);
    const wanted = this.grips.held.get(body.name);
    if (wanted === undefined) {
      target.setAttribute("d", "");
      return;
    }
    const to = on(wanted);
    target.setAttribute("d", `M${to.x - 9} ${to.y}h18M${to.x} ${to.y - 9}v18`);
  }

  /** How the ring of a device looks that can be held. */
  get ring() {
    return "filled";
  }

  /** What the signs mean. */
  legend() {
    const { springs, environment } = this.session.about;
    const inside = springs.length ? "zigzags are its springs, boxes its masses" : `inside, it is of the kind ${environment}`;
    return `Ring: device (x). Square: its tool in the world (x_e). Dashed: the difference that its coupling permits. Arrow: the force it exerts on the hand (f), whose scale is below; a third axis is in the list alone${this.session.about.hands.length ? ", and so are turns and torques" : ""}. Violet circle: a button is pressed. The world: ${inside}.`;
  }

  /** Draw a force, in parts of the greatest; returns its line, or null where it is too small to be seen. */
  arrow(path, head, from, parts) {
    const [fx, fy] = [parts[0], -(parts[1] ?? 0)].map((part) => ARROW * Math.max(-1.2, Math.min(1.2, part)));
    const length = Math.hypot(fx, fy);
    if (length < 2) {
      path.setAttribute("d", "");
      head.setAttribute("d", "");
      return null;
    }
    const [ux, uy] = [fx / length, fy / length];
    const start = { x: from.x + 13 * ux, y: from.y + 13 * uy };
    const end = { x: start.x + fx, y: start.y + fy };
    path.setAttribute("d", `M${start.x} ${start.y}L${end.x} ${end.y}`);
    head.setAttribute("d", `M${end.x + 8 * ux} ${end.y + 8 * uy}L${end.x - 5 * uy} ${end.y + 5 * ux}L${end.x + 5 * uy} ${end.y - 5 * ux}Z`);
    return [start, { x: end.x + 8 * ux, y: end.y + 8 * uy }, 5];
  }

  drawScale() {
    const y = this.height - 10;
    this.bar.setAttribute("d", `M10 ${y - 4}v8M10 ${y}h${this.swing}v-4v8`);
    place(this.barText, { x: this.swing + 16, y: y + 4 });
    const told = (most, which) => this.kinds.map((turns) => quantity(most[turns], unitsOf(turns)[which])).join(", ");
    say(this.barText, told(this.most, 0));
    const from = { x: this.swing + (this.kinds.length > 1 ? 150 : 84), y };
    this.arrow(this.forceBar, this.forceHead, { x: from.x - 13, y }, [1]);
    place(this.forceText, { x: from.x + ARROW + 14, y: y + 4 });
    say(this.forceText, told(this.mostForce, 1));
  }
}

/** A place that is moved to the right and up, px. */
const offset = (spot, [x, y]) => ({ x: spot.x + x, y: spot.y - y });

/** The box around a place. */
const around = ({ x, y }, wide, high) => [x - wide, y - high, x + wide, y + high];

/** A spring of so many half turns between two positions, px. */
function zigzag(a, b, turns) {
  const [dx, dy] = [b.x - a.x, b.y - a.y];
  const length = Math.hypot(dx, dy) || 1;
  const [nx, ny] = [(-COIL * dy) / length, (COIL * dx) / length];
  let d = `M${a.x.toFixed(1)} ${a.y.toFixed(1)}`;
  for (let i = 1; i < turns; i += 1) {
    const part = 0.12 + (0.76 * i) / turns;
    const side = i % 2 ? 1 : -1;
    d += `L${(a.x + part * dx + side * nx).toFixed(1)} ${(a.y + part * dy + side * ny).toFixed(1)}`;
  }
  return `${d}L${b.x.toFixed(1)} ${b.y.toFixed(1)}`;
}
