"""deshybrid: a discrete-event and automaton toolkit with a hybrid-observer compiler.

>>> import deshybrid as dh
>>> des = dh.DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
>>> dh.check(des).current_location_observable
True
"""

from deshybrid.compiler import Compilation, Design, Recovery, check, compile, design, recover, to_des
from deshybrid.des.automaton import DES, Transition
from deshybrid.des.observability import ObservabilityReport
from deshybrid.diagnostics import DeshybridError, InputError, LimitReached, render_all
from deshybrid.emit import notebook as _pictures  # noqa: F401 - says how notebooks draw what is imported here
from deshybrid.model.load import load, loads
from deshybrid.model.system import HybridSystem

__all__ = [
    "DES",
    "Compilation",
    "DeshybridError",
    "Design",
    "HybridSystem",
    "InputError",
    "LimitReached",
    "ObservabilityReport",
    "Recovery",
    "Transition",
    "check",
    "compile",
    "design",
    "load",
    "loads",
    "recover",
    "render_all",
    "to_des",
]
