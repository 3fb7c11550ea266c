"""cvxpy, imported when a program is first written: it takes a second, and many designs need no program at all.

The levels of scalar spring-dampers, and programs that are handed to the solver as numbers
(:class:`manyhands.design.solver.LinearMatrixProgram`), do without it. So ``from manyhands.design import convex as cp``
stands where ``import cvxpy as cp`` would.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    import cvxpy

    return getattr(cvxpy, name)
