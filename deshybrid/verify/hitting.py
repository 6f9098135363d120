"""That no set of generators below a stated cost meets all demands: branch and bound in exact arithmetic.

In: prices, and for each demand the sets of generators one of which is enough for it.  Out: whether it is proved.
Idea: at each node a linear program proposes multipliers in floating point; whatever they are, the Lagrange bound that
they give is computed with rational numbers and holds.  A bound between two multiples of the common unit of all prices
is rounded up.  Where the bound is too low, a generator is decided both ways.
Cost: exponential in the worst case; one linear program for each node.  Source: Land and Doig (1960); Geoffrion (1974).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, gcd, lcm
from typing import Any, TypeAlias

from deshybrid.diagnostics import LimitReached, diagnostic

LARGEST_SEARCH = 20_000
_FINEST = 10**6  # denominators of multipliers
Way: TypeAlias = frozenset[str]
Ways: TypeAlias = frozenset[Way]


@dataclass(frozen=True, slots=True)
class _Node:
    """Demands that are left, what has been spent, and the generators that are still undecided (in all ways)."""

    demands: frozenset[Ways]
    spent: Fraction


def costs_at_least(prices: Mapping[str, Fraction], demands: Iterable[Ways], target: Fraction) -> bool:
    """Return whether every set of generators that meets the demands costs `target` or more.

    Raises `LimitReached` (DH0907) beyond 20,000 nodes of the search.

    >>> one, other = frozenset("a"), frozenset("b")
    >>> prices = {"a": Fraction(2), "b": Fraction(3)}
    >>> demands = [frozenset((one, other)), frozenset((other, frozenset("ab")))]
    >>> costs_at_least(prices, demands, Fraction(3)), costs_at_least(prices, demands, Fraction(4))
    (True, False)
    """
    unit = Fraction(gcd(*(p.numerator for p in prices.values())), lcm(*(p.denominator for p in prices.values())))
    free = {name for name, price in prices.items() if price == 0}
    start = _bought(_Node(frozenset(_minimal(demands)), Fraction()), free, prices)
    waiting, nodes = [start], 0
    while waiting:
        nodes += 1
        if nodes > LARGEST_SEARCH:
            text = f"the lower bound was not decided within {LARGEST_SEARCH} steps"
            raise LimitReached(diagnostic("DH0907", text))
        node = waiting.pop()
        if frozenset() in node.demands:
            continue
        if not node.demands:
            if node.spent < target:
                return False
            continue
        bound, branch = _bound(node, prices)
        if unit > 0:
            bound = ceil(bound / unit) * unit
        if bound < target:
            waiting += [_without(node, branch), _bought(node, {branch}, prices)]
    return True


def _minimal(demands: Iterable[Ways]) -> Iterable[Ways]:
    """Demands that no other one implies."""
    kept: list[Ways] = []
    for demand in sorted(set(demands), key=len):
        if not any(other <= demand for other in kept):
            kept.append(demand)
    return kept


def _bought(node: _Node, generators: set[str], prices: Mapping[str, Fraction]) -> _Node:
    demands = (frozenset(way - generators for way in demand) for demand in node.demands)
    left = frozenset(demand for demand in demands if frozenset() not in demand)
    return _Node(left, node.spent + sum((prices[name] for name in generators), Fraction()))


def _without(node: _Node, generator: str) -> _Node:
    return _Node(frozenset(frozenset(w for w in d if generator not in w) for d in node.demands), node.spent)


def _bound(node: _Node, prices: Mapping[str, Fraction]) -> tuple[Fraction, str]:
    """A proven lower bound, and the generator to decide next: the one that the linear program halves most."""
    import numpy as np
    from scipy.optimize import linprog
    from scipy.sparse import coo_array

    demands = sorted(node.demands, key=lambda demand: sorted(map(sorted, demand)))
    ways = sorted({way for demand in demands for way in demand}, key=sorted)
    names = sorted({name for way in ways for name in way})
    column = {name: number for number, name in enumerate(names)}
    place = {way: column[min(way)] if len(way) == 1 else len(names) + number for number, way in enumerate(ways)}
    links = [(way, name) for way in ways if len(way) > 1 for name in sorted(way)]
    entries = [(row, place[way], -1.0) for row, demand in enumerate(demands) for way in demand]
    entries += [(len(demands) + row, place[way], 1.0) for row, (way, _) in enumerate(links)]
    entries += [(len(demands) + row, column[name], -1.0) for row, (_, name) in enumerate(links)]
    rows, columns, values = zip(*sorted(entries), strict=True)
    shape = (len(demands) + len(links), len(names) + len(ways))
    costs = np.zeros(shape[1])
    costs[: len(names)] = [float(prices[name]) for name in names]
    limits = np.concatenate((-np.ones(len(demands)), np.zeros(len(links))))
    matrix: Any = coo_array((values, (rows, columns)), shape=shape).tocsr()
    answer = linprog(costs, matrix, limits, bounds=(0, 1))
    x = answer.x
    if x is None:
        return node.spent, names[0]
    multipliers = [Fraction(max(-m, 0.0)).limit_denominator(_FINEST) for m in answer.ineqlin.marginals]
    bound = _lagrange(demands, links, multipliers, {name: prices[name] for name in names})
    return node.spent + bound, min(names, key=lambda name: (abs(x[column[name]] - 0.5), name))


def _lagrange(
    demands: list[Ways], links: list[tuple[Way, str]], multipliers: list[Fraction], prices: Mapping[str, Fraction]
) -> Fraction:
    """min over 0 <= x, v <= 1 of c x + Σ π (1 - Σ v) + Σ μ (v - x), for multipliers that are not negative."""
    reduced = dict(prices)
    gained: dict[Way, Fraction] = {}
    for demand, multiplier in zip(demands, multipliers, strict=False):
        for way in demand:
            gained[way] = gained.get(way, Fraction()) + multiplier
    for (way, name), multiplier in zip(links, multipliers[len(demands) :], strict=True):
        gained[way] -= multiplier
        reduced[name] -= multiplier
    total = sum(multipliers[: len(demands)], Fraction())
    for way, gain in gained.items():
        if len(way) == 1:
            reduced[min(way)] -= gain
        else:
            total += min(-gain, Fraction())
    return total + sum((min(price, Fraction()) for price in reduced.values()), Fraction())


__all__ = ["Way", "Ways", "costs_at_least"]
