"""What a session does about its faults: how often a node is started anew, and what follows when a loop is too slow.

Neither changes what is certified. A restart is bounded, so that what cannot run does not keep the others busy with
its beginnings; a breach is an assumption of the certificate that a device has measured not to hold.
"""

from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

from manyhands.launch.session.fields import Choice, Quantity, SessionModel, Whole
from manyhands.launch.session.limits import DEFAULT_RESTARTS, DEFAULT_WINDOW, LONGEST_WINDOW, MAX_RESTARTS, MIN_POSITIVE

_RESTARTS: Final = Whole("restarts", 0, MAX_RESTARTS)
_WINDOW: Final = Quantity("a window", "s", above=0.0, most=LONGEST_WINDOW, smallest=MIN_POSITIVE)
_BREACHES: Final = ("warn", "soften", "stop")


class Faults(SessionModel):
    """What follows the death of a process, and the breach of an assumption."""

    restarts: Annotated[int, BeforeValidator(_RESTARTS)] = Field(
        default=DEFAULT_RESTARTS, description="how often a node that dies is started anew; 0 ends the session"
    )
    window: Annotated[float, BeforeValidator(_WINDOW)] = Field(
        default=DEFAULT_WINDOW, description="after how long a run, in s, a node's earlier deaths no longer count"
    )
    breach: Annotated[Literal["warn", "soften", "stop"], BeforeValidator(Choice(_BREACHES))] = Field(
        default="soften", description="what follows a delay longer than the certificate's: warn, soften or stop"
    )
