"""What exact and ball arithmetic cost, in operations on words of 64 bits: about as many as a slow core does in a ns.

The formulas are upper bounds by the algorithms of FLINT, with constants measured on one core of a shared machine and
rounded up. They decide two things: which of two methods of proof is tried first, and whether a proof is begun at all
(:mod:`manyhands.design.proof.work`). They decide nothing about what holds.

With n rows and numbers of b bits:

- the characteristic polynomial of a matrix of whole numbers is found modulo n b/60 primes, each for n^3 + n^2 b/64;
- an exact solution by Dixon's lifting has 2 n b/60 digits, each for n^2 b/64 and for every column; an inverse has n
  columns;
- a product of two matrices of balls takes n^3 operations, each of some words, and n^2 conversions.
"""

from __future__ import annotations

_WORD = 64
_PRIME = 60  # bits of a prime, or of a digit of the lifting
_CHARPOLY = 6.0
_SOLVE = 25.0
_ENTRY = 3_000.0  # an entry that Python handles, reads or converts

QUICK = 200
"""Rows up to which balls are tried at a second, longer precision."""

STEPS = {128: 3, 384: 5}
"""By precision in bits: the factorisations after which a proof of definiteness in balls gives up. Each gains about 13
digits of condition, and no more digits can be gained than the precision has."""

MOST_EXACT = 2e9
"""Operations that the exact proof of one matrix may take where balls do not decide."""

EXACT_FIRST = 5e6
"""Operations up to which the exact proof is tried first: it decides equality as well."""


def charpoly(n: int, bits: float) -> float:
    """A characteristic polynomial of n x n whole numbers."""
    primes = 1.0 + n * bits / _PRIME
    return n * n * _ENTRY + _CHARPOLY * primes * (n**3 + n**2 * bits / _WORD)


def solution(n: int, columns: int, bits: float) -> float:
    """An exact solution of n equations for some right-hand sides, in rationals."""
    digits = 1.0 + 2.0 * n * bits / _PRIME
    return n * (n + columns) * _ENTRY + _SOLVE * digits * n * n * (1.0 + bits / _WORD) * max(columns, 1)


def product(n: int, precision: int) -> float:
    """A product of two n x n matrices of balls."""
    words = 1.0 if precision <= 128 else 1.9
    return n * n * 300.0 + words * n**3 * (8.0 + 1_600.0 / (n + 50))


def precisions(n: int) -> tuple[int, ...]:
    """The precisions at which balls of this order are tried, in bits."""
    first, second = STEPS
    return (first, second) if n <= QUICK else (first,)


def in_balls(n: int, products: float = 0.0) -> float:
    """A proof in balls that an n x n matrix is positive definite, at every precision that may be tried.

    Args:
        n: rows.
        products: further products of n x n matrices at each precision, to build it.
    """
    each = sum((3 * STEPS[p] - 1 + products) * product(n, p) for p in precisions(n))
    return each + len(precisions(n)) * (2.0 * n * n * _ENTRY + 15.0 * n**3)


def definiteness(n: int, bits: float) -> float:
    """A proof that an n x n matrix of rationals over a common denominator is definite: in balls, exactly, or both."""
    if n <= 1:
        return 2.0 * _ENTRY + 10.0 * bits
    exact = charpoly(n, bits)
    return exact if exact <= EXACT_FIRST else min(exact, MOST_EXACT) + in_balls(n)


def numbers(count: float) -> float:
    """Reading so many numbers, and adding them into sparse matrices, a few times each."""
    return 5.0 * _ENTRY * count
