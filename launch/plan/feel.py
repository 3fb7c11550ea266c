"""What a user feels of a thing behind a coupling, and over which network.

A thing behind a coupling is two springs in series (:func:`softened`).

A coupling of K and a contact of k give way together, and are felt as K k/(K + k). Where K is far below k, the contact's
own stiffness makes no difference any more: the coupling is the limit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from manyhands.design.certificate import Certificate
from manyhands.design.models.axis import Units
from manyhands.design.models.statespace import symmetric_part
from manyhands.launch.session import Session
from manyhands.nodes.kernel.bundle import SIMULATED
from manyhands.nodes.kernel.words import counted

FAR_SOFTER: Final = 0.1
"""A coupling of less than this part of its contact's stiffness is far softer: less than an eleventh of it is felt."""


@dataclass(frozen=True)
class Softened:
    """A thing that is felt far softer than it is.

    Attributes:
        port: where it is felt.
        contact: its stiffness, k in N/m.
        coupling: of the coupling there, K in N/m.
        units: of the port.
    """

    port: str
    contact: float
    coupling: float
    units: Units

    @property
    def felt(self) -> float:
        """K k/(K + k), N/m."""
        return self.coupling * self.contact / (self.coupling + self.contact)

    @property
    def sentence(self) -> str:
        """What is felt, and why."""
        unit = self.units("N/m")
        return (
            f"{self.port}: a contact of {self.contact:g} {unit} will feel like {self.felt:.3g} {unit}: "
            "the coupling is the limit"
        )


def softened(session: Session, certificates: Iterable[Certificate]) -> list[Softened]:
    """The ports at which the hardest thing is felt far softer than it is, the worst first.

    Args:
        session: the session.
        certificates: of its parts.
    """
    hardest = session.environment.hardest(session.ports)
    found = []
    for certificate in certificates:
        for port, K in zip(certificate.loop.ports, np.diag(certificate.stiffness).tolist(), strict=True):
            if FAR_SOFTER * hardest.get(port, 0.0) > K:
                found.append(Softened(port, hardest[port], K, session.units(port)))
    return sorted(found, key=lambda one: one.felt / one.contact)


def stiffness_range(certificate: Certificate) -> tuple[float, float] | None:
    """The least and the greatest static stiffness of the blocks of V over all directions, N/m; None without any."""
    if certificate.spring_damper is not None:
        found = np.linalg.eigvalsh(certificate.stiffness)
    else:
        try:
            static = [block.response(1.0).real for block in certificate.blocks]
        except np.linalg.LinAlgError:  # a pole at z = 1: no static stiffness
            return None
        compliance = np.concatenate([np.linalg.eigvalsh(symmetric_part(V)) for V in static])
        found = 1.0 / compliance[compliance > 0.0]
    return (float(found.min()), float(found.max())) if found.size else None


def feel_lines(session: Session, certificates: Iterable[Certificate]) -> list[str]:
    """One line about the port at which most is lost, with the number of the others; none where nothing is."""
    found = softened(session, certificates)
    if not found:
        return []
    others = f" (and {counted(len(found) - 1, 'more port')})" if len(found) > 1 else ""
    return [f"{session.name}: {found[0].sentence}{others}"]


def person_lines(session: Session) -> list[str]:
    """One line for each device whose hand is a person's at a browser, and so rests in a simulation."""
    return [
        f"{name}: nobody is at the browser in a simulation, and its hand rests; launch the session for a person, or "
        "give it driver: simulated and a hand"
        for name, device in session.devices.items()
        if device.driver == "browser"
    ]


def network_lines(session: Session, clock: str) -> list[str]:
    """One line for each wave link whose stated network is not that of a run by this clock."""
    lines = []
    for name, link in session.wave_links.items():
        if clock == SIMULATED and link.network is None and link.round_trip is not None:
            lines.append(
                f"{name}: a round trip of {1e3 * link.round_trip:.4g} ms is stated, and no network is simulated: a "
                f"wave arrives in its tick; --delay {500.0 * link.round_trip:.4g}ms simulates one"
            )
        elif clock != SIMULATED and link.network is not None:
            lines.append(
                f"{name}: its network is simulated under the {SIMULATED} clock alone; this run has the real one"
            )
    return lines
