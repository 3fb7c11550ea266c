/** The camera of the drawing in space: it looks at a point from some direction and distance. Lengths in m, angles in rad.

y is up. `azimuth` turns the camera about y, from the side of z towards that of x; `elevation` raises it.
*/

const FIRST = { azimuth: (25 * Math.PI) / 180, elevation: (15 * Math.PI) / 180 };
const STEEPEST = 1.55; // elevation, just below the vertical, where right and left would change places
const CLOSEST = 0.1; // parts of the first distance
const FARTHEST = 10;

export const FIELD = 0.6; // rad, the angle from the lower to the upper edge of the picture

export class Orbit {
  /** A camera that sees all within `radius` around `middle`. */
  constructor(middle, radius) {
    this.middle = [...middle];
    this.radius = radius;
    this.width = this.height = 1; // px
    this.moves = 0; // how often the camera was moved: whoever draws compares
    this.home();
  }

  /** The first view. */
  home() {
    this.turned = { ...FIRST };
    this.target = [...this.middle];
    this.zoomed = 1;
    this.update();
  }

  /** The picture's size, px. */
  resize(width, height) {
    this.width = width;
    this.height = height;
    this.update();
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
    const { azimuth, elevation } = this.turned;
    const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
    const narrow = Math.min(1, this.width / this.height); // a picture that is higher than wide sees less to the sides
    this.distance = (this.zoomed * this.radius) / Math.sin(Math.atan(narrow * Math.tan(FIELD / 2)));
    this.back = [ce * sa, se, ce * ca]; // from the target to the eye
    this.right = [ca, 0, -sa];
    this.up = [-se * sa, ce, -se * ca];
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

One pointer turns it; with Shift, or a button other than the first, it pans. Two fingers zoom and pan. The wheel zooms
where `frame` has the focus, or with Ctrl, so that a page which is scrolled is not caught here.
*/
export function steer(orbit, frame, surface) {
  const pointers = new Map(); // by id: the latest position, px
  surface.addEventListener("contextmenu", (event) => event.preventDefault());
  surface.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    frame.focus({ preventScroll: true });
    surface.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  surface.addEventListener("pointermove", (event) => {
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
    surface.addEventListener(end, (event) => pointers.delete(event.pointerId));
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
