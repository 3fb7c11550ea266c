/** The values of the certificate, beside the measured values. */

import { byId, html, say, tell, told } from "./elements.js";
import { dampingUnit, number, quantity } from "./format.js";
import { isBroken } from "./promises.js";

const us = (seconds) => `${number(1e6 * seconds)} µs`;

function row(head, text, attributes = {}) {
  return html("tr", {}, told("th", { scope: "row" }, head), told("td", attributes, text));
}

export class Certificate {
  constructor(about) {
    this.about = about;
    const { certificate } = about;
    byId("certificate-none").hidden = certificate !== null;
    byId("certificate-table").hidden = certificate === null;
    byId("parties").hidden = certificate === null;
    if (certificate === null) return;
    const ports = Object.values(about.nodes).flatMap((node) => node.ports);
    this.worst = html("td", { id: "tau-worst" }, "–");
    const rows = [
      row("delays, τ", this.lateness(), { id: "lateness" }),
      html("tr", {}, html("th", { scope: "row" }, "delay measured (worst now, p99)"), this.worst),
      ...Object.entries(certificate.margins).map(([name, margin]) => row(`margin ${name}`, `${number(margin)} ${dampingUnit(about, ports)}`)),
      row("transparency, γ", certificate.gamma === null ? "no objective" : number(certificate.gamma)),
      row("ladder covers", certificate.ladder.map(us).join(", ") || "no softer couplings"),
      row("levels", certificate.enforced.length ? `proved; enforced at run time: ${certificate.enforced.join(", ")}` : "all proved"),
    ];
    byId("certificate-table").tBodies[0].replaceChildren(...rows);
    say(byId("account-bound"), `≥ ${quantity(-certificate.tank, "J")}${certificate.power ? ` − ${quantity(certificate.power, "W")} t` : ""}`);
    this.parties = Object.keys(about.nodes).map((name) => this.party(name, certificate));
    byId("parties-table").tBodies[0].replaceChildren(...this.parties.map((party) => party.row));
  }

  /** What is proved of delays, and what happens to energy that longer ones put in. */
  lateness() {
    const { certificate, clock } = this.about;
    const proved = `proved up to ${us(certificate.tau)}`;
    if (clock !== "realtime") return proved;
    const tank = `${quantity(certificate.tank, "J")}${certificate.power ? ` and ${quantity(certificate.power, "W")}` : ""}`;
    return `${proved}, ${certificate.bounded ? `enforced beyond (tank ${tank})` : `counted beyond (bound ${tank})`}`;
  }

  party(name, certificate) {
    const level = certificate.delta_D[name];
    const cell = (attributes, ...texts) => html("td", { role: "cell", ...attributes }, ...texts);
    const [total, least, account] = [cell(), cell(), cell({ "data-account": name })];
    const given = cell({ "data-given": name });
    const shown = level === undefined ? "as designed" : `Δ ${number(level)} ${dampingUnit(this.about, this.about.nodes[name].ports)}`;
    const head = told("th", { role: "rowheader", scope: "row" }, name);
    const cells = [head, cell({ class: "level" }, shown), total, least, account, given];
    return { name, total, least, account, given, row: html("tr", { role: "row" }, ...cells) };
  }

  show(session) {
    tell(byId("energy"), session.picture?.energy ?? "");
    tell(byId("wave-links"), (session.picture?.wave_links ?? []).map((text) => `${text}.`).join(" "));
    if (this.about.certificate === null) return;
    let [worst, most] = [0, 0];
    for (const { figures } of session.nodes.values()) {
      worst = Math.max(worst, figures.tau_worst_us ?? 0);
      most = Math.max(most, figures.tau_us?.p99 ?? 0);
    }
    const { promises } = session.picture;
    const real = this.about.clock === "realtime";
    say(this.worst, real ? `${number(worst)} µs, ${number(most)} µs` : "none: the clock is simulated");
    this.worst.className = isBroken(promises, "delay") ? "broken" : "";
    for (const { name, total, least, account, given } of this.parties) {
      const { figures, given: shares } = session.nodes.get(name);
      if (shares !== undefined) say(given, shares.replace("/", " / "));
      given.className = isBroken(promises, "force given", name) ? "broken" : "";
      say(total, quantity(figures.ledger, "J"));
      say(least, quantity(figures.ledger_margin, "J"));
      least.className = isBroken(promises, "passivity", name) ? "broken" : "";
      if (figures.interface === undefined) continue;
      say(account, quantity(figures.interface, "J"));
      account.className = isBroken(promises, "lateness energy", name) ? "broken" : "";
    }
  }
}
