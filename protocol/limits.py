"""The limits of everything that crosses a process border, in one place.

A process checks the size of incoming data before it allocates memory for them. The limits are generous for a session
and small for a machine. The sender checks them as well, so a frame that the other side would drop is an error at the
sender. SPEC.md states the limits, and a test compares the two.
"""

from typing import Final

MAX_CONTROL_BYTES: Final = 1024 * 1024
"""Longest frame of any kind, bytes.

A hello with the feedthrough of :data:`MAX_PORTS` ports needs about 0.6 MiB, so sockets must admit this size. A gate
admits no more than the signals of its link need.
"""

MAX_PORTS: Final = 256
"""Most ports that one link carries (those of one device in one coupling block, or of one block)."""

MAX_BUTTONS: Final = 32
"""Most buttons of the devices of one coupling, and so of one link: their state is one unsigned integer."""

MAX_NAME: Final = 96
"""Longest name of a node, port, session or figure, and longest certificate id, characters."""

MAX_TEXT: Final = 4096
"""Longest text written for a person (the reason of a refusal, of a stop, of a fault), characters."""

MAX_ENDPOINT: Final = 256
"""Longest transport endpoint, characters."""

MAX_ENTRIES: Final = 2048
"""Most entries of one mapping (endpoints, figures, counts, traces)."""

MAX_SENTENCES: Final = 128
"""Most sentences of one kind, and most promises, in a Condition."""

MAX_BY_ITSELF: Final = 8
"""Most sentences of one source, a driver or a session, about what a device does by itself."""

MAX_SENTENCE: Final = 200
"""Longest of these sentences, characters: those of a session and of its driver have room in the remark of a promise."""

MAX_CONTAINERS: Final = 5000
"""Most arrays and maps in one frame: an empty one needs a hundred times its length. A report of all maps needs 4100."""

MAX_TRACE_SIDE: Final = MAX_CONTROL_BYTES // 8
"""Most rows, and most columns, of one trace; the frame's length bounds their product."""

MAX_COUNT: Final = 2**63 - 1
"""Greatest tick, stamp, epoch and count: what a signed 64-bit integer holds."""

MAX_VERSION: Final = 2**31 - 1
"""Greatest protocol version that can be named."""

MAX_RUNG: Final = 15
"""Greatest rung of a ladder of couplings."""

MAX_PID: Final = 2**31 - 1
"""Greatest process id."""

MAX_ROUND_TRIP: Final = 60
"""Longest round trip of a wave link that an Echo tells, s."""

MAX_PART_BYTES: Final = 16 * 1024 * 1024
"""Longest part of a session that a guest fetches, bytes: two bundles, one with a recorded motion of minutes."""

MAX_PIECE_BYTES: Final = 64 * 1024
"""Longest piece of it in one frame, bytes: HUB_INBOX_FRAMES of them may wait for one guest."""

MAX_DATAGRAM_BYTES: Final = 1200
"""Longest datagram, bytes: with its heads it fits into 1280, the least MTU of IPv6, so that no path cuts it up."""

MAX_SOCKET_PATH: Final = 107
"""Longest path of a Unix-domain socket, bytes: ``sun_path`` holds 108 with its closing zero."""

LINK_QUEUE_FRAMES: Final = 256
"""Frames that wait in one direction of a link (a quarter of a second at 1 kHz) before ``send`` declines.

ZeroMQ updates its count of frames that were read only now and then, so room is sure for half as many.
"""

HUB_QUEUE_FRAMES: Final = 1000
"""The same limit at a node towards the supervisor, which reads more slowly."""

HUB_INBOX_FRAMES: Final = 64
"""The same limit at the hub for one member: a hub may have thousands of members, and a frame may have a mebibyte."""

SEND_ONLY_BYTES: Final = 1024
"""Longest frame that a send-only end takes, bytes: room for the handshake. Such an end reads none, and keeps one."""

MAX_STRAY_FRAMES: Final = 512
"""Frames that a loop reads from one link without admitting one, while it waits for the signal of one tick.

This is twice the length of a link's queue; it takes a millisecond or two to read as many. A peer that sends more is no
part of the session any more, and the node ends rather than read on. Repeats of a signal may be more after a long wait
(:mod:`manyhands.nodes.link.repeats`).
"""

LINGER_MS: Final = 500
"""The longest wait of a closing transport for frames that are on their way, such as a refusal, ms."""

CONNECT_MS: Final = 4000
"""The longest time that a host may take to accept a connection, ms: a firewall that drops what it does not want answers
never, and the kernel alone would ask for two minutes. TCP has asked three times by then."""

HANDSHAKE_MS: Final = 5000
"""The longest time of a connection to prove its key, after which it is closed, ms."""

DOOR_BURST: Final = 64
"""Connections opened at a door within a tenth of a second, beyond those it is meant for, before it is shut."""

DOOR_FAILURES: Final = 16
"""Handshakes in a second that may fail for their key before a door is shut: each costs some tenths of a ms."""

DOOR_SHUT_MS: Final = 1000
"""How long a door stays shut, ms: the kernel then drops new connections, and existing connections go on."""

HUB_FRAMES_PER_S: Final = 200
"""Frames a second that a hub reads beyond what its members need; the rest wait in their senders' queues."""

HEARTBEAT_MS: Final = 1000
"""The time between two checks of each end of a hub's TCP connection that the other end is there, ms."""

SILENCE_MS: Final = 3000
"""The time without an answer after which such a connection counts as lost, ms."""
