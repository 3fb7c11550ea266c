/** The list of present alarms, each with advice; below it, folded, the alarms that are over or whose cause was handled a while ago. */

import { byId, html, say } from "./elements.js";

const FRESH = 60; // s for which an alarm whose cause was handled stays among the present ones, so that it is seen

const shown = new Map(); // by key: the element, and the alarm from which it was made

const at = (seconds) => `${seconds.toFixed(1)} s`; // of the session's time

function item(alarm) {
  const since = `${at(alarm.since)}${alarm.earlier ? " or earlier" : ""}`;
  const when = alarm.cleared === null ? `since ${since}` : `${since} to ${at(alarm.cleared)}`;
  return html(
    "li",
    { class: alarm.level, "data-level": alarm.level },
    html("strong", {}, alarm.level),
    html("span", { class: "text" }, alarm.text),
    html("span", { class: "advice" }, alarm.advice),
    html("span", { class: "when" }, when),
  );
}

/** Update the lists to `alarms` at the session's time `now`, s; an unchanged alarm keeps its element, so that screen readers do not read it again. */
export function showAlarms(alarms, now) {
  const standing = byId("alarms-list");
  const past = byId("alarms-past-list");
  const keys = new Set(alarms.map((alarm) => alarm.key));
  for (const [key, { element }] of shown) {
    if (keys.has(key)) continue;
    element.remove();
    shown.delete(key);
  }
  const lists = [standing, past];
  const filled = [0, 0];
  for (const alarm of alarms) {
    const over = alarm.cleared !== null || (alarm.level === "note" && now - alarm.since > FRESH);
    const from = JSON.stringify(alarm);
    const before = shown.get(alarm.key);
    if (before?.from !== from) {
      before?.element.remove();
      shown.set(alarm.key, { element: item(alarm), from });
    }
    const { element } = shown.get(alarm.key);
    const which = over ? 1 : 0;
    const there = lists[which].children[filled[which]] ?? null;
    if (there !== element) lists[which].insertBefore(element, there);
    filled[which] += 1;
  }
  const count = filled[1];
  byId("alarms-none").hidden = count < alarms.length;
  byId("alarms-past").hidden = count === 0;
  say(byId("alarms-past-count"), String(count));
  byId("alarms").dataset.standing = alarms.length - count;
}
