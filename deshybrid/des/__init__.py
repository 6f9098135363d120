"""Discrete-event systems: the toolkit under one name, `import deshybrid.des as des`.

A name is loaded from its module when it is first used, since a command needs few of them.

>>> import deshybrid.des as des
>>> plant = des.DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)])
>>> des.determinise(plant).states
(('1', '2'),)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deshybrid.des.automaton import *
    from deshybrid.des.composition import *
    from deshybrid.des.detectability import *
    from deshybrid.des.epsilon import *
    from deshybrid.des.estimates import *
    from deshybrid.des.faults import *
    from deshybrid.des.languages import *
    from deshybrid.des.observability import *
    from deshybrid.des.observer import *
    from deshybrid.des.opacity import *
    from deshybrid.des.operations import *
    from deshybrid.des.persistence import *
    from deshybrid.des.signatures import *

_MODULES = {  # of each module all that it calls its own
    "automaton": "DES Output Transition",
    "composition": "Composition JointRun JointTransition parallel product unfold",
    "detectability": "DetectabilityReport WordLasso strong_detectability strong_periodic_detectability "
    "weak_detectability weak_periodic_detectability",
    "epsilon": "Edge Moves OutputAutomaton eliminate_epsilon moves_by_location",
    "estimates": "ClosedSets closed_sets current_estimates initial_estimates",
    "faults": "FaultReport diagnosability predictability",
    "languages": "DeterministicAutomaton LanguageReport determinise equivalent included minimise",
    "observability": "C2Failure Method ObservabilityReport Step Undecided UndecidedCheck Witness "
    "check_observability verdict_diagnostics",
    "observer": "LocationObserver build_location_observer entry_estimate_after entry_estimates",
    "opacity": "OpacityReport current_state_opacity initial_state_opacity",
    "operations": "accessible coaccessible hide project reverse trim",
    "persistence": "blocked_locations location_graph persistent_locations require_living",
    "signatures": "Candidate Constraint Signature SignaturePlan recover_observability signatures_of",
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}
__all__ = sorted(_HOMES)  # noqa: PLE0605


if not TYPE_CHECKING:  # a type checker would take it that every name is here

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        found = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = found  # the next use finds it at once
        return found


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
