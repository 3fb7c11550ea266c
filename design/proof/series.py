"""What a certificate counts of the world's own compliance in series with the coupling, and the loop that is left.

**Of a network** it is a part of a link.
Let one spring and damper k + b s, s = (z-1)/(Tz), join port i to an end that is no port: z_i. With f_i the force that
the world exerts on the port, and x_i the port's displacement,

    f_i = -(k + b s)(x_i - z_i),    so that    x_i - z_i = -[p/(k + b s) + (1 - p)/(k + b s)] f_i,    0 < p < 1.

Let x_i' = x_i + p/(k + b s) f_i. Then f_i = -(k + b s)/(1 - p) (x_i' - z_i), and with x = x_device + W f and
C = diag(p_i/(k_i + b_i s))

    x' = x_device + (W + C) f,        f = -E' x',

with E' the same world in which the links of port i are stiffer by 1/(1 - p_i). Devices and forces are the same. So the
pair (W, E) is the pair (V, E') with V = W + C, and a certificate states V, the p_i, and E. E' is a network with
stiffness and damping >= 0, whatever the p_i are. Every statement about the loop's stability is about (V, E'), every
statement about transparency about (W, E).

Links in parallel to one end add up, and are stiffer by the same factor. Of a link that is known up to an interval, both
ends are: the network in the interval is E' for some world in the stated interval.

**Of a state space, or of rational functions,** it is a plain spring at each port, C = diag(c_i). With f = -E x and
x' = x + C f,

    f = -E' x',        E' = E (I - C E)^-1,        E'(1) = E1 (I - C E1)^-1,

and with E = (A, B, C_E, D) and N = (I - D C)^-1

    E' = (A + B C N C_E,  B (I + C N D),  N C_E,  N D).

The pair (W, E) is the pair (V, E') for every C. That E' can be in a stable loop is for its storage matrix to prove, and
for E'(1) = E'(1)' >= 0, which is decided in rationals.
"""

from __future__ import annotations

from dataclasses import replace

from flint import arb_mat, fmpq, fmpq_mat

from manyhands.design.proof import exact, rational
from manyhands.design.proof.claim import (
    Claim,
    LinkData,
    NetworkData,
    Span,
    StiffenedData,
    SystemData,
    TransferData,
)
from manyhands.design.proof.exact import exact_decimal
from manyhands.design.proof.finding import Finding
from manyhands.design.proof.system import Realisation


def finding(claim: Claim) -> Finding:
    """Whether it is the world's: each p_i between 0 and 1, of a port that meets one end that is no port by springs of
    its own; or each c_i > 0.
    """
    condition = "what is counted in series is the world's own"
    if isinstance(claim.environment, SystemData | TransferData) and not claim.environment.delay:
        smallest = min(claim.series.values())
        fault = "" if smallest > 0 else "a compliance is not greater than 0"
        return Finding(condition, not fault, rational.rounded(smallest), 0.0, argument=fault or "exactly: compared")
    fault = _fault(claim)
    least = min((rational.rounded(1 - part) for part in claim.series.values()), default=0.0)
    return Finding(condition, not fault, least if not fault else -1.0, 0.0, argument=fault or "exactly: compared")


def _fault(claim: Claim) -> str:
    """Why the parts cannot be counted; empty if they can."""
    network = claim.environment
    if not isinstance(network, NetworkData) or network.delay:
        return "the environment is no network, state space or matrix of rational functions without delay"
    links = _links_of(network)
    for port, part in claim.series.items():
        name = claim.ports[port]
        if not 0 < part < 1:
            return f"the part of {name} is not between 0 and 1"
        own = links.get(port, [])
        ends = {end for link in own for end in link.ends if end != port}
        if len(ends) != 1:
            return f"the links of {name} lead to {len(ends)} ends, and not to one"
        (end,) = ends
        if end is not None and end < network.ports:
            return f"the link of {name} leads to another port"
        if not any(exact_decimal(link.stiffness[0]) > 0 for link in own):
            return f"the link of {name} has no stiffness"
        if any(arm != 1 for link in own for arm in link.arms):
            return f"the link of {name} has a lever arm"
    return ""


def _links_of(network: NetworkData) -> dict[int | None, list[LinkData]]:
    """The links at every end."""
    out: dict[int | None, list[LinkData]] = {}
    for link in network.links:
        for end in link.ends:
            out.setdefault(end, []).append(link)
    return out


def cut(claim: Claim) -> Claim:
    """The claim about (V, E') alone, given that :func:`finding` holds."""
    network = claim.environment
    if claim.series and isinstance(network, SystemData | TransferData):
        return replace(claim, environment=StiffenedData(network, _compliance(claim)), series={})
    if not claim.series or not isinstance(network, NetworkData):
        return claim
    factors = {port: 1 / (1 - part) for port, part in claim.series.items()}

    def stiffened(link: LinkData) -> LinkData:
        factor = next((factors[end] for end in link.ends if end in factors), None)
        if factor is None:
            return link
        low_k, high_k, low_b, high_b = (exact_decimal(end) * factor for end in (*link.stiffness, *link.damping))
        return LinkData(link.ends, (low_k, high_k), (low_b, high_b), link.arms)

    return replace(claim, environment=replace(network, links=tuple(map(stiffened, network.links))), series={})


def _compliance(claim: Claim) -> fmpq_mat:
    """diag(c_i) of a state space or of rational functions, m x m, m/N."""
    return exact.dense({(port, port): c for port, c in claim.series.items()}, range(len(claim.ports)))


def counted(claim: Claim) -> Realisation:
    """C in balls, m x m.

    Of a network it has one state for each port where something is counted, in the order of the ports. A port's state is
    that of a spring-damper block (K + B s)^-1 with K = k/p and B = b/p; of an interval, the middle.

    Raises:
        ZeroDivisionError: a link has neither stiffness nor damping.
    """
    m, ports, T = len(claim.ports), sorted(claim.series), claim.period
    network = claim.environment
    if not isinstance(network, NetworkData):
        return arb_mat(0, 0), arb_mat(0, m), arb_mat(m, 0), arb_mat(_compliance(claim))
    n, links = len(ports), _links_of(network)
    A, B, C, D = arb_mat(n, n), arb_mat(n, m), arb_mat(m, n), arb_mat(m, m)
    for at, port in enumerate(ports):
        own, part = links[port], claim.series[port]
        k = sum((_middle(link.stiffness) for link in own), fmpq(0)) / part
        b = sum((_middle(link.damping) for link in own), fmpq(0)) / part
        compliance = 1 / (T * k + b)
        A[at, at] = b * compliance
        B[at, port] = T * b * compliance
        C[port, at] = compliance
        D[port, port] = T * compliance
    return A, B, C, D


def _middle(span: Span) -> fmpq:
    return (exact_decimal(span[0]) + exact_decimal(span[1])) / 2
