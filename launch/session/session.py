"""A session: devices, couplings, environment and design, as one validated and frozen object.

The session file is the one place where the structure of a session is written, so the structure is derived here,
once: :attr:`Session.ports`, :attr:`Session.blocks` and :meth:`Session.osp_level` are what the LMIs, the
processes, the sockets and the keys all start from. Values arrive normalised (what was one number for all axes
is a tuple by axis), and a ``Session`` that exists satisfies everything that docs/session-file.md asks for.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from manyhands.launch.session.design import Design
from manyhands.launch.session.device import Device
from manyhands.launch.session.environment import Environment, environment_of_its_type
from manyhands.launch.session.error import listed
from manyhands.launch.session.faults import Faults
from manyhands.launch.session.fields import (
    Flag,
    NamedParts,
    Period,
    Problem,
    SessionModel,
    SessionName,
    part_name,
    refusal,
)
from manyhands.launch.session.given import full_matrix
from manyhands.launch.session.limits import MAX_COUPLINGS, MAX_DEVICES, MAX_OBSERVERS, MAX_PROBLEMS
from manyhands.launch.session.matrices import Array
from manyhands.launch.session.motion import motion_problems, with_own_names
from manyhands.launch.session.observers import Observer, observer_problems
from manyhands.launch.session.problems import first_error, nulls_in, problems_in
from manyhands.launch.session.source import apply_overrides, read_tree
from manyhands.launch.session.structure import ENVIRONMENT, CouplingBlock, ports_of_block, structure_problems
from manyhands.protocol.messages import Role

_BEGUN_BY_OVERRIDES: Final = frozenset(
    {("design", "weights"), ("design", "weights", "W1"), ("design", "weights", "W2"), ("faults",)}
)
"""Optional parts: an override of a key in them may begin them."""


class Session(SessionModel):
    """A whole session."""

    name: SessionName = Field(alias="session", description="the session's name")
    period: Period = Field(description="the length T of a tick in s")
    devices: Annotated[
        dict[str, Device],
        BeforeValidator(with_own_names),
        BeforeValidator(NamedParts(part_name("a device name"), MAX_DEVICES)),
    ] = Field(description="the devices by name")
    couplings: Annotated[
        dict[str, CouplingBlock], BeforeValidator(NamedParts(part_name("a coupling name"), MAX_COUPLINGS))
    ] = Field(description="the blocks of the virtual coupling V by name")
    environment: Annotated[Environment, BeforeValidator(environment_of_its_type)] = Field(
        description="the virtual environment"
    )
    design: Design = Field(description="what the coupling is, or how it is found")
    observers: Annotated[
        dict[str, Observer], BeforeValidator(NamedParts(part_name("an observer name"), MAX_OBSERVERS, least=0))
    ] = Field(default={}, description="who may look on, by name, and at what")
    colocate: Flag = Field(default=False, description="whether each coupling runs in its device's process")
    faults: Faults = Field(default=Faults(), description="what follows deaths of processes and breaches of delay")

    @model_validator(mode="after")
    def _hangs_together(self) -> Self:
        device_ports = {name: device.ports(name) for name, device in self.devices.items()}
        problems = list(islice(structure_problems(device_ports, self.couplings), MAX_PROBLEMS))
        for problem in islice(self.environment.problems(self.ports), MAX_PROBLEMS):
            problems.append(problem._replace(at=("environment", *problem.at)))
        problems += islice(observer_problems(self.observers, self.roles), MAX_PROBLEMS)
        motions = {name: (d.trace, d.limits) for name, d in self.devices.items() if d.trace is not None}
        problems += islice(motion_problems(motions, self.period), MAX_PROBLEMS)
        if not problems and self.colocate:
            problems += islice(self._not_to_be_colocated(), MAX_PROBLEMS)
        if not problems:
            found = self.design.problems(self.ports, self.blocks_by_name, self.period)
            for problem in islice(found, MAX_PROBLEMS):
                problems.append(problem._replace(at=("design", *problem.at)))
        if problems:
            raise refusal(*problems)
        return self

    @cached_property
    def ports(self) -> tuple[str, ...]:
        """The m ports, in the order of devices, then of axes: the order of x, p and f_v."""
        return tuple(port for name in self.devices for port in self.ports_of(name))

    @cached_property
    def roles(self) -> Mapping[str, Role]:
        """Every node's name and role: devices first, then couplings, then the environment."""
        return {
            **dict.fromkeys(self.devices, Role.DEVICE),
            **dict.fromkeys(self.couplings, Role.COUPLING),
            ENVIRONMENT: Role.ENVIRONMENT,
        }

    def _not_to_be_colocated(self) -> Iterator[Problem]:
        """A coupling of several devices sees the motion of all: it is in the process of none of them."""
        for name in self.couplings:
            if len(self.devices_of(name)) > 1:
                found = f"true, with the coupling {name!r} of the devices {listed(self.devices_of(name))}"
                yield Problem(("colocate",), found, "couplings of one device each, or false")

    def devices_of(self, coupling: str) -> tuple[str, ...]:
        """The devices that have a port in a coupling, in the session's order."""
        own = set(self.blocks_by_name[coupling])
        return tuple(device for device in self.devices if own & set(self.ports_of(device)))

    @cached_property
    def carriers(self) -> Mapping[str, str]:
        """Of each coupling that runs in a device's process, the device."""
        return {name: self.devices_of(name)[0] for name in self.couplings} if self.colocate else {}

    @cached_property
    def blocks_by_name(self) -> Mapping[str, tuple[str, ...]]:
        """The ports of each coupling."""
        device_ports = {name: device.ports(name) for name, device in self.devices.items()}
        return {name: ports_of_block(block, device_ports) for name, block in self.couplings.items()}

    @property
    def blocks(self) -> tuple[tuple[str, ...], ...]:
        """The ports of each coupling, in the order of the couplings: the block structure of V."""
        return tuple(self.blocks_by_name.values())

    def ports_of(self, device: str) -> tuple[str, ...]:
        """The ports of a device, in the order of its axes."""
        return self.devices[device].ports(device)

    def osp_level(self, device: str) -> Array:
        """Delta_D of a device, m_i x m_i, in N·s/m: the lower end, where the session gives an interval."""
        return np.array(self.devices[device].osp_low, dtype=np.float64)

    @property
    def orders(self) -> tuple[int, ...]:
        """States of a linear coupling for each port, by block in the order of the couplings; 0 without one."""
        return tuple(self.design.order_of(name) for name in self.couplings)

    @property
    def given_stiffness(self) -> Array | None:
        """The given K, m x m in the order of :attr:`ports`, in N/m; ``None`` unless a stiffness is given."""
        return None if self.design.stiffness is None else full_matrix(self.design.stiffness, len(self.ports))

    @property
    def given_damping(self) -> Array | None:
        """The given B, m x m in N·s/m: 0 where a stiffness is given alone, ``None`` where neither is."""
        if self.design.stiffness is None:
            return None
        return full_matrix(self.design.damping or 0.0, len(self.ports))

    def as_plain(self) -> dict[str, Any]:
        """The session as plain data in the form of a session file; read back, it is the same session."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)


def load_session(path: Path, overrides: Sequence[str] = ()) -> Session:
    """Read and check a session file.

    Args:
        path: the file.
        overrides: ``KEY.PATH=VALUE`` each, checked like the file itself.

    Raises:
        SessionError: whatever is wrong with either, told by the first problem in the order of the file.
    """
    tree = apply_overrides(read_tree(path), overrides, _BEGUN_BY_OVERRIDES)
    problems: list[Problem] = []
    session: Session | None = None
    try:
        session = Session.model_validate(tree.data, context={"folder": path.parent})
    except ValidationError as error:
        problems += problems_in(error, Session)
    reported = {tree.locate(problem.at)[0] for problem in problems}
    problems += [problem for problem in nulls_in(tree.data) if problem.at not in reported]
    if session is None or problems:
        raise first_error(tree, problems)
    return session
