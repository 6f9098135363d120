"""From a model file to a stochastic system: what the keys `transition_probability`, `noise` and `prior` mean.

In: a `HybridSystem` and, in continuous time, the step (s) of the trace.  Out: a `StochasticSystem`, or every part that
the model lacks, in one message each.  Models in discrete time are taken as they are.  Models in continuous time are
sampled exactly over one step, inputs held: then `process` is the intensity of white noise (its square per second),
`measurement` the covariance of one sample, and `transition_probability` that of one step.

One matrix exponential a mode.  Source: Hwang et al. (2006), (1) and (2); Van Loan (1978).
"""

import numpy as np

from deshybrid.diagnostics import Diagnostic, ModelError, UsageError, diagnostic, raise_all
from deshybrid.linear.sampling import sample_covariance, sample_dynamics
from deshybrid.model.system import HybridSystem, Location
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem


def stochastic_system(system: HybridSystem, *, step: float | None = None) -> StochasticSystem:
    """Return the stochastic system of a model; `step` (s) is needed in continuous time only.

    The prior's probability is by default shared equally by the `initial` locations.

    Raises `ModelError` (DH1101) where the model lacks a part, `UsageError`: DH0306 for a purely discrete model, DH0601
    where a model in continuous time is given no step.

    >>> from deshybrid.model.load import load
    >>> stochastic_system(load("models/hwang2006/turn.yaml")).names
    ('CV', 'CT')
    """
    require_stochastic(system)
    if system.time_step is None and step is None:
        text = "a model in continuous time is filtered at a step, which takes a trace of two rows or more"
        raise UsageError(diagnostic("DH0601", text))
    prior, chain = system.prior, system.probability_from_to
    if prior is None or prior.mean is None or prior.covariance is None or chain is None:
        raise ModelError(*_lacking(system))
    names = tuple(location.name for location in system.locations)
    transition = ModeTransition.from_rows(names, [[chain[i].get(j, 0.0) for j in names] for i in names])
    given = prior.probability or {name: 1.0 / len(system.initial) for name in system.initial}
    inputs = len(system.input_names)
    modes = [_mode(location, inputs, None if system.time_step else step) for location in system.locations]
    mu = [given.get(name, 0.0) for name in names]
    return StochasticSystem(modes, transition, x=prior.mean, P=prior.covariance, mu=mu)


def require_stochastic(system: HybridSystem) -> None:
    """Raise what `stochastic_system` raises of the model itself: DH0306, or DH1101 for every part that is missing.

    >>> from deshybrid.model.load import load
    >>> require_stochastic(load("models/hwang2006/turn.yaml"))
    """
    if system.is_discrete:
        raise UsageError(diagnostic("DH0306", f"model `{system.name}` has no continuous state, so nothing to filter"))
    raise_all(_lacking(system), ModelError)


def _lacking(system: HybridSystem) -> list[Diagnostic]:
    found = []
    prior = system.prior
    parts = {
        "transition_probability": system.probability_from_to is not None,
        "prior: mean": prior is not None and prior.mean is not None,
        "prior: covariance": prior is not None and prior.covariance is not None,
    }
    for key, there in parts.items():
        if not there:
            found.append(diagnostic("DH1101", f"model `{system.name}` does not state `{key}`"))
    for location in system.locations:
        for key, value in (("process", location.process_noise), ("measurement", location.measurement_noise)):
            if value is None:
                text = f"location `{location.name}` has no covariance `noise: {key}`"
                found.append(diagnostic("DH1101", text, location.span, "of this location"))
    return found


def _mode(location: Location, inputs: int, step: float | None) -> Mode:
    """The mode of a location that lacks nothing; `step` None where its dynamics are discrete already."""
    dynamics, Q, R = location.dynamics, location.process_noise, location.measurement_noise
    if dynamics is None or Q is None or R is None:
        raise ModelError(diagnostic("DH1101", f"location `{location.name}` has no dynamics or no `noise`"))
    if step is not None:
        location.noise_form.require_fixed("a model in continuous time", location.name, of=("process_by_state",))
        Q = sample_covariance(dynamics.A, Q, step)
        dynamics = sample_dynamics(dynamics, step)
    places = list(location.input_index)
    B, D = np.zeros((len(dynamics.f), inputs)), np.zeros((len(dynamics.g), inputs))
    B[:, places], D[:, places] = dynamics.B, dynamics.D
    return Mode(
        location.name,
        F=dynamics.A,
        H=dynamics.C,
        Q=Q,
        R=R,
        B=B,
        D=D,
        f=dynamics.f,
        g=dynamics.g,
        output_index=location.output_index,
        noise=location.noise_form,
    )


__all__ = ["require_stochastic", "stochastic_system"]
