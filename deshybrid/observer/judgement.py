"""What a transition detector compares with its levels at a sample: for people to look at, not for the step.

In: the constants of a step, and the states before and after it.  Out: for each residual generator the numbers that
decide about it, and the levels they are compared with:
- relay and exclusion: |r| over its threshold, by output; at 1 or below in all of them the relay goes on, above the
  second level in one of them it goes off;
- `sprt`: the log-likelihood ratio of "not this location" to "this one", before a decision begins it again; accepted at
  the first level or below, denied at the second or above;
- `imm`: the probability of the location; named at the second level or above, doubted below the first;
- `glr`: the largest log of the generalised likelihood ratio; the location is denied while it is above the level.

They are computed from what the step keeps, by its own functions, so that they are what was decided by.
Cost: that of the residuals.  Source: the modules `reference` and `tables`.
"""

from typing import NamedTuple

from deshybrid.observer import reference
from deshybrid.observer.reference import Numbers, State, Tables

LIKELIHOOD = "log-likelihood ratio"
PROBABILITY = "probability"


class Scale(NamedTuple):
    """What one generator is judged by: the names of the numbers, and the levels they are compared with, from below."""

    curves: tuple[str, ...]
    levels: Numbers


def scales(tables: Tables, outputs: tuple[str, ...]) -> tuple[Scale, ...]:
    """Return the scale of each generator; `outputs` are the names of the system's outputs."""
    found = []
    for generator in tables["generators"]:
        if tables["decision"] == "glr":
            found.append(Scale((LIKELIHOOD,), (tables["limits"][0] / 2.0,)))
        elif tables["decision"] == "imm":
            found.append(Scale((PROBABILITY,), (0.5, tables["confidence"])))
        elif tables["decision"] == "sprt":
            found.append(Scale((LIKELIHOOD,), tuple(generator["test"][2:])))
        else:
            names = tuple(f"|{outputs[channel]}| / threshold" for channel in _weighed(generator))
            found.append(Scale(names, (1.0, generator["release"])))
    return tuple(found)


def judged(tables: Tables, before: State, after: State) -> tuple[Numbers, ...]:
    """Return by generator the numbers of its scale, at a valid sample; nothing where there was none yet."""
    if after.sample is None:
        return ()
    found = []
    for g, generator in enumerate(tables["generators"]):
        residual = reference.residuals(generator, after.z[g], *after.sample)
        if tables["decision"] == "glr":
            found.append((_shift(tables["limits"], after.evidence[g], len(residual)),))
        elif tables["decision"] == "imm":
            found.append((reference.likelihood(tables, tables["owner"][g], after.evidence),))
        elif tables["decision"] == "sprt":
            slope, offset, _, _ = generator["test"]
            white = reference.affine(generator["whitening"], generator["unbiased"], residual)
            found.append((before.evidence[g][0] + (slope * reference.square(white) - offset),))
        else:
            weight = generator["weight"]
            found.append(tuple(abs(residual[channel]) * weight[channel] for channel in _weighed(generator)))
    return tuple(found)


def _weighed(generator: Tables) -> list[int]:
    """The outputs that the generator has a residual of."""
    return [channel for channel, weight in enumerate(generator["weight"]) if weight > 0.0]


def _shift(limits: Numbers, recent: Numbers, width: int) -> float:
    """The largest |S_N|²/(2 N) over the last N white residuals; the limits of |S_N|² grow with N."""
    total, largest = (0.0,) * width, 0.0
    for number, limit in enumerate(limits):
        latest = recent[number * width : (number + 1) * width]
        total = tuple(first + second for first, second in zip(total, latest, strict=True))
        largest = max(largest, reference.square(total) / limit)
    return largest * limits[0] / 2.0


__all__ = ["LIKELIHOOD", "PROBABILITY", "Scale", "judged", "scales"]
