/** The camera of the drawing in space: it looks at a point from some direction and distance. Lengths in m, angles in rad.

y is up. `azimuth` turns the camera about y, from the side of z towards that of x; `elevation` raises it.
*/

const FIRST = { azimuth: (25 * Math.PI) / 180, elevation: (15 * Math.PI) / 180 };
export const ABOVE = { ...FIRST, elevation: (35 * Math.PI) / 180 }; // where things lie on a ground, and walls may be in front
const STEEPEST = 1.55; // elevation, just below the vertical, where right and left would change places
const CLOSEST = 0.1; // parts of the first distance
const FARTHEST = 10;
const MARGIN = 0.06; // parts of the picture that the first view leaves free around what fills it

export const FIELD = 0.6; // rad, the angle from the lower to the upper edge of the picture

export class Orbit {
  /** A camera whose first view, from this direction, is filled by these places; all that is drawn is within `radius`. */
  constructor(places, radius, from = FIRST) {
    Object.assign(this, { places, radius, from });
    this.width = this.height = 1; // px
    this.moves = 0; // how often the camera was moved: whoever draws compares
    this.home();
  }

  /** The first view. */
  home() {
    this.turned = { ...this.from };
    this.zoomed = 1;
    this.fill();
    this.update();
  }

  /** The picture's size, px. What the camera looks at stays, unless it is still the first view. */
  resize(width, height) {
    const first = this.target === this.first;
    Object.assign(this, { width, height });
    const target = this.target;
    this.fill();
    if (!first) this.target = target;
    this.update();
  }

  /** Look at the places from the first direction, from so near that they just fill the picture. */
  fill() {
    const { right, up, back } = axesOf(this.from);
    const tall = Math.tan(FIELD / 2) * (1 - MARGIN);
    const wide = (tall * this.width) / this.height;
    const along = (axis, place) => dot(axis, place);
    const span = (axis) => [Math.min, Math.max].map((end) => end(...this.places.map((place) => along(axis, place))));
    let centre = [right, up, back].map((axis) => span(axis).reduce((low, high) => (low + high) / 2));
    for (let i = 0; i < 8; i += 1) {
      // the least distance at which all are within the picture, and where its middle then is
      const sides = this.places.map((place) => [along(right, place) - centre[0], along(up, place) - centre[1], along(back, place) - centre[2]]);
      this.nearest = Math.max(...sides.map(([x, y, z]) => z + Math.max(Math.abs(x) / wide, Math.abs(y) / tall)), 1e-6);
      const seen = sides.map(([x, y, z]) => [x / (this.nearest - z), y / (this.nearest - z)]);
      const middle = [0, 1].map((j) => (Math.min(...seen.map((s) => s[j])) + Math.max(...seen.map((s) => s[j]))) / 2);
      centre = [centre[0] + middle[0] * this.nearest, centre[1] + middle[1] * this.nearest, centre[2]];
    }
    this.first = this.target = [0, 1, 2].map((i) => centre[0] * right[i] + centre[1] * up[i] + centre[2] * back[i]);
  }

  /** Turn the camera about its target, rad. */
  turn(azimuth, elevation) {
    this.turned.azimuth += azimuth;
    this.turned.elevation = Math.max(-STEEPEST, Math.min(STEEPEST, this.turned.elevation + elevation));
    this.update();
  }

  /** Approach the target: the distance becomes so many times as great. */
  zoom(factor) {
    this.zoomed = Math.max(CLOSEST, Math.min(FARTHEST, this.zoomed * factor));
    this.update();
  }

  /** Move the picture by so many px to the right and downwards. */
  pan(dx, dy) {
    const moved = this.across(dx, dy, this.distance);
    this.target = this.target.map((x, i) => x - moved[i]);
    this.update();
  }

  update() {
    Object.assign(this, axesOf(this.turned));
    this.distance = this.zoomed * this.nearest;
    this.eye = this.target.map((x, i) => x + this.distance * this.back[i]);
    this.scale = this.height / 2 / Math.tan(FIELD / 2); // px of a length that is as far away as it is long
    this.moves += 1;
  }

  /** How far in front of the eye a place is. */
  depth(place) {
    return -dot(this.back, place) + dot(this.back, this.eye);
  }

  /** Where a place is in the picture, px, and how many px a length has there; null behind the eye. */
  project(place) {
    const depth = this.depth(place);
    if (!(depth > 1e-3 * this.distance)) return null;
    const pixels = this.scale / depth;
    const x = this.width / 2 + pixels * (dot(this.right, place) - dot(this.right, this.eye));
    const y = this.height / 2 - pixels * (dot(this.up, place) - dot(this.up, this.eye));
    return { x, y, pixels };
  }

  /** The motion in space, parallel to the picture and at a depth, that moves by so many px to the right and downwards. */
  across(dx, dy, depth) {
    const length = depth / this.scale;
    return this.right.map((x, i) => length * (dx * x - dy * this.up[i]));
  }
}

/** The directions of a view: to the right, upwards, and from what it looks at to the eye. */
function axesOf({ azimuth, elevation }) {
  const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
  return { back: [ce * sa, se, ce * ca], right: [ca, 0, -sa], up: [-se * sa, ce, -se * ca] };
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

const TURN = 0.008; // rad for each px of a pointer
const KEY_TURN = Math.PI / 36;
const KEY_PAN = 24; // px
const KEY_ZOOM = 1.15;
const WHEEL = 0.0015; // of the logarithm of the distance, for each px of a wheel

/** What a key does to the camera. */
const KEYS = {
  ArrowRight: (orbit, shift) => (shift ? orbit.pan(-KEY_PAN, 0) : orbit.turn(KEY_TURN, 0)),
  ArrowLeft: (orbit, shift) => (shift ? orbit.pan(KEY_PAN, 0) : orbit.turn(-KEY_TURN, 0)),
  ArrowUp: (orbit, shift) => (shift ? orbit.pan(0, KEY_PAN) : orbit.turn(0, KEY_TURN)),
  ArrowDown: (orbit, shift) => (shift ? orbit.pan(0, -KEY_PAN) : orbit.turn(0, -KEY_TURN)),
  "+": (orbit) => orbit.zoom(1 / KEY_ZOOM),
  "=": (orbit) => orbit.zoom(1 / KEY_ZOOM), // the key of + without Shift
  "-": (orbit) => orbit.zoom(KEY_ZOOM),
  _: (orbit) => orbit.zoom(KEY_ZOOM),
  Home: (orbit) => orbit.home(),
};

/** Let pointers on `surface`, and keys and the wheel on `frame`, move the camera.

`claims` returns what a pointer does instead, a function of its later events, or null.

One pointer turns it; with Shift, or a button other than the first, it pans. Two fingers zoom and pan. The wheel zooms
where `frame` has the focus, or with Ctrl, so that a page which is scrolled is not caught here.
*/
export function steer(orbit, frame, surface, claims) {
  const pointers = new Map(); // by id: the latest position, px
  const claimed = new Map(); // by id of others: what they do
  surface.addEventListener("contextmenu", (event) => event.preventDefault());
  surface.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    surface.setPointerCapture(event.pointerId);
    const instead = claims(event);
    if (instead) {
      claimed.set(event.pointerId, instead);
      return;
    }
    frame.focus({ preventScroll: true });
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  surface.addEventListener("pointermove", (event) => {
    claimed.get(event.pointerId)?.(event);
    const before = pointers.get(event.pointerId);
    if (before === undefined) return;
    const now = [event.clientX, event.clientY];
    pointers.set(event.pointerId, now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (pointers.size > 1) pinch(orbit, pointers, event.pointerId, before, now);
    else if (event.shiftKey || (event.buttons & 1) === 0) orbit.pan(dx, dy);
    else orbit.turn(-TURN * dx, TURN * dy);
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    surface.addEventListener(end, (event) => pointers.delete(event.pointerId) || claimed.delete(event.pointerId));
  }
  frame.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && document.activeElement !== frame) return;
      event.preventDefault();
      orbit.zoom(Math.exp(WHEEL * Math.max(-400, Math.min(400, event.deltaY * (event.deltaMode === 1 ? 30 : 1)))));
    },
    { passive: false },
  );
  frame.addEventListener("keydown", (event) => {
    const key = KEYS[event.key];
    if (key === undefined || event.target !== frame || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    key(orbit, event.shiftKey);
  });
}

/** One of two fingers has moved: what is between them stays between them. */
function pinch(orbit, pointers, moved, before, now) {
  const [other] = [...pointers].filter(([id]) => id !== moved).map(([, at]) => at);
  const apart = (at) => Math.max(1, Math.hypot(at[0] - other[0], at[1] - other[1]));
  orbit.zoom(apart(before) / apart(now));
  orbit.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
}
