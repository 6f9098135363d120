"""The sampling step of a model: stated, or derived from what moves fastest in it.

In: a `HybridSystem`.  Out: seconds.  `design`, `run` and `simulate` take the same step, so that the traces of one fit
the others.  One spectrum a location, O(n³) each.
"""

import numpy as np

from deshybrid.model.system import HybridSystem

SHARE = 0.05  # of the shortest time constant


def sampling_step(system: HybridSystem) -> float:
    """Return the step (s): that of `time`, else that of `observer`, else a twentieth of the shortest time constant.

    The time constants are those of the plant's modes, of the poles that the model asks for and of its rate; the derived
    step is rounded to one digit.  A model in which nothing moves, such as a purely discrete one, has a step of 1 s.

    >>> from deshybrid.model.load import load
    >>> sampling_step(load("models/balluchi2012/driveline.yaml"))
    0.012
    """
    stated = system.time_step or system.observer.step
    if stated is not None:
        return stated
    wishes = system.observer
    speeds = [abs(pole) for poles in wishes.poles.values() for pole in poles]
    speeds += [wishes.rate or 0.0]
    speeds += [
        float(np.abs(np.linalg.eigvals(location.dynamics.A)).max(initial=0.0))
        for location in system.locations
        if location.dynamics is not None
    ]
    fastest = max(speeds)
    return float(f"{SHARE / fastest:.1g}") if fastest > 0.0 else 1.0
