"""The part of `analyse` on observability: which modes and switches the outputs tell apart, as printed and on a window.

In: a `StochasticSystem` and a `Window`.  Out: verdicts with their text, their JSON and a message for every "no".
Source: Hwang, Balakrishnan and Tomlin (2003), section 2.
"""

from dataclasses import dataclass

from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.stochastic.distance import OutputDistance
from deshybrid.stochastic.observability import LiteralVerdict, literal_verdict
from deshybrid.stochastic.system import StochasticSystem
from deshybrid.stochastic.telling_apart import ModePair, SwitchComparison, Window, compare_modes, compare_switches


@dataclass(frozen=True, eq=False)
class Observability:
    """The literal verdict of the paper, and what the window tells apart."""

    window: Window
    literal: LiteralVerdict
    pairs: tuple[ModePair, ...]
    switches: tuple[SwitchComparison, ...]

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Every "no": modes (DH1202) and switches (DH1203) that the window does not tell apart."""
        within = f"within {self.window.rows} rows with an error of {self.window.error:g}"
        found = []
        for pair in self.pairs:
            if pair.distance.rows_that_suffice(self.window.error) is None:
                text = f"modes `{pair.first}` and `{pair.second}` are not told apart {within}"
                found.append(diagnostic("DH1202", text, notes=(_growth(pair.distance),)))
        for switch in self.switches:
            if switch.distance.rows_that_suffice(self.window.error) is None:
                text = f"a switch from `{switch.source}` to `{switch.target}` is not seen {within}"
                found.append(diagnostic("DH1203", text, notes=(_growth(switch.distance),)))
        return tuple(found)

    def record(self) -> dict[str, object]:
        """Return the part of the JSON."""
        return {
            **_literal_record(self.literal),
            "window": {"rows": self.window.rows, "before": self.window.before, "error": self.window.error},
            "pairs": [self._pair_record(pair) for pair in self.pairs],
            "switches": [self._switch_record(switch) for switch in self.switches],
        }

    def _pair_record(self, pair: ModePair) -> dict[str, object]:
        return {
            "modes": [pair.first, pair.second],
            "covariances_differ_from": pair.covariances_differ_from,
            "differ_from": pair.differ_from,
            **_distance_record(pair.distance, self.window.error),
            "worst_states": {
                "bhattacharyya": float(pair.worst_states[-1]),
                "rows_needed": pair.rows_needed_from_worst_states(self.window.error),
            },
        }

    def _switch_record(self, switch: SwitchComparison) -> dict[str, object]:
        return {
            "from": switch.source,
            "to": switch.target,
            "differ_from": switch.differ_from,
            **_distance_record(switch.distance, self.window.error),
            "time_known_to": switch.time_known_to,
        }

    def __str__(self) -> str:
        window = self.window
        if not self.pairs:
            return f"{_literal_text(self.literal)}\none mode: there is nothing to tell apart"
        lines = [
            _literal_text(self.literal),
            f"told apart with an error of {window.error:g}, {window.rows} rows looked at:",
        ]
        for pair in self.pairs:
            text = _rows_text(pair.differ_from, pair.distance, window.error)
            lines.append(f"  {pair.first} | {pair.second}: {text}; whatever the state: {_whatever(pair, window)}")
        for switch in self.switches:
            text = _rows_text(switch.differ_from, switch.distance, window.error)
            known = "" if switch.time_known_to is None else f"; its time is known to {switch.time_known_to}"
            lines.append(f"  {switch.source} -> {switch.target}: {text}{known}")
        return "\n".join(lines)


def observability(system: StochasticSystem, window: Window) -> Observability:
    """Return the part on observability; raises `UsageError` (DH1103, DH1201).

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> observability(calm_and_wild(), Window()).diagnostics
    ()
    """
    return Observability(
        window, literal_verdict(system), compare_modes(system, window), compare_switches(system, window)
    )


def _literal_record(verdict: LiteralVerdict) -> dict[str, object]:
    return {
        "lemma_2": verdict.lemma_2,
        "lemma_3": verdict.lemma_3,
        "theorem_1": verdict.theorem_1,
        "joint_index": verdict.index,
        "unobservable": list(verdict.unobservable),
        "equal_covariances": [list(pair) for pair in verdict.equal_modes],
        "equal_at_switch": [list(pair) for pair in verdict.equal_switches],
    }


def _literal_text(verdict: LiteralVerdict) -> str:
    if verdict.index is None:
        names = ", ".join(verdict.unobservable)
        return f"Theorem 1 of Hwang et al. (2003), read literally: fails, since {names} is not observable by itself"
    parts = [f"Lemma 2 {_holds(verdict.lemma_2)} at τ̄ = {verdict.index}", f"Lemma 3 {_holds(verdict.lemma_3)}"]
    return f"Theorem 1 of Hwang et al. (2003), read literally: {_holds(verdict.theorem_1)} ({', '.join(parts)})"


def _holds(verdict: bool) -> str:
    return "holds" if verdict else "fails"


def _distance_record(distance: OutputDistance, error: float) -> dict[str, object]:
    forward, backward, middle = distance.per_row()
    return {
        "rows_needed": distance.rows_needed(error),
        "rows_that_suffice": distance.rows_that_suffice(error),
        "kullback_leibler": [float(distance.forward[-1]), float(distance.backward[-1])],
        "bhattacharyya": float(distance.bhattacharyya[-1]),
        "chernoff": float(distance.chernoff[-1]),
        "per_row": {"kullback_leibler": [forward, backward], "bhattacharyya": middle},
    }


def _rows_text(differ_from: int | None, distance: OutputDistance, error: float) -> str:
    if differ_from is None:
        return "never"
    needed, enough = distance.rows_needed(error), distance.rows_that_suffice(error)
    if needed is None:
        return f"outputs differ from row {differ_from} on, too little"
    return f"outputs differ from row {differ_from} on; rows needed: {needed}, that suffice: {enough or 'more'}"


def _whatever(pair: ModePair, window: Window) -> str:
    """The rows that a test needs which has to work for every state, and so for the worst ones and on average."""
    worst, mean = pair.rows_needed_from_worst_states(window.error), pair.distance.rows_needed(window.error)
    return f"over {window.rows}" if worst is None or mean is None else f"{max(worst, mean)} or more"


def _growth(distance: OutputDistance) -> str:
    *_, last = distance.per_row()
    total = float(distance.bhattacharyya[-1])
    return f"the Bhattacharyya distance at the end of the window is {total:.4g}; the last row added {last:.2g}"


__all__ = ["Observability", "observability"]
