"""The limits of everything that a session file may hold, in one place.

A session file may come from an untrusted author. These limits bound the memory and time that reading it takes.
"""

from typing import Final

# the text
MAX_FILE_BYTES: Final = 1 << 23
MAX_DEPTH: Final = 32
MAX_NODES: Final = 300_000
"""Keys, items and values after every alias is expanded."""
MAX_OVERRIDES: Final = 100
MAX_OVERRIDE_CHARACTERS: Final = 1 << 16

# the structure
MAX_DEVICES: Final = 1024
MAX_DOF: Final = 32
MAX_PORTS: Final = 2048
MOST_BUTTONS: Final = 16
"""Of one device."""
MOST_BUTTONS_IN_ALL: Final = 64
"""Of a session: each may change five times in a telemetry of the environment, which has room for these events."""
MOST_HOLDS: Final = 32
"""Of a scene, by buttons."""
MOST_SPANS: Final = 1000
"""Times at which a button of a simulated device is held down."""
MAX_COUPLINGS: Final = 1024
MAX_OBSERVERS: Final = 32
MAX_READS: Final = 4096
"""Channels that one observer reads."""
MAX_MASSES: Final = 4096
MAX_LINKS: Final = 16_384
MAX_BODIES: Final = 32
MAX_MODEL_BYTES: Final = 1 << 20
"""An engine's model file: it is part of every bundle and recording."""
MAX_ASSETS: Final = 32
MAX_ASSET_BYTES: Final = 1 << 22
"""The files of an engine's model together: in base64, with its text, they fit into the session that a run keeps."""
MAX_MESH_BYTES: Final = 1 << 25
"""A mesh file: 50,000 triangles are 13 MB of text in an STL file."""
MAX_ORDER: Final = 256
"""States of one coupling block."""
MAX_PORT_ORDER: Final = 16
"""States of a linear coupling for each of its ports."""
MAX_POLES: Final = MAX_PORT_ORDER // 2
MAX_RUNGS: Final = 8
"""Delays of a ladder, besides the design's own."""
MAX_ENVIRONMENT_ORDER: Final = 512
"""States of an environment given by matrices; the sum of all entries' degrees of one given by rational functions."""
MAX_DELAY: Final = 16
"""Whole ticks by which an environment may be late."""
MAX_ITERATIONS: Final = 10_000
MAX_FACTORY_NAME: Final = 200
"""Characters in the name of a model's factory."""

MAX_PROBLEMS: Final = 200
"""Unknown or repeated names that are reported for one file; each is compared with every valid name."""

# numbers
MAX_MAGNITUDE: Final = 1e12
MIN_POSITIVE: Final = 1e-12
"""Smallest value of a quantity that must be greater than 0: dividing by it stays well inside double precision."""
MAX_STIFFNESS: Final = 1e8
"""The greatest stiffness of a spring to a proxy, N/m: beyond it the deflections are near the rounding of positions."""

MAX_DEGREE: Final = 16
MAX_COEFFICIENT: Final = 1e24
SHORTEST_PERIOD: Final = 1e-5
LONGEST_PERIOD: Final = 0.1

# what a device may exert and reach where its session states no limits: far above any hand-held device
DEFAULT_FORCE: Final = 1000.0
"""N; N·m on a rotational axis."""
DEFAULT_DISPLACEMENT: Final = 10.0
"""m; rad on a rotational axis."""
DEFAULT_SPEED: Final = 100.0
"""m/s; rad/s on a rotational axis."""
HAND_FORCE: Final = 50.0
"""N; N·m on a rotational axis. The most by which a hand speeds a device up, where a session states nothing: above what
the joints of a finger can control, and below a shoulder's [Tan1994]_."""
HAND_POWER: Final = 40.0
"""W; the most that a hand puts into others, where a session states nothing: 20 N at 2 m/s."""
HAND_ENERGY: Final = 100.0
"""J; the most that a hand puts into others at once, or stores in the world: its 20 N over 5 m of strokes."""
HAND_STORE: Final = 10.0
"""J; the most that a hand may store and give back while it only yields: 2 kg at 3 m/s, or 500 N/m bent by 0.2 m."""

# faults
MAX_RESTARTS: Final = 100
DEFAULT_RESTARTS: Final = 3
LONGEST_WINDOW: Final = 86_400.0
"""s."""
DEFAULT_WINDOW: Final = 60.0
"""s."""
DEFAULT_TANK: Final = 5e-3
"""J; a device of Example 1 may then be pushed with 2 N for 7 ms after its force should have ended."""
DEFAULT_TANK_POWER: Final = 1e-3
"""W; see docs/decisions/0030-lateness-in-joules.md for what a machine spends, and what a hand can feel."""
LARGEST_TANK: Final = 10.0
"""J; 1 kg at 4.5 m/s."""
LARGEST_TANK_POWER: Final = 1.0
"""W."""

# wave links
LONGEST_INTERVAL: Final = 0.01
"""s; an end that hears nothing for 0.03 s holds the tool, and two lost waves in a row are ordinary on their way."""
LONGEST_ROUND_TRIP: Final = 10.0
"""s."""
MAX_DEPTH_TICKS: Final = 10_000
"""Ticks for which a wave is kept before it is played."""
DEFAULT_WAVE_TANK: Final = 5e-3
"""J; with packets up to 3.5 ms late, a play-out two ticks deep does not creep with it."""

# recorded traces
MAX_TRACE_BYTES: Final = 1 << 26
MAX_TRACE_ROWS: Final = 1_000_000
MAX_TRACE_LINE: Final = 200
MAX_MOTION_NUMBERS: Final = 200_000
"""Times and positions of all recorded motions of a session; they must fit into the session file that a run keeps."""

# each intended motion and force is evaluated at this many times when the file is read
PROBE_COUNT: Final = 600
PROBE_SECONDS: Final = 60.0
