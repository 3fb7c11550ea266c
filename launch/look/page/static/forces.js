/** The list of the force on each hand, by axis. */

import { byId, html, place, tell } from "./elements.js";
import { axisOf, quantity, unitsOf } from "./format.js";

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
      tell(item, `${device}: f ${told.join(", ")}`);
      place(item, { "data-force": forces.join(" ") });
    }
  }
}
