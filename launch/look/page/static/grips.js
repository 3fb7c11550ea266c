/** Holds and turns devices by pointer or by keys. The page repeats each hold ten times a second, since a hold that is not repeated ends. */

import { byId, place, say, svg } from "./elements.js";
import { quantity, unitsOf } from "./format.js";
import { QUATERNION, STILL, about, along, angleOf, dragged, times, unitOf } from "./turns.js";

const AGAIN = 100; // ms
const STEPS = 40; // key presses from the middle to the edge of the drawing
const KEYS = {
  ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowUp: [1, 1], ArrowDown: [1, -1], PageUp: [2, 1], PageDown: [2, -1],
};
const TURNS = { s: [0, 1], w: [0, -1], d: [1, 1], a: [1, -1], q: [2, 1], e: [2, -1] }; // about the picture's right, its upwards, and towards the eye
const TURN = Math.PI / 60; // rad of a key press
const BALL = 100; // px, the radius of the ball about a device by which a pointer turns it

export class Grips {
  constructor(session, send) {
    this.session = session;
    this.send = send;
    this.held = new Map(); // by device: the wanted position, m, one entry for each axis
    this.turned = new Map(); // by held device whose orientation is a port: where it is to be turned
    this.fingers = new Map(); // by such a device that a finger holds: its handle, and what drags it
    setInterval(() => this.held.forEach((_, device) => this.send(this.demand(device))), AGAIN);
    document.addEventListener("visibilitychange", () => document.hidden && this.releaseAll());
    addEventListener("pagehide", () => this.releaseAll());
  }

  holds(device) {
    return this.held.has(device);
  }

  /** What the server is asked for of a held device. */
  demand(device) {
    const turn = this.turned.get(device);
    return { grasp: device, position: this.held.get(device), ...(turn && { turn }) };
  }

  /** Hold a device, or move it to another position; turn it, where it can be turned. */
  hold(device, position, turn = this.turned.get(device) ?? this.orientation(device)) {
    const ports = this.session.about.nodes[device].ports;
    const within = position.map((x, axis) => {
      const reach = this.session.about.reach[ports[axis]] ?? Infinity;
      return Math.max(-reach, Math.min(reach, x));
    });
    this.held.set(device, within);
    if (this.session.turnsInSpace(device)) this.turned.set(device, turn);
    this.send(this.demand(device));
    say(byId("grip-status"), `Holding ${device}. Escape lets go.`);
  }

  release(device) {
    this.turned.delete(device);
    if (!this.held.delete(device)) return;
    this.send({ release: device });
    say(byId("grip-status"), `${device} let go.`);
  }

  releaseAll() {
    for (const device of [...this.held.keys()]) this.release(device);
  }

  /** The server has refused a hold. */
  refused(why) {
    this.held.clear();
    this.turned.clear();
    say(byId("grip-status"), why);
  }

  /** The present position of a device, m, one entry for each axis. */
  position(device) {
    const axes = this.session.about.nodes[device].ports.length;
    return Array.from({ length: axes }, (_, axis) => this.session.known(`${device}/sample`, axis));
  }

  /** The present orientation of a device, in the model's axes. */
  orientation(device) {
    return unitOf(QUATERNION.map((_, part) => this.session.known(`${device}/orientation`, part))) ?? STILL;
  }

  /** The handle of a device: a ring, which can be dragged if a person can hold the device.

  `drag.start(event, x)` returns a function of later events, whose values are positions, m; x is the device's at the
  start. `drag.most()` is the displacement that keys reach in 40 steps, m. `drag.axes()` are the picture's directions to
  the right, upwards and towards the eye, in the model's axes.
  */
  handle(device, drag) {
    const grip = this.session.about.grips.includes(device);
    const circles = [svg("circle", { r: 11, class: "body" }), svg("circle", { r: 4, class: "dot" })];
    if (grip) circles.unshift(svg("circle", { r: 24, class: "touch" }), svg("circle", { r: 17, class: "ring" }));
    const handle = svg("g", { class: grip ? "handle grip" : "handle", "data-device": device }, ...circles);
    if (!grip) return handle;
    place(handle, {
      tabindex: "0",
      role: "slider",
      "aria-label": `device ${device}: drag it, or move it with the arrow keys; ${this.session.turnsInSpace(device) ? "turn it by W, A, S, D, Q and E, or drag with Shift; " : ""}Escape lets go`,
    });
    this.attach(handle, device, drag);
    return handle;
  }

  /** Show whether a device is held, and where it is. */
  show(handle, device, most) {
    if (!handle.classList.contains("grip")) return;
    const x = this.position(device);
    const held = this.session.picture.held[device] ?? "";
    handle.classList.toggle("held", this.holds(device));
    handle.classList.toggle("elsewhere", held === "elsewhere");
    place(handle, {
      "data-at": x.join(" "),
      "data-held": held,
      "aria-valuemin": String(-most),
      "aria-valuemax": String(most),
      "aria-valuenow": String(x[0]),
      "aria-valuetext": held === "elsewhere" ? "held by another page" : this.text(device),
    });
  }

  attach(handle, device, drag) {
    const axes = this.session.about.nodes[device].ports.length;
    const turns = this.session.turnsInSpace(device);
    let moved = null; // while a pointer holds the device
    let pointer = null; // which
    handle.addEventListener("touchstart", (event) => event.cancelable && event.preventDefault(), { passive: false });
    if (turns) handle.addEventListener("contextmenu", (event) => event.preventDefault());
    handle.addEventListener("pointerdown", (event) => {
      const turning = turns && (event.button === 2 || (event.button === 0 && event.shiftKey));
      if (!(turning || event.button === 0) || moved || this.session.picture?.held[device] === "elsewhere") return;
      event.preventDefault();
      handle.focus({ preventScroll: true });
      handle.setPointerCapture(event.pointerId);
      pointer = event.pointerId;
      const x = this.position(device);
      if (turns && event.pointerType === "touch") this.fingers.set(device, { handle, drag });
      this.hold(device, x);
      const turn = turning && this.ball(event, device, handle, drag);
      const move = turning || drag.start(event, x);
      moved = (later) => (turning ? this.hold(device, x, turn(later)) : this.hold(device, move(later)));
    });
    handle.addEventListener("pointermove", (event) => event.pointerId === pointer && moved?.(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      handle.addEventListener(end, (event) => {
        if (moved === null || event.pointerId !== pointer) return;
        moved = null;
        this.fingers.delete(device);
        this.release(device);
      });
    }
    // the focus goes to another handle when a second finger takes it
    handle.addEventListener("blur", () => moved === null && this.release(device));
    handle.addEventListener("keydown", (event) => {
      if (event.key === "Escape" || (event.key === "Enter" && this.holds(device))) this.release(device);
      else if (event.key === "Enter" || event.key === " ") this.hold(device, this.position(device));
      else if (event.key in KEYS && (KEYS[event.key][0] < axes || axes === 1)) this.step(device, axes, event, drag.most());
      else if (turns && event.key.toLowerCase() in TURNS && !event.ctrlKey && !event.altKey && !event.metaKey) this.turnStep(device, event, drag.axes());
      else return;
      event.preventDefault();
    });
  }

  /** A pointer turns a device, as if its ring were in the middle of a ball: a function of later events, whose values are orientations. */
  ball(event, device, handle, drag) {
    const axes = drag.axes();
    return this.turning(event, device, handle, (from, to) => along(dragged(from, to), axes));
  }

  /** The same by the way that a pointer makes around the ring, as a knob is turned. */
  knob(event, device, handle, drag) {
    const angle = ([x, y]) => Math.atan2(y, x);
    const [, , towards] = drag.axes();
    return this.turning(event, device, handle, (from, to) => about(towards, angle(to) - angle(from)));
  }

  /** The same by what `by` makes of two places of the pointer, in parts of the ball's radius from the ring's middle. */
  turning(event, device, handle, by) {
    const box = handle.querySelector(".body").getBoundingClientRect();
    const middle = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
    const at = ({ clientX, clientY }) => [(clientX - middle[0]) / BALL, (middle[1] - clientY) / BALL];
    const [from, start] = [at(event), this.turned.get(device) ?? this.orientation(device)];
    return (later) => times(by(from, at(later)), start);
  }

  /** A finger beside those that hold devices turns one that can be turned: what it does later; null where there is none. */
  beside(event) {
    const [held] = event.pointerType === "touch" ? this.fingers : [];
    if (!held) return null;
    const [device, { handle, drag }] = held;
    const turn = this.knob(event, device, handle, drag);
    return (later) => this.fingers.has(device) && this.hold(device, this.held.get(device), turn(later));
  }

  turnStep(device, event, axes) {
    const [axis, sign] = TURNS[event.key.toLowerCase()];
    const start = this.turned.get(device) ?? this.orientation(device);
    const turn = times(about(axes[axis], sign * TURN * (event.shiftKey ? 5 : 1)), start);
    this.hold(device, this.held.get(device) ?? this.position(device), turn);
  }

  step(device, axes, event, most) {
    const [axis, sign] = KEYS[event.key];
    const position = [...(this.held.get(device) ?? this.position(device))];
    position[axes === 1 ? 0 : axis] += ((sign * most) / STEPS) * (event.shiftKey ? 5 : 1);
    this.hold(device, position);
  }

  /** The text of a handle for screen readers. */
  text(device) {
    const units = this.session.about.nodes[device].ports.map((port) => unitsOf(this.session.turns(port))[0]);
    const told = (position) => position.map((x, axis) => quantity(x, units[axis])).join(", ");
    const turn = this.session.turnsInSpace(device) ? `, turned by ${quantity(angleOf(this.orientation(device)), "rad")}` : "";
    const [where, wanted] = [told(this.position(device)) + turn, this.held.get(device)];
    return wanted ? `held at ${told(wanted)}; is at ${where}` : `free at ${where}`;
  }
}
