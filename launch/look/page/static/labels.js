/** Places labels beside what they name, so that none covers another; one without room is not shown. */

const HIGH = 15; // px of a line
const BESIDE = [[0, -1], [1, 0], [0, 1], [-1, 0], [0.8, -0.8], [-0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]];

export class Labels {
  /** `texts` are SVG texts that are in the drawing, the most important first. */
  constructor(texts) {
    this.labels = texts.map((text) => ({ text, width: 0 }));
    this.taken = this.things = [];
  }

  /** Begin a picture of `width` by `height` px.

  A box is left, top, right and bottom. Those in `taken` stay free of labels; those in `things`, in the order of the
  labels and null where there is none, are avoided by the labels of others, where there is room elsewhere.
  */
  begin(width, height, taken, things) {
    Object.assign(this, { width, height, taken, things, next: 0 });
  }

  /** Place the next label around a point; `far` is its distance from it, px. */
  place(point, far) {
    const own = this.next;
    const label = this.labels[own];
    this.next += 1;
    const { text } = label;
    text.removeAttribute("display");
    label.width ||= text.getComputedTextLength();
    const box = point && (this.room(label, point, far, own) ?? this.room(label, point, far, null));
    if (!box) {
      text.setAttribute("display", "none");
      return;
    }
    this.taken.push(box);
    text.setAttribute("transform", `translate(${box[0].toFixed(1)} ${(box[3] - 4).toFixed(1)})`);
  }

  /** The first free box around a point; on things as well where `own` is null. */
  room(label, { x, y }, far, own) {
    for (let tried = 0; tried < 2 * BESIDE.length; tried += 1) {
      const away = far + (tried < BESIDE.length ? 0 : HIGH);
      const [dx, dy] = BESIDE[tried % BESIDE.length];
      const left = x + dx * (away + label.width / 2) - label.width / 2;
      const top = y + dy * (away + HIGH / 2) - HIGH / 2;
      const box = [left, top, left + label.width, top + HIGH];
      const inside = left >= 2 && top >= 2 && box[2] <= this.width - 2 && box[3] <= this.height - 2;
      if (!inside || this.taken.some((other) => overlap(box, other))) continue;
      if (own !== null && this.things.some((other, i) => i !== own && other && overlap(box, other))) continue;
      return box;
    }
    return null;
  }
}

const overlap = (a, b) => a[0] < b[2] + 2 && b[0] < a[2] + 2 && a[1] < b[3] && b[1] < a[3];
