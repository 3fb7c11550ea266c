"""What another pair of poles buys: the level of Example 2 against the order of its couplings.

    python examples/order_curve.py                     # the whole table; about three minutes
    python examples/order_curve.py --orders 0 1 2      # its beginning; under a minute
    python examples/order_curve.py --series            # with the world's own springs counted in series

Each entry is a design of its own, loop shaping (24) with so many states for each port, and each is certified: the
level printed is proved, and the table's figure is an upper bound that a coupling reached. The search is local, so a
better coupling of the same order may exist. Fewer states than asked for are used where more gain nothing. A coupling so
near the edge that it cannot be proved is not in the table, however low its level.
"""

import argparse
import sys
import time

from manyhands.design.errors import DesignError
from manyhands.design.problem import LinearWanted, Wish
from manyhands.design.synthesis import design
from manyhands.launch.plan.loop import coupling_request, haptic_loop
from manyhands.launch.session.shipped import load_named

ORDERS = (0, 1, 2, 4, 6)
ONE_BLOCK = "couplings={c: {devices: [dx, dy, dz]}}"  # in place of the session's cx, cy, cz


def cells(order: int, centralised: bool, series: bool) -> str:
    """The certified level gamma with ``order`` states a port, and the seconds it took, as two cells of the table."""
    changes = [*([ONE_BLOCK] if centralised else []), *(["design.series=true"] if series else [])]
    session = load_named("example2-linear", changes)
    loop, asked = haptic_loop(session), coupling_request(session)
    if not isinstance(asked, LinearWanted):
        raise TypeError(f"expected a session that asks for a linear coupling, found {asked}")
    wanted = LinearWanted((order,) * len(loop.partition.blocks), Wish("loop-shaping", asked.wish.aim))
    started = time.perf_counter()
    try:
        claim = design(loop, wanted).certificate.transparency
    except DesignError as error:
        print(f"order {order}: {error}", file=sys.stderr)
        claim = None
    gamma = "not certified" if claim is None else f"{claim.gamma:.3f}"
    return f"{gamma} | {time.perf_counter() - started:.0f}"


def main() -> None:
    """Print the table, a row as soon as it is there."""
    parser = argparse.ArgumentParser(description="gamma of Example 2 against the order of its couplings")
    parser.add_argument("--orders", type=int, nargs="+", default=ORDERS, help="states for each port")
    parser.add_argument("--series", action="store_true", help="count the world's own springs in series")
    given = parser.parse_args()
    states = "states a port, in series" if given.series else "states a port"
    print(f"| {states} | a block each | seconds | one block for all | seconds |")
    print("|---|---|---|---|---|")
    for order in given.orders:
        one_each, one = (cells(order, centralised, given.series) for centralised in (False, True))
        print(f"| {order} | {one_each} | {one} |", flush=True)


if __name__ == "__main__":
    main()
