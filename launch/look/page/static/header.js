/** The page's header: the session and its health. */

import { byId, say, tell } from "./elements.js";

const CONNECTION = {
  live: "connected",
  over: "the session is over",
};

/** Write a health with its sign, so that the colour alone never carries the meaning. */
export function showHealth(element, health) {
  const wanted = `health health-${health}`;
  if (element.getAttribute("class") !== wanted) element.setAttribute("class", wanted);
  say(element, health);
}

export function showState(state, why) {
  document.body.dataset.state = state;
  say(byId("connection"), why || CONNECTION[state] || state);
}

export function showFacts(about) {
  tell(byId("name"), about.session);
  document.title = `${about.session} – manyhands`;
  say(byId("clock"), about.clock);
  const id = byId("certificate-id");
  say(id, about.certificate ? about.id.slice(0, 12) : "none");
  id.title = about.id;
}

export function showHeader(session) {
  const { picture, about } = session;
  showHealth(byId("health"), picture.health);
  const why = byId("health-why");
  tell(why, picture.present);
  why.hidden = picture.present === "" || byId("alarms-list").childElementCount > 0; // alarms say more
  if (!why.hidden) byId("alarms-none").hidden = true;
  say(byId("tick"), picture.tick.toLocaleString("en"));
  say(byId("rate"), picture.pace || "–");
  const end = about.ticks ? ` of ${(about.ticks * about.period).toFixed(0)} s` : " s";
  say(byId("time"), `${(picture.tick * about.period).toFixed(1)}${end}`);
  document.body.dataset.tick = picture.tick;
}
