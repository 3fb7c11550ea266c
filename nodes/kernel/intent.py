"""The intent of a simulated hand: a force or a motion as a pure function of time.

A session file gives it as a number, as a formula in ``t`` or as a recorded trace; :func:`intent_from` turns each into a
callable. All three are deterministic, so two runs of a session have the same intent.

A formula comes from outside, so it is never given to ``eval``. :class:`Formula` checks its syntax tree against a short
list of what is allowed, and turns it into nested closures over ``float``. All is evaluated in double precision, so no
input can grow an integer without bound. A result that is not a finite number is an error that names the time; it never
becomes a force.
"""

import ast
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

MAX_FORMULA_LENGTH: Final = 500
MAX_FORMULA_DEPTH: Final = 40
MAX_EXPONENT: Final = 100.0

ALLOWED: Final = (
    "a formula of numbers, t (s), pi, + - * / **, comparisons, and/or/not, 'a if c else b', "
    "sin cos tan exp sqrt abs min max floor, step(x) and pulse(t, a, b)"
)

Evaluate: TypeAlias = Callable[[float], float]


class FormulaError(ValueError):
    """A formula that is not allowed, or has no finite value at some time.

    Attributes:
        text: the formula.
        problem: what is wrong, without the formula.
        position: the character where, counted from 1; None for an error of the evaluation.
    """

    def __init__(self, text: str, problem: str, position: int | None = None) -> None:
        self.text = text
        self.problem = problem
        self.position = position
        shown = text if len(text) <= 80 else text[:77] + "..."
        where = "" if position is None else f" at position {position}"
        super().__init__(f"formula {shown!r}: {problem}{where}; allowed is {ALLOWED}")


def _step(x: float) -> float:
    return 1.0 if x >= 0.0 else 0.0


def _pulse(t: float, a: float, b: float) -> float:
    return 1.0 if a <= t < b else 0.0


# name -> (function, fewest arguments, most arguments)
_FUNCTIONS: Final[Mapping[str, tuple[Callable[..., float], int, int]]] = {
    "sin": (math.sin, 1, 1),
    "cos": (math.cos, 1, 1),
    "tan": (math.tan, 1, 1),
    "exp": (math.exp, 1, 1),
    "sqrt": (math.sqrt, 1, 1),
    "abs": (math.fabs, 1, 1),
    "floor": (math.floor, 1, 1),
    "min": (min, 2, 16),
    "max": (max, 2, 16),
    "step": (_step, 1, 1),
    "pulse": (_pulse, 3, 3),
}

# math.pow, unlike **, stays in the reals: (-1)**0.5 is an error there and not a complex number
_OPERATORS: Final[Mapping[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: math.pow,
}

_COMPARISONS: Final[Mapping[type[ast.cmpop], Callable[[float, float], bool]]] = {
    ast.Lt: lambda a, b: a < b,
    ast.LtE: lambda a, b: a <= b,
    ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b,
    ast.Eq: lambda a, b: a == b,
    ast.NotEq: lambda a, b: a != b,
}


class Formula:
    """A formula in ``t`` (s), which is checked when it is made; a call evaluates it.

    Comparisons and ``and``/``or``/``not`` give 1 or 0; ``a if c else b`` evaluates only the branch that it takes.
    ``step(x)`` is 1 for x >= 0, ``pulse(t, a, b)`` is 1 for a <= t < b, and both are 0 otherwise.

    Raises:
        FormulaError: at construction, for anything that is not allowed; in a call, for a value that is not a finite
            number.
    """

    __slots__ = ("_evaluate", "text")

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > MAX_FORMULA_LENGTH:
            raise FormulaError(text, f"{len(text)} characters, more than {MAX_FORMULA_LENGTH}")
        self._evaluate = _Compiler(text).compile()

    def __call__(self, t: float) -> float:
        """The value at time ``t`` (s)."""
        try:
            value = float(self._evaluate(t))
        except ZeroDivisionError:
            raise FormulaError(self.text, f"division by zero at t = {t!r} s") from None
        except OverflowError:
            raise FormulaError(self.text, f"a number too large at t = {t!r} s") from None
        except ValueError:
            raise FormulaError(self.text, f"no real value at t = {t!r} s") from None
        if not math.isfinite(value):
            raise FormulaError(self.text, f"no finite value at t = {t!r} s")
        return value

    def __repr__(self) -> str:
        return f"Formula({self.text!r})"


class _Compiler:
    """Turns the text of one formula into nested closures, and refuses everything that is not on the list."""

    def __init__(self, text: str) -> None:
        self.text = text
        line = "".join(" " if c.isspace() else c for c in text)
        for index, character in enumerate(line):
            if not (character.isascii() and character.isprintable()):
                raise FormulaError(text, f"the character {character!r}", index + 1)
        # ast counts columns from the first character that is not blank
        self.indent = len(line) - len(line.lstrip())
        self.line = line.strip()

    def compile(self) -> Evaluate:
        if not self.line:
            raise FormulaError(self.text, "no formula")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # "1if t else 2" is only a warning to Python; here it is refused
                tree = ast.parse(self.line, mode="eval")
        except SyntaxError as error:
            column = self.indent + (error.offset or 1)
            raise FormulaError(self.text, f"not a formula ({error.msg})", column) from None
        except (RecursionError, MemoryError):
            raise FormulaError(self.text, f"nested more than {MAX_FORMULA_DEPTH} deep") from None
        return self._build(tree.body, 1)

    def _refuse(self, node: ast.expr, problem: str) -> FormulaError:
        return FormulaError(self.text, problem, self.indent + node.col_offset + 1)

    def _build(self, node: ast.expr, depth: int) -> Evaluate:
        if depth > MAX_FORMULA_DEPTH:
            raise self._refuse(node, f"nested more than {MAX_FORMULA_DEPTH} deep")
        match node:
            case ast.Constant():
                return self._constant(node)
            case ast.Name(id="t"):
                return lambda t: t
            case ast.Name(id="pi"):
                return lambda t: math.pi
            case ast.Name(id=name):
                raise self._refuse(node, f"the unknown name {name!r}")
            case ast.BinOp():
                return self._binary(node, depth)
            case ast.UnaryOp():
                return self._unary(node, depth)
            case ast.Compare():
                return self._compare(node, depth)
            case ast.BoolOp():
                return self._logic(node, depth)
            case ast.IfExp():
                return self._choice(node, depth)
            case ast.Call():
                return self._call(node, depth)
            case _:
                raise self._refuse(node, f"{type(node).__name__.lower()} is not allowed")

    def _constant(self, node: ast.Constant) -> Evaluate:
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._refuse(node, f"{value!r} is not a real number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self._refuse(node, "a number too large")
        return lambda t: number

    def _binary(self, node: ast.BinOp, depth: int) -> Evaluate:
        operate = _OPERATORS.get(type(node.op))
        if operate is None:
            raise self._refuse(node, f"the operator {type(node.op).__name__.lower()} is not allowed")
        left, right = self._build(node.left, depth + 1), self._build(node.right, depth + 1)
        if isinstance(node.op, ast.Pow) and _literal_size(node.right) > MAX_EXPONENT:
            raise self._refuse(node.right, f"an exponent beyond {MAX_EXPONENT:g}")
        return lambda t: operate(left(t), right(t))

    def _unary(self, node: ast.UnaryOp, depth: int) -> Evaluate:
        operand = self._build(node.operand, depth + 1)
        match node.op:
            case ast.USub():
                return lambda t: -operand(t)
            case ast.UAdd():
                return operand
            case ast.Not():
                return lambda t: 0.0 if operand(t) else 1.0
            case _:
                raise self._refuse(node, f"the operator {type(node.op).__name__.lower()} is not allowed")

    def _compare(self, node: ast.Compare, depth: int) -> Evaluate:
        tests = []
        for operator in node.ops:
            test = _COMPARISONS.get(type(operator))
            if test is None:
                raise self._refuse(node, f"the comparison {type(operator).__name__.lower()} is not allowed")
            tests.append(test)
        terms = [self._build(term, depth + 1) for term in (node.left, *node.comparators)]

        def evaluate(t: float) -> float:
            left = terms[0](t)
            for test, term in zip(tests, terms[1:], strict=True):
                right = term(t)
                if not test(left, right):
                    return 0.0
                left = right
            return 1.0

        return evaluate

    def _logic(self, node: ast.BoolOp, depth: int) -> Evaluate:
        terms = [self._build(term, depth + 1) for term in node.values]
        if isinstance(node.op, ast.And):
            return lambda t: 1.0 if all(term(t) for term in terms) else 0.0
        return lambda t: 1.0 if any(term(t) for term in terms) else 0.0

    def _choice(self, node: ast.IfExp, depth: int) -> Evaluate:
        test, then, otherwise = (self._build(part, depth + 1) for part in (node.test, node.body, node.orelse))
        return lambda t: then(t) if test(t) else otherwise(t)

    def _call(self, node: ast.Call, depth: int) -> Evaluate:
        if not isinstance(node.func, ast.Name) or node.func.id not in _FUNCTIONS:
            raise self._refuse(node, f"the unknown function {ast.unparse(node.func)!r}")
        function, fewest, most = _FUNCTIONS[node.func.id]
        if node.keywords or not fewest <= len(node.args) <= most:
            count = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise self._refuse(node, f"{node.func.id} takes {count} plain arguments")
        arguments = [self._build(argument, depth + 1) for argument in node.args]
        if len(arguments) == 1:
            only = arguments[0]
            return lambda t: function(only(t))
        return lambda t: function(*[argument(t) for argument in arguments])


def _literal_size(node: ast.expr) -> float:
    """The absolute value of a number in the formula, whatever its signs; 0 for anything but a plain number."""
    while isinstance(node, ast.UnaryOp):
        node = node.operand
    return abs(float(node.value)) if isinstance(node, ast.Constant) and isinstance(node.value, int | float) else 0.0


MAX_TRACE_SAMPLES: Final = 1_000_000

Intent: TypeAlias = Callable[[float], float]
IntentData: TypeAlias = float | str | Mapping[str, Sequence[float]]


class IntentError(ValueError):
    """A number or a recorded trace that cannot be an intent; the message gives the reason."""


class SampledSignal:
    """A recorded signal: linear between its samples, and its last value afterwards.

    Args:
        times: sample times (s), strictly increasing from 0; at most ``MAX_TRACE_SAMPLES``.
        values: the signal at those times, one value for each.

    Raises:
        IntentError: there are no samples or too many, the lengths differ, a number is not finite, or the times do not
            increase strictly from 0. The message counts samples from 1.
    """

    __slots__ = ("_times", "_values")

    def __init__(self, times: Sequence[float], values: Sequence[float]) -> None:
        if not 1 <= len(times) <= MAX_TRACE_SAMPLES:
            raise IntentError(f"{len(times)} samples; expected 1 to {MAX_TRACE_SAMPLES}")
        if len(times) != len(values):
            raise IntentError(f"{len(times)} times and {len(values)} values; expected as many of both")
        self._times = np.array(times, dtype=np.float64)
        self._values = np.array(values, dtype=np.float64)
        unusable = np.flatnonzero(~(np.isfinite(self._times) & np.isfinite(self._values)))
        if unusable.size:
            raise IntentError(f"sample {unusable[0] + 1} is not finite; expected finite numbers")
        if self._times[0] != 0.0:
            raise IntentError(f"the first time is {self._times[0]:g} s; expected 0")
        stalled = np.flatnonzero(np.diff(self._times) <= 0.0)
        if stalled.size:
            i = int(stalled[0]) + 1
            before, after = self._times[i - 1], self._times[i]
            raise IntentError(f"sample {i + 1} is at {after:g} s, after {before:g} s; expected increasing times")

    def __call__(self, t: float) -> float:
        """The value at time ``t`` (s); for t < 0 the first value."""
        return float(np.interp(t, self._times, self._values))


class Constant:
    """An intent that does not change."""

    __slots__ = ("value",)

    def __init__(self, value: float) -> None:
        if not math.isfinite(value):
            raise IntentError(f"the number {value!r} is not finite")
        self.value = float(value)

    def __call__(self, t: float) -> float:
        """The value, whatever ``t`` is."""
        return self.value


def intent_from(data: IntentData) -> Intent:
    """The intent that a session writes as a number, a formula, or ``{"times": [...], "values": [...]}``.

    Raises:
        FormulaError: the formula is not allowed.
        IntentError: the data is of another form, or its numbers are unusable.
    """
    match data:
        case bool():
            pass  # a number to Python, but no intent
        case int() | float():
            return Constant(float(data))
        case str():
            return Formula(data)
        case Mapping() if set(data) == {"times", "values"}:
            return SampledSignal(data["times"], data["values"])
        case _:
            pass  # refused below
    raise IntentError(
        f"{type(data).__name__} is no intent; expected a number, a formula or a trace of times and values"
    )
