/** The strip of alarms: a line for each cause, with who and since when; what happened and what to do unfold below it. */

import { byId, html, say, tell } from "./elements.js";

const FRESH = 60; // s for which an alarm whose cause was handled stays among the present ones, so that it is seen
const SIGNS = { fault: "✕", warning: "▲", note: "•" };

const shown = new Map(); // by key: the line, and the alarm that it shows

const at = (seconds) => `${seconds.toFixed(1)} s`; // of the session's time

/** The line of an alarm: it keeps its element, so that it stays unfolded, and screen readers do not read it again. */
class Line {
  constructor() {
    this.parts = Object.fromEntries(["level", "headline", "who", "when", "parties", "text", "advice"].map((name) => [name, html("span", { class: name })]));
    const { level, headline, who, when, ...below } = this.parts;
    const summary = html("summary", {}, level, " ", headline, " ", who, " ", when);
    this.element = html("li", {}, html("details", {}, summary, ...Object.values(below)));
  }

  show(alarm) {
    const { level, headline, when, text, advice } = this.parts;
    this.alarm = alarm;
    this.element.className = this.element.dataset.level = alarm.level;
    say(level, `${SIGNS[alarm.level]} ${alarm.level}`);
    tell(headline, alarm.headline);
    tell(text, alarm.text);
    say(advice, alarm.advice);
    const aside = (said) => html("span", { class: "aside" }, said); // where there is no room, a sign says it
    const earlier = alarm.earlier ? [aside(" or earlier")] : [];
    const before = alarm.earlier ? [html("span", { class: "short", "aria-hidden": "true" }, "≤ ")] : [];
    when.replaceChildren(
      ...(alarm.cleared === null ? [aside("since ")] : []),
      ...[...before, at(alarm.since), ...earlier],
      ...(alarm.cleared === null ? [] : [` to ${at(alarm.cleared)}`]),
    );
  }

  /** Name the parties where they fit into the line; otherwise count them there, and name them below it. */
  fit() {
    const { who, headline, parties } = this.parts;
    const names = this.alarm.who.join(", ");
    tell(who, names);
    const more = this.element.querySelector("summary").clientHeight > 1.7 * headline.getClientRects()[0]?.height;
    const counted = more && this.alarm.who.length > 1;
    if (counted) say(who, `${this.alarm.who.length} parties`);
    tell(parties, counted ? names : "");
  }
}

/** Update the lists to `alarms` at the session's time `now`, s. */
export function showAlarms(alarms, now) {
  const lists = [byId("alarms-list"), byId("alarms-past-list")];
  const keys = new Set(alarms.map((alarm) => alarm.key));
  for (const [key, { element }] of shown) {
    if (keys.has(key)) continue;
    element.remove();
    shown.delete(key);
  }
  const filled = [0, 0];
  const standing = new Map();
  for (const alarm of alarms) {
    const over = alarm.cleared !== null || (alarm.level === "note" && now - alarm.latest > FRESH);
    const from = JSON.stringify(alarm);
    if (!shown.has(alarm.key)) shown.set(alarm.key, new Line());
    const line = shown.get(alarm.key);
    const changed = line.from !== from;
    if (changed) line.show(alarm);
    line.from = from;
    const which = over ? 1 : 0;
    const there = lists[which].children[filled[which]] ?? null;
    if (there !== line.element) lists[which].insertBefore(line.element, there);
    filled[which] += 1;
    if (changed) line.fit();
    if (!over) standing.set(alarm.level, (standing.get(alarm.level) ?? 0) + 1);
  }
  byId("alarms-none").hidden = filled[0] > 0;
  byId("alarms-past").hidden = filled[1] === 0;
  say(byId("alarms-past-count"), String(filled[1]));
  byId("alarms").dataset.standing = filled[0];
  const count = byId("alarms-count");
  count.hidden = filled[0] === 0;
  count.className = [...standing.keys()][0] ?? "";
  say(count, `alarms ${[...standing].map(([level, n]) => `${SIGNS[level]} ${n}`).join(" ")}`);
  const words = [...standing].map(([level, n]) => `${n} ${level}${n > 1 ? "s" : ""}`).join(", ");
  count.title = words;
  count.setAttribute("aria-label", `alarms: ${words}`);
}

addEventListener("resize", () => shown.forEach((line) => line.fit()));
