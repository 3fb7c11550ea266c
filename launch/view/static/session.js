/** A session as the page knows it: what it was told first, the latest of everything, and the instant that is drawn. */

import { Track } from "./tracks.js";

const BEHIND = 0.2; // s of the session that the drawing is behind the latest: telemetry comes ten times a second

export class Session {
  constructor(told) {
    this.about = told;
    this.tracks = new Map(Object.entries(told.tracks).map(([key, facts]) => [key, new Track(facts, told.buckets)]));
    this.nodes = new Map(Object.keys(told.nodes).map((name) => [name, { state: "", health: "waiting", figures: {} }]));
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

  /** Move the drawn instant on by `passed` s of the person's time: as fast as the session goes, a little behind it. */
  advance(passed) {
    if (!this.picture || this.paused) return;
    const second = 1 / this.about.period;
    const rate = this.picture.over ? 0 : (this.picture.rate ?? second);
    const aim = this.picture.over ? this.picture.tick : this.picture.tick - BEHIND * rate;
    if (this.head === null || Math.abs(aim - this.head) > Math.max(rate, second)) this.head = aim;
    const share = Math.min(1, 2 * passed);
    this.head = Math.max(this.head, Math.min(this.head + rate * passed + share * (aim - this.head), this.picture.tick));
  }

  /** The drawn instant in buckets. */
  get bucket() {
    return this.head === null ? 0 : this.head / this.about.bucket;
  }

  /** What a column of a track is at the drawn instant; NaN where that is not known. */
  now(key, column) {
    return this.tracks.get(key)?.at(column, this.bucket) ?? NaN;
  }
}
