/** How the promises of the session stand, who is in at its seats, and the health that follows. The server states all of it. */

import { byId, html, say, told } from "./elements.js";

const rows = new Map(); // by promise, state and party: the row's element, and the text from which it was made

function row({ cells, state, present, claim, remark }) {
  const [promise, word, who, since, cost] = cells;
  const kind = state === "kept" || present ? state.replace(" ", "-") : "over";
  return html(
    "tr",
    { role: "row", class: `promise-${kind}`, "data-promise": promise, "data-state": state },
    html("th", { role: "rowheader", scope: "row", title: claim }, promise),
    html("td", { role: "cell", class: "state" }, word),
    told("td", { role: "cell", class: who === "all" ? "who everyone" : "who", title: remark }, who),
    html("td", { role: "cell", class: "since" }, since),
    html("td", { role: "cell", class: "cost" }, cost),
  );
}

/** Update the table; a row that is unchanged keeps its element. */
export function showPromises(promises) {
  const body = byId("promises-table").tBodies[0];
  const keys = promises.map(({ cells: [promise, state, who] }) => `${promise} ${state} ${who}`);
  for (const [key, { element }] of rows) {
    if (keys.includes(key)) continue;
    element.remove();
    rows.delete(key);
  }
  promises.forEach((one, i) => {
    const from = JSON.stringify(one);
    const before = rows.get(keys[i]);
    if (before?.from !== from) {
      before?.element.remove();
      rows.set(keys[i], { element: row(one), from });
    }
    const { element } = rows.get(keys[i]);
    if (body.children[i] !== element) body.insertBefore(element, body.children[i] ?? null);
  });
  byId("promises").hidden = promises.length === 0;
}

/** Update the line of each seat. */
export function showLobby(seats) {
  const list = byId("lobby");
  while (list.children.length > seats.length) list.lastChild.remove();
  seats.forEach(({ text, health }, i) => {
    const line = list.children[i] ?? list.appendChild(html("li"));
    line.className = `health health-${health}`;
    say(line, text);
  });
  list.hidden = seats.length === 0;
}

/** Whether a promise of a party is broken. */
export function isBroken(promises, promise, party) {
  return promises.some((one) => one.cells[0] === promise && one.state === "broken" && (party === undefined || one.who.includes(party)));
}
