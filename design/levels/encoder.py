"""What a certificate claims about the steps of the devices' encoders (:mod:`manyhands.design.quantisation`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class EncoderClaim:
    """What a certificate claims about the steps of the encoders.

    Attributes:
        force: w, by port, N: the greatest force that the steps add; None where the certificate bounds nothing.
        covered: whether the devices' dry friction is at least w at every port, so that quantised samples are covered.
    """

    force: tuple[float, ...] | None
    covered: bool

    def describe(self) -> dict[str, Any]:
        """As plain data, which :func:`encoder_of` reads."""
        return {"force": None if self.force is None else list(self.force), "covered": self.covered}


def encoder_of(data: Mapping[str, Any], ports: int) -> EncoderClaim:
    """What :meth:`EncoderClaim.describe` wrote, for so many ports.

    Raises:
        KeyError, TypeError, ValueError: a key is missing or unknown, or its value has the wrong type or size.
    """
    if set(data) != {"force", "covered"} or not isinstance(data["covered"], bool):
        raise ValueError(f"encoder: found {sorted(data)}; expected force, and covered, which is true or false")
    force = None if data["force"] is None else tuple(map(float, data["force"]))
    if force is not None and len(force) != ports:
        raise ValueError(f"encoder.force: found {len(force)} numbers; expected one for each of {ports} ports")
    return EncoderClaim(force, data["covered"])
