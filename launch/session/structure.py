"""How devices and coupling blocks hang together, and every name in them.

A name that leads nowhere is only visible over the whole session; :func:`structure_problems` finds all of them at
once, so that an author sees how many places are left to mend.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Final, Literal, Self, TypeAlias

from pydantic import BeforeValidator, Field, model_validator

from manyhands.launch.session.environment import GROUND
from manyhands.launch.session.error import one_of, show
from manyhands.launch.session.fields import Items, Problem, SessionModel, optional, refuse
from manyhands.launch.session.limits import MAX_DEVICES, MAX_PORTS

ENVIRONMENT: Final = "environment"
"""The name of the one node that is the environment."""

SUPERVISOR: Final = "supervisor"
"""The name of the process that starts, watches and ends a session."""

RESERVED: Final = (ENVIRONMENT, SUPERVISOR, GROUND)
"""Names that no device, coupling or observer may take: other processes of a session, and the fixed end of links."""

PortsOf: TypeAlias = Mapping[str, tuple[str, ...]]
"""The ports of each device, or of each coupling, in order."""


def _word(value: object) -> str:
    if not isinstance(value, str):
        raise refuse(show(value), "a name there")
    return value


_DEVICES: Final = Items("device names", MAX_DEVICES, _word)
_PORTS: Final = Items("port names", MAX_PORTS, _word)


class CouplingBlock(SessionModel):
    """One block of V, run as one process: the devices that it couples, or the ports."""

    devices: Annotated[tuple[str, ...] | None, BeforeValidator(optional(_DEVICES))] = Field(
        default=None, description="the devices of which it couples every port"
    )
    ports: Annotated[tuple[str, ...] | None, BeforeValidator(optional(_PORTS))] = Field(
        default=None, description="the ports that it couples"
    )

    @model_validator(mode="after")
    def _devices_or_ports(self) -> Self:
        if (self.devices is None) == (self.ports is None):
            found = "neither devices nor ports" if self.ports is None else "both devices and ports"
            raise refuse(found, "one of the two: devices: [...] or ports: [...]")
        return self


def structure_problems(devices: PortsOf, couplings: Mapping[str, CouplingBlock]) -> Iterator[Problem]:
    """Everything that is wrong with the names of devices and couplings; ``devices`` gives the ports of each."""
    ports = tuple(port for own in devices.values() for port in own)
    if len(ports) > MAX_PORTS:
        yield Problem(("devices",), f"{len(ports)} ports", f"at most {MAX_PORTS}")
    yield from _name_problems(devices, couplings)
    yield from _coupling_problems(devices, ports, couplings)


def _name_problems(devices: PortsOf, couplings: Mapping[str, CouplingBlock]) -> Iterator[Problem]:
    for kind, names in (("devices", devices), ("couplings", couplings)):
        for name in names:
            if name in RESERVED:
                yield Problem((kind, name), f"the reserved name {name!r}", f"a name other than {', '.join(RESERVED)}")
    for name in couplings:
        if name in devices:
            yield Problem(("couplings", name), f"the name {name!r} of a device", "a name that no device has")


def _coupling_problems(
    devices: PortsOf, ports: tuple[str, ...], couplings: Mapping[str, CouplingBlock]
) -> Iterator[Problem]:
    owner: dict[str, str] = {}
    dangling = False
    valid = frozenset(ports)
    for name, block in couplings.items():
        kind: Literal["devices", "ports"] = "devices" if block.devices is not None else "ports"
        known = devices if kind == "devices" else valid
        for index, entry in enumerate(block.devices or block.ports or ()):
            place = ("couplings", name, kind, index)
            if entry not in known:
                dangling = True
                names = devices if kind == "devices" else ports
                yield Problem(place, f"the unknown {kind[:-1]} {show(entry)}", one_of(names, entry))
                continue
            for port in devices[entry] if kind == "devices" else (entry,):
                if port in owner:
                    also = "this coupling" if owner[port] == name else f"the coupling {owner[port]!r}"
                    yield Problem(
                        place, f"the port {port!r}, which is also in {also}", "each port in one coupling, once"
                    )
                owner.setdefault(port, name)
    for port in ports:
        if port not in owner and not dangling:  # a port without a coupling is often a misspelt entry's consequence
            yield Problem(("couplings",), f"no coupling for the port {port!r}", "every port in exactly one coupling")


def ports_of_block(block: CouplingBlock, devices: PortsOf) -> tuple[str, ...]:
    """The ports of a coupling, in the order in which it lists them or their devices."""
    if block.ports is not None:
        return block.ports
    return tuple(port for device in block.devices or () for port in devices[device])
