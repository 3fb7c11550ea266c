/** Rotations as unit quaternions, the real part first, and what hands turn: their names, their parts in traces. */

export const times = ([a, b, c, d], [w, x, y, z]) => [
  a * w - b * x - c * y - d * z,
  a * x + b * w + c * z - d * y,
  a * y - b * z + c * w + d * x,
  a * z + b * y - c * x + d * w,
];

export const inverse = ([w, x, y, z]) => [w, -x, -y, -z];

/** A vector, turned by a unit quaternion. */
export const turned = (turn, v) => times(times(turn, [0, ...v]), inverse(turn)).slice(1);

export const QUATERNION = ["qw", "qx", "qy", "qz"];
export const STILL = [1, 0, 0, 0];

const LEAST_LENGTH = 0.5; // of the mean of two unit quaternions of one bucket: a shorter one says nothing

/** The unit quaternion of four values of a trace; null where they say nothing. */
export function unitOf(values) {
  const length = Math.hypot(...values);
  return length < LEAST_LENGTH ? null : values.map((x) => x / length);
}
