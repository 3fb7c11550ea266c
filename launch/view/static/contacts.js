/** Which things of a scene overlap, and where: the contacts that are drawn, found from the positions alone. */

/** The nearest point of a segment. */
function onSegment(place, a, b) {
  let [along, length] = [0, 0];
  for (let i = 0; i < 3; i += 1) {
    along += (b[i] - a[i]) * (place[i] - a[i]);
    length += (b[i] - a[i]) ** 2;
  }
  const part = length ? Math.max(0, Math.min(1, along / length)) : 0;
  return a.map((x, i) => x + part * (b[i] - x));
}

/** The contact of a sphere with a thing whose nearest point is `point`; `thickness` is the sum of both radii. */
function withPoint(place, radius, point, thickness) {
  const distance = Math.hypot(place[0] - point[0], place[1] - point[1], place[2] - point[2]);
  if (distance >= thickness || distance === 0) return null;
  const normal = place.map((x, i) => (x - point[i]) / distance);
  return { at: place.map((x, i) => x - radius * normal[i]), normal };
}

function withWall(place, radius, point, normal) {
  const length = Math.hypot(...normal);
  let gap = -radius;
  for (let i = 0; i < 3; i += 1) gap += (normal[i] / length) * (place[i] - point[i]);
  if (gap >= 0) return null;
  const unit = normal.map((x) => x / length);
  return { at: place.map((x, i) => x - radius * unit[i]), normal: unit };
}

function withBox(place, radius, low, high) {
  if (place.some((x, i) => x + radius < low[i] || x - radius > high[i])) return null;
  const inside = place.every((x, i) => x > low[i] && x < high[i]);
  if (!inside) return withPoint(place, radius, place.map((x, i) => Math.max(low[i], Math.min(high[i], x))), radius);
  const faces = place.flatMap((x, i) => [[x - low[i], i, low, -1], [high[i] - x, i, high, 1]]);
  const [, axis, corner, side] = faces.reduce((nearest, face) => (face[0] < nearest[0] ? face : nearest));
  return { at: place.map((x, i) => (i === axis ? corner[i] : x)), normal: [0, 1, 2].map((i) => (i === axis ? side : 0)) };
}

/** The contacts of a sphere with an obstacle, by its shape. */
const WITH = {
  room(place, radius, { points: [low, high] }, found) {
    for (let i = 0; i < 3; i += 1) {
      if (place[i] - radius < low[i]) found.push({ at: replaced(place, i, low[i]), normal: replaced([0, 0, 0], i, 1) });
      if (place[i] + radius > high[i]) found.push({ at: replaced(place, i, high[i]), normal: replaced([0, 0, 0], i, -1) });
    }
    return null;
  },
  wall: (place, radius, { points }) => withWall(place, radius, points[0], points[1]),
  box: (place, radius, { points }) => withBox(place, radius, points[0], points[1]),
  sphere: (place, radius, { points, radius: own }) => withPoint(place, radius, points[0], radius + own),
  capsule: (place, radius, { points, radius: own }) =>
    withPoint(place, radius, onSegment(place, points[0], points[1]), radius + own),
};

const replaced = (values, i, value) => values.map((x, j) => (i === j ? value : x));

/** Finds the contacts of a scene. Things that a spring joins, or whose contact has no stiffness, do not touch. */
export class Contacts {
  /** `things` are the tools and bodies that are spheres, with name, radius and present place; `joined` are pairs of names. */
  constructor(scene, things, joined) {
    const apart = new Set(joined.map(key));
    const stiffness = new Map(scene.contacts.map((pair) => [key(pair.between), pair.stiffness]));
    const touch = (a, b) => {
      const names = key([a, b]);
      return (stiffness.get(names) ?? (apart.has(names) ? 0 : scene.contact.stiffness)) > 0;
    };
    this.pairs = things
      .flatMap((a, i) => things.slice(i + 1).map((b) => ({ a, b, thickness: a.radius + b.radius })))
      .filter(({ a, b, thickness }) => thickness > 0 && touch(a.name, b.name));
    this.beside = Object.entries(scene.obstacles)
      .filter(([, obstacle]) => obstacle.shape in WITH)
      .flatMap(([name, obstacle]) => things.filter((thing) => touch(thing.name, name)).map((thing) => ({ thing, obstacle })));
  }

  /** The contacts at the things' present places: the place and the normal of each. */
  now() {
    const found = [];
    for (const { a, b, thickness } of this.pairs) {
      const contact = withPoint(a.place, a.radius, b.place, thickness);
      if (contact) found.push(contact);
    }
    for (const { thing, obstacle } of this.beside) {
      const contact = WITH[obstacle.shape](thing.place, thing.radius, obstacle, found);
      if (contact) found.push(contact);
    }
    return found;
  }
}

const key = (names) => [...names].sort().join("\n");
