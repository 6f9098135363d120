"""Stage 2: from the hybrid system H to its discrete-event system D_H.

In: a `HybridSystem`.  Out: the `DES` with the same locations, events and outputs; what is continuous is forgotten, and
transition number i of the one is transition number i of the other, so that a verdict leads back to the file.
The way back makes a model without continuous state of an automaton, so that its observer can be compiled.
Cost: linear.  Source: Balluchi et al. (2012), section 3.1.
"""

from types import MappingProxyType

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.model.system import HybridSystem, HybridTransition, Location


def abstract(system: HybridSystem) -> DES:
    """Return D_H of a hybrid system.

    >>> from deshybrid.model.load import load
    >>> str(abstract(load("models/balluchi2012/fig2.yaml")).transitions[3])
    '2 -d/ε-> 5'
    """
    arcs = tuple(
        Transition(t.source, t.event, t.target, t.outputs, None, t.span, t.output_span) for t in system.transitions
    )
    spans = {location.name: location.span for location in system.locations if location.span is not None}
    names = tuple(location.name for location in system.locations)
    return DES(names, arcs, system.initial, system.name, MappingProxyType(spans))


def discrete_model(des: DES) -> HybridSystem:
    """Return the model without continuous state whose D_H is `des`.

    Raises `UsageError` (DH0308) where a transition has a signature: a model gets its signatures from `recover`.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)], initial=["1"])
    >>> abstract(discrete_model(des)) == des
    True
    """
    signed = next((t for t in des.transitions if t.signature is not None), None)
    if signed is not None:
        fault = f"`{signed}` has a signature already, and a model gets its signatures from `recover`"
        raise UsageError(diagnostic("DH0308", fault, signed.span))
    arcs = tuple(
        HybridTransition(t.source, t.event, t.target, t.outputs, span=t.span, output_span=t.output_span)
        for t in des.transitions
    )
    locations = tuple(Location(name, span=des.location_spans.get(name)) for name in des.locations)
    return HybridSystem(des.name, locations, arcs, des.initial)


__all__ = ["abstract", "discrete_model"]
