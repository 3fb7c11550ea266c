/** The session's graph: devices, couplings and the environment in three columns, each and each link with its health. */

import { svg, say } from "./elements.js";

const COLUMNS = { device: 0, coupling: 1, environment: 2 };
const LINE = 14; // px of a line of text
const GAP = 12; // px between two boxes of a column
const BETWEEN = 16; // px between two columns, for the links
const ASIDE = 3; // px between a text and the edge of its box

/** The lines of a name that fit into so many px: it is parted after separators, and elsewhere only where a part is too long. */
function lines(name, room, measure) {
  const parts = name.split(/(?<=[_.-])/);
  const out = [""];
  for (let part of parts) {
    if (measure(out.at(-1) + part) > room && out.at(-1)) out.push("");
    while (measure(part) > room && part.length > 1) {
      let kept = part.length - 1;
      while (kept > 1 && measure(part.slice(0, kept)) > room) kept -= 1;
      out[out.length - 1] = part.slice(0, kept);
      out.push("");
      part = part.slice(kept);
    }
    out[out.length - 1] += part;
  }
  return out;
}

export class Graph {
  constructor(parent, about) {
    Object.assign(this, { parent, about });
    this.drawing = svg("svg", { role: "img", "aria-label": "Nodes and links of the session" });
    parent.replaceChildren(this.drawing);
    this.links = about.links.map(({ ends }) => this.link(ends));
    this.nodes = new Map(Object.keys(about.nodes).map((name) => [name, this.node(name)]));
    this.arrange();
    new ResizeObserver(() => this.arrange()).observe(parent);
  }

  link(ends) {
    const title = svg("title");
    const line = svg("line", { class: "link" }, title);
    this.drawing.append(line);
    return { line, title, ends };
  }

  node(name) {
    const title = svg("title");
    const box = svg("rect", { rx: 6, class: "box" }, title);
    const label = svg("text", { "text-anchor": "middle" });
    const word = svg("text", { "text-anchor": "middle" });
    this.drawing.append(box, label, word);
    return { box, label, word, title };
  }

  /** Boxes that fill the present width, each as high as the lines of its name need. */
  arrange() {
    const width = this.parent.clientWidth;
    if (!width || width === this.width) return;
    this.width = width;
    const wide = Math.min(150, (width - 2 - 2 * BETWEEN) / 3);
    const measure = (text) => {
      const { word } = this.nodes.values().next().value;
      const before = word.textContent;
      say(word, text);
      const found = word.getComputedTextLength();
      say(word, before);
      return found;
    };
    const columns = [[], [], []];
    for (const [name, node] of Object.entries(this.about.nodes)) {
      columns[COLUMNS[node.role] ?? 2].push({ name, rows: lines(name, wide - 2 * ASIDE, measure) });
    }
    const high = ({ rows }) => LINE * (rows.length + 1) + 10;
    const whole = (column) => column.reduce((sum, node) => sum + high(node) + GAP, 0);
    const height = Math.max(...columns.map(whole));
    this.drawing.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.places = new Map();
    columns.forEach((column, c) => {
      const room = column.length ? (height - whole(column)) / column.length : 0; // the boxes of a column share what is left
      const x = 1 + wide / 2 + (c * (width - 2 - wide)) / 2;
      let top = 0;
      for (const node of column) {
        this.draw(node, x, top + (room + GAP) / 2, wide, high(node));
        top += high(node) + GAP + room;
      }
    });
    for (const { line, ends } of this.links) {
      const [from, to] = ends.map((end) => this.places.get(end));
      for (const [name, value] of Object.entries({ x1: from.x, y1: from.y, x2: to.x, y2: to.y })) line.setAttribute(name, value.toFixed(1));
    }
  }

  draw({ name, rows }, x, top, wide, high) {
    const { box, label, word } = this.nodes.get(name);
    for (const [key, value] of Object.entries({ x: x - wide / 2, y: top, width: wide, height: high })) box.setAttribute(key, value.toFixed(1));
    label.replaceChildren(...rows.map((row, i) => svg("tspan", { x: x.toFixed(1), y: (top + LINE * (i + 1)).toFixed(1) }, row)));
    word.setAttribute("x", x.toFixed(1));
    word.setAttribute("y", (top + LINE * (rows.length + 1) + 1).toFixed(1));
    this.places.set(name, { x, y: top + high / 2 });
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
      const { line, title, ends } = this.links[i];
      line.setAttribute("class", `link health-${health}`);
      say(title, `${ends.join(" – ")}: ${health}`);
    });
  }
}
