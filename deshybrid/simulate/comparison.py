"""The comparison of a ratio: what plain logic without a model makes of two outputs; the bar for an observer.

In: the model's `simulation: {comparison: ...}` and two measured outputs over time.  Out: a name for each sample.  A
ratio fits a location within a relative band; of several that fit, the nearest counts; an answer is named once it has
lasted.

Linear in samples times locations.  Source: what gearbox controllers do without a model: the crankshaft's speed over the
output shaft's, compared with the ratios of the gears.
"""

import math
from collections.abc import Sequence

from deshybrid.model.system import RatioComparison
from deshybrid.simulate.trace import Trace

_SLACK = 1e-9  # s, so that an answer that lasts exactly as long as asked for is named


def compare_ratios(
    rule: RatioComparison, time: Sequence[float], numerator: Sequence[float], denominator: Sequence[float]
) -> tuple[str | None, ...]:
    """Return the location that the comparison names at each time (s); a sample that is NaN fits no location.

    >>> rule = RatioComparison("engine", "shaft", {"first": 4.0, "second": 2.0}, "open", band=0.05, debounce=0.1)
    >>> compare_ratios(rule, [0.0, 0.1, 0.2, 0.3], [40.0, 41.0, 30.0, 20.0], [10.0, 10.0, 10.0, 10.0])
    ('open', 'first', 'first', 'first')
    """
    named, last, since = rule.otherwise, rule.otherwise, time[0] if len(time) else 0.0
    answers = []
    for now, above, below in zip(time, numerator, denominator, strict=True):
        answer = _nearest(rule, above, below)
        since = now if answer != last else since
        last = answer
        if now - since >= rule.debounce - _SLACK:
            named = answer
        answers.append(named)
    return tuple(answers)


def names_by_ratio(rule: RatioComparison, trace: Trace) -> tuple[str | None, ...]:
    """Return what the comparison names in each row of a trace."""
    places = [trace.system.output_names.index(name) for name in (rule.numerator, rule.denominator)]
    above, below = trace.outputs[:, places].T.tolist()
    return compare_ratios(rule, trace.time.tolist(), above, below)


def _nearest(rule: RatioComparison, above: float, below: float) -> str | None:
    """The location whose ratio fits best, or `otherwise`."""
    if not abs(below) > rule.slowest:
        return rule.otherwise
    errors = {name: _error(above, ratio * below) for name, ratio in rule.ratio.items()}
    best = min(errors, key=errors.__getitem__)
    return best if errors[best] <= rule.band else rule.otherwise


def _error(value: float, expected: float) -> float:
    """The relative distance of a value from what is expected."""
    error = abs(value / expected - 1.0) if expected else math.inf
    return math.inf if math.isnan(error) else error


__all__ = ["compare_ratios", "names_by_ratio"]
