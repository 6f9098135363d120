"""All parts of `analyse` on one model.

In: a stochastic model (a path or a system) and what is asked of it.  Out: an `Analysis`, with its text, its JSON, and a
message for every "no".  Source: Hwang, Balakrishnan and Tomlin (2003, 2006); Böker.
"""

from dataclasses import dataclass, field
from math import inf

import numpy as np

from deshybrid.analysis.convergence import Convergence, convergence
from deshybrid.analysis.detection import Detection, detection
from deshybrid.analysis.observability import Observability, observability
from deshybrid.compiler import Source, to_hybrid
from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic
from deshybrid.model.system import HybridSystem
from deshybrid.stochastic.from_model import require_stochastic, stochastic_system
from deshybrid.stochastic.held_input import hold_filter, hold_input
from deshybrid.stochastic.sojourn import Demand
from deshybrid.stochastic.system import StochasticSystem
from deshybrid.stochastic.telling_apart import Window


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked: the window, and what the error has to do between switches (`Demand`; state_bound for every state).

    `step` (s) for models in continuous time only.  `inputs`: the values, by name, at which known inputs are held for
    what is told apart and for delays; the others are held at 0.
    """

    window: Window = field(default_factory=Window)
    factor: float = 0.99
    delay: int = 0
    error_bound: float = 0.0
    state_bound: float | None = None
    step: float | None = None
    inputs: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """The answers for one model, and what they were made from.

    Where modes measure different outputs there is nothing to be observed or detected: the mode is taken as known.
    """

    name: str
    system: StochasticSystem
    observability: Observability | None
    convergence: Convergence
    detection: Detection | None
    inputs: tuple[tuple[str, float], ...] = ()  # by name, as they were held

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """A message for every "no"."""
        told = () if self.observability is None else self.observability.diagnostics
        return (*told, *self.convergence.diagnostics)

    @property
    def holds(self) -> bool:
        """Whether there is no "no"."""
        return not self.diagnostics

    def record(self) -> dict[str, object]:
        """Return what `analyse --json` prints (format `deshybrid-analysis/1`)."""
        return {
            "format": "deshybrid-analysis/1",
            "name": self.name,
            "modes": list(self.system.names),
            "holds": self.holds,
            "inputs": dict(self.inputs),
            "observability": None if self.observability is None else self.observability.record(),
            "convergence": self.convergence.record(),
            "detection": None if self.detection is None else self.detection.record(),
        }

    def __str__(self) -> str:
        known = "modes measure different outputs, so that the mode is taken as known"
        held = ", ".join(f"{name} = {value:g}" for name, value in self.inputs)
        told = f"inputs held at {held} where modes are told apart and delays predicted" if held else None
        parts = (told, self.observability or known, self.convergence, self.detection)
        return "\n".join(str(part) for part in parts if part is not None)


def analyse(source: Source, question: Question | None = None) -> Analysis:
    """Return what can be known of a stochastic model (a path or a system) beforehand.

    Bounds of the state and of the input are those of the model's `bounds` where the question states none.

    Raises `ModelError` (DH1101) and `UsageError` (DH0306, DH0601, DH1201, DH1205, DH1209; DH1103 for a delay where
    modes measure different outputs).

    >>> analyse("models/hwang2006/turn.yaml").holds
    True
    """
    model, question = to_hybrid(source), question or Question()
    require_stochastic(model)
    step = _step(model, question.step)
    system = stochastic_system(model, step=step)
    if question.delay:
        system.comparable_bank  # noqa: B018 - a filter of the wrong mode cannot run on other outputs
    held = _held(model, question)
    u = np.array([value for _, value in held])
    still = hold_input(system, u) if held else system
    comparable = bool((system.bank.measured == system.bank.measured[0]).all())
    converging = convergence(system, _demand(model, question), step)
    filters = [state.filter for state in converging.states if state.filter is not None]
    complete = [hold_filter(one, u) if held else one for one in filters] if len(filters) == len(system.modes) else []
    return Analysis(
        model.name,
        system,
        observability(still, question.window) if comparable else None,
        converging,
        detection(still, question.window.rows, complete) if comparable else None,
        held,
    )


def _step(model: HybridSystem, step: float | None) -> float:
    """The distance of rows: the model's own, or in continuous time the one that is asked for; raises DH0601."""
    own = model.time_step
    if own is None and step is None:
        helps = ("state the distance of the rows: `--step SECONDS`",)
        raise UsageError(diagnostic("DH0601", "a model in continuous time is analysed at a step", helps=helps))
    if step is not None and not (0.0 < step < inf and own in (None, step)):
        expected = "a positive number" if own is None else f"{own:g} s, which the model describes"
        raise UsageError(diagnostic("DH0601", f"the step is {step:g} s, expected {expected}"))
    return own or step or 1.0


def _held(model: HybridSystem, question: Question) -> tuple[tuple[str, float], ...]:
    """Every input with the value at which it is held."""
    asked = dict(question.inputs)
    unknown = [name for name in asked if name not in model.input_names]
    if unknown:
        names = ", ".join(f"`{name}`" for name in model.input_names) or "none"
        helps = (f"the inputs of `{model.name}` are {names}",)
        raise UsageError(diagnostic("DH1209", f"there is no input `{unknown[0]}`", helps=helps))
    return tuple((name, asked.get(name, 0.0)) for name in model.input_names)


def _demand(model: HybridSystem, question: Question) -> Demand:
    state, bounds = question.state_bound, model.bounds
    known = bounds.state if state is None else np.full(len(model.state_names), state)
    return Demand(question.factor, question.delay, question.error_bound, known, bounds.input)


__all__ = ["Analysis", "Question", "analyse"]
