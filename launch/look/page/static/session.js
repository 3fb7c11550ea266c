/** A session as the page knows it: the first message, the latest values, and the instant that is drawn. */

import { Track } from "./tracks.js";

const BEHIND = 0.2; // s by which the drawing stays behind the latest values: telemetry comes ten times a second
const LATELY = 3; // s that scales are fitted to

export class Session {
  constructor(about) {
    this.about = about;
    this.turning = new Set(about.turning);
    this.tracks = new Map(Object.entries(about.tracks).map(([key, facts]) => [key, new Track(facts, about.buckets)]));
    this.nodes = new Map(Object.keys(about.nodes).map((name) => [name, { state: "", health: "waiting", figures: {} }]));
    this.picture = null;
    this.alarms = [];
    this.head = null; // the tick that is drawn, with its fraction
    this.paused = false;
  }

  /** Take in a picture. */
  take(picture) {
    this.picture = picture;
    if (picture.alarms) this.alarms = picture.alarms;
    for (const [name, node] of Object.entries(picture.nodes)) {
      this.nodes.set(name, { ...this.nodes.get(name), ...node });
    }
    for (const [key, piece] of Object.entries(picture.tracks)) this.tracks.get(key)?.add(piece);
  }

  /** Move the drawn instant on by `passed` s of real time, at the session's speed and a little behind it. */
  advance(passed) {
    if (!this.picture || this.paused) return;
    const second = 1 / this.about.period;
    const rate = this.picture.over ? 0 : (this.picture.rate ?? second);
    const aim = this.picture.over ? this.picture.tick : this.picture.tick - BEHIND * rate;
    if (this.head === null || Math.abs(aim - this.head) > Math.max(rate, second)) this.head = aim;
    const share = Math.min(1, 2 * passed);
    this.head = Math.max(this.head, Math.min(this.head + rate * passed + share * (aim - this.head), this.picture.tick));
  }

  /** The session's time, s. */
  get time() {
    return (this.picture?.tick ?? 0) * this.about.period;
  }

  /** The drawn instant in buckets of the session's ticks. */
  get bucket() {
    return this.head === null ? 0 : this.head / this.about.bucket;
  }

  /** The value of a track's column at the drawn instant; NaN where it is not known. */
  now(key, column) {
    const track = this.tracks.get(key);
    return track ? track.at(column, ((this.head ?? 0) * this.about.period) / track.seconds) : NaN;
  }

  /** The same, and 0 where it is not known. */
  known(key, column) {
    const value = this.now(key, column);
    return Number.isNaN(value) ? 0 : value;
  }

  /** The buttons of a device that are pressed. */
  pressed(device) {
    return this.nodes.get(device)?.pressed ?? [];
  }

  /** Whether a hand turns the tool of a device in space. */
  turnsInSpace(device) {
    return this.about.hands.includes(device);
  }

  /** Whether a torque acts on such a hand: on one whose orientation is sensed alone none does. */
  feelsTurns(device) {
    return this.turnsInSpace(device) && !this.about.sensed.includes(device);
  }

  /** Where columns of a track are, by their names. */
  columns(key, names) {
    const track = this.tracks.get(key);
    return names.map((name) => track?.columns.indexOf(name) ?? -1);
  }

  /** Whether a port or a body turns: its place is an angle, and its force a torque. */
  turns(name) {
    return this.turning.has(name);
  }

  /** The greatest magnitude of some topics in the last seconds: of what turns, of what does not, or (null) of all. */
  greatest(topics, turns = false) {
    let most = 0;
    for (const track of this.tracks.values()) {
      if (!topics.includes(track.topic)) continue;
      track.columns.forEach((column, c) => {
        if (turns === null || this.turns(column) === turns) most = Math.max(most, track.most(c, Math.ceil(LATELY / track.seconds)));
      });
    }
    return most;
  }
}
