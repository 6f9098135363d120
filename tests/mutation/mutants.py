"""Small faults for a module, one at a time: what a slip of the pen could leave behind.

In: the source of a module.  Out: `Mutant`s, in the order of the source, and the source text that each of them makes.
Operators: a comparison becomes its neighbour or opposite; `and` becomes `or`; `not` and a minus vanish; an arithmetic
or bit operator becomes another; an integer grows by one; True becomes False; a condition is negated; `break` becomes
`continue`; `min` becomes `max`, `any` becomes `all`; a statement without a new name vanishes; `return x` returns None.
Left alone: annotations and type aliases, names that type checkers need, and texts (messages are compared elsewhere).
"""

import ast
import copy
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
_COMBINED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.FloorDiv: ast.Mult,
    ast.Div: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.Pow: ast.Mult,
}
_CALLED = {"min": "max", "max": "min", "any": "all", "all": "any"}
_TYPES = {"annotation", "returns"}  # fields that hold types
Step = tuple[str, int | None]  # a field of a node, and the place in it where it is a list


@dataclass(frozen=True)
class Mutant:
    """One fault: where it is (`path` leads there from the module), what was there, and what is there now."""

    module: str
    function: str
    line: int
    old: str
    new: str
    occurrence: int
    path: tuple[Step, ...]
    replacement: ast.AST

    @property
    def key(self) -> str:
        """The same as long as the code around it is the same: it names no line."""
        again = f" (no. {self.occurrence})" if self.occurrence > 1 else ""
        return f"{self.module}.{self.function}: {self.old} => {self.new}{again}"


def mutants(module: str, source: str) -> list[Mutant]:
    """Return every mutant of a module, in the order of the source."""
    found: list[Mutant] = []
    seen: Counter[tuple[str, str, str]] = Counter()
    for path, function, node in _nodes(ast.parse(source), (), "module"):
        for replacement in _faults(node):
            names = (function, _short(node), _short(replacement))
            seen[names] += 1
            found.append(Mutant(module, *names[:1], node.lineno, *names[1:], seen[names], path, replacement))
    return sorted(found, key=lambda mutant: mutant.line)


def mutated(source: str, mutant: Mutant) -> str:
    """Return the source with one fault in it."""
    tree: ast.AST = ast.parse(source)
    node = tree
    for field, place in mutant.path[:-1]:
        node = getattr(node, field) if place is None else getattr(node, field)[place]
    field, place = mutant.path[-1]
    if place is None:
        setattr(node, field, mutant.replacement)
    else:
        getattr(node, field)[place] = mutant.replacement
    return ast.unparse(ast.fix_missing_locations(tree))


def _nodes(node: ast.AST, path: tuple[Step, ...], function: str) -> Iterator[tuple[tuple[Step, ...], str, ast.AST]]:
    """Every statement and expression below a node, with the way to it and the name of what it is in."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        function = node.name if function == "module" else f"{function}.{node.name}"
    for field, value in ast.iter_fields(node):
        if field in _TYPES:
            continue
        children = enumerate(value) if isinstance(value, list) else [(None, value)]
        for place, child in children:
            if isinstance(child, ast.AST) and not _is_about_types(child):
                here = (*path, (field, place))
                if hasattr(child, "lineno"):
                    yield here, function, child
                yield from _nodes(child, here, function)


def _is_about_types(node: ast.AST) -> bool:
    alias = isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation) == "TypeAlias"
    variable = isinstance(node, ast.Call) and ast.unparse(node.func) in {"TypeVar", "cast"}
    return alias or variable or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")


def _faults(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in place of a node."""
    yield from _faults_of_expression(node)
    yield from _faults_of_statement(node)
    yield from _negated(node)


def _faults_of_expression(node: ast.AST) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(left, ops, comparators):
            for i, op in enumerate(ops):
                yield ast.Compare(left, [*ops[:i], _COMPARED[type(op)](), *ops[i + 1 :]], comparators)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.BinOp(left, op, right) if type(op) in _COMBINED:
            yield ast.BinOp(left, _COMBINED[type(op)](), right)
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() as value):
            yield ast.Constant(value + 1)
        case ast.Call(ast.Name(name), args, keywords) if name in _CALLED:
            yield ast.Call(ast.Name(_CALLED[name], ast.Load()), args, keywords)


def _faults_of_statement(node: ast.AST) -> Iterator[ast.AST]:
    match node:
        case ast.Return(value) if value is not None and ast.unparse(value) != "None":
            yield ast.Return(ast.Constant(None))
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()
        case ast.AugAssign(target, op, value):
            if type(op) in _COMBINED:
                yield ast.AugAssign(target, _COMBINED[type(op)](), value)
            yield ast.Pass()
        case ast.Expr(value) if not isinstance(value, ast.Constant):
            yield ast.Pass()
        case ast.Raise() | ast.Assign([ast.Attribute() | ast.Subscript()]):
            yield ast.Pass()


def _negated(node: ast.AST) -> Iterator[ast.AST]:
    """The same with a condition turned round, where no other operator does that already."""
    done = (ast.Compare, ast.Constant, ast.UnaryOp)
    if isinstance(node, (ast.If, ast.IfExp, ast.While)) and not isinstance(node.test, done):
        changed = copy.copy(node)
        changed.test = ast.UnaryOp(ast.Not(), node.test)
        yield changed
    for i, generator in enumerate(getattr(node, "generators", [])):
        for j, condition in enumerate(generator.ifs):
            if not isinstance(condition, done):
                changed = copy.deepcopy(node)
                changed.generators[i].ifs[j] = ast.UnaryOp(ast.Not(), condition)
                yield changed


def _short(node: ast.AST) -> str:
    """The first line of the text of a node."""
    return ast.unparse(ast.fix_missing_locations(copy.deepcopy(node))).splitlines()[0]


__all__ = ["Mutant", "mutants", "mutated"]
