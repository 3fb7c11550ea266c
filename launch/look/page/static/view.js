/** The view of the virtual world: in space where the session has a geometry and the browser WebGL, otherwise in its plane. */

import { byId, html, say } from "./elements.js";
import { World } from "./world.js";

const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i; // renderers that compute on the processor
const WHY = {
  missing: "this browser has no WebGL",
  lost: "the browser took WebGL away; the page has it again when it is opened anew",
  unloaded: "a script did not come; open the page anew",
};

/** A context of WebGL, null where there is none. Without a graphics card, smooth edges would take more than half of the time of a picture. */
function contextOf(canvas) {
  const probe = html("canvas").getContext("webgl2");
  const known = probe?.getExtension("WEBGL_debug_renderer_info");
  const renderer = known ? probe.getParameter(known.UNMASKED_RENDERER_WEBGL) : "";
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  return canvas.getContext("webgl2", { alpha: false, antialias: !SOFTWARE.test(renderer), powerPreference: "low-power" });
}

export class View {
  constructor(parent, session, grips) {
    Object.assign(this, { parent, session, grips });
    this.drawings = {};
    this.only = ""; // why there is the plane alone
    this.button = byId("view-switch");
    const spatial = session.about.scene ?? session.about.drawing;
    this.button.hidden = spatial === null;
    this.button.disabled = false;
    this.button.onclick = () => this.show(this.shown === "space" ? "plane" : "space");
    if (spatial === null) this.show("plane");
    else this.begin(html("canvas", { "aria-hidden": "true" }));
    window.onresize = () => this.drawing?.arrange(); // a window that is only lower changes no width
  }

  /** Begin in space; three.js is loaded only here. */
  async begin(canvas) {
    const context = contextOf(canvas);
    if (context === null) {
      this.without("missing");
      return;
    }
    try {
      const { Space } = await import("./space.js");
      if (this.disposed) return;
      this.makeSpace = (holder) => new Space(holder, this.session, this.grips, canvas, context);
      canvas.addEventListener("webglcontextlost", () => this.without("lost"));
      this.show("space");
    } catch (error) {
      console.error(error);
      this.without("unloaded");
    }
  }

  /** There is no view in space, or no longer. */
  without(why) {
    this.button.disabled = true;
    this.only = ` It is drawn in its plane, because ${WHY[why]}.`;
    this.drawings.space?.dispose();
    delete this.drawings.space;
    this.show("plane");
  }

  show(kind) {
    this.grips.releaseAll(); // the handles go
    const first = !(kind in this.drawings);
    const holder = first ? html("div") : this.drawings[kind].parent;
    this.parent.replaceChildren(holder);
    if (first) this.drawings[kind] = kind === "space" ? this.makeSpace(holder) : new World(holder, this.session, this.grips);
    this.shown = this.parent.dataset.view = kind;
    this.button.setAttribute("aria-pressed", String(kind === "space"));
    const held = this.session.about.grips.length ? ` Drag a ${this.drawing.ring} ring, or focus it and press the arrow keys.` : "";
    say(byId("world-legend"), `${this.drawing.legend()}${held}${this.only}`);
    if (this.only) byId("signs").open = true;
  }

  get drawing() {
    return this.drawings[this.shown];
  }

  rescale(now) {
    this.drawing?.rescale(now);
  }

  draw() {
    this.drawing?.draw();
  }

  /** Draw once more if the camera was moved since: it follows a hand at every frame. */
  follow() {
    if (this.shown === "space" && this.drawing.moved) this.drawing.draw();
  }

  /** A different session is shown from now on. */
  dispose() {
    this.disposed = true;
    this.drawings.space?.dispose();
  }
}
