"""The part of `analyse` on convergence: steady-state filters, rows between switches, boundedness.

In: a `StochasticSystem`, a `Demand`, the step in s.  Out: values with their text, their JSON and a message for every
"no".  Source: Hwang, Balakrishnan and Tomlin (2003), section 3; (2006), Theorem 4.1; Böker.
"""

from dataclasses import asdict, dataclass
from math import isfinite, log

from deshybrid.continuous.conic import has_solver
from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.stochastic.boundedness import Boundedness, boundedness
from deshybrid.stochastic.constant_gains import ConstantGains, certify_constant_gains
from deshybrid.stochastic.sojourn import Demand, ModeTerms, SojournBound, sojourn_bound
from deshybrid.stochastic.steady_state import SteadyState, steady_state
from deshybrid.stochastic.system import StochasticSystem


@dataclass(frozen=True, slots=True, eq=False)
class Convergence:
    """`bounds` for the predictor and the filter gain, empty where a mode has no steady-state filter; `inequalities`,
    the certificate without delay, where every error shrinks by the factor and a solver is there (extra `lmi`), else
    None; `boundedness` for dwell times of 1, 2, ... rows up to the first that is enough; `step` in s.
    """

    step: float
    demand: Demand
    states: tuple[SteadyState, ...]
    bounds: tuple[SojournBound, ...]
    inequalities: ConstantGains | None
    boundedness: tuple[Boundedness, ...]

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Modes without a filter (DH1206), no number of rows that is enough (DH1207), an unbounded filter (DH1208)."""
        found = [
            diagnostic("DH1206", f"mode `{state.mode.name}` has no steady-state filter", notes=(state.reason,))
            for state in self.states
            if state.filter is None
        ]
        if self.bounds and not any(bound.by_condition or bound.by_powers for bound in self.bounds):
            text = f"no rows between switches are enough for a factor of {self.demand.factor:g} a row"
            found.append(diagnostic("DH1207", text, notes=(_why_not(self.demand, self.bounds[0]),)))
        last = self.boundedness[-1]
        if last.bounded is False:
            notes = (f"along {' -> '.join(last.cycle)}, repeated, an unseen part grows by {last.growth:.4g} each time",)
            text = f"the covariance of the switching filter is not bounded, with stays of {last.dwell} rows or more"
            found.append(diagnostic("DH1208", text, notes=notes))
        return tuple(found)

    def record(self) -> dict[str, object]:
        """Return the part of the JSON."""
        demand = self.demand
        return {
            "filters": [_filter_record(state) for state in self.states],
            "demand": {
                "factor": demand.factor,
                "delay": demand.delay,
                "error_bound": demand.error_bound,
                "state_bound": None if demand.state is None else demand.state.tolist(),
            },
            "rows_between_switches": [_bound_record(bound, self.step) for bound in self.bounds],
            "inequalities": None if self.inequalities is None else _inequalities_record(self.inequalities, self.step),
            "boundedness": [asdict(found) | {"cycle": list(found.cycle)} for found in self.boundedness],
        }

    def __str__(self) -> str:
        shown = [
            f"{state.mode.name} {'none' if state.filter is None else f'{state.filter.radius:.3g}'}"
            for state in self.states
        ]
        lines = [f"steady-state filters, the factor of their errors a row: {', '.join(shown)}"]
        if self.bounds:
            lines.append(f"rows between switches, for a factor of {self.demand.factor:g} a row{_delayed(self.demand)}:")
        lines += [f"  {bound.gain} gain: {_bound_text(bound, self.step)}" for bound in self.bounds]
        if self.inequalities is not None:
            rows = self.inequalities.required_steps
            held = "none" if rows is None else f"{rows} ({rows * self.step:g} s)"
            lines.append(f"  predictor gain, by matrix inequalities, without delay: {held}")
        return "\n".join([*lines, *(_boundedness_text(found) for found in self.boundedness)])


def convergence(system: StochasticSystem, demand: Demand, step: float) -> Convergence:
    """Return the part on convergence.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> print(convergence(calm_and_wild(), Demand(), 1.0))
    steady-state filters, the factor of their errors a row: calm 0.73, wild 0.0917
    rows between switches, for a factor of 0.99 a row:
      predictor gain: 1 (1 s) by κ, 1 by powers; 1 as printed
      filter gain: 1 (1 s) by κ, 1 by powers; 1 as printed
      predictor gain, by matrix inequalities, without delay: 1 (1 s)
    covariance of the switching filter: bounded, the state shows in 1 row
    """
    states = tuple(steady_state(mode) for mode in system.modes)
    filters = [state.filter for state in states if state.filter is not None]
    bounds: tuple[SojournBound, ...] = ()
    if len(filters) == len(states):
        bounds = (sojourn_bound(filters, "predictor", demand), sojourn_bound(filters, "filter", demand))
    tried: list[Boundedness] = []
    for dwell in range(1, len(system.x) + 2):
        tried.append(boundedness(system, dwell))
        if tried[-1].bounded is not False:
            break
    inequalities = None
    if bounds and has_solver() and all(found.radius < demand.factor for found in filters):
        inequalities = certify_constant_gains(system, step=step, rate=-log(demand.factor) / step)
    return Convergence(step, demand, states, bounds, inequalities, tuple(tried))


def _why_not(demand: Demand, bound: SojournBound) -> str:
    terms = max(bound.modes, key=lambda terms: max(terms.radius / demand.factor, terms.settling))
    if terms.radius >= demand.factor:
        return f"the error of mode `{terms.mode}` shrinks by {terms.radius:.4g} a row by itself"
    if not isfinite(terms.mismatch):
        return f"the wrong filter of mode `{terms.mode}` follows a state, or an input, of which no bound is stated"
    added = f"{demand.delay} rows of the wrong filter add up to {terms.mismatch:.4g} to a component of the error each"
    return f"{added}, and an error of {demand.error_bound:g} may be left"


def _delayed(demand: Demand) -> str:
    return "" if not demand.delay else f", a delay of {demand.delay} and an error of {demand.error_bound:g} left"


def _bound_text(bound: SojournBound, step: float) -> str:
    rows = bound.by_condition
    held = "none by κ" if rows is None else f"{rows} ({rows * step:g} s) by κ"
    return f"{held}, {bound.by_powers or 'none'} by powers; {bound.as_printed or 'none'} as printed"


def _boundedness_text(found: Boundedness) -> str:
    which = "" if found.dwell == 1 else f" with stays of {found.dwell} rows or more"
    start = f"covariance of the switching filter{which}:"
    if found.bounded:
        return f"{start} bounded, the state shows in {found.rows} row{'' if found.rows == 1 else 's'}"
    cycle = " -> ".join(found.cycle)
    if found.bounded is False:
        return f"{start} not bounded, along {cycle}"
    return f"{start} undecided" + (f"; along {cycle} a part that does not grow is never seen" if cycle else "")


def _filter_record(state: SteadyState) -> dict[str, object]:
    made = state.filter
    return {
        "mode": state.mode.name,
        "exists": made is not None,
        "reason": state.reason or None,
        "radius": None if made is None else made.radius,
        "positive_definite": None if made is None else made.positive_definite,
        "predictor_gain": None if made is None else made.predictor_gain.tolist(),
        "filter_gain": None if made is None else made.filter_gain.tolist(),
    }


def _bound_record(bound: SojournBound, step: float) -> dict[str, object]:
    rows = bound.by_condition
    return {
        "gain": bound.gain,
        "by_condition": rows,
        "seconds": None if rows is None else rows * step,
        "by_powers": bound.by_powers,
        "as_printed": bound.as_printed,
        "modes": [_terms_record(terms) for terms in bound.modes],
    }


def _inequalities_record(found: ConstantGains, step: float) -> dict[str, object]:
    rows, cycle = found.required_steps, found.certificate.limit.cycle
    return {
        "rows": rows,
        "seconds": None if rows is None else rows * step,
        "worst_cycle": None if cycle is None else list(cycle.locations),
        "worst_stays": None if cycle is None else [round(stay / step) for stay in cycle.stays],
        "diverges": found.diverges,
    }


def _terms_record(terms: ModeTerms) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and not isfinite(value) else value for key, value in asdict(terms).items()
    }


__all__ = ["Convergence", "convergence"]
