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

/** Write a name into an SVG text, shortened to a width in the drawing's own units. */
export function fit(text, name, width) {
  say(text, name);
  for (let kept = name.length - 1; kept > 0 && text.getComputedTextLength() > width; kept -= 1) say(text, `${name.slice(0, kept)}…`);
}

/** Set attributes of an element that is drawn again and again. */
export function place(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, typeof value === "number" ? value.toFixed(1) : value);
  }
}
