"""No honest party is named as broken for what a hostile one does, and the cause is named; by a fixed set of seeds.

Other seeds, by the hundred: ``python -m tests.deterministic.blame``.
"""

from __future__ import annotations

from .blame import Hostility, hostility, named, run


def test_who_is_moved_by_a_guest_beyond_its_budget_is_not_named() -> None:
    """A guest claimed 1e6 J and moved by 30 m: the last line named the honest seat, and said to raise its limits."""
    found = run(Hostility(1, ("energy", "waves"), 30.0, 1.0, 1e6, 0, linked=True), 1300)
    assert found.wrong == ()
    assert "left" not in found.last.partition(";")[0]
    assert "Raise the limits" not in found.last


def test_two_hostile_parties_of_any_kind_blame_nobody() -> None:
    for seed in (100005, 100011):
        assert run(hostility(seed), 1000).wrong == ()


def test_what_the_judge_takes_for_blame() -> None:
    assert named("worst: force limits: broken by right_seat since 0.6 s (3 ticks), and by left_seat. Raise") == {
        "left_seat"
    }
    assert named("at 0.6 s: left_seat (left) was beyond its energy budget, and was stopped") == {"left_seat"}
    assert named("at 0.6 s: left was beyond its limits; another party moved it: of others 1 J from right_seat") == set()
    assert named("at 0.6 s: right was beyond its limits; nobody else has moved it") == set()
