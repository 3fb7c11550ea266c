/** The session's graph: devices, couplings and the environment in three columns, each and each link with its health. */

import { fit, svg, say } from "./elements.js";

const COLUMNS = { device: 0, coupling: 1, environment: 2 };
const ROW = 52;
const BOX = { width: 104, height: 38 };
const WIDTH = 420;

const centre = (column) => BOX.width / 2 + 4 + (column * (WIDTH - BOX.width - 8)) / 2;

export class Graph {
  constructor(parent, about) {
    const columns = [[], [], []];
    for (const [name, node] of Object.entries(about.nodes)) columns[COLUMNS[node.role] ?? 2].push(name);
    const rows = Math.max(...columns.map((column) => column.length));
    this.places = new Map();
    columns.forEach((names, column) => {
      names.forEach((name, row) => {
        this.places.set(name, { x: centre(column), y: ROW * ((rows * (row + 0.5)) / names.length) });
      });
    });
    this.drawing = svg("svg", {
      viewBox: `0 0 ${WIDTH} ${rows * ROW}`,
      role: "img",
      "aria-label": "Nodes and links of the session",
    });
    this.links = about.links.map(({ ends: [a, b] }) => this.link(a, b));
    this.nodes = new Map(Object.keys(about.nodes).map((name) => [name, this.node(name)]));
    parent.replaceChildren(this.drawing);
    for (const [name, { label }] of this.nodes) fit(label, name, BOX.width - 8);
  }

  link(a, b) {
    const from = this.places.get(a);
    const to = this.places.get(b);
    const title = svg("title");
    const line = svg("line", { x1: from.x, y1: from.y, x2: to.x, y2: to.y, class: "link" }, title);
    this.drawing.append(line);
    return { line, title, ends: `${a} – ${b}` };
  }

  node(name) {
    const { x, y } = this.places.get(name);
    const title = svg("title");
    const box = svg(
      "rect",
      { x: x - BOX.width / 2, y: y - BOX.height / 2, width: BOX.width, height: BOX.height, rx: 6, class: "box" },
      title,
    );
    const label = svg("text", { x, y: y - 3, "text-anchor": "middle" }, name);
    const word = svg("text", { x, y: y + 12, "text-anchor": "middle" });
    this.drawing.append(box, label, word);
    return { box, label, word, title };
  }

  show(session) {
    for (const [name, { box, word, title }] of this.nodes) {
      const { health, state, rate, tick } = session.nodes.get(name);
      box.setAttribute("class", `box health-${health}`);
      box.setAttribute("data-node", name);
      box.setAttribute("data-health", health);
      word.setAttribute("class", `health-${health}`);
      say(word, health);
      say(title, `${name}: ${state || "no message yet"}, tick ${tick}${rate ? `, ${rate.toFixed(0)} ticks/s` : ""}`);
    }
    session.picture.links.forEach((health, i) => {
      this.links[i].line.setAttribute("class", `link health-${health}`);
      say(this.links[i].title, `${this.links[i].ends}: ${health}`);
    });
  }
}
