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

/** A rotation about an axis, rad. */
export const about = (axis, angle) => [Math.cos(angle / 2), ...axis.map((x) => Math.sin(angle / 2) * x)];

/** The angle of a rotation, rad, 0 to π. */
export const angleOf = ([w, x, y, z]) => 2 * Math.atan2(Math.hypot(x, y, z), Math.abs(w));

/** The place on a ball of radius 1, seen from z, at which a pointer is; beside the ball on its rim. */
function onBall([x, y]) {
  const far = Math.hypot(x, y);
  return far < 1 ? [x, y, Math.sqrt(1 - far * far)] : [x / far, y / far, 0];
}

/** The rotation of a ball of radius 1 that is dragged from one place of the picture to another: by twice the arc, so that a drag from its middle to its rim is half a turn. */
export function dragged(from, to) {
  const [[a, b, c], [d, e, f]] = [onBall(from), onBall(to)];
  return [a * d + b * e + c * f, b * f - c * e, c * d - a * f, a * e - b * d];
}

/** The same rotation, where the axes of the picture are these directions. */
export const along = ([w, ...parts], axes) => [w, ...[0, 1, 2].map((i) => parts.reduce((sum, part, axis) => sum + part * axes[axis][i], 0))];

const LEAST_LENGTH = 0.5; // of the mean of two unit quaternions of one bucket: a shorter one says nothing

/** The unit quaternion of four values of a trace; null where they say nothing. */
export function unitOf(values) {
  const length = Math.hypot(...values);
  return length < LEAST_LENGTH ? null : values.map((x) => x / length);
}
