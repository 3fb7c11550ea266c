"""The sampled-data loop of a session in one process: the cores of the nodes without their processes.

It starts from the same bundles and takes the same steps in the same order as the processes do, so that a
run of the processes under the simulated clock has the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manyhands.launch.bundles import Run, cut
from manyhands.launch.preparation import Prepared
from manyhands.launch.recording import Recording
from manyhands.launch.topology import ENVIRONMENT
from manyhands.nodes.bundle import SIMULATED, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.guard import Guard, LimitExceeded
from manyhands.nodes.device.simulated import simulated_driver
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.ledger import Ledger

_PROGRESS_TICKS = 1000


class Simulation:
    """A session's cores, wired directly.

    Attributes:
        devices: the devices' cores by name.
        guards: what watches over the devices' limits, by name.
        couplings: the blocks' cores by name.
        ledgers: every party's energy ledger by node; parties that promised nothing are absent.
    """

    def __init__(self, prepared: Prepared) -> None:
        """Everything at rest at tick 0."""
        session = prepared.session
        self._session, self._id = session, prepared.id
        bundles = cut(prepared, Run(SIMULATED, None, "", traces=True))
        index = {port: i for i, port in enumerate(session.ports)}
        T, m = session.period, len(session.ports)
        self._drivers, self._device_ports = [], []
        self._coupling_ports = []
        self.devices: dict[str, DeviceCore] = {}
        self.guards: dict[str, Guard] = {}
        self.couplings: dict[str, CouplingCore] = {}
        self.ledgers: dict[str, Ledger] = {}
        D_V = np.zeros((m, m))
        environment: EnvironmentBundle | None = None
        for name, bundle in bundles.items():
            ports = np.array([index[port] for port in bundle.common.ports])
            match bundle:
                case DeviceBundle():
                    device = DeviceCore(bundle.level, bundle.K, T)
                    self._drivers.append(simulated_driver(bundle))
                    self._device_ports.append(ports)
                    self.devices[name] = device
                    self.guards[name] = Guard(bundle.limits, T, bundle.common.ports)
                    self.ledgers[name] = device.ledger
                case CouplingBundle():
                    coupling = CouplingCore(bundle.block, bundle.K, bundle.level, T, bundle.limits.force)
                    self.couplings[name] = coupling
                    self._coupling_ports.append(ports)
                    D_V[np.ix_(ports, ports)] = bundle.block.D
                    if coupling.ledger is not None:
                        self.ledgers[name] = coupling.ledger
                case EnvironmentBundle():
                    environment = bundle
        if environment is None:
            raise AssertionError("every session has an environment")
        self._environment = EnvironmentCore(environment.E, D_V, environment.Phi_E, T)
        if self._environment.ledger is not None:
            self.ledgers[ENVIRONMENT] = self._environment.ledger

    def run(self, ticks: int, progress: Callable[[int], None] | None = None) -> Recording:
        """Run ``ticks`` ticks; ``progress`` is told now and then how many are done.

        Raises:
            LimitExceeded: a device went beyond its displacement or its speed, which would end a session.
        """
        m = len(self._session.ports)
        x, f_v = np.zeros((ticks, m)), np.zeros((ticks, m))
        p = np.zeros(m)
        devices = list(zip(self._drivers, self.devices.values(), self.guards.values(), self._device_ports, strict=True))
        couplings = list(zip(self.couplings.values(), self._coupling_ports, strict=True))
        for k in range(ticks):
            for (driver, device, guard, ports), name in zip(devices, self.devices, strict=True):
                displacement = driver.sample(k)
                breach = guard.breach(displacement)
                if breach is not None:
                    raise LimitExceeded(f"{name}, {k * self._session.period:.6g} s after the start: {breach}")
                device.sample(displacement)
                x[k, ports] = displacement
            for coupling, ports in couplings:
                p[ports] = coupling.free_position(x[k, ports])
            f_v[k] = self._environment.react(p)
            self._environment.settle()
            for coupling, ports in couplings:
                f_v[k, ports] = applied = coupling.limited(f_v[k, ports])
                coupling.absorb(applied)
            for driver, device, guard, ports in devices:
                f_v[k, ports] = force = guard.clip(f_v[k, ports])
                driver.apply(force)
                driver.idle()
                device.apply(force, driver.intended_work())
            if progress is not None and (k + 1) % _PROGRESS_TICKS == 0:
                progress(k + 1)
        return Recording(self._session.name, self._id, self._session.period, self._session.ports, x, f_v)
