"""Stage 2: from the hybrid system H to its discrete-event system D_H.

In: a `HybridSystem`.  Out: the `DES` with the same locations, events and outputs; what is continuous is forgotten, and
transition number i of the one is transition number i of the other, so that a verdict leads back to the file.
Cost: linear.  Source: Balluchi et al. (2012), section 3.1.
"""

from types import MappingProxyType

from deshybrid.des.automaton import DES, Transition
from deshybrid.model.system import HybridSystem


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


__all__ = ["abstract"]
