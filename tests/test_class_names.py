"""A name of a class has one meaning in the whole product."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import manyhands

from .support.rooms import ROOMS

PRODUCT = Path(manyhands.__file__).parent
DECLARED_AND_MADE = {"Hand", "StateSpaceEnvironment"}  # of one name in a session file, and as what is made of it


def test_no_two_classes_of_the_product_have_one_name() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    for room in {*ROOMS} - {"devices"}:  # a driver's package has names of its own, as a stranger's has
        for path in (PRODUCT / room).rglob("*.py"):
            for statement in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(statement, ast.ClassDef):
                    homes[statement.name].append(str(path.relative_to(PRODUCT)))
    doubled = {name: paths for name, paths in homes.items() if len(paths) > 1}
    assert doubled.keys() == DECLARED_AND_MADE, doubled
