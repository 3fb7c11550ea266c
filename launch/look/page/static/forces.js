/** The list of the force on each hand, by axis; how far a hand has turned its tool's device from it; pressed buttons. */

import { byId, html, place, tell } from "./elements.js";
import { axisOf, quantity, unitsOf } from "./format.js";

const AXES = ["x", "y", "z"];

export class Forces {
  constructor(session) {
    this.session = session;
    const devices = Object.entries(session.about.nodes).filter(([, node]) => node.role === "device");
    this.items = devices.map(([device, { ports }]) => ({ device, ports, item: html("li", { "data-force-of": device }) }));
    byId("forces").replaceChildren(...this.items.map(({ item }) => item));
  }

  draw() {
    for (const { device, ports, item } of this.items) {
      const forces = ports.map((_, axis) => this.session.known(`${device}/force`, axis));
      const told = forces.map((f, axis) => {
        const turns = this.session.turns(ports[axis]);
        return `${axisOf(ports[axis], turns)} ${quantity(f, unitsOf(turns)[1])}`;
      });
      const parts = [`${device}: f ${told.join(", ")}`];
      if (this.session.feelsTurns(device)) parts.push(...this.turn(device, item));
      const pressed = this.session.pressed(device);
      if (pressed.length) parts.push(`pressed: ${pressed.join(", ")}`);
      tell(item, parts.join("; "));
      place(item, { "data-force": forces.join(" "), "data-pressed": pressed.join(" ") });
    }
  }

  /** The angle from its tool, and the torque on the hand about the world's axes. */
  turn(device, item) {
    const angle = this.session.known(`${device}/angle`, 0);
    const torque = AXES.map((_, i) => this.session.known(`${device}/torque`, i));
    place(item, { "data-angle": String(angle), "data-torque": torque.join(" ") });
    return [`turned ${quantity(angle, "rad")} from its tool`, `t ${AXES.map((axis, i) => `${axis} ${quantity(torque[i], "N·m")}`).join(", ")}`];
  }
}
