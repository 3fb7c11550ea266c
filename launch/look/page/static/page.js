/** The page: messages come from its socket, and it is drawn once for each frame of the screen. */

import { showAlarms } from "./alarms.js";
import { Certificate } from "./certificate.js";
import { Connection } from "./connection.js";
import { Cues } from "./cues.js";
import { byId } from "./elements.js";
import { Forces } from "./forces.js";
import { Graph } from "./graph.js";
import { Grips } from "./grips.js";
import { showFacts, showHeader, showState } from "./header.js";
import { Plots } from "./plots.js";
import { showLobby, showPromises } from "./promises.js";
import { Session } from "./session.js";
import { View } from "./view.js";

const DRAW_EVERY = 25; // ms, so every second frame of most screens: a hand's motion is not faster
const PLOT_EVERY = 66; // ms
const WORDS_EVERY = 250; // ms: figures that change faster cannot be read
const CALM_EVERY = 500; // ms, for people who have asked their system for less motion

const calm = matchMedia("(prefers-reduced-motion: reduce)");
let session = null;
let views = null;
let pictures = 0;

function begin(about) {
  const same = session && session.about.pid === about.pid && session.about.started === about.started;
  if (same) {
    session.about = about; // the socket was lost for a while: the same session continues
    return;
  }
  session = new Session(about);
  const grips = new Grips(session, (message) => connection.send(message));
  showFacts(about);
  views?.view.dispose();
  views?.cues.dispose();
  views = null; // built with the first picture: until then there is nothing to draw
  session.grips = grips;
}

function take(picture) {
  session.take(picture);
  pictures += 1;
  document.body.dataset.pictures = pictures;
  showState(picture.over ? "over" : "live", picture.over ? "" : picture.phase === "running" ? "" : picture.phase);
  if (picture.alarms) showAlarms(session.alarms, session.time);
  if (views) return;
  session.advance(0);
  views = {
    graph: new Graph(byId("graph-drawing"), session.about),
    view: new View(byId("world-drawing"), session, session.grips),
    forces: new Forces(session),
    plots: new Plots(session),
    certificate: new Certificate(session.about),
    cues: new Cues(session),
  };
}

const connection = new Connection(
  (message) => {
    if (message.type === "session") begin(message);
    else if (message.type === "picture") take(message);
    else if (message.type === "refused") session.grips.refused(message.why);
  },
  (state, why) => {
    session?.grips.releaseAll();
    showState(state, why);
  },
);

byId("pause").addEventListener("click", (event) => {
  if (!session) return;
  session.paused = !session.paused;
  event.currentTarget.setAttribute("aria-pressed", String(session.paused));
  event.currentTarget.textContent = session.paused ? "Go on" : "Pause";
});

let [before, plotted, written] = [performance.now(), 0, 0];

function frame(now) {
  requestAnimationFrame(frame);
  if (!views) return;
  if (now - before < (calm.matches ? CALM_EVERY : DRAW_EVERY)) {
    views.view.follow();
    return;
  }
  session.advance((now - before) / 1000);
  before = now;
  views.view.rescale(now);
  views.view.draw();
  views.forces.draw();
  views.cues.draw(now);
  if (now - plotted >= PLOT_EVERY) {
    plotted = now;
    views.plots.draw();
  }
  if (now - written >= WORDS_EVERY) {
    written = now;
    showAlarms(session.alarms, session.time);
    showHeader(session);
    showPromises(session.picture.promises);
    showLobby(session.picture.lobby);
    views.graph.show(session);
    views.certificate.show(session);
    views.plots.showValues();
  }
}
requestAnimationFrame(frame);
