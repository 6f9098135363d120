"""Check a plan of signatures and the proof that none is cheaper, without the code that made them.

In: the JSON tree of `recover --json`, and the parts of a model it should be for, if wished.  Out: a report.  The idea:
- every constraint is replayed on the system: its runs look the same under all candidates beside it, so that a plan
  without it would leave them confused (`plan_runs`);
- the plan itself is tried on the system (`plan_runs`);
- every set of generators that meets all constraints costs at least what is stated (`hitting`), so a plan of that cost
  is cheapest.

Source: Balluchi et al. (2012), section 4.1; Moreno-Centeno and Karp (2013).
"""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction

from deshybrid.verify.hitting import Way, costs_at_least
from deshybrid.verify.plan_file import Claimed, Plan, read_plan
from deshybrid.verify.plan_runs import Choice, choices, constraint_faults, offer_faults, plan_faults
from deshybrid.verify.report import Check, VerifyReport
from deshybrid.verify.watched import Watched, paths_in_words

_ROUNDING = Fraction(1, 10**12)  # of the gap, a quotient of two doubles


def verify_plan(document: Mapping[str, object], model: Mapping[str, object] | None = None) -> VerifyReport:
    """Return which claims of a plan are proved; `document` is the tree that `recover --json` writes.

    `model` holds the `system` and the `candidates` that the plan has to be for, in the same form.
    Raises `UsageError` (DH0408) where the tree is not a plan, `LimitReached` (DH0907) where the lower bound takes too
    long.  A claim that cannot be proved is refused in the report, not raised.

    >>> arcs = [["2", "d", "5", [None]], ["5", "a", "2", ["α"]]]
    >>> five = {"name": "s_5", "locations": ["5"], "covering": False, "transitions": [0], "cost": 1.0}
    >>> proof = {"condition": "C1", "transitions": [0], "detectors": [], "cycles": [[0, 2]]}
    >>> plan = {
    ...     "recoverable": True, "signatures": [{"name": "s_5", "by": "residual"}], "instrumented": {"s_5": [0]},
    ...     "generators": 1, "generator_names": ["5"], "cost": 1.0, "lower_bound": 1.0, "optimal": True, "gap": 0.0,
    ...     "system": {"locations": ["2", "5"], "initial": ["2"], "transitions": arcs},
    ...     "candidates": [{**five, "residual": True, "negation": True}],
    ...     "constraints": [{**proof, "runs": [[[0, None], [1, "α"], [0, None]]]}],
    ... }
    >>> verify_plan(plan).holds, verify_plan({**plan, "constraints": []}).holds
    (True, False)
    """
    document = Watched(document)
    plan = read_plan(document)
    said = (*_of_the_model(document, model), *_said(plan), *_shown(document, plan))
    checks = tuple(Check(*each) for each in said)
    unchecked = paths_in_words(document.unread(), frozenset())
    if not model:
        unchecked = (*unchecked, "that system and candidates are those of a model (`--model`)")
    return VerifyReport(checks, (), unchecked, what="claims", doubt="")


def _of_the_model(
    document: Mapping[str, object], model: Mapping[str, object] | None
) -> Iterator[tuple[str, str, str, bool]]:
    for part, expected in (model or {}).items():
        yield "plan", part, "it is that of the model", document.get(part) == expected


def _said(plan: Plan) -> Iterator[tuple[str, str, str, bool]]:
    open_to = choices(plan)
    yield _stated("plan", "candidates", "they fit the system", offer_faults(plan))
    yield _stated("plan", "signatures", "with them the location becomes known", plan_faults(plan, open_to))
    for number, claimed in enumerate(plan.constraints):
        faults = constraint_faults(plan, open_to, claimed)
        yield _stated("proof", f"constraint {number}", "its runs force it", faults)
    yield from (("plan", "cost", *said) for said in _costs(plan, open_to))


def _shown(document: Mapping[str, object], plan: Plan) -> Iterator[tuple[str, str, str, bool]]:
    """What the file says of its signatures for readers: it has to be what was checked."""
    entries = document.get("signatures")
    shown = zip(entries if isinstance(entries, list) else (), plan.instrumented, strict=False)
    for entry, (number, _, transitions) in shown:
        offer, arcs = plan.offers[number], [plan.arcs[k] for k in transitions]
        meant = {
            "location": "|".join(offer.locations),
            "covers": list(offer.locations),
            "transitions": [[arc.source, arc.event, arc.target] for arc in arcs],
        }
        for key, value in meant.items():
            if key in entry:
                yield "plan", f"signature `{offer.name}`", f"`{key}` is that of what was checked", entry[key] == value
    if "already_observable" in document:
        said = "`already_observable` says that there are no signatures"
        yield "plan", "signatures", said, document["already_observable"] is (not plan.instrumented)


def _stated(certificate: str, part: str, said: str, faults: Iterable[str]) -> tuple[str, str, str, bool]:
    reasons = "; ".join(faults)
    return certificate, part, f"{said} ({reasons})" if reasons else said, not reasons


def _costs(plan: Plan, open_to: tuple[Choice, ...]) -> Iterator[tuple[str, bool]]:
    prices: dict[str, Fraction] = {}
    for offer in plan.offers:
        if offer.residual:
            prices[offer.generator] = min(offer.cost, prices.get(offer.generator, offer.cost))
    named = set(plan.generators)
    yield "the generators are on offer, each named once", named <= set(prices) and len(named) == len(plan.generators)
    yield "`generators` is their number", plan.count == len(plan.generators)
    cost = sum((prices.get(name, Fraction()) for name in named), Fraction())
    yield "`cost` is what they cost", plan.cost == Fraction(repr(float(cost)))
    yield "`optimal` says that cost and lower bound are equal", plan.optimal == (plan.cost == plan.lower_bound)
    saved = (plan.cost - plan.lower_bound) / plan.cost if plan.cost else Fraction()
    yield "`gap` is the share between them", abs(saved - plan.gap) < _ROUNDING
    target = cost if plan.optimal else plan.lower_bound
    yield "every plan costs `lower_bound` at least", _proved(plan, open_to, prices, target)


def _proved(plan: Plan, open_to: tuple[Choice, ...], prices: Mapping[str, Fraction], target: Fraction) -> bool:
    ways: dict[int | str, set[Way]] = {}
    for choice in open_to:
        offer = plan.offers[choice.offer]
        ways.setdefault(offer.name if offer.covering else choice.transitions[0], set()).update(choice.ways)
    demands = (
        frozenset[Way]().union(*(ways.get(needed, ()) for needed in _needed(claimed))) for claimed in plan.constraints
    )
    return costs_at_least(prices, demands, target)


def _needed(claimed: Claimed) -> tuple[int | str, ...]:
    return (*claimed.transitions, *claimed.detectors)


__all__ = ["verify_plan"]
