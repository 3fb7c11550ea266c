"""One tick of a scene: springs, contacts and friction, solved together with the couplings' compliance.

With the positions z of all tools and bodies (P x 3, m) and the forces F(z) of springs, dampers and contacts on them, a
tick is

    z = z_free + W F(z),        W = blockdiag(S D_V S at the ports, T^2/m I at each body),

where z_free is where the tools would be without forces, r, and where the bodies' velocities carry them. Springs and
dampers are linear, and a matrix made beforehand holds them. Contacts act along the gradients n of the gaps at the tick
before, with the gap's tangent plane g(z) = d + n^T (u - u(k-1)) in place of the gap, u the first point less the second:

    normal force    max(0, -k g - b (g - min(0, d))/T),
    friction        -k e, with e = (I - n n^T) (e(k-1) + u - u(k-1)), shortened to at most mu N(k-1)/k,

N(k-1) being the normal force of the tick before. Both are gradients of convex functions of z, so that the tick has one
solution. docs/decisions/0041-scenes.md proves that the scene then keeps the level 0, for every W.

A driven body has no compliance, so z_free is where its motion puts it. The work of the forces that move it is taken
from the scene's tank. In a tick whose work the tank cannot pay, all driven bodies stand still, where their work is 0,
and their motion goes on from there in the next tick.

A button may hold a body by a tool: a spring and a damper join the two from the tick in which it is pressed, with the
offset that they had in the tick before as the one without force. They go when it is let go. A button takes hold of the
body whose gap to the tool is the smallest, and no greater than stated; where there is none, it holds nothing until it
is pressed again. The two go on touching each other.

A primal-dual active-set iteration [Hintermueller2002]_ finds the solution, from the forces of the tick before on, in
:data:`MOST_STEPS` steps at most. It works with the forces along the rows of a matrix G, one row along the gradient of
each pair and three across it, and projects them on what the laws admit [Alart1991]_. The forces that are sent are those
from which z follows. What an unfinished iteration leaves is an error of a contact's law alone; the
passivity controller of :class:`manyhands.nodes.environment.enforced.EnforcedCore` covers it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.scene import ContactScene
from manyhands.nodes.environment.model import MOST_FORCE
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.intent import Intent, intent_from
from manyhands.nodes.rows import figures as names

Vector = NDArray[np.float64]

MOST_STEPS: Final = 12
"""Newton steps of a tick: they bound its time."""

NEAR: Final = 2e-3
"""m; a pair with a greater gap takes part in a tick only if points are fast enough to close it."""

_EVERYWHERE: Final = 1e4  # m; beyond it all pairs have taken part, for nothing in a scene is so far away

_ENOUGH: Final = 1e-12  # m; a residual of this size is a force's rounding


class SceneLaw:
    """The forces of a scene, as a law of :class:`manyhands.nodes.environment.enforced.EnforcedCore`.

    Attributes:
        failure: that a tick had forces beyond :data:`.MOST_FORCE`, after which they are zero; None before.
        tank: what the driven bodies may still give out, J.
        paused: ticks in which the tank held them.
        held: always empty, for a scene has no proxies.
        steps: Newton steps so far.
        unfinished: ticks whose iteration did not end in :data:`MOST_STEPS` steps.
        held_bodies: by each hold of the scene, the body that its button holds, by its number among tools and bodies;
            None where it holds none.
    """

    def __init__(self, scene: ContactScene, T: float, buttons: Sequence[str] = ()) -> None:
        """Start at rest, with all displacements 0.

        Args:
            scene: the scene.
            T: period, s.
            buttons: the names of the buttons, in the order of their bits.
        """
        tools, bodies = scene.tools, scene.bodies
        points = len(tools) + len(bodies)
        size = 3 * points
        self._T = T
        self._first = 3 * len(tools)  # the first coordinate of the bodies
        self._ports = np.zeros(len(scene.ports), dtype=np.intp)
        for i, tool in enumerate(tools):
            self._ports[list(tool.ports)] = [3 * i + axis for axis in tool.axes]
        K, B, load = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)
        for link in scene.links:
            a, b = scene.ends_of(link)
            rest = scene.rest_of(link)
            for end, other, sign in ((a, b, 1.0), (b, a, -1.0)):
                if end is None:
                    continue
                own = slice(3 * end, 3 * end + 3)
                load[own] += sign * link.stiffness * rest
                for matrix, amount in ((K, link.stiffness), (B, link.damping)):
                    matrix[own, own] += amount * np.eye(3)
                    if other is not None:
                        matrix[own, 3 * other : 3 * other + 3] -= amount * np.eye(3)
        self._mobility = np.zeros((size, size))
        motions: list[tuple[int, Intent]] = []  # by coordinate
        for i, body in enumerate(bodies, len(tools)):
            own = slice(3 * i, 3 * i + 3)
            if body.motion:
                motions += [(3 * i + axis, intent_from(motion)) for axis, motion in enumerate(body.motion)]
                continue
            load[own] += body.mass * np.array(scene.gravity)
            self._mobility[own, own] = T * T / body.mass * np.eye(3)
        self._driven = np.array([row for row, _ in motions], dtype=np.intp)
        self._motions = [motion for _, motion in motions]
        self._moved = 0  # ticks of their motion
        self.tank, self._work = scene.tank, 0.0  # J
        self._pauses, self.paused = False, 0
        self._K, self._B, self._load = K + B / T, B / T, load
        self._plain = self._K, self._B, self._load  # without what is held
        names_of_tools = [tool.name for tool in tools]
        self._holds = [(hold, names_of_tools.index(hold.tool)) for hold in scene.holds]
        self._bits = [1 << buttons.index(hold.button) if hold.button in buttons else 0 for hold in scene.holds]
        self._graspable = scene.graspable if scene.holds else None
        self.held_bodies: list[int | None] = [None] * len(scene.holds)
        self._offsets = np.zeros((len(scene.holds), 3))  # of tool and body where the spring has no force, m
        self._pressed = 0
        contacts = self._contacts = scene.contacts
        self._total = contacts.stiffness + contacts.damping / T
        self._jacobian = np.kron(contacts.incidence, np.eye(3)).reshape(len(contacts), 3, size)
        self._I = np.eye(size)
        self._z: Vector = scene.points.ravel()
        self._home: Vector = self._z
        self._step = np.zeros(size)  # of the tick before
        self._free = self._z.copy()
        self._target: Vector = self._z[self._driven]  # of the driven bodies in this tick; motions begin at 0
        self._normal = np.zeros(len(contacts))  # the normal forces of the tick before, N
        self._bristles = np.zeros((len(contacts), 3))  # e of the tick before, m
        self._compliance: Vector | None = None
        self._W: Vector = self._mobility
        self._linear: Vector = self._mobility
        self._next: Vector = self._z
        self._normal_next, self._bristles_next = self._normal, self._bristles
        self.failure: str | None = None
        self.held: tuple[int, ...] = ()  # no proxies
        self.steps = self.unfinished = 0
        self._prepare()

    @property
    def touching(self) -> int:
        """The number of pairs that press on each other in the tick before."""
        return int(np.count_nonzero(self._normal))

    @property
    def figures(self) -> Mapping[str, float]:
        """The unfinished ticks; with driven bodies the ticks in which they paused, and what is in their tank, J."""
        found = {names.UNFINISHED: float(self.unfinished)}
        if self._holds:
            found[names.HOLDING] = float(sum(body is not None for body in self.held_bodies))
        return found | ({names.PAUSED: float(self.paused), names.DRIVE_TANK: self.tank} if self._motions else {})

    @property
    def orientations(self) -> Floats:
        """Empty: nothing in a scene turns."""
        return []

    @property
    def masses(self) -> Floats:
        """How far the bodies are from where they started, x, y and z of each, m."""
        found: Floats = (self._z - self._home)[self._first :].tolist()
        return found

    def press(self, pressed: int) -> None:
        """Hold what buttons that are pressed now take hold of, and let go what is held by those that are not any more.

        It allocates, and the next proposal inverts a matrix, in a tick in which a button changes and in no other: a
        finger does so a few times a second, and no button in less than 20 ms.
        """
        before, self._pressed = self._pressed, pressed
        changed = False
        for i, bit in enumerate(self._bits):
            if pressed & bit and not before & bit:
                self.held_bodies[i] = self._grasp(i)
                changed = changed or self.held_bodies[i] is not None
            elif not pressed & bit and self.held_bodies[i] is not None:
                self.held_bodies[i], changed = None, True
        if changed:
            self._join()

    def _grasp(self, hold: int) -> int | None:
        """The body that a hold takes hold of where all things are, by its number; keeps its offset from the tool."""
        own, tool = self._holds[hold]
        z, pairs = self._z.reshape(-1, 3), self._graspable
        if pairs is None:
            return None
        gaps, _ = pairs.gaps(z)
        near = [(gap, pair.b) for gap, pair in zip(gaps.tolist(), pairs.pairs, strict=True) if pair.a == tool]
        gap, body = min(near, default=(np.inf, -1))
        if not gap <= own.within:
            return None
        self._offsets[hold] = z[tool] - z[body]
        return body

    def _join(self) -> None:
        """Make springs and dampers anew, with those of what is held."""
        K, B, load = (part.copy() for part in self._plain)
        for (hold, tool), body, offset in zip(self._holds, self.held_bodies, self._offsets, strict=True):
            if body is None:
                continue
            b = hold.damping / self._T
            a, c = slice(3 * tool, 3 * tool + 3), slice(3 * body, 3 * body + 3)
            for own, other, sign in ((a, c, 1.0), (c, a, -1.0)):
                load[own] += sign * hold.stiffness * offset
                K[own, own] += (hold.stiffness + b) * np.eye(3)
                K[own, other] -= (hold.stiffness + b) * np.eye(3)
                B[own, own] += b * np.eye(3)
                B[own, other] -= b * np.eye(3)
        self._K, self._B, self._load = K, B, load
        self._past = load + B @ self._z
        self._compliance = None  # the matrices of the solution are made anew

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """The forces on the tools, N, of the tick's solution."""
        if compliance is not self._compliance:
            self._compliance = compliance
            ports, W = self._ports, self._mobility.copy()
            W[np.ix_(ports, ports)] = compliance
            self._linear = np.asarray(np.linalg.inv(self._I + W @ self._K), dtype=np.float64)
            self._W = self._linear @ W
            self._weigh()
        self._free[self._ports] = self._home[self._ports] + r
        F = self._forces_on(self._target)
        driven = self._driven
        if len(driven):
            self._work = -float(F[driven] @ (self._next - self._z)[driven])
            self._pauses = not self._work <= self.tank
            if self._pauses:
                F, self._work = self._forces_on(self._z[driven]), 0.0
        f: Vector = F[self._ports]
        # written with not: a comparison with NaN is false
        if self.failure is None and not np.abs(f).max() <= MOST_FORCE:
            self.failure = f"the scene failed: found a force beyond {MOST_FORCE:g} N; expected tools near the scene"
        if self.failure is None:
            return f
        self._next, self._work = self._z, 0.0
        return np.zeros(len(f))

    def _forces_on(self, driven: Vector) -> Vector:
        """The forces on all points, N, with the driven bodies at ``driven``; sets the positions at the tick's end."""
        past = self._past
        self._free[self._driven] = driven
        self._next, force = self._touched(self._linear @ self._free + self._W @ past)
        F: Vector = past - self._K @ self._next + force
        return F

    def advance(self, x_e: Vector, f: Vector) -> None:
        """Step to the next tick, with the tools at ``x_e``, m; the forces ``f`` are in the positions already."""
        z = self._next.copy()
        z[self._ports] = self._home[self._ports] + x_e
        self._step = z - self._z
        self._z = z
        self._normal, self._bristles = self._normal_next, self._bristles_next
        self._free[self._first :] = z[self._first :] + self._step[self._first :]
        self._drive()
        self._prepare()

    def _drive(self) -> None:
        """Pay the work of the driven bodies, and set their next target; motions pause where the tank held them."""
        driven = self._driven
        if not len(driven):
            return
        self.tank -= self._work
        if self._pauses:
            self.paused += 1
        else:
            self._moved += 1
        try:
            moved = [motion(self._moved * self._T) for motion in self._motions]
        except ValueError as error:
            self.failure = self.failure or f"a driven body failed: {error}"
            return
        self._target = self._home[driven] + moved

    def _prepare(self) -> None:
        """Everything of the next tick that follows from the positions of this one."""
        self._past = self._load + self._B @ self._z
        self._gap, self._gradient = self._contacts.gaps(self._z.reshape(-1, 3))
        self._reach = NEAR + 8.0 * float(np.abs(self._step).max(initial=0.0))
        self._take(np.flatnonzero(self._gap < self._reach))

    def _take(self, near: NDArray[np.intp]) -> None:
        """Let the pairs ``near`` take part in the tick.

        The rows of G are their gradients, and then three for each pair with friction: what is across the gradient.
        """
        T, contacts, size = self._T, self._contacts, len(self._z)
        n, J, gap = self._gradient[near], self._jacobian[near], self._gap[near]
        self._near, self._kappa = near, self._total[near]
        # the normal force is max(0, kappa (constant - n^T (u - u(k-1))))
        constants = -gap - contacts.damping[near] / T * np.maximum(0.0, -gap) / self._kappa
        compliances = 1.0 / self._kappa
        rows = np.matmul(n[:, None, :], J)[:, 0]
        last = self._normal[near]
        most = contacts.friction[near] * last
        rubbing = self._rubbing = np.flatnonzero(most > 0.0)
        if len(rubbing):
            n = n[rubbing]
            across = np.eye(3) - n[:, :, None] * n[:, None, :]
            self._most, self._k = most[rubbing], contacts.stiffness[near[rubbing]]
            self._e = np.matmul(across, self._bristles[near[rubbing]][:, :, None])[:, :, 0]
            self._across = np.matmul(across, J[rubbing])
            rows = np.concatenate([rows, self._across.reshape(-1, size)])
            last = np.concatenate([last, (-self._k[:, None] * self._e).ravel()])
            constants = np.concatenate([constants, -self._e.ravel()])
            compliances = np.concatenate([compliances, np.repeat(1.0 / self._k, 3)])
        self._G, self._last, self._constants, self._compliances = rows, last, constants, compliances
        self._weigh()

    def _weigh(self) -> None:
        """What follows from G and the compliance together."""
        self._WG = self._W @ self._G.T
        yielding = (self._G * self._WG.T).sum(axis=1)
        count = len(self._near)
        if len(self._rubbing):  # one weight for the three rows of a pair, two of which are independent
            yielding[count:] = np.repeat(yielding[count:].reshape(-1, 3).sum(axis=1) / 2.0, 3)
        self._compliant = yielding + self._compliances
        self._weights = 1.0 / self._compliant

    def _touched(self, free: Vector) -> tuple[Vector, Vector]:
        """The positions and the contacts' forces on all points, from the positions ``free`` without contacts."""
        z, force = self._solved(free)
        while 4.0 * (moved := float(np.abs(z - self._z).max(initial=0.0))) > self._reach and self._reach < _EVERYWHERE:
            # far motion: the pairs within 8 times of it take part, at least twice as far as before
            self._reach = 8.0 * moved
            near = np.flatnonzero(self._gap < self._reach)
            if len(near) > len(self._near):
                self._take(near)
                z, force = self._solved(free)
        self._normal_next = np.zeros(len(self._contacts))
        self._bristles_next = np.zeros((len(self._contacts), 3))
        near = self._near
        if len(near):
            self._normal_next[near] = self._found[: len(near)]
            rubbing = self._rubbing
            if len(rubbing):
                tangential = self._found[len(near) :].reshape(-1, 3)
                self._bristles_next[near[rubbing]] = tangential / -self._k[:, None]
        return z, force

    def _solved(self, free: Vector) -> tuple[Vector, Vector]:
        """The positions, and the contacts' forces on all points."""
        if len(self._near) == 0:
            return free, np.zeros(len(free))
        G, WG = self._G, self._WG
        past = free - self._z
        forces = self._last
        best, least = forces, np.inf
        for step in range(MOST_STEPS + 1):
            trial = self._trial(G @ (past + WG @ forces), forces)
            wanted = self._admitted(trial)
            off = float((np.abs(wanted - forces) * self._compliant).max())
            if off < least:
                best, least = wanted, off
            if off <= _ENOUGH:
                break
            if step == MOST_STEPS:
                self.unfinished += 1
                break
            self.steps += 1
            constant, firm = self._linear_laws(trial)
            forces = constant - firm @ np.linalg.solve(self._I + WG @ firm, past + WG @ constant)
        self._found = best
        return free + WG @ best, G.T @ best

    def _trial(self, u: Vector, forces: Vector) -> Vector:
        """The forces that the laws would be fulfilled with, N, if they admitted every force.

        Args:
            u: the motion of the points along the rows of G, m.
            forces: along the rows of G, N.
        """
        # a law is compliance * force + u = constant; the weights make it a step towards the solution
        trial: Vector = forces + self._weights * (self._constants - forces * self._compliances - u)
        return trial

    def _admitted(self, trial: Vector) -> Vector:
        """The nearest forces that the laws admit, N: no pull, and no more friction than its bound."""
        count = len(self._near)
        admitted = trial.copy()
        np.maximum(trial[:count], 0.0, out=admitted[:count])
        if len(self._rubbing):
            across = admitted[count:].reshape(-1, 3)
            length = np.sqrt((across * across).sum(axis=1))
            across *= (self._most / np.maximum(length, self._most))[:, None]
        return admitted

    def _linear_laws(self, trial: Vector) -> tuple[Vector, Vector]:
        """The laws around ``trial``: the forces are the first result less the second (N/m) times the points' motion."""
        count = len(self._near)
        firm = self._kappa * (trial[:count] > 0.0)
        constant, rows = firm * self._constants[:count], firm[:, None] * self._G[:count]
        if len(self._rubbing) == 0:
            return constant, rows
        k, e, most, rho = self._k, self._e, self._most, self._weights[count::3]
        across = trial[count:].reshape(-1, 3)
        length = np.maximum(np.sqrt((across * across).sum(axis=1)), most)
        part = most / length
        slips = part < 1.0
        # where it slips, the force keeps its size and turns with the motion across it
        stiffness = np.where(slips, part * rho / (1.0 - part * (1.0 - rho / k)), k)
        along = across * (slips / length)[:, None]
        turned = e - (along * e).sum(axis=1)[:, None] * along
        blocks = self._across - along[:, :, None] * np.matmul(along[:, None, :], self._across)
        tangential = (most * slips)[:, None] * along - stiffness[:, None] * turned
        return (
            np.concatenate([constant, tangential.ravel()]),
            np.concatenate([rows, (stiffness[:, None, None] * blocks).reshape(-1, rows.shape[1])]),
        )
