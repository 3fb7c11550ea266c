"""The tools that hands turn: the world's part of the law of :mod:`manyhands.nodes.kernel.orientation`.

In an engine such a tool is an avatar that can turn freely about a point. A chordal spring joins it to its hand: before
each step the avatar is turned by

    -t(R, A) = 2 k D_w D_v,     D = R A*,

with R the hand's orientation of the tick and A the avatar's before the step, and it turns in whatever way the engine
finds. Where it is after the step is the proxy that the hand is proposed. The hand tests the proposal itself, so nothing
is assumed of the engine here. An avatar whose hand is not there feels no torque, and nothing is proposed to that hand.

**Hands that feel nothing.** A hand whose orientation is sensed leads its avatar by the same spring, and no torque acts
on it. What it states of deposits is energy that nobody put in, so it has no account here: nothing is taken from it, and
nothing granted to it. All other hands are as safe from its avatar as from any other body of the engine.

**What is granted.** The bank grants a hand what its account lacks for the whole step. Its account is at the hand, so a
copy of its spring is kept here. A hand deposits at once what it does not need, so its account is always D - G: what it
deposits corrects the copy in every tick, and only the proxy of a hand that missed an answer is guessed. No claim rests
on the copy: it decides alone how much of the bank's energy a hand is offered, and that is never more than the bank has.
To grant more where the proxy is not known was tried, and starves the other hands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import OrientedTool
from manyhands.nodes.kernel.orientation import (
    NO_RIDER,
    RIDER,
    UPRIGHT,
    OrientationBank,
    OrientationSpring,
    Quaternion,
    is_life,
    torque,
    total,
    unit,
)
from manyhands.nodes.kernel.timeouts import STALE_TICKS


class _Tool:
    """One tool: what was heard of its hand, and what that is told."""

    def __init__(self, of: OrientedTool) -> None:
        self.of = of
        # a copy of the hand's; a sensed one has none
        self.spring = None if of.torque is None else OrientationSpring(of.stiffness, of.torque)
        self.R: Quaternion | None = None
        self.life, self.known, self.lives = 0.0, 0.0, 0  # of this tick, the last that was one, and how many there were
        self.away = 0  # ticks in a row in which nothing came
        self.heard: Sequence[float] = NO_RIDER
        self.told: Sequence[float] = NO_RIDER


class OrientedTools:
    """All tools that hands turn, in the order in which their numbers ride with the signals.

    Attributes:
        bank: what hands have given, and what proxies may have.
    """

    def __init__(self, tools: Sequence[OrientedTool], asked: AskedModel) -> None:
        """Ask an engine, whose avatars stand upright, about ``tools``."""
        self._tools, self._asked = [_Tool(of) for of in tools], asked
        self._at = [UPRIGHT] * len(tools)  # of the avatars, after the last step
        self.bank = bank_of(tools)

    def hear(self, riders: Sequence[float], tick: int) -> None:
        """Take what came with the signals of ``tick``, and turn the avatars by their springs in the engine's next step.

        Args:
            riders: :data:`RIDER` numbers for each tool; zeros where nothing came.
            tick: k.
        """
        torques = np.zeros(3 * len(self._tools))
        for i, (tool, at) in enumerate(zip(self._tools, self._at, strict=True)):
            numbers = riders[RIDER * i : RIDER * (i + 1)]
            deposited, life = total(numbers[4]), numbers[5]
            R = unit(numbers[:4]) if is_life(life) else None  # no answer could be for a hand without a life
            if R is not None:
                anew = life != tool.known
                tool.known, tool.lives = life, tool.lives + anew
                if tool.spring is not None:
                    self._account(tool, tool.spring, deposited, tick)
                    if anew or tool.away > STALE_TICKS:  # it has let go meanwhile
                        tool.spring.proxy = R
            tool.R, tool.life = R, life
            tool.away = 0 if R is not None else tool.away + 1
            tool.heard = NO_RIDER if R is None else (*numbers[:4], deposited, float(tool.lives))
            if R is not None:
                torques[3 * i : 3 * i + 3] = [-t for t in torque(tool.of.stiffness, R, at)]
        self._asked.turn(torques)

    def _account(self, tool: _Tool, copy: OrientationSpring, deposited: float, tick: int) -> None:
        """Take in what the hand has deposited, J; its account is D - G."""
        self.bank.deposit(tool.of.device, deposited, tool.known, tick)
        copy.deposited, copy.granted = deposited, self.bank.granted[tool.of.device]
        copy.account = copy.deposited - copy.granted

    def answer(self) -> Floats:
        """What rides with the forces of the tick, after the engine's step."""
        self._at = self._asked.avatars(len(self._tools))
        told: Floats = []
        for tool, at in zip(self._tools, self._at, strict=True):
            if tool.R is None:
                tool.told = NO_RIDER
            elif tool.spring is None:
                tool.told = (*at, 0.0, tool.life)
            else:
                device = tool.of.device
                granted = self.bank.grant(device, tool.spring.lacks(tool.R, at))
                tool.spring.turn(tool.R, at, granted)
                tool.told = (*at, granted, tool.life)
            told += tool.told
        return told

    @property
    def width(self) -> int:
        """How many numbers ride with the signals of all ports."""
        return RIDER * len(self._tools)

    @property
    def heard(self) -> Floats:
        """By tool, what was heard of its hand in the last tick: orientation, deposits, and which of its lives."""
        return [number for tool in self._tools for number in tool.heard]

    @property
    def told(self) -> Floats:
        """By tool, what its hand was told: proxy and grants; zeros for nothing."""
        return [number for tool in self._tools for number in tool.told[: RIDER - 1]]


def bank_of(tools: Sequence[OrientedTool]) -> OrientationBank:
    """The bank of a world: with an account for each hand that feels a torque, and none for one that is sensed."""
    power = {tool.device: tool.power for tool in tools if tool.power is not None}
    return OrientationBank(tuple(power), power=power)
