"""The channel table is complete and meets the theory's requirements."""

import pytest

from manyhands.protocol.channels import CHANNELS, Rate
from manyhands.protocol.codec import LAYOUTS
from manyhands.protocol.messages import Condition, Force, Observation, Reaction, Role, Sample, Tool


def test_every_message_has_a_channel_and_every_channel_a_message() -> None:
    assert {message for channel in CHANNELS.values() for message in channel.messages} == set(LAYOUTS)
    assert all(name == channel.name and channel.messages for name, channel in CHANNELS.items())


@pytest.mark.parametrize(
    ("name", "message", "sender", "receiver", "symbol", "unit"),
    [
        ("sample", Sample, Role.DEVICE, Role.COUPLING, "x", "m"),
        ("tool", Tool, Role.COUPLING, Role.ENVIRONMENT, "p", "m"),
        ("reaction", Reaction, Role.ENVIRONMENT, Role.COUPLING, "f_v", "N"),
        ("force", Force, Role.COUPLING, Role.DEVICE, "f_v", "N"),
    ],
)
def test_signals_go_where_theory_sends_them(
    name: str, message: type, sender: Role, receiver: Role, symbol: str, unit: str
) -> None:
    channel = CHANNELS[name]
    assert (channel.messages, channel.senders, channel.receivers) == ((message,), (sender,), (receiver,))
    assert (channel.symbol, channel.unit, channel.rate) == (symbol, unit, Rate.EVERY_TICK)


def test_the_environment_never_sees_a_sample_nor_a_device_a_tool() -> None:
    seen = {role: {c.name for c in CHANNELS.values() if role in c.receivers} for role in Role}
    assert "sample" not in seen[Role.ENVIRONMENT]
    assert not {"tool", "reaction"} & seen[Role.DEVICE]


def test_an_observer_writes_to_nobody_and_reads_observations_alone() -> None:
    assert {c.name for c in CHANNELS.values() if Role.OBSERVER in c.senders} == {"control"}  # to join
    assert {c.name for c in CHANNELS.values() if Role.OBSERVER in c.receivers} == {"control", "observation"}
    assert CHANNELS["observation"].senders == (Role.SUPERVISOR,)
    assert CHANNELS["observation"].messages == (Observation, Condition)


def test_a_hand_writes_to_devices_alone_and_reads_nothing() -> None:
    assert {c.name for c in CHANNELS.values() if Role.HAND in c.senders} == {"grip"}
    assert not {c.name for c in CHANNELS.values() if Role.HAND in c.receivers}
    assert CHANNELS["grip"].receivers == (Role.DEVICE,)
