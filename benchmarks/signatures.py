"""The cheapest signatures of structured plants: `python -m benchmarks.signatures [--seconds S] [word in the name ...]`.

Families of plants with silent and ambiguous transitions, and of candidates with costs; outputs are made unambiguous
only where all candidates together could not tell.  Times are processor seconds of the recovery alone.
"""

import argparse
import random
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate, joint_signatures, options
from deshybrid.des.observability import check_observability
from deshybrid.des.signatures import SignaturePlan, recover_observability

Row: TypeAlias = tuple[str, str, str, str | None]
Case: TypeAlias = tuple[DES, tuple[Candidate, ...]]
_COSTS = (1.0, 1.0, 1.5, 2.0, 3.0)


def gearboxes(locations: int, candidates: int, *, seed: int = 1) -> Case:
    """Hubs of nine gears in a ring: gears go in and out of their hub, hubs shift to the next; symbols recur."""
    draw = random.Random(seed)
    hubs, gears = locations // 10, 9
    watched = set(draw.sample([f"g{h}_{i}" for h in range(hubs) for i in range(gears)], candidates))
    rows: list[Row] = []
    for h in range(hubs):
        rows.append((f"N{h}", "shift", f"N{(h + 1) % hubs}", f"shift{draw.randrange(3)}"))
        for i in range(gears):
            gear = f"g{h}_{i}"
            rows.append(
                (f"N{h}", f"in{i}", gear, _symbol(draw, "in", 6 if gear in watched else 3 * hubs, gear in watched))
            )
            rows.append((gear, "out", f"N{h}", f"out{draw.randrange(4)}"))
    return _recoverable(draw, rows, watched, f"gearboxes {locations}")


def rings(locations: int, candidates: int, *, seed: int = 1) -> Case:
    """A ring of modes with few symbols, and a short cut from every fourth mode."""
    draw = random.Random(seed)
    watched = set(draw.sample([f"m{n}" for n in range(locations)], candidates))
    rows: list[Row] = []
    for n in range(locations):
        targets = [(n + 1) % locations] + ([draw.randrange(locations)] if n % 4 == 0 else [])
        for k, target in enumerate(targets):
            known = f"m{target}" in watched
            rows.append((f"m{n}", f"e{k}", f"m{target}", _symbol(draw, "o", 3 if known else 6, known)))
    return _recoverable(draw, rows, watched, f"rings {locations}")


def scattered(locations: int, candidates: int, *, seed: int = 1) -> Case:
    """Two exits from each location to anywhere."""
    draw = random.Random(seed)
    watched = set(draw.sample([f"q{n}" for n in range(locations)], candidates))
    rows: list[Row] = []
    for n in range(locations):
        for k in range(2):
            target = f"q{draw.randrange(locations)}"
            rows.append((f"q{n}", f"e{k}", target, _symbol(draw, "o", 8, target in watched)))
    return _recoverable(draw, rows, watched, f"scattered {locations}")


def switches(count: int, candidates: int, *, seed: int = 1) -> Case:
    """Every position of `count` switches is a location; a click does not tell which switch has moved, or how.

    The candidates are detectors that cover half of the locations each: a switch, or a parity of some, is on.
    """
    draw = random.Random(seed)
    places = [format(n, f"0{count}b") for n in range(2**count)]
    rows: list[Row] = [
        (place, f"t{i}", place[:i] + str(1 - int(place[i])) + place[i + 1 :], f"click{i % 3}")
        for place in places
        for i in range(count)
    ]
    des = DES.from_transitions(rows, name=f"switches {2**count}")
    parities = [frozenset((i,)) for i in range(count)]
    while len(parities) < candidates:
        parity = frozenset(draw.sample(range(count), draw.randint(2, count)))
        parities += [] if parity in parities else [parity]
    return des, tuple(_detector(draw, des, parity) for parity in parities)


def _detector(draw: random.Random, des: DES, parity: frozenset[int]) -> Candidate:
    covers = [place for place in des.locations if sum(int(place[i]) for i in parity) % 2]
    taken = [n for n, t in enumerate(des.transitions) if t.target in set(covers)]
    name = "on_" + "_".join(map(str, sorted(parity)))
    return Candidate.covering(name, covers, taken, cost=draw.choice(_COSTS) + len(parity) - 1)


def _symbol(draw: random.Random, stem: str, symbols: int, may_be_silent: bool) -> str | None:
    return None if may_be_silent and draw.random() < 0.25 else f"{stem}{draw.randrange(symbols)}"


def _recoverable(draw: random.Random, rows: list[Row], watched: set[str], name: str) -> Case:
    """Give a symbol of its own to the last step of what all candidates together leave confused, until nothing is."""
    des = DES.from_transitions(rows, name=name)
    offered = tuple(
        Candidate(
            f"s_{place}",
            place,
            tuple(n for n, t in enumerate(des.transitions) if t.target == place),
            draw.choice(_COSTS),
            negation=draw.random() < 0.5,
        )
        for place in des.locations
        if place in watched
    )
    arcs = list(des.transitions)
    while True:
        des = replace(des, transitions=tuple(arcs))
        report = check_observability(des.with_signatures(joint_signatures(offered, options(des, offered))))
        if report.witness is None:
            return des, offered
        before, last = report.witness.runs[0][-2:]
        for n, t in enumerate(arcs):
            if (t.source, t.event, t.target) == (before.location, last.event, last.location):
                arcs[n] = replace(t, outputs=(f"unique{n}",))


CASES: dict[str, Callable[[], Case]] = {
    "gearboxes, 100 locations": partial(gearboxes, 100, 30),
    "ring, 100 locations": partial(rings, 100, 30),
    "scattered, 100 locations": partial(scattered, 100, 30),
    "switches, 64 locations": partial(switches, 6, 30),
    "switches, 128 locations": partial(switches, 7, 30),
    "gearboxes, 300 locations": partial(gearboxes, 300, 100),
    "ring, 300 locations": partial(rings, 300, 100),
    "scattered, 300 locations": partial(scattered, 300, 100),
    "switches, 256 locations": partial(switches, 8, 100),
}


def row(name: str, case: Case, plan: SignaturePlan, seconds: float) -> str:
    """Return a line of the table."""
    des, candidates = case
    proof = "optimal" if plan.optimal and plan.fewest else "least cost" if plan.optimal else f"gap {plan.gap:.1%}"
    facts = (name, len(des.locations), len(des), len(candidates), len(plan.constraints))
    return " | ".join(("", *map(str, facts), f"{plan.cost:g}", proof, f"{seconds:.1f}", "")).strip()


def main(words: Iterable[str], seconds: float | None) -> None:
    """Print the table of the cases whose name has one of the words, all without words."""
    print("| plant | locations | transitions | candidates | constraints | cost | proof | s |")
    print("|---|---|---|---|---|---|---|---|")
    for name, make in CASES.items():
        if not words or any(word in name for word in words):
            case = make()
            before = time.process_time()
            plan = recover_observability(*case, seconds=seconds)
            print(row(name, case, plan, time.process_time() - before), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--seconds", type=float, default=None)
    arguments = parser.parse_args()
    main(arguments.words, arguments.seconds)
