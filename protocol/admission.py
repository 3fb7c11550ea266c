"""Whether a process that says hello belongs to this session: the checks of a handshake, and the words for a refusal.

Pure functions. A refusal is one sentence that says who refused whom, what was found, what would be right and
what to do; it is sent to the other side as it is, so that both ends tell the same story.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from manyhands.protocol.codec import ForeignHello, Malformed, Received
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    LinkHello,
    NodeHello,
    Refusal,
    RefusalCode,
    Role,
    presentable,
)


@dataclass(frozen=True, slots=True)
class Expected:
    """Who must be at the other end of a link: its name, its role, and the ports of the link in their order."""

    name: str
    role: Role
    ports: tuple[str, ...]


def check_link_hello(hello: LinkHello | ForeignHello, own: LinkHello, expects: Expected) -> Refusal | None:
    """The first thing that is wrong with a hello, from the most fundamental on; None if nothing is."""
    me, peer = own.name, expects.name
    if hello.version != own.version or isinstance(hello, ForeignHello):
        return _refuse_version(me, peer, hello.version, own.version)
    refusal = _check_session(me, peer, hello, own.certificate, own.session)
    if refusal is not None:
        return refusal
    if hello.name != expects.name:
        text = f"found {hello.name} at the other end; expected {expects.name}; see that endpoints are not swapped"
        return refuse(me, hello.name, RefusalCode.NAME, text)
    refusal = _check_role(me, peer, hello.role, expects.role)
    if refusal is not None:
        return refusal
    if hello.ports != expects.ports:
        text = (
            f"found the ports {_list(hello.ports)}; expected {_list(expects.ports)}; start both from one session file"
        )
        return refuse(me, peer, RefusalCode.PORTS, text)
    return _check_feedthrough(hello, own, expects)


def check_node_hello(
    hello: Received,
    certificate: str,
    session: str,
    expected: Mapping[str, Role],
    sender: str,
    binds: Collection[str] = (),
) -> Refusal | None:
    """The supervisor's answer to the first message of a node: None if it may join, otherwise why not.

    Args:
        hello: what the node's first frame turned out to be.
        certificate: id of the certificate the session runs under.
        session: name of the session.
        expected: the session's nodes (and observers) and their roles.
        sender: who sent it, as the transport knows it: by key, where there are keys.
        binds: the peers for which the sender binds a link, and must have an endpoint.
    """
    own = Role.SUPERVISOR.value
    match hello:
        case ForeignHello(version):
            return _refuse_version(own, "a node", version, PROTOCOL_VERSION)
        case NodeHello():
            pass
        case _:
            text = f"found {describe(hello)}; expected the hello of a node; see that nothing else connects here"
            return refuse(own, "a node", RefusalCode.MALFORMED, text)
    if hello.version != PROTOCOL_VERSION:
        return _refuse_version(own, hello.name, hello.version, PROTOCOL_VERSION)
    refusal = _check_session(own, hello.name, hello, certificate, session)
    if refusal is not None:
        return refusal
    if hello.name not in expected:
        text = f"found this name; expected one of {_list(tuple(expected))}; start it from the same session file"
        return refuse(own, hello.name, RefusalCode.NAME, text)
    if hello.name != sender:
        text = f"found the name {hello.name} from {sender}; expected its own; start it from its own bundle"
        return refuse(own, sender, RefusalCode.NAME, text)
    refusal = _check_role(own, hello.name, hello.role, expected[hello.name])
    if refusal is None and set(hello.endpoints) != set(binds):
        text = (
            f"found endpoints for {_list(sorted(hello.endpoints))}; expected them for {_list(sorted(binds))}; "
            "start it from the bundle of this session"
        )
        return refuse(own, hello.name, RefusalCode.ENDPOINTS, text)
    return refusal


def _check_session(me: str, peer: str, hello: LinkHello | NodeHello, certificate: str, session: str) -> Refusal | None:
    if hello.certificate != certificate:
        text = (
            f"found the certificate {hello.certificate}; expected {certificate}; "
            "start all nodes of the session from one certificate file"
        )
        return refuse(me, peer, RefusalCode.CERTIFICATE, text)
    if hello.session != session:
        text = f"found the session {hello.session}; expected {session}; see that no two share endpoints"
        return refuse(me, peer, RefusalCode.SESSION, text)
    return None


def _check_role(me: str, peer: str, found: Role, expected: Role) -> Refusal | None:
    if found is expected:
        return None
    text = f"found the role {found}; expected {expected}; start both from one session file"
    return refuse(me, peer, RefusalCode.ROLE, text)


def _check_feedthrough(hello: LinkHello, own: LinkHello, expects: Expected) -> Refusal | None:
    """D_V goes from a coupling to the environment, which solves the algebraic loop with it, and nowhere else."""
    rows = hello.feedthrough
    if own.role is not Role.ENVIRONMENT or hello.role is not Role.COUPLING:
        if rows is None:
            return None
        text = f"found a feedthrough for a {own.role}; expected none; only the environment may see it"
        return refuse(own.name, expects.name, RefusalCode.FEEDTHROUGH, text)
    size = len(expects.ports)
    if rows is not None and len(rows) == size and all(len(row) == size for row in rows):
        return None
    found = "none" if rows is None else f"rows of {_list([str(len(row)) for row in rows])}"
    text = f"found {found} as feedthrough; expected {size} x {size}; start both from one certificate file"
    return refuse(own.name, expects.name, RefusalCode.FEEDTHROUGH, text)


def _refuse_version(me: str, peer: str, found: int, expected: int) -> Refusal:
    text = f"found protocol version {found}; expected {expected}; install the same release of manyhands on both sides"
    return refuse(me, peer, RefusalCode.VERSION, text)


def refuse(me: str, peer: str, code: RefusalCode, text: str) -> Refusal:
    """The refusal of ``peer`` by ``me``; ``text`` says what was found, what would be right and what to do."""
    return Refusal(code, presentable(f"{me} refused {peer}: {text}"))


def describe(received: Received) -> str:
    """What was received, in a few words."""
    if isinstance(received, Malformed):
        return f"a malformed frame ({received.reason})"
    return f"a {type(received).__name__}"


def _list(names: Sequence[str]) -> str:
    """A few names, and how many more."""
    shown = ", ".join(names[:8]) or "none"
    return shown if len(names) <= 8 else f"{shown} and {len(names) - 8} more"
