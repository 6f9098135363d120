"""Pictures for notebooks: how systems, observers and verdicts are drawn when a cell ends with one.

In: a `DES`, its D'_H, its D_O, or an `ObservabilityReport`.  Out: SVG, or None where Graphviz is missing or the system
is too large to be looked at.  The drawings are those of `deshybrid draw`; the ids in one begin with its checksum, since
many drawings share a page.  Cost: a verdict for a `DES`, then the layout, at most 300 nodes.
"""

from typing import TYPE_CHECKING

from deshybrid.des.automaton import DES
from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.observability import check_observability
from deshybrid.des.observer import LocationObserver
from deshybrid.des.report import ObservabilityReport
from deshybrid.diagnostics import DeshybridError
from deshybrid.diagnostics.pictured import notebook_picture

if TYPE_CHECKING:
    from deshybrid.emit.picture import Picture

MOST_DECIDED = 300  # locations of a system that is only looked at: no verdict is waited for beyond
MOST_CONDENSED = 20_000  # states that are condensed to a drawing


@notebook_picture.register
def _of_des(des: DES) -> str | None:
    if not 0 < len(des.locations) <= MOST_DECIDED:
        return None
    return _of_report(check_observability(des))


@notebook_picture.register
def _of_report(report: ObservabilityReport) -> str | None:
    from deshybrid.emit.picture import des_picture

    if len(report.des.locations) + len(report.des) > MOST_CONDENSED:
        return None
    return _svg(des_picture(report, title=report.des.name))


@notebook_picture.register
def _of_output_automaton(automaton: OutputAutomaton) -> str | None:
    from deshybrid.emit.picture import dprime_picture

    if not 0 < len(automaton.des.locations) <= MOST_DECIDED:
        return None
    title = f"{automaton.des.name}: without silent transitions"
    return _svg(dprime_picture(check_observability(automaton.des), title=title))


@notebook_picture.register
def _of_observer(observer: LocationObserver) -> str | None:
    from deshybrid.emit.picture import location_observer_picture

    if len(observer.states) + len(observer.transitions) > MOST_CONDENSED:
        return None
    return _svg(location_observer_picture(observer, title=f"{observer.automaton.des.name}: the location observer"))


def _svg(picture: "Picture") -> str | None:
    """None where nothing can draw: a picture less is no reason to end a notebook."""
    from hashlib import sha256

    from deshybrid.emit.drawing import draw
    from deshybrid.emit.html import inline_svg

    try:
        drawn = draw(picture, "svg")
    except DeshybridError:
        return None
    return inline_svg(drawn, f"d{sha256(drawn).hexdigest()[:8]}")
