/** Places labels beside what they name, so that none covers another; one without room is not shown. */

const HIGH = 15; // px of a line
const BESIDE = [[0, -1], [1, 0], [0, 1], [-1, 0], [0.8, -0.8], [-0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]];

export class Labels {
  /** `texts` are SVG texts that are in the drawing, the most important first. */
  constructor(texts) {
    this.labels = texts.map((text) => ({ text, width: 0, side: 0 }));
    this.taken = [];
  }

  /** Begin a picture of `width` by `height` px, in which these boxes (left, top, right, bottom) are taken already. */
  begin(width, height, boxes) {
    Object.assign(this, { width, height, taken: boxes, next: 0 });
  }

  /** Place the next label around a point; `far` is its distance from it, px. */
  place(point, far) {
    const label = this.labels[this.next];
    this.next += 1;
    const { text } = label;
    text.removeAttribute("display");
    label.width ||= text.getComputedTextLength();
    const found = point && this.room(label, point, far);
    if (!found) {
      text.setAttribute("display", "none");
      return;
    }
    label.side = found.side;
    this.taken.push(found.box);
    text.setAttribute("transform", `translate(${found.box[0].toFixed(1)} ${(found.box[3] - 4).toFixed(1)})`);
  }

  /** The first free place, beginning with the one that the label has, so that it does not jump. */
  room(label, { x, y }, far) {
    for (let tried = 0; tried < 2 * BESIDE.length; tried += 1) {
      const side = (label.side + tried) % BESIDE.length;
      const away = far + (tried < BESIDE.length ? 0 : HIGH);
      const [dx, dy] = BESIDE[side];
      const left = x + dx * (away + label.width / 2) - label.width / 2;
      const top = y + dy * (away + HIGH / 2) - HIGH / 2;
      const box = [left, top, left + label.width, top + HIGH];
      const inside = left >= 2 && top >= 2 && box[2] <= this.width - 2 && box[3] <= this.height - 2;
      if (inside && !this.taken.some((other) => overlap(box, other))) return { box, side };
    }
    return null;
  }
}

const overlap = (a, b) => a[0] < b[2] + 2 && b[0] < a[2] + 2 && a[1] < b[3] && b[1] < a[3];
