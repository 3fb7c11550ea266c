"""Figures for tests: of plain numbers, and any that a party may send."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hypothesis import strategies as st

from manyhands.protocol.messages import Figures


def as_figures(figures: Mapping[str, float]) -> Figures:
    """Figures of plain numbers; what are figures already stay as they are."""
    return figures if isinstance(figures, Figures) else Figures(figures)


def drawn_figures(
    numbers: Sequence[str], tables: Mapping[str, Sequence[str]], values: st.SearchStrategy[float]
) -> st.SearchStrategy[Figures]:
    """Figures with some of these numbers, and tables with some of these keys."""
    of_tables = {name: st.dictionaries(st.sampled_from(keys), values, max_size=3) for name, keys in tables.items()}
    return st.builds(
        Figures,
        st.dictionaries(st.sampled_from(numbers), values, max_size=8),
        st.fixed_dictionaries({}, optional=of_tables),
    )
