/** Holds devices by pointer or by keys. The page repeats each hold ten times a second, since a hold that is not repeated ends. */

import { byId, place, say, svg } from "./elements.js";
import { quantity, unitsOf } from "./format.js";

const AGAIN = 100; // ms
const STEPS = 40; // key presses from the middle to the edge of the drawing
const KEYS = {
  ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowUp: [1, 1], ArrowDown: [1, -1], PageUp: [2, 1], PageDown: [2, -1],
};

export class Grips {
  constructor(session, send) {
    this.session = session;
    this.send = send;
    this.held = new Map(); // by device: the wanted position, m, one entry for each axis
    setInterval(() => this.held.forEach((position, grasp) => this.send({ grasp, position })), AGAIN);
    document.addEventListener("visibilitychange", () => document.hidden && this.releaseAll());
    addEventListener("pagehide", () => this.releaseAll());
  }

  holds(device) {
    return this.held.has(device);
  }

  /** Hold a device, or move it to another position. */
  hold(device, position) {
    const ports = this.session.about.nodes[device].ports;
    const within = position.map((x, axis) => {
      const reach = this.session.about.reach[ports[axis]] ?? Infinity;
      return Math.max(-reach, Math.min(reach, x));
    });
    this.held.set(device, within);
    this.send({ grasp: device, position: within });
    say(byId("grip-status"), `Holding ${device}. Escape lets go.`);
  }

  release(device) {
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
    say(byId("grip-status"), why);
  }

  /** The present position of a device, m, one entry for each axis. */
  position(device) {
    const axes = this.session.about.nodes[device].ports.length;
    return Array.from({ length: axes }, (_, axis) => this.session.known(`${device}/sample`, axis));
  }

  /** The handle of a device: a ring, which can be dragged if a person can hold the device.

  `drag.start(event, x)` returns a function of later events, whose values are positions, m; x is the device's at the
  start. `drag.most()` is the displacement that keys reach in 40 steps, m.
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
      "aria-label": `device ${device}: drag it, or move it with the arrow keys; Escape lets go`,
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
    let moved = null; // while a pointer holds the device
    handle.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || this.session.picture?.held[device] === "elsewhere") return;
      event.preventDefault();
      handle.focus({ preventScroll: true });
      handle.setPointerCapture(event.pointerId);
      const x = this.position(device);
      moved = drag.start(event, x);
      this.hold(device, x);
    });
    handle.addEventListener("pointermove", (event) => moved && this.hold(device, moved(event)));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      handle.addEventListener(end, () => {
        if (moved === null) return;
        moved = null;
        this.release(device);
      });
    }
    // the focus goes to another handle when a second finger takes it
    handle.addEventListener("blur", () => moved === null && this.release(device));
    handle.addEventListener("keydown", (event) => {
      if (event.key === "Escape" || (event.key === "Enter" && this.holds(device))) this.release(device);
      else if (event.key === "Enter" || event.key === " ") this.hold(device, this.position(device));
      else if (event.key in KEYS && (KEYS[event.key][0] < axes || axes === 1)) this.step(device, axes, event, drag.most());
      else return;
      event.preventDefault();
    });
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
    const [where, wanted] = [told(this.position(device)), this.held.get(device)];
    return wanted ? `held at ${told(wanted)}; is at ${where}` : `free at ${where}`;
  }
}
