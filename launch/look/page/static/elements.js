/** Functions that make elements. Texts of a session become text nodes, never markup. */

const SVG = "http://www.w3.org/2000/svg";

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

export const html = (name, attributes = {}, ...children) => filled(document.createElement(name), attributes, children);
export const svg = (name, attributes = {}, ...children) => filled(document.createElementNS(SVG, name), attributes, children);
export const byId = (id) => document.getElementById(id);

/** Set a text unless it is unchanged: a screen reader reads every change in a live region. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

const BETWEEN = /(?<=[\p{L}\d][_.-])(?=\p{L})/u; // two parts of a name

/** The same, where a line may end after a separator inside a name, and nowhere else in it. */
export function tell(element, text) {
  if (element.textContent === text) return;
  element.replaceChildren(...text.split(BETWEEN).flatMap((part, i) => (i ? [html("wbr"), part] : [part])));
}

/** An element with such a text. */
export function told(name, attributes, text) {
  const element = html(name, attributes);
  tell(element, text);
  return element;
}

/** Set attributes of an element that is drawn again and again. */
export function place(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, typeof value === "number" ? value.toFixed(1) : value);
  }
}

/** Mark a tool in the picture while buttons of its device are pressed. */
export function showPressed(mark, pressed, at) {
  mark.style.display = pressed.length ? "" : "none";
  place(mark, pressed.length ? { cx: at.x, cy: at.y, "data-pressed": pressed.join(" ") } : { "data-pressed": "" });
}

/** The height that a drawing in a holder has to fill, px: the least that the style sheet states for what the holder is in. */
export const height = (holder) => Math.round(parseFloat(getComputedStyle(holder.parentElement).minHeight));

/** The box at the top of a drawing so many px wide that its buttons cover, and what is said beside them. */
export const buttons = (width) => [byId("grip-status").textContent ? 0 : width - 196, 0, width, 46];
