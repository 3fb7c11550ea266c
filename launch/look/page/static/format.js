/** Numbers for people: three digits, and a unit prefix where one helps. */

const PREFIXES = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];

/** The unit prefix, as factor and letter, that makes values up to `most` short. Delays are in µs already. */
export function prefixOf(most, unit) {
  if (unit === "us" || !(most > 0)) return [1, ""];
  return PREFIXES.find(([factor]) => most >= factor * 0.9995) ?? PREFIXES.at(-1);
}

/** The unit of a place, and of a force, on an axis that turns or does not. */
export const unitsOf = (turns) => (turns ? ["rad", "N·m"] : ["m", "N"]);

/** The unit of a damping at some ports, of which all, none or some turn. */
export function dampingUnit(about, ports) {
  const kinds = new Set(ports.map((port) => about.turning.includes(port)));
  return [...kinds].sort().map((turns) => (turns ? "N·m·s/rad" : "N·s/m")).join(" or ");
}

const LEAST = 1e-12; // in any unit: what is smaller is the rounding of a sum, and shown as 0

export const unitOf = (unit) => (unit === "us" ? "µs" : unit);

/** A value with its unit; a dash where there is no value. */
export function quantity(value, unit) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (Math.abs(value) < LEAST) return `0 ${unitOf(unit)}`;
  const [factor, letter] = prefixOf(Math.abs(value), unit);
  return `${number(value / factor)} ${letter}${unitOf(unit)}`;
}

/** A number with three digits; a large number with all its digits. */
export function number(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-3) return value.toExponential(2);
  return size >= 100 ? value.toFixed(0) : value.toPrecision(3);
}

/** The least of 1, 2, 5, 10, … (times a power of ten) that is not below `most`. */
export function rounded(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= most * 0.999999);
}

/** The end of a scale: it grows at once with what it shows, and shrinks when a third of it would do. */
export const fitted = (before, most) => (most > before || most < 0.3 * before ? rounded(most) : before);

/** The name of a port's axis: what follows the device's name; a device of one axis moves along x, or turns by φ. */
export const axisOf = (port, turns) => (port.includes(".") ? port.slice(port.lastIndexOf(".") + 1) : turns ? "φ" : "x");
