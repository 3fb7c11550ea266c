"""Bundles of devices in their own time, for tests of a loop that meets delays for which nothing is certified."""

from __future__ import annotations

from dataclasses import replace

from manyhands.nodes.bundle import OWN, Bundle, DeviceBundle


def in_own_time(bundle: Bundle) -> Bundle:
    """The bundle, of a device that moves by one period a tick: its ledger holds however late the tick is."""
    return replace(bundle, time=OWN) if isinstance(bundle, DeviceBundle) else bundle
