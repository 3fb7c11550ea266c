/** Cues of the force on a hand, for ears and gamepads: an impact sounds, and a force rumbles.

A cue is not haptics: it is open loop, behind the session as the picture is, and no part of a port or a certificate.

The law, with m the size of the force on the hand in a bucket of its trace and F the limit of its device's force,
both of all axes together:
  impact    m rises within 20 ms by more than 2 % of F; the next one is heard after 60 ms
  loudness  (rise / F)^(1/2) of a falling tone, of which 1/e is left after 40 ms
  rumble    the strong motor by m / F, and after an impact the weak one by its loudness for 100 ms
*/

import { byId, html, say } from "./elements.js";

const WITHIN = 0.02; // s
const THRESHOLD = 0.02; // of F
const APART = 0.06; // s
const LASTS = 0.04; // s
const PITCH = 180; // Hz
const RUMBLE_EVERY = 100; // ms
const RUMBLE_LASTS = 150; // ms: longer than until the next, so that it goes on
const SILENT = 0.01; // of F: below it nothing rumbles
const LATE = 1; // s: what the drawing has jumped over is not sounded later

/** The greatest and the least size of a force in a bucket, N, from the two values of each axis; NaN where none is known. */
export function sizes(track, bucket) {
  let [most, least] = [0, 0];
  for (let axis = 0; axis < track.columns.length; axis += 1) {
    const both = [track.value(axis, bucket, 0), track.value(axis, bucket, 1)];
    const [a, b] = both.map(Math.abs);
    most += Math.max(a, b) ** 2;
    least += both[0] * both[1] < 0 ? 0 : Math.min(a, b) ** 2; // it went through 0
  }
  return [Math.sqrt(most), Math.sqrt(least)];
}

/** The loudness, 0 to 1, of an impact that begins in a bucket; 0 for none. */
export function impact(track, bucket, limit) {
  const within = Math.max(2, Math.floor(WITHIN / track.seconds)); // buckets, with this one
  let least = Infinity;
  for (let b = bucket - within + 1; b <= bucket; b += 1) {
    const size = sizes(track, b)[1];
    if (size < least) least = size; // not of NaN
  }
  let rise = sizes(track, bucket)[0] - least;
  if (!(rise > THRESHOLD * limit)) return 0;
  for (let b = bucket + 1; b < bucket + within; b += 1) {
    const later = sizes(track, b)[0] - least;
    if (later > rise) rise = later;
  }
  return Math.min(1, Math.sqrt(rise / limit));
}

/** Sound an impact at the instant `at` of an audio context, s. */
export function strike(context, at, loudness) {
  const [tone, gain] = [context.createOscillator(), context.createGain()];
  tone.type = "triangle";
  tone.frequency.setValueAtTime(PITCH, at);
  gain.gain.setValueAtTime(loudness, at);
  gain.gain.setTargetAtTime(0, at, LASTS);
  tone.connect(gain).connect(context.destination);
  tone.start(at);
  tone.stop(at + 8 * LASTS);
}

const pads = () => [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.vibrationActuator);

export class Cues {
  constructor(session) {
    this.session = session;
    this.context = null; // while sound is on
    this.rumbles = false;
    this.shakes = false; // whether a rumble was asked for that has not been ended
    this.box = byId("cues");
    this.choice = byId("cue-device");
    this.begin = 0; // the first bucket that was not looked at yet
    this.last = -Infinity; // the bucket of the last impact
    this.loudness = 0;
    this.asked = 0; // when a rumble was asked for last, ms
    const devices = Object.entries(session.about.nodes).filter(([, node]) => node.role === "device");
    this.choice.replaceChildren(...devices.map(([name]) => html("option", {}, name)));
    this.choice.value = session.about.grips[0] ?? devices[0]?.[0] ?? "";
    this.box.hidden = devices.length === 0;
    Object.assign(this.box.dataset, { sounds: 0, rumbles: 0 });
    for (const [id, change] of [["cue-sound", () => this.switchSound()], ["cue-rumble", () => this.switchRumble()]]) {
      const button = byId(id);
      button.onclick = () => button.setAttribute("aria-pressed", String(change())); // a new session's takes its place
      button.setAttribute("aria-pressed", "false");
    }
  }

  /** Stop all cues, for another session. */
  dispose() {
    if (this.context) this.switchSound();
    if (this.rumbles) this.switchRumble();
  }

  switchSound() {
    if (this.context) {
      this.context.close();
      this.context = null;
    } else {
      this.context = new AudioContext();
      this.context.resume();
    }
    say(byId("cue-status"), this.context ? "An impact on the hand sounds." : "");
    return this.context !== null;
  }

  switchRumble() {
    this.rumbles = !this.rumbles;
    if (!this.rumbles) this.endRumble();
    const none = "No gamepad that rumbles is known yet: press one of its buttons, for a browser shows it only then.";
    say(byId("cue-status"), !this.rumbles ? "" : pads().length ? "The gamepad rumbles with the force." : none);
    return this.rumbles;
  }

  /** The device whose force is told: the one that this page took hold of last, or the one that was chosen. */
  get device() {
    const held = [...this.session.grips.held.keys()].at(-1);
    if (held && this.choice.value !== held) this.choice.value = held;
    return this.choice.value;
  }

  /** Tell of what the drawing has come to since the last call. */
  draw(now) {
    const device = this.device;
    const track = this.session.tracks.get(`${device}/force`);
    if (!track || this.session.head === null) return;
    const ports = this.session.about.nodes[device].ports;
    const limit = Math.hypot(...ports.map((port) => this.session.about.force?.[port] ?? NaN));
    const end = Math.min(Math.floor((this.session.head * this.session.about.period) / track.seconds), track.end);
    const [before, apart] = [track === this.track ? this.begin : end, Math.ceil(APART / track.seconds)];
    this.track = track;
    this.begin = Math.max(before, end);
    this.box.dataset.at = end * track.seconds;
    if (end - before > LATE / track.seconds) return;
    for (let bucket = before; bucket < end; bucket += 1) {
      const loudness = impact(track, bucket, limit);
      if (loudness === 0 || Math.abs(bucket - this.last) < apart) continue;
      Object.assign(this, { last: bucket, loudness });
      if (!this.context) continue;
      strike(this.context, this.context.currentTime + (bucket - before) * track.seconds, loudness);
      this.box.dataset.sounds = Number(this.box.dataset.sounds) + 1;
    }
    if (this.rumbles && now - this.asked >= RUMBLE_EVERY) this.rumble(now, track, end, limit);
  }

  rumble(now, track, end, limit) {
    this.asked = now;
    const size = this.session.paused || this.session.picture.over ? 0 : Math.min(1, sizes(track, end - 1)[0] / limit);
    if (!(size > SILENT)) {
      this.endRumble();
      return;
    }
    const fresh = (end - this.last) * track.seconds < RUMBLE_EVERY / 1000 ? this.loudness : 0;
    const effect = { duration: RUMBLE_LASTS, startDelay: 0, strongMagnitude: size, weakMagnitude: fresh };
    for (const pad of pads()) pad.vibrationActuator.playEffect("dual-rumble", effect).catch(() => this.refused());
    this.shakes = true;
    this.box.dataset.rumbles = Number(this.box.dataset.rumbles) + 1;
  }

  refused() {
    say(byId("cue-status"), "The gamepad did not take the effect: this browser or this gamepad has no dual rumble.");
  }

  endRumble() {
    if (!this.shakes) return;
    this.shakes = false;
    for (const pad of pads()) pad.vibrationActuator.reset?.();
  }
}
