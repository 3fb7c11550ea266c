/** Places labels beside what they name, so that none covers another and no line crosses one; one without room is not shown. */

const HIGH = 15; // px of a line
const BESIDE = [[0, -1], [1, 0], [0, 1], [-1, 0], [0.8, -0.8], [-0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]];
const STEPS = [0, 1, 2, 3.5]; // lines away from what is named, where there is no room beside it

export class Labels {
  /** `texts` are SVG texts that are in the drawing, the most important first. */
  constructor(texts) {
    this.labels = texts.map((text) => ({ text, width: 0, latest: 0 }));
  }

  /** Begin a picture of `width` by `height` px.

  A box is left, top, right and bottom. Those in `taken` stay free of labels; those in `things`, in the order of the
  labels and null where there is none, are avoided by the labels of others, where there is room elsewhere. No label is
  on one of the `lines`: each is two points, and how far it reaches to its sides, px.
  */
  begin(width, height, taken, things, lines) {
    Object.assign(this, { width, height, taken, things, lines, next: 0 });
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

  /** The first free box around a point, where the label was before if that is free; on things as well where `own` is null. */
  room(label, { x, y }, far, own) {
    const all = STEPS.length * BESIDE.length;
    for (let i = -1; i < all; i += 1) {
      const tried = i < 0 ? label.latest : i;
      const away = far + HIGH * STEPS[Math.floor(tried / BESIDE.length)];
      const [dx, dy] = BESIDE[tried % BESIDE.length];
      const left = x + dx * (away + label.width / 2) - label.width / 2;
      const top = y + dy * (away + HIGH / 2) - HIGH / 2;
      const box = [left, top, left + label.width, top + HIGH];
      const inside = left >= 2 && top >= 2 && box[2] <= this.width - 2 && box[3] <= this.height - 2;
      if (!inside || this.taken.some((other) => overlap(box, other))) continue;
      if (this.lines.some(([from, to, aside]) => crosses(from, to, aside + 1, box))) continue;
      if (own !== null && this.things.some((other, j) => j !== own && other && overlap(box, other))) continue;
      label.latest = tried;
      return box;
    }
    return null;
  }
}

const overlap = (a, b) => a[0] < b[2] + 2 && b[0] < a[2] + 2 && a[1] < b[3] && b[1] < a[3];

/** Whether a line that reaches `aside` px to its sides meets a box: what is left of it within each pair of edges. */
function crosses(from, to, aside, [left, top, right, bottom]) {
  let [begin, end] = [0, 1];
  for (const [at, along, low, high] of [
    [from.x, to.x - from.x, left - aside, right + aside],
    [from.y, to.y - from.y, top - aside, bottom + aside],
  ]) {
    if (along === 0) {
      if (at <= low || at >= high) return false;
      continue;
    }
    const [a, b] = [(low - at) / along, (high - at) / along];
    begin = Math.max(begin, Math.min(a, b));
    end = Math.min(end, Math.max(a, b));
  }
  return begin < end;
}
