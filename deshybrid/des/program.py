"""The 0/1 program of signature recovery: which transitions to instrument, with which residual generators.

Variables: y_q = location q has a residual generator; r_t, n_t = transition t carries its signature by residual, by
negation.  Rows: r_t <= y_q for t into q; n_t <= y_a for every other alternative a of t (two locations of one set of
alternatives can therefore never both be named by negation); r_t + n_t <= 1; and for every constraint found so far,
that at least one transition of a set carries a signature.

Objectives, minimised one after the other: the cost of the generators; the number of instrumented transitions; how many
alternatives the negations must deny beyond one each (to deny one is a threshold turned round, to deny many is fragile);
how many negations there are; and, so that the choice is by declaration, the sums of the numbers of generators and of
transitions.

In: candidates, then constraints.  Out: a `Selection`.  Cost: one call of `scipy.optimize.milp` per solution.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate, Option, generator_costs, options

Row: TypeAlias = tuple[dict[int, float], float]  # coefficients by variable, upper bound of their sum
_SLACK = 1e-6  # of the largest cost: the solver's tolerance; generator costs that differ by less count as equal


@dataclass(frozen=True, slots=True)
class Program:
    """Rows and objectives that do not change; the variables are the y, the r and the n, in this order."""

    generators: tuple[str, ...]
    options: tuple[Option, ...]
    rows: tuple[Row, ...]
    objectives: tuple[dict[int, float], ...]

    @property
    def size(self) -> int:
        """The number of variables."""
        return len(self.generators) + 2 * len(self.options)

    def carries(self, option: int) -> tuple[int, int]:
        """Return the variables r and n of option number `option`."""
        return len(self.generators) + option, len(self.generators) + len(self.options) + option


@dataclass(frozen=True, slots=True)
class Selection:
    """A solution: transitions (numbers) that carry a signature, locations that have a generator, the objective."""

    transitions: tuple[int, ...]
    generators: tuple[str, ...]
    objective: float


def build_program(des: DES, candidates: tuple[Candidate, ...]) -> Program:
    """Return the program of these candidates, without constraints from confusions yet."""
    costs = generator_costs(des, candidates)
    usable = options(des, candidates)
    frame = Program(tuple(costs), usable, (), ())
    number = {location: y for y, location in enumerate(costs)}
    carries = [frame.carries(index) for index in range(len(usable))]
    places = [candidates[option.candidate].location for option in usable]
    pairs = list(zip(usable, carries, strict=True))
    scale = max(costs.values(), default=0.0) or 1.0
    objectives = (
        {y: cost / scale for y, cost in enumerate(costs.values())},
        {variable: 1.0 for _, both in pairs for variable in both},
        {n: len(option.negation) - 1.0 for option, (_, n) in pairs if option.negation},
        {n: 1.0 for _, (_, n) in pairs},
        {y: des.locations.index(location) + 1.0 for location, y in number.items()},
        {variable: option.transition + 1.0 for option, both in pairs for variable in both},
    )
    rows = (
        row for place, (option, both) in zip(places, pairs, strict=True) for row in _rows(option, both, number, place)
    )
    return Program(tuple(costs), usable, tuple(rows), objectives)


def _rows(option: Option, carries: tuple[int, int], generator: dict[str, int], location: str) -> Iterator[Row]:
    r, n = carries
    yield {r: 1.0, n: 1.0}, 1.0
    yield ({r: 1.0, generator[location]: -1.0} if option.residual else {r: 1.0}), 0.0
    if option.negation is None:
        yield {n: 1.0}, 0.0
    else:
        yield from (({n: 1.0, generator[other]: -1.0}, 0.0) for other in option.negation)


def solve(program: Program, constraints: Sequence[tuple[int, ...]], settled: Sequence[float]) -> Selection:
    """Return a solution that is best in objective number `len(settled)`, the earlier ones held at these values.

    `constraints` are sets of transitions, of each of which at least one must carry a signature; this must be possible.
    """
    import numpy as np
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import coo_array

    rows = [*program.rows, *_covering(program, constraints)]
    rows += [(program.objectives[level], value + _SLACK) for level, value in enumerate(settled)]
    entries = [(row, column, value) for row, (terms, _) in enumerate(rows) for column, value in terms.items()]
    lines, columns, values = np.array(entries, dtype=float).reshape(-1, 3).T
    matrix = coo_array((values, (lines.astype(int), columns.astype(int))), shape=(len(rows), program.size))
    weights = np.zeros(program.size)
    for column, weight in program.objectives[len(settled)].items():
        weights[column] = weight
    answer = milp(
        weights,
        integrality=np.ones(program.size, dtype=np.int64),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(matrix.tocsr(), -np.inf, [upper for _, upper in rows]),
        options={"mip_rel_gap": 0.0},
    )
    if answer.x is None:
        raise RuntimeError(f"the 0/1 program has no solution although its constraints can be met: {answer.message}")
    return _selection(program, [bool(value > 0.5) for value in answer.x], program.objectives[len(settled)])


def _covering(program: Program, constraints: Sequence[tuple[int, ...]]) -> Iterator[Row]:
    carries = {option.transition: program.carries(index) for index, option in enumerate(program.options)}
    for constraint in constraints:
        yield {variable: -1.0 for transition in constraint for variable in carries[transition]}, -1.0


def _selection(program: Program, chosen: list[bool], objective: dict[int, float]) -> Selection:
    carried = (any(chosen[variable] for variable in program.carries(index)) for index in range(len(program.options)))
    return Selection(
        transitions=tuple(option.transition for option, taken in zip(program.options, carried, strict=True) if taken),
        generators=tuple(name for y, name in enumerate(program.generators) if chosen[y]),
        objective=sum(weight for variable, weight in objective.items() if chosen[variable]),
    )


__all__ = ["Program", "Selection", "build_program", "solve"]
