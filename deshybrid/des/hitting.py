"""The implicit hitting set: the cheapest generators and the fewest options that meet demands found one by one.

A choice that fails says what every choice that succeeds must contain: a `Demand`.  So: solve a 0/1 program for the best
choice that meets all demands so far, test it, turn what it leaves confused into demands, repeat until the test
succeeds.  A choice that is best for fewer demands is best for all, so the first that succeeds is proven, and the
demands are the proof.

The cost of the generators comes first, and there all options that a set of generators makes possible count as taken,
since more signatures never confuse.  Before any program is solved, generators are struck out one by one while the rest
suffices: this gives a plan to fall back on, and its failures are demands.  Where a limit ends the search, the best plan
so far is kept, with the bound that the programs have proven.

In: a `Separation`, its `Program`.  Out: an `Outcome`.  Cost: NP-hard; each test is linear in the joint moves.
Source: Moreno-Centeno and Karp (2013), implicit hitting sets; Davies and Bacchus (2011).
"""

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from deshybrid.des.confusions import departures, joint_cycles, minimal
from deshybrid.des.program import Program, Row, Selection, solve
from deshybrid.des.separation import Demand, Separation
from deshybrid.diagnostics import LimitReached, check_limits, diagnostic

_NEAR = 1e-9  # of the largest cost: sums in another order
Choice = frozenset[int]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The best choice that was found: options and generators (numbers), and what is proven of it.

    `bound`: no choice has less of the first objective.  `settled`: how many objectives are proven least, in turn.
    """

    options: Choice
    generators: Choice
    bound: float
    settled: int
    demands: tuple[Demand, ...]


class Search:
    """Demands grow, objective by objective, until a choice succeeds; `options` and `generators` are the best so far.

    Not a value: it is at work until `run` returns an `Outcome`.
    """

    def __init__(
        self, separation: Separation, program: Program, deadline: float | None = None, rounds: int = 10_000
    ) -> None:
        self.separation, self.program, self.deadline, self.rounds = separation, program, deadline, rounds
        self.demands: dict[Choice, Demand] = {}
        self.settled: list[float] = []
        self.bound = 0.0
        self.generators: Choice = frozenset(range(len(program.generators)))
        self.options: Choice = program.available(self.generators)

    def run(self) -> Outcome:
        """Return the best choice; what a limit has left open shows in `settled`."""
        with suppress(LimitReached, MemoryError):
            self.settle(len(self.program.objectives))
        return self.outcome()

    def outcome(self) -> Outcome:
        """Return what has been found so far."""
        demands = tuple(self.demands.values())
        return Outcome(self.options, self.generators, self.bound, len(self.settled), demands)

    def settle(self, levels: int) -> None:
        """Find the best choice by the first `levels` objectives; raises `LimitReached`, the best so far is kept."""
        self._demand(departures(self.separation))
        self.settled.append(self._cheapest())
        self._thin()
        while len(self.settled) < levels:
            best = self.best()
            if best is None:
                raise RuntimeError("the 0/1 program has no solution although its constraints can be met")
            self.options, self.generators = best.options, best.generators
            self.settled.append(best.objective)

    def best(self, forbidden: tuple[Row, ...] = ()) -> Selection | None:
        """Return the best choice that succeeds, by the next objective with the settled ones kept; None for none."""
        while True:
            selection = self._solve(forbidden)
            if selection is None:
                return None
            if not selection.proven:
                raise _stopped()
            new = self._against(selection.options)
            if not new:
                return selection
            self._demand(new)

    def cost(self, generators: Iterable[int]) -> float:
        """Return the first objective of a set of generators."""
        return sum(self.program.objectives[0][generator] for generator in sorted(generators))

    def _cheapest(self) -> float:
        """Settle the first objective, on generators alone."""
        self._keep(self._struck_out(self.generators))
        while self.bound < self.cost(self.generators) - _NEAR:
            selection = self._solve(())
            if selection is None:
                raise _stopped()
            self.bound = max(self.bound, min(selection.bound, selection.objective))
            new = self._against(self.program.available(selection.generators))
            if not new:
                self._keep(selection.generators)
                if not selection.proven:
                    raise _stopped()
                break
            self._demand(new)
            self._keep(self._struck_out(self._repaired(selection.generators, new)))
        self.bound = self.cost(self.generators)
        return self.bound

    def _keep(self, generators: Choice) -> None:
        """Keep a set of generators that suffices, if it costs less than the best so far."""
        if self.cost(generators) < self.cost(self.generators) - _NEAR or generators < self.generators:
            self.generators, self.options = generators, self.program.available(generators)

    def _struck_out(self, generators: Choice) -> Choice:
        """Leave out generators, dearest and last declared first, while the rest suffices."""
        kept = generators
        for generator in sorted(generators, key=lambda g: (-self.program.objectives[0][g], -g)):
            options = self.program.available(kept - {generator})
            if self._meets(options) and not self._learn(options):
                kept -= {generator}
        return kept

    def _repaired(self, generators: Choice, unmet: list[Demand]) -> Choice:
        """Add the cheapest generators for one demand after the other until all are met."""
        while unmet:
            for demand in unmet:
                if not demand.options & self.program.available(generators):
                    ways = [way for option in sorted(demand.options) for way in self.program.ways(option)]
                    generators |= min(ways, key=lambda way: (self.cost(way - generators), len(way)))
            unmet = self._learn(self.program.available(generators))
        return generators

    def _thin(self) -> None:
        """Leave out options while the rest suffices; later objectives start from there."""
        for option in sorted(self.options, key=lambda o: (-len(self.program.options[o].transitions), -o)):
            options = self.options - {option}
            if self._meets(options) and not self._learn(options):
                self.options = options

    def _meets(self, options: Choice) -> bool:
        return all(demand & options for demand in self.demands)

    def _learn(self, options: Choice) -> list[Demand]:
        """Return what a choice leaves confused, and demand it from now on."""
        new = self._against(options)
        self._demand(new)
        return new

    def _demand(self, new: Iterable[Demand]) -> None:
        for demand in new:
            self.demands.setdefault(demand.options, demand)

    def _against(self, options: Choice) -> list[Demand]:
        """Demands that a choice fails, with no option in common; none where it succeeds.

        After each, all that would meet it counts as taken, so that the next one is another.
        """
        found, taken = list[Demand](), set(options)
        while cycles := joint_cycles(self.separation, self.separation.mask(taken)):
            self._check_time()
            for demand in cycles:
                if not demand.options & taken:
                    found.append(minimal(self.separation, demand))
                    taken |= found[-1].options
        return found

    def _solve(self, forbidden: tuple[Row, ...]) -> Selection | None:
        self._check_time()
        if self.rounds <= 0:
            raise _stopped()
        self.rounds -= 1
        seconds = None if self.deadline is None else self.deadline - time.monotonic()
        return solve(self.program, self.demands, self.settled, seconds=seconds, forbidden=forbidden)

    def _check_time(self) -> None:
        check_limits()
        if self.deadline is not None and time.monotonic() > self.deadline:
            raise _stopped()


def _stopped() -> LimitReached:
    return LimitReached(diagnostic("DH0902", "the search for the cheapest signatures stopped before its end"))


__all__ = ["Outcome", "Search"]
