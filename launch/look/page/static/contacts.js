/** Which things of a scene overlap, and where: the contacts that are drawn, found from the positions alone.

A solid is all that is within its radius of its core, which is a box, or the segment from `place - half` to `place + half`.
*/

/** Whether the core is a box, perhaps without thickness: points and segments along an axis are, too. */
const isBox = ({ box, half }) => box || half.filter((h) => h !== 0).length < 2;

const within = (value, most) => Math.max(-most, Math.min(most, value));
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** The nearest points of two segments. */
function nearest(a, b) {
  const apart = a.place.map((x, i) => x - b.place[i]);
  const [aa, bb, ab] = [dot(a.half, a.half), dot(b.half, b.half), dot(a.half, b.half)];
  const [da, db] = [dot(apart, a.half), dot(apart, b.half)];
  const span = aa * bb - ab * ab;
  let s = span > 1e-12 * aa * bb ? within((ab * db - bb * da) / span, 1) : 0;
  const t = bb > 0 ? within((ab * s + db) / bb, 1) : 0;
  if (aa > 0) s = within((ab * t - da) / aa, 1);
  return [a.place.map((x, i) => x + s * a.half[i]), b.place.map((x, i) => x + t * b.half[i])];
}

/** The contact of two solids: its place, and its normal from the second to the first; null where they do not overlap. */
function between(a, b) {
  const most = a.radius + b.radius;
  for (let i = 0; i < 3; i += 1) {
    if (Math.abs(a.place[i] - b.place[i]) >= most + Math.abs(a.half[i]) + Math.abs(b.half[i])) return null;
  }
  return isBox(a) && isBox(b) ? betweenBoxes(a, b, most) : betweenSegments(a, b, most);
}

function betweenSegments(a, b, most) {
  const [from, to] = nearest(a, b);
  const distance = Math.hypot(from[0] - to[0], from[1] - to[1], from[2] - to[2]);
  if (distance >= most || distance === 0) return null;
  const normal = from.map((x, i) => (x - to[i]) / distance);
  return { at: from.map((x, i) => x - a.radius * normal[i]), normal };
}

/** Two boxes touch as a point and a box of both sizes do. */
function betweenBoxes(a, b, most) {
  const reach = a.half.map((h, i) => Math.abs(h) + Math.abs(b.half[i]));
  const apart = a.place.map((x, i) => x - b.place[i]);
  const outside = apart.map((x, i) => x - within(x, reach[i]));
  const distance = Math.hypot(...outside);
  let normal = outside.map((x) => x / distance);
  if (distance === 0) {
    const deep = apart.map((x, i) => reach[i] - Math.abs(x));
    const axis = deep.indexOf(Math.min(...deep));
    if (deep[axis] <= 0) return null; // points in one place have no normal
    normal = [0, 1, 2].map((i) => (i === axis ? Math.sign(apart[i]) || 1 : 0));
  } else if (distance >= most) return null;
  const at = a.place.map((x, i) => {
    const [own, other] = [Math.abs(a.half[i]), Math.abs(b.half[i])];
    const middle = (Math.max(x - own, b.place[i] - other) + Math.min(x + own, b.place[i] + other)) / 2;
    return x + within(middle - x, own) - a.radius * normal[i];
  });
  return { at, normal };
}

/** The contact with the half-space behind a wall. */
function withWall(a, point, unit) {
  const parts = unit.map((n, i) => n * a.half[i]);
  const own = a.box ? parts.reduce((sum, part) => sum + Math.abs(part), 0) : Math.abs(parts[0] + parts[1] + parts[2]);
  const far = a.radius + own;
  if (dot(unit, a.place) - dot(unit, point) >= far) return null;
  return { at: a.place.map((x, i) => x - far * unit[i]), normal: unit };
}

/** The planes of a wall or a room: a point and the unit normal to the inside of each. */
function planesOf({ shape, points: [first, second] }) {
  if (shape === "wall") return [[first, second.map((x) => x / Math.hypot(...second))]];
  if (shape !== "room") return [];
  const along = (axis, side) => [0, 1, 2].map((i) => (i === axis ? side : 0));
  return [0, 1, 2].flatMap((axis) => [[first, along(axis, 1)], [second, along(axis, -1)]]);
}

/** The solid of an obstacle; null of one that is none. */
export function solidOf({ shape, points, radius }) {
  if (!["box", "sphere", "capsule"].includes(shape)) return null;
  const [a, b] = [points[0], points.at(-1)];
  const place = a.map((x, i) => (x + b[i]) / 2);
  return { place, half: b.map((x, i) => x - place[i]), radius, box: shape === "box" };
}

/** Finds the contacts of a scene. Things whose contact has no stiffness do not touch. */
export class Contacts {
  /** `things` are the tools and bodies, solids with their names, `driven` or not. */
  constructor(scene, things) {
    const stated = [...scene.contacts].reverse(); // the first of a pair holds
    const stiffness = new Map(stated.map((pair) => [key(pair.between), pair.stiffness]));
    const touch = (a, b) => (stiffness.get(key([a, b])) ?? scene.contact.stiffness) > 0;
    this.pairs = things.flatMap((a, i) =>
      things.slice(i + 1).filter((b) => !(a.driven && b.driven) && touch(a.name, b.name)).map((b) => [a, b]),
    );
    this.walls = [];
    for (const [name, obstacle] of Object.entries(scene.obstacles)) {
      const [solid, planes] = [solidOf(obstacle), planesOf(obstacle)];
      for (const thing of things) {
        if (thing.driven || !touch(thing.name, name)) continue;
        if (solid) this.pairs.push([thing, solid]);
        for (const [point, unit] of planes) this.walls.push([thing, point, unit]);
      }
    }
  }

  /** The contacts at the things' present places: the place and the normal of each. */
  now() {
    const found = [];
    for (const [a, b] of this.pairs) {
      const contact = between(a, b);
      if (contact) found.push(contact);
    }
    for (const [thing, point, unit] of this.walls) {
      const contact = withWall(thing, point, unit);
      if (contact) found.push(contact);
    }
    return found;
  }
}

const key = (names) => [...names].sort().join("\n");
