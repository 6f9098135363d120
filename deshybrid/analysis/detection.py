"""The part of `analyse` on detection delays: which switches a filter names soon, and which the means never show.

In: a `StochasticSystem`, the rows looked at after a switch, the steady-state filters where all modes have one.  Out:
values with their text and their JSON.  Source: Hwang, Balakrishnan and Tomlin (2006), section 4.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import permutations
from math import isfinite

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.detection_delay import SETTLED_ROWS, Bank, Delay, drawn_delays, predicted_delay
from deshybrid.stochastic.mean_residual import Equality, equalities, mismatch, steady_residual
from deshybrid.stochastic.printed_delays import PrintedDelays, printed_delays
from deshybrid.stochastic.steady_state import SteadyFilter
from deshybrid.stochastic.system import StochasticSystem

TRIALS, SEED = 200, 0
METHODS: tuple[Bank, Bank] = ("imm", "mmae")


@dataclass(frozen=True, slots=True, eq=False)
class SwitchDelay:
    """One switch and one filter: the delay predicted, those of drawn runs, and what the paper's propositions say."""

    predicted: Delay
    drawn: FloatArray  # (trials,), infinite where the mode was not named
    printed: PrintedDelays | None

    @property
    def median(self) -> float:
        """The median of the drawn delays; infinite where half of the runs do not name the mode."""
        return float(np.median(self.drawn))

    @property
    def foreseen(self) -> int | None:
        """The predicted rows, None where the mean run does not name the mode before the switch either."""
        return self.predicted.rows if self.predicted.source_named else None


@dataclass(frozen=True, slots=True, eq=False)
class MeanOfResidual:
    """The steady-state mean of one filter's residual while another mode is true, None where there is none."""

    filter: str
    true: str
    steady: FloatArray | None
    equalities: tuple[Equality, ...]

    @property
    def told(self) -> bool:
        """Whether some equality fails, so that the mean may tell the modes apart."""
        return not all(equality.holds for equality in self.equalities)


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """Pairs of delays, by IMM and by MMAE, the easiest switch first: by the mean of the drawn delays of the IMM, a run
    that does not name the mode counting as one row more than were looked at.  Without steady-state filters no
    `residuals`.
    """

    rows: int
    switches: tuple[tuple[SwitchDelay, SwitchDelay], ...]
    residuals: tuple[MeanOfResidual, ...]

    def record(self) -> dict[str, object]:
        """Return the part of the JSON."""
        return {
            "settled_rows": SETTLED_ROWS,
            "rows": self.rows,
            "trials": TRIALS,
            "seed": SEED,
            "easiest_first": [[pair[0].predicted.source, pair[0].predicted.target] for pair in self.switches],
            "switches": [_switch_record(pair) for pair in self.switches],
            "residuals": [_residual_record(found) for found in self.residuals],
        }

    def __str__(self) -> str:
        start = f"rows until a switch is named, predicted and (median of {TRIALS} drawn runs), the easiest first:"
        lines = [start if self.switches else "the chain has no switches"]
        for pair in self.switches:
            shown = [
                f"{found.predicted.method.upper()} {found.foreseen or '-'} ({_shown(found.median)})" for found in pair
            ]
            lines.append(f"  {pair[0].predicted.source} -> {pair[0].predicted.target}: {', '.join(shown)}")
        hidden = [f"{found.true} in the filter of {found.filter}" for found in self.residuals if not found.told]
        return "\n".join([*lines, *([f"means of residuals do not show {'; '.join(hidden)}"] if hidden else [])])


def detection(system: StochasticSystem, rows: int, filters: Sequence[SteadyFilter]) -> Detection:
    """Return the part on delays; `filters`: those of all modes, empty where some mode has none.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> print(detection(calm_and_wild(), 50, ()))
    rows until a switch is named, predicted and (median of 200 drawn runs), the easiest first:
      wild -> calm: IMM - (1), MMAE - (3)
      calm -> wild: IMM - (2), MMAE - (2)
    """
    chain, names = system.chain.probability_to_from, system.names
    found = []
    for source, target in permutations(names, 2):
        if chain[names.index(target), names.index(source)] > 0.0:
            one, two = (_delay(system, (source, target), method, rows, filters) for method in METHODS)
            found.append((one, two))
    found.sort(key=lambda pair: float(np.minimum(pair[0].drawn, rows + 1.0).mean()))
    residuals = []
    for own, true in permutations(filters, 2):
        pair = mismatch(own, true.mode)
        residuals.append(MeanOfResidual(own.mode.name, true.mode.name, steady_residual(pair), equalities(pair)))
    return Detection(rows, tuple(found), tuple(residuals))


def _delay(
    system: StochasticSystem, switch: tuple[str, str], method: Bank, rows: int, filters: Sequence[SteadyFilter]
) -> SwitchDelay:
    source, target = switch
    return SwitchDelay(
        predicted_delay(system, source, target, method, rows),
        drawn_delays(system, source, target, method, rows=rows, trials=TRIALS, seed=SEED),
        printed_delays(system, filters, source, target, method, rows=rows) if filters else None,
    )


def _shown(rows: float) -> str:
    return f"{rows:g}" if isfinite(rows) else "never"


def _switch_record(pair: Sequence[SwitchDelay]) -> dict[str, object]:
    record: dict[str, object] = {"from": pair[0].predicted.source, "to": pair[0].predicted.target}
    for found in pair:
        printed = found.printed
        record[found.predicted.method] = {
            "predicted": found.foreseen,
            "by_third_condition": found.predicted.by_third_condition if found.predicted.source_named else None,
            "source_named": found.predicted.source_named,
            "drawn_median": found.median if isfinite(found.median) else None,
            "drawn_missed": int(np.isinf(found.drawn).sum()),
            "as_printed": None
            if printed is None
            else asdict(printed) | {"difficulty": printed.difficulty if isfinite(printed.difficulty) else None},
        }
    return record


def _residual_record(found: MeanOfResidual) -> dict[str, object]:
    return {
        "filter": found.filter,
        "true": found.true,
        "steady_mean": None if found.steady is None else found.steady.tolist(),
        "told": found.told,
        "equalities": [asdict(equality) for equality in found.equalities],
    }


__all__ = ["Detection", "MeanOfResidual", "SwitchDelay", "detection"]
