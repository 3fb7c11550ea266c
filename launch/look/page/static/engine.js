/** The world of a physics engine for the drawing in space: its solids, in frames that its nodes report. */

import { ABOVE } from "./orbit.js";
import { shapesOf } from "./shapes.js";
import { QUATERNION, STILL, inverse, times, turned, unitOf } from "./turns.js";

/** By the axis that is upwards in the engine, how it is turned so that y is, as the drawing has it. */
const UPRIGHT = { y: [1, 0, 0, 0], z: [Math.SQRT1_2, -Math.SQRT1_2, 0, 0] };
const AXES = ["x", "y", "z"];
const FLAT = 0.9; // of the cosine from a plane's normal to the vertical: what is flatter is the ground

export class Engine {
  constructor(session) {
    const { about, tracks } = session;
    Object.assign(this, { session, drawing: about.drawing });
    this.upright = UPRIGHT[this.drawing.up];
    this.from = ABOVE;
    this.axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => turned(this.upright, axis));
    const devices = Object.entries(about.nodes).filter(([, node]) => node.role === "device");
    this.things = Object.entries(this.drawing.frames).map(([name, frame]) => {
      const { at, turn, ports, directions, reported, axes, oriented, pivot } = frame;
      const [device] = devices.find(([, node]) => ports.length === node.ports.length && node.ports.every((port) => ports.includes(port))) ?? [];
      const shapes = this.drawing.shapes.filter((shape) => shape.frame === name);
      const own = device ? about.nodes[device].ports : ports; // in the order of the device's traces
      const names = reported ? AXES.map((axis) => `${name}.${axis}`) : own;
      const track = reported ? "environment/masses" : "environment/tools";
      const size = Math.max(0, ...shapes.flatMap((shape) => corners(shape).map((corner) => Math.hypot(...corner))));
      const place = turned(this.upright, at);
      return {
        ...{ name: device ?? name, names, tool: device !== undefined, at: place, radius: size, half: [0, 0, 0], size, shapes },
        ...{ base: times(this.upright, turn), track, columns: names.map((column) => tracks.get(track).columns.indexOf(column)) },
        directions: reported ? this.axes : own.map((port) => turned(this.upright, directions[ports.indexOf(port)])),
        along: reported ? this.axes : own.map((port) => (axes[port] ? [0, 0, 0] : turned(this.upright, directions[ports.indexOf(port)]))),
        points: names.map((port) => (axes[port] ? turned(this.upright, axes[port]) : null)), // of the axes that turn it
        pivot: pivot && turned(this.upright, pivot), // about which its hand turns it
        inwards: reported ? [0, 1, 2] : ports.map((port) => own.indexOf(port)), // the joints from the world to the thing
        quaternion: oriented ? QUATERNION.map((part) => tracks.get("environment/orientations").columns.indexOf(`${name}.${part}`)) : null,
        start: turn,
        from: reported ? at : null, // an engine reports positions, and not displacements
        ...{ place: [...place], device: [...place], moved: names.map(() => 0) },
      };
    });
  }

  /** Solids that stand still. */
  standing(palette, { radius }) {
    const still = this.drawing.shapes.filter(({ frame }) => frame === "");
    return [shapesOf(still, this.upright, ({ shape }) => palette.of(shape === "plane" ? "pane" : "solid"), radius)];
  }

  solid(thing, material) {
    const shapes = thing.shapes.length ? thing.shapes : [{ shape: "sphere", size: [thing.radius, thing.radius, thing.radius], at: [0, 0, 0], turn: UPRIGHT.y }];
    return shapesOf(shapes, thing.base, () => material, thing.radius);
  }

  /** The pose of a thing whose axes have these displacements: its place, its turn, and where its axes point then.

  What a hand turns, and the point about which it does, is turned as the device's trace `topic` says.
  */
  pose(thing, values, topic = "proxy") {
    const pointing = [...thing.along];
    let [place, turn] = [thing.at, STILL];
    if (thing.pivot) {
      const by = this.byHand(thing.name, topic);
      const centre = thing.pivot.map((x, i) => thing.along.reduce((sum, along, port) => sum + values[port] * along[i], x));
      const away = turned(by, place.map((x, i) => x - thing.pivot[i]));
      return { place: centre.map((x, i) => x + away[i]), pointing, turn: times(by, thing.base), centre };
    }
    [...thing.inwards].reverse().forEach((port, done, outwards) => {
      const point = thing.points[port];
      if (point === null) {
        place = place.map((x, i) => x + values[port] * thing.directions[port][i]);
        return;
      }
      const half = values[port] / 2;
      const spin = [Math.cos(half), ...thing.directions[port].map((x) => Math.sin(half) * x)];
      place = turned(spin, place.map((x, i) => x - point[i])).map((x, i) => x + point[i]);
      turn = times(spin, turn);
      for (const inner of outwards.slice(0, done)) pointing[inner] = turned(spin, pointing[inner]); // it turns with it
    });
    return { place, pointing, turn: times(this.spin(thing, turn), thing.base) };
  }

  /** How far a thing is turned from the start: as its engine reports it, else by its own axes. */
  spin({ quaternion, start }, own) {
    if (!quaternion) return own;
    const found = unitOf(quaternion.map((column) => this.session.known("environment/orientations", column)));
    return found ? this.drawn(times(found, inverse(start))) : STILL;
  }

  /** How far a hand's device has turned, or its tool, as its trace says; that of a device that is sensed alone has no proxy. */
  byHand(device, topic) {
    const told = topic === "proxy" && !this.session.feelsTurns(device);
    const [key, parts] = told ? ["environment/told", this.session.columns("environment/told", QUATERNION.map((part) => `${device}.${part}`))] : [`${device}/${topic}`, [0, 1, 2, 3]];
    const found = unitOf(parts.map((part) => this.session.known(key, part)));
    return found ? this.drawn(found) : STILL;
  }

  /** A rotation of the model in the drawing, and a vector of the model. */
  drawn(turn) {
    return times(times(this.upright, turn), inverse(this.upright));
  }

  vector(v) {
    return turned(this.upright, v);
  }

  /** A vector of the drawing in the model. */
  inModel(v) {
    return turned(inverse(this.upright), v);
  }

  /** Where an engine's bodies touch is not reported. */
  contacts() {
    return [];
  }

  remark() {
    const { hidden, large, frames } = this.drawing;
    const hands = Object.values(frames).some(({ pivot }) => pivot);
    const turns = Object.keys(frames).filter((name) => frames[name].turns);
    const of = (names, text) => (names.length ? `${names.join(", ")}: ${text}. ` : "");
    return (
      (hands ? "Rods at a tool: how it is turned, along its own x (the longest), y and z; faint: how its device is. Arc: the torque on the hand. " : "") +
      (this.session.about.grips.some((device) => this.session.turnsInSpace(device)) ? "Drag a ring with Shift, or with the right button, to turn its tool; or move a second finger around it, or press W, A, S, D, Q and E on it. " : "") +
      of(turns, "how it is turned is not reported, and it is drawn as it was at the start (environment.orientations)") +
      of(hidden, "not drawn, since where it is is not reported (environment.bodies)") +
      of(large, "not drawn, since it has too many triangles")
    );
  }

  bounds() {
    const still = this.drawing.shapes.filter(({ frame, size, shape }) => frame === "" && (shape !== "plane" || (size[0] && size[1])));
    const places = still.flatMap((shape) => corners(shape).map((corner) => [turned(this.upright, corner), 0]));
    const floors = this.drawing.shapes.filter(({ shape, frame, turn }) => shape === "plane" && frame === "" && turned(times(this.upright, turn), [0, 0, 1])[1] > FLAT);
    return { places, ground: floors.length ? turned(this.upright, floors[0].at)[1] : undefined };
  }
}

/** The corners of the box around a shape, in its frame. */
function corners({ shape, at, turn, size, points }) {
  const half = shape === "plane" ? [size[0], size[1], 0] : shape === "capsule" ? [size[0], size[1], size[0] + size[2]] : size;
  const own = shape === "mesh" ? points : [0, 1, 2, 3, 4, 5, 6, 7].map((n) => half.map((h, i) => ((n >> i) & 1 ? h : -h)));
  return own.map((corner) => turned(turn, corner).map((x, i) => x + at[i]));
}
