/** The positions of the bodies of the virtual world: tools at the left, then masses by the number of springs between, then ground.

A body is what is drawn as one: a device's tool with its first two axes, a mass, or masses that are the axes of one
body, recognised by their names (`ball.x`, `ball.y`). Columns and rows are counted from 0; a body moves about its position.
*/

/** The axis of a body that no spring joins to a port, by its name. */
const named = (mass) => Math.max(0, "xyz".indexOf(mass.match(/[._-]([xyz])$/)?.[1] ?? "-"));

const stem = (mass) => mass.replace(/[._-]?([xyz012])$/, "") || mass;

/** For each mass, the axis along which it moves (that of the nearest ports), and the number of springs to these ports. */
function reachedFrom(ports, springs) {
  const found = new Map(ports.map(({ port, axis }) => [port, { axis, far: 0 }]));
  let edge = [...found.keys()];
  while (edge.length) {
    const next = [];
    for (const at of edge) {
      for (const { ends } of springs) {
        const other = ends[0] === at ? ends[1] : ends[1] === at ? ends[0] : null;
        if (other === null || other === "ground" || found.has(other)) continue;
        found.set(other, { axis: found.get(at).axis, far: found.get(at).far + 1 });
        next.push(other);
      }
    }
    edge = next;
  }
  return found;
}

/** The bodies, and the pairs of bodies that springs join. */
export function layout(about) {
  const devices = Object.entries(about.nodes).filter(([, node]) => node.role === "device");
  const ports = devices.flatMap(([device, node]) => node.ports.map((port, axis) => ({ device, port, axis })));
  const reached = reachedFrom(ports, about.springs);
  const bodies = new Map();
  const bodyOf = new Map(ports.map(({ device, port }) => [port, `tool ${device}`]));
  for (const [device, node] of devices) {
    bodies.set(`tool ${device}`, { kind: "tool", name: device, ports: node.ports, planar: node.ports.length > 1, column: 0, row: 0 });
  }
  const masses = Object.keys(about.masses);
  masses.forEach((mass, index) => {
    const { axis, far } = reached.get(mass) ?? { axis: named(mass), far: 1 };
    const siblings = masses.filter((m) => stem(m) === stem(mass));
    const axes = new Set(siblings.map((m) => (reached.get(m) ?? { axis: named(m) }).axis));
    const together = siblings.length > 1 && axes.size === siblings.length;
    const id = `mass ${together ? stem(mass) : mass}`;
    const body = bodies.get(id) ?? { kind: "mass", name: id.slice(5), axes: [], column: far, row: 0 };
    body.axes.push({ axis, index });
    body.planar = body.axes.some((a) => a.axis > 0);
    bodies.set(id, body);
    bodyOf.set(mass, id);
  });
  const last = Math.max(...[...bodies.values()].map((body) => body.column));
  if (about.springs.some(({ ends }) => ends.includes("ground"))) {
    bodies.set("ground", { kind: "ground", name: "ground", column: last + 1, row: 0 });
    bodyOf.set("ground", "ground");
  }
  const pairs = new Map();
  for (const { ends } of about.springs) {
    const [a, b] = ends.map((end) => bodyOf.get(end));
    if (a && b && a !== b) pairs.set([a, b].sort().join("|"), [a, b]);
  }
  const inColumn = (column) => [...bodies.values()].filter((body) => body.column === column).length;
  const columns = Math.max(...[...bodies.values()].map((body) => body.column)) + 1;
  const rows = Math.max(...Array.from({ length: columns }, (_, column) => inColumn(column))); // one body needs a row of its own
  devices.forEach(([device], i) => (bodies.get(`tool ${device}`).row = ((i + 0.5) * rows) / devices.length - 0.5));
  settleRows(bodies, [...pairs.values()], rows);
  return { bodies, pairs: [...pairs.values()], columns, rows };
}

/** Each mass stands at the mean height of its neighbours to the left; no two masses overlap. */
function settleRows(bodies, pairs, rows) {
  const columns = Map.groupBy
    ? Map.groupBy(bodies.values(), (body) => body.column)
    : [...bodies.values()].reduce((by, body) => by.set(body.column, [...(by.get(body.column) ?? []), body]), new Map());
  for (const [column, members] of [...columns].sort(([a], [b]) => a - b)) {
    if (column === 0) continue;
    for (const body of members) {
      const beside = pairs
        .filter((pair) => pair.some((id) => bodies.get(id) === body))
        .flatMap((pair) => pair.map((id) => bodies.get(id)))
        .filter((other) => other.column < column);
      body.row = beside.length ? beside.reduce((sum, other) => sum + other.row, 0) / beside.length : (rows - 1) / 2;
    }
    members.sort((a, b) => a.row - b.row);
    const gap = Math.min(1, rows / members.length);
    const middle = members.reduce((sum, body) => sum + body.row, 0) / members.length;
    const crowded = members.some((body, i) => i > 0 && body.row - members[i - 1].row < 0.7 * gap);
    if (crowded) members.forEach((body, i) => (body.row = middle + (i - (members.length - 1) / 2) * gap));
  }
}
