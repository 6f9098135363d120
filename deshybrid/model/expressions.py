"""Arithmetic and conditions as written in a model file: text to tree.  Nothing is ever evaluated as Python.

In: the text of one value.  Out: a tree whose nodes know which characters they were written with.  The grammar, from
loose to tight:

    condition:   a | b    a & b    !a    (condition)    comparison chain  a <= b < c   (also >= > ==, and || &&)
    arithmetic:  a + b    a - b    a * b    a / b    -a    +a    a ** b (from the right)    (a)    f(a, b)
    leaves:      1.5e-3   a name   pi    and in pole positions only an imaginary number, 2j

Recursive descent, one token ahead, at most 50 levels deep and 2,000 characters long.  Cost: linear in the text.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

LONGEST_TEXT = 2_000
_DEEPEST = 50
IMAGINARY = "1j"  # the name of the imaginary unit in a parsed pole; no name of a model file can be written so


class ExpressionError(Exception):
    """A mistake in an expression, at `text[start:end]`; whoever knows the file turns it into a `Diagnostic`."""

    def __init__(
        self, code: str, message: str, start: int, end: int, *, label: str = "", helps: tuple[str, ...] = ()
    ) -> None:
        self.code, self.message, self.label, self.helps = code, message, label, helps
        self.start, self.end = start, end
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Number:
    """A number as written."""

    value: float
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Name:
    """A parameter, a state, an input, or `pi`."""

    text: str
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Call:
    """A function of the arguments, for example `sqrt(2)`."""

    function: str
    arguments: tuple["Expression", ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Minus:
    """The negative of an operand."""

    operand: "Expression"
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Power:
    """`base ** exponent`."""

    base: "Expression"
    exponent: "Expression"
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Chain:
    """Operands joined from the left: `first`, then (operator, operand) for `+ -` or for `* /`, never mixed."""

    first: "Expression"
    rest: tuple[tuple[str, "Expression"], ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Comparison:
    """`operands[0] relations[0] operands[1] ...`; all links hold."""

    operands: tuple["Expression", ...]
    relations: tuple[str, ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Junction:
    """Conditions joined by `&` or by `|`."""

    operator: str
    parts: tuple["Expression", ...]
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Negation:
    """`!part`."""

    part: "Expression"
    start: int
    end: int


Expression: TypeAlias = Number | Name | Call | Minus | Power | Chain | Comparison | Junction | Negation


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str  # "number", "imaginary", "name", "symbol", "end"
    text: str
    start: int
    end: int


_TOKEN = re.compile(
    r"\s*(?:(?P<imaginary>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?j(?!\w))"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[^\W\d]\w*)"
    r"|(?P<symbol>\*\*|<=|>=|==|!=|&&|\|\||[-+*/()<>=&|!,^])"
    r"|(?P<end>\Z))"
)
_ADVICE = {
    "^": "write `**` for a power",
    "=": "write `==` to compare",
    "!=": "write `!(a == b)`",
    "and": "write `&`",
    "or": "write `|`",
    "not": "write `!`",
}
_CUT = "close the parenthesis; an expression that holds a comma must be quoted"


def parse_arithmetic(text: str) -> Expression:
    """Return the tree of an arithmetic expression.

    Raises `ExpressionError`: DH0121 (syntax), DH0105 (longer than 2,000 characters or too deep).

    >>> parse_arithmetic("k/tau").rest[0][1].text
    'tau'
    """
    return _Parser(text).whole(conditions=False)


def parse_condition(text: str) -> Expression:
    """Return the tree of a guard or invariant.

    Raises `ExpressionError`: DH0121 (syntax), DH0105 (longer than 2,000 characters or too deep).

    >>> parse_condition("0 <= h1 < 2 & !(h2 > 1)").operator
    '&'
    """
    return _Parser(text).whole(conditions=True)


def _tokens(text: str) -> list[_Token]:
    if len(text) > LONGEST_TEXT:
        message = f"an expression is longer than {LONGEST_TEXT} characters"
        raise ExpressionError("DH0105", message, 0, len(text), helps=("name parts of it under `parameters`",))
    found: list[_Token] = []
    position = 0
    while not found or found[-1].kind != "end":
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            start = position + len(text[position:]) - len(text[position:].lstrip())
            raise ExpressionError("DH0121", f"`{text[start]}` has no meaning in an expression", start, start + 1)
        found.append(_Token(match.lastgroup, match[match.lastgroup], match.start(match.lastgroup), match.end()))
        position = match.end()
    return found


class _Parser:
    """One method for each level of the grammar; each returns the tree of what it consumed."""

    def __init__(self, text: str) -> None:
        self._tokens = _tokens(text)
        self._next = 0
        self._depth = 0
        self._inner: Callable[[], Expression] = self._sum

    def whole(self, *, conditions: bool) -> Expression:
        """Return the tree of the whole text."""
        self._inner = self._or if conditions else self._sum
        tree = self._inner()
        if self._token.kind != "end":
            raise self._unexpected("expected an operator or the end here")
        return tree

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _take(self) -> _Token:
        token = self._token
        self._next += token.kind != "end"
        return token

    def _accept(self, *symbols: str) -> _Token | None:
        return self._take() if self._token.kind == "symbol" and self._token.text in symbols else None

    def _unexpected(self, label: str) -> ExpressionError:
        token = self._token
        shown = "the expression ends too early" if token.kind == "end" else f"`{token.text}` is not expected here"
        advice = _CUT if token.kind == "end" and ")" in label else _ADVICE.get(token.text)
        helps = () if advice is None else (advice,)
        return ExpressionError("DH0121", shown, token.start, token.end, label=label, helps=helps)

    def _deeper(self, level: Callable[[], Expression], opening: _Token) -> Expression:
        if self._depth >= _DEEPEST:
            message = f"an expression is nested more than {_DEEPEST} deep"
            raise ExpressionError("DH0105", message, opening.start, opening.end)
        self._depth += 1
        tree = level()
        self._depth -= 1
        return tree

    def _or(self) -> Expression:
        return self._junction("|", "||", self._and)

    def _and(self) -> Expression:
        return self._junction("&", "&&", self._not)

    def _junction(self, operator: str, doubled: str, level: Callable[[], Expression]) -> Expression:
        parts = [level()]
        while self._accept(operator, doubled):
            parts.append(level())
        return parts[0] if len(parts) == 1 else Junction(operator, tuple(parts), parts[0].start, parts[-1].end)

    def _not(self) -> Expression:
        sign = self._accept("!")
        if sign is None:
            return self._comparison()
        part = self._deeper(self._not, sign)
        return Negation(part, sign.start, part.end)

    def _comparison(self) -> Expression:
        operands, relations = [self._sum()], []
        while relation := self._accept("<=", ">=", "<", ">", "=="):
            relations.append(relation.text)
            operands.append(self._sum())
        if not relations:
            return operands[0]
        return Comparison(tuple(operands), tuple(relations), operands[0].start, operands[-1].end)

    def _sum(self) -> Expression:
        return self._chain(("+", "-"), self._product)

    def _product(self) -> Expression:
        return self._chain(("*", "/"), self._signed)

    def _chain(self, operators: tuple[str, ...], level: Callable[[], Expression]) -> Expression:
        first, rest = level(), []
        while operator := self._accept(*operators):
            rest.append((operator.text, level()))
        return Chain(first, tuple(rest), first.start, rest[-1][1].end) if rest else first

    def _signed(self) -> Expression:
        sign = self._accept("-", "+")
        if sign is None:
            return self._power()
        operand = self._deeper(self._signed, sign)
        return Minus(operand, sign.start, operand.end) if sign.text == "-" else operand

    def _power(self) -> Expression:
        base = self._leaf()
        operator = self._accept("**")
        if operator is None:
            return base
        exponent = self._deeper(self._signed, operator)
        return Power(base, exponent, base.start, exponent.end)

    def _leaf(self) -> Expression:
        token = self._token
        if token.kind == "number":
            self._take()
            return _number(token, token.text)
        if token.kind == "imaginary":
            self._take()
            unit = Name(IMAGINARY, token.start, token.end)
            return Chain(_number(token, token.text[:-1]), (("*", unit),), token.start, token.end)
        if token.kind == "name" and token.text not in _ADVICE:
            self._take()
            return self._call(token) if self._accept("(") else Name(token.text, token.start, token.end)
        if self._accept("("):
            tree = self._deeper(self._inner, token)
            return replace(tree, start=token.start, end=self._expect(")").end)
        raise self._unexpected("expected a number, a name or `(` here")

    def _call(self, function: _Token) -> Expression:
        arguments = [self._deeper(self._sum, function)]
        while self._accept(","):
            arguments.append(self._deeper(self._sum, function))
        end = self._expect(")").end
        return Call(function.text, tuple(arguments), function.start, end)

    def _expect(self, symbol: str) -> _Token:
        token = self._accept(symbol)
        if token is None:
            raise self._unexpected(f"expected `{symbol}` here")
        return token


def _number(token: _Token, text: str) -> Number:
    value = float(text)
    if value == float("inf"):
        raise ExpressionError("DH0123", f"`{text}` is beyond the largest number", token.start, token.end)
    return Number(value, token.start, token.end)


__all__ = [
    "IMAGINARY",
    "LONGEST_TEXT",
    "Call",
    "Chain",
    "Comparison",
    "Expression",
    "ExpressionError",
    "Junction",
    "Minus",
    "Name",
    "Negation",
    "Number",
    "Power",
    "parse_arithmetic",
    "parse_condition",
]
