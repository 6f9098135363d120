"""The 0/1 program of signature recovery: which transitions to instrument, with which residual generators.

Variables: y_g = generator g is there (of a location, or a covering detector); r_o, n_o = option o is taken by residual,
by negation.  Rows: r_o <= y_g for its generator g; n_o <= y_a for every other alternative a of its transition (two
locations of one set of alternatives can therefore never both be named by negation); r_o + n_o <= 1; and for every
constraint found so far, that at least one of its options is taken: once with r_o, once with their generators in place
of them, which says the same of whole numbers and more of fractions.

Objectives, minimised one after the other: the cost of the generators; the number of instrumented transitions; how
easily these are confused with others (where that is known of any: the sum over them); how many
alternatives the negations must deny beyond one each (to deny one is a threshold turned round, to deny many is fragile);
how many negations there are; and, so that the choice is by declaration, the sums of the numbers of generators and of
transitions.

In: candidates, then constraints.  Out: a `Selection`.  Cost: one call of `scipy.optimize.milp` per solution.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate, Option, generator_costs, options

Row: TypeAlias = tuple[dict[int, float], float]  # coefficients by variable, upper bound of their sum
_SLACK = 1e-6  # of the largest cost: the solver's tolerance; generator costs that differ by less count as equal
_UNLIMITED = 1e9  # seconds
_STOPPED = 1  # the status of `milp` at its time limit


@dataclass(frozen=True, slots=True)
class Program:
    """Rows and objectives that do not change; the variables are the y, the r and the n, in this order.

    `needs` tells for each option the generator number that it takes by residual, -1 for none.
    """

    generators: tuple[str, ...]
    options: tuple[Option, ...]
    needs: tuple[int, ...]
    denies: tuple[tuple[int, ...] | None, ...]
    rows: tuple[Row, ...]
    objectives: tuple[dict[int, float], ...]

    @property
    def size(self) -> int:
        """The number of variables."""
        return len(self.generators) + 2 * len(self.options)

    def carries(self, option: int) -> tuple[int, int]:
        """Return the variables r and n of option number `option`."""
        return len(self.generators) + option, len(self.generators) + len(self.options) + option

    def ways(self, option: int) -> Iterator[frozenset[int]]:
        """Yield the sets of generators (numbers) each of which is enough for option number `option`."""
        if self.needs[option] >= 0:
            yield frozenset((self.needs[option],))
        denied = self.denies[option]
        if denied is not None:
            yield frozenset(denied)

    def available(self, generators: frozenset[int]) -> frozenset[int]:
        """Return the numbers of the options that these generators make possible; all of them together are."""
        return frozenset(
            option for option in range(len(self.options)) if any(way <= generators for way in self.ways(option))
        )


@dataclass(frozen=True, slots=True)
class Selection:
    """A solution: options and generators (numbers), the objective, and what no solution falls below."""

    options: frozenset[int]
    generators: frozenset[int]
    objective: float
    bound: float

    @property
    def proven(self) -> bool:
        """True where the solver proved the solution to be best."""
        return self.objective <= self.bound + _SLACK


def build_program(des: DES, candidates: tuple[Candidate, ...]) -> Program:
    """Return the program of these candidates, without constraints from confusions yet."""
    costs = generator_costs(des, candidates)
    usable = options(des, candidates)
    number = {generator: y for y, generator in enumerate(costs)}
    needs = tuple(number[candidates[o.candidate].generator] if o.residual else -1 for o in usable)
    denies = tuple(None if o.negation is None else tuple(number[name] for name in o.negation) for o in usable)
    frame = Program(tuple(costs), usable, needs, denies, (), ())
    carries = [frame.carries(index) for index in range(len(usable))]
    pairs = list(zip(usable, carries, strict=True))
    scale = max(costs.values(), default=0.0) or 1.0
    order = {
        name: place + 1.0 for place, name in enumerate((*des.locations, *(c.name for c in candidates if c.covers)))
    }
    confusions = {
        variable: candidates[o.candidate].confusion_of(o.transitions) for o, both in pairs for variable in both
    }
    objectives = (
        {y: cost / scale for y, cost in enumerate(costs.values())},
        {variable: float(len(option.transitions)) for option, both in pairs for variable in both},
        *([confusions] if any(confusions.values()) else []),
        {n: len(option.negation) - 1.0 for option, (_, n) in pairs if option.negation},
        {n: 1.0 for _, (_, n) in pairs},
        {y: order[generator] for generator, y in number.items()},
        {variable: sum(t + 1.0 for t in option.transitions) for option, both in pairs for variable in both},
    )
    rows = tuple(row for index in range(len(usable)) for row in _rows(frame, index))
    return Program(frame.generators, usable, needs, denies, rows, objectives)


def _rows(program: Program, option: int) -> Iterator[Row]:
    r, n = program.carries(option)
    yield {r: 1.0, n: 1.0}, 1.0
    yield ({r: 1.0, program.needs[option]: -1.0} if program.needs[option] >= 0 else {r: 1.0}), 0.0
    denied = program.denies[option]
    if denied is None:
        yield {n: 1.0}, 0.0
    else:
        yield from (({n: 1.0, other: -1.0}, 0.0) for other in denied)


def solve(
    program: Program,
    constraints: Iterable[frozenset[int]],
    settled: Sequence[float],
    *,
    seconds: float | None = None,
    forbidden: Sequence[Row] = (),
) -> Selection | None:
    """Return a solution that is best in objective number `len(settled)`, the earlier ones held at these values.

    `constraints` are sets of options (numbers), of each of which at least one must be taken; `forbidden` are more rows.
    None where there is no solution, or none was found within `seconds`; one that was found may then not be proven.
    """
    import numpy as np
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import coo_array

    rows = [*program.rows, *_covering(program, constraints), *forbidden]
    rows += [(program.objectives[level], value + _SLACK) for level, value in enumerate(settled)]
    entries = [(row, column, value) for row, (terms, _) in enumerate(rows) for column, value in terms.items()]
    lines, columns, values = np.array(entries, dtype=float).reshape(-1, 3).T
    matrix = coo_array((values, (lines.astype(int), columns.astype(int))), shape=(len(rows), program.size))
    objective = program.objectives[len(settled)]
    weights = np.zeros(program.size)
    for column, weight in objective.items():
        weights[column] = weight
    answer = milp(
        weights,
        integrality=np.ones(program.size, dtype=np.int64),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(matrix.tocsr(), -np.inf, [upper for _, upper in rows]),
        options={"mip_rel_gap": 0.0, "time_limit": _UNLIMITED if seconds is None else max(seconds, 0.01)},
    )
    if answer.x is None:
        return None
    bound = answer.mip_dual_bound if answer.status == _STOPPED else answer.fun
    return _selection(program, [bool(value > 0.5) for value in answer.x], objective, float(bound or 0.0))


def _covering(program: Program, constraints: Iterable[frozenset[int]]) -> Iterator[Row]:
    for constraint in constraints:
        carries = [program.carries(option) for option in sorted(constraint)]
        negations = {n: -1.0 for _, n in carries}
        yield {r: -1.0 for r, _ in carries} | negations, -1.0
        yield {program.needs[o]: -1.0 for o in sorted(constraint) if program.needs[o] >= 0} | negations, -1.0


def _selection(program: Program, chosen: list[bool], objective: dict[int, float], bound: float) -> Selection:
    return Selection(
        options=frozenset(o for o in range(len(program.options)) if any(chosen[v] for v in program.carries(o))),
        generators=frozenset(y for y in range(len(program.generators)) if chosen[y]),
        objective=sum(weight for variable, weight in objective.items() if chosen[variable]),
        bound=bound,
    )


__all__ = ["Program", "Row", "Selection", "build_program", "solve"]
