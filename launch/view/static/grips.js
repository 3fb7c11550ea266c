/** Holds devices by pointer or by keys. The page repeats each hold ten times a second, since a hold that is not repeated ends. */

import { byId, say } from "./elements.js";
import { quantity } from "./format.js";

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
    return Array.from({ length: axes }, (_, axis) => {
      const x = this.session.now(`${device}/sample`, axis);
      return Number.isNaN(x) ? 0 : x;
    });
  }

  /** Make a handle draggable; `scale()` returns px per m and the greatest displacement drawn, `place(event)` a position in px. */
  attach(handle, device, scale, place) {
    const axes = this.session.about.nodes[device].ports.length;
    let from = null;
    handle.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || this.session.picture?.held[device] === "elsewhere") return;
      event.preventDefault();
      handle.focus({ preventScroll: true });
      handle.setPointerCapture(event.pointerId);
      from = { at: place(event), x: this.position(device) };
      this.hold(device, from.x);
    });
    handle.addEventListener("pointermove", (event) => {
      if (from === null) return;
      const to = place(event);
      const moved = [to.x - from.at.x, from.at.y - to.y].map((px) => px / scale().pixels);
      this.hold(device, from.x.map((x, axis) => x + (moved[axis] ?? 0)));
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      handle.addEventListener(end, () => {
        if (from === null) return;
        from = null;
        this.release(device);
      });
    }
    handle.addEventListener("blur", () => this.release(device));
    handle.addEventListener("keydown", (event) => {
      if (event.key === "Escape" || (event.key === "Enter" && this.holds(device))) this.release(device);
      else if (event.key === "Enter" || event.key === " ") this.hold(device, this.position(device));
      else if (event.key in KEYS && (KEYS[event.key][0] < axes || axes === 1)) this.step(device, axes, event, scale());
      else return;
      event.preventDefault();
    });
  }

  step(device, axes, event, { most }) {
    const [axis, sign] = KEYS[event.key];
    const position = [...(this.held.get(device) ?? this.position(device))];
    position[axes === 1 ? 0 : axis] += ((sign * most) / STEPS) * (event.shiftKey ? 5 : 1);
    this.hold(device, position);
  }

  /** The text of a handle for screen readers. */
  text(device) {
    const where = this.position(device).map((x) => quantity(x, "m")).join(", ");
    const wanted = this.held.get(device);
    return wanted ? `held at ${wanted.map((x) => quantity(x, "m")).join(", ")}; is at ${where}` : `free at ${where}`;
  }
}
