/** The plots: one quantity at a time, with the traces that the person chose, drawn through the extremes of every bucket. */

import { byId, html, say, svg, told } from "./elements.js";
import { prefixOf, quantity, unitOf } from "./format.js";

const QUANTITIES = [
  { id: "x", label: "Position", topics: ["sample", "tools", "masses", "tool"], shown: ["sample", "tools", "masses"] },
  { id: "v", label: "Velocity", topics: ["velocity"] },
  { id: "f", label: "Force", topics: ["force", "reaction"], shown: ["force"] },
  { id: "angle", label: "Angle", topics: ["angle"] },
  { id: "t", label: "Torque", topics: ["torque"] },
  { id: "E", label: "Ledgers", topics: ["ledger"] },
  { id: "account", label: "Accounts", topics: ["interface"] },
  { id: "tau", label: "Delay", topics: ["tau"] },
  { id: "tank", label: "Tanks", topics: ["tank"] },
];
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];
const COLOURS = 8;
const AT_FIRST = 8; // traces that are shown before the person has chosen any

const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** The owner of a trace: a port, where a device or the environment moves it; otherwise a node. */
function nameOf(role, track, column) {
  if (column === track.symbol) return track.node;
  return role === "coupling" || track.topic === "torque" ? `${track.node} ${column}` : column;
}

/** The traces of a quantity: each is a column of a track, with its name, colour and dash. */
function tracesOf(quantity_, session) {
  const traces = [];
  for (const topic of quantity_.topics) {
    for (const [key, track] of session.tracks) {
      if (track.topic !== topic) continue;
      track.columns.forEach((column, c) => {
        const name = nameOf(session.about.nodes[track.node].role, track, column);
        const place = traces.length;
        traces.push({
          key,
          column: c,
          unit: track.units[c],
          track,
          label: `${track.symbol} ${name}`,
          on: (quantity_.shown ?? quantity_.topics).includes(topic) && place < AT_FIRST,
          colour: `--trace-${place % COLOURS}`,
          dash: DASHES[Math.floor(place / COLOURS) % DASHES.length],
        });
      });
    }
  }
  return traces;
}

/** The quantity once for each unit of its traces: what turns has another axis than what translates. */
function byUnit(q, traces) {
  const units = [...new Set(traces.map((trace) => trace.unit))];
  return units.map((unit, i) => ({
    ...q,
    id: i ? `${q.id}-${i}` : q.id,
    unit,
    traces: traces.filter((trace) => trace.unit === unit),
  }));
}

export class Plots {
  constructor(session) {
    this.session = session;
    this.panel = byId("plot");
    this.quantities = QUANTITIES.flatMap((q) => byUnit(q, tracesOf(q, session)));
    this.tabs = this.quantities.map((q, i) => this.tab(q, i));
    byId("plot-tabs").replaceChildren(...this.tabs);
    this.select(0);
    new ResizeObserver(() => this.resize()).observe(this.panel);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.select(this.selected));
  }

  tab(q, i) {
    const tab = html(
      "button",
      { type: "button", role: "tab", id: `tab-${q.id}`, "aria-controls": "plot-panel" },
      `${q.label} (${unitOf(q.unit)})`,
    );
    tab.addEventListener("click", () => this.select(i));
    tab.addEventListener("keydown", (event) => {
      const count = this.quantities.length;
      const to = { ArrowRight: i + 1, ArrowLeft: i - 1 + count, Home: 0, End: count - 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      this.select(to % count);
      this.tabs[to % count].focus();
    });
    return tab;
  }

  select(i) {
    this.selected = i;
    this.tabs.forEach((tab, t) => {
      tab.setAttribute("aria-selected", String(t === i));
      tab.tabIndex = t === i ? 0 : -1;
    });
    byId("plot-panel").setAttribute("aria-labelledby", this.tabs[i].id);
    this.traces = this.quantities[i].traces;
    this.unit = this.quantities[i].unit;
    this.legend();
    this.build();
  }

  legend() {
    this.values = this.traces.map((trace) => html("output", { "aria-live": "off" }));
    const items = this.traces.map((trace, i) => {
      const box = html("input", { type: "checkbox" });
      box.checked = trace.on;
      box.addEventListener("change", () => {
        trace.on = box.checked;
        this.chart.setSeries(i + 1, { show: trace.on });
        this.draw();
      });
      const line = svg("line", { x1: 0, y1: 4, x2: 26, y2: 4, stroke: `var(${trace.colour})`, "stroke-width": 3 });
      if (trace.dash.length) line.setAttribute("stroke-dasharray", trace.dash.join(" "));
      const swatch = svg("svg", { viewBox: "0 0 26 8", "aria-hidden": "true" }, line);
      return html("li", {}, html("label", {}, box, swatch, told("span", {}, trace.label), this.values[i]));
    });
    byId("plot-legend").replaceChildren(...items);
  }

  size() {
    return { width: Math.max(200, this.panel.clientWidth), height: this.panel.clientWidth < 500 ? 240 : 300 };
  }

  build() {
    this.chart?.destroy();
    const { about } = this.session;
    const seconds = () => {
      const head = (this.session.head ?? 0) * about.period;
      return [head - about.window, head];
    };
    const axis = { stroke: variable("--text"), grid: { stroke: variable("--grid") }, ticks: { stroke: variable("--grid") } };
    const options = {
      ...this.size(),
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      scales: { x: { time: false, range: seconds }, y: { range: (_chart, least, most) => this.range(least, most) } },
      axes: [
        { ...axis, label: "time, s", labelSize: 20, size: 36, values: (_c, splits) => splits.map((t) => (t < 0 ? "" : number_of(t))) },
        { ...axis, size: (_c, marks) => 24 + 7 * Math.max(4, ...(marks ?? []).map((mark) => mark.length)), values: (_c, splits) => this.marks(splits) },
      ],
      series: [{}, ...this.traces.map((trace) => ({
        label: trace.label,
        show: trace.on,
        stroke: variable(trace.colour),
        dash: trace.dash,
        width: 1.5,
        points: { show: false },
      }))],
    };
    this.chart = new uPlot(options, this.data(), this.panel);
  }

  range(least, most) {
    if (least === null || !Number.isFinite(least)) return [-1e-3, 1e-3];
    const margin = Math.max(0.08 * (most - least), 1e-6, 1e-3 * Math.abs(most));
    return [least - margin, most + margin];
  }

  marks(splits) {
    const [factor, letter] = prefixOf(Math.max(...splits.map(Math.abs)), this.unit);
    return splits.map((v) => `${Number((v / factor).toPrecision(4))}${v === 0 ? "" : ` ${letter}${unitOf(this.unit)}`}`);
  }

  /** The data for uPlot: times, and the values of each shown trace; null where there is no value. */
  data() {
    const { about, bucket } = this.session;
    const end = Math.floor(bucket) + 1;
    const begin = Math.max(0, end - about.buckets);
    const step = about.bucket * about.period;
    const times = new Array(2 * (end - begin));
    for (let b = begin, i = 0; b < end; b += 1) {
      times[i++] = b * step;
      times[i++] = (b + 0.5) * step;
    }
    let [points, last] = [0, 0];
    const columns = this.traces.map(({ on, track, column }) => {
      const values = new Array(times.length).fill(null);
      if (!on) return values;
      for (let b = begin, i = 0; b < end; b += 1) {
        const own = Math.floor((b * step) / track.seconds + 1e-6); // a node may have a period of its own
        for (const half of [0, 1]) {
          const value = track.value(column, own, half);
          values[i++] = Number.isNaN(value) ? null : value;
          if (!Number.isNaN(value)) {
            points += 1;
            last = Math.max(last, b);
          }
        }
      }
      return values;
    });
    Object.assign(this.panel.dataset, { points, lastTick: last * about.bucket });
    return [times, ...columns];
  }

  draw() {
    this.chart.setData(this.data());
  }

  showValues() {
    this.traces.forEach((trace, i) => {
      say(this.values[i], quantity(this.session.now(trace.key, trace.column), this.unit));
    });
  }

  resize() {
    const { width, height } = this.size();
    if (width !== this.chart.width || height !== this.chart.height) this.chart.setSize({ width, height });
  }
}

const number_of = (t) => String(Number(t.toFixed(3)));
