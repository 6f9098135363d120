"""The tracker as a table: every state that can be reached, with all that the step may ask of it.

The same questions as `deshybrid.observer.online` answers, each by one look.  There is no table where commands decide
what is possible, so `allowed` says nothing here.  Like that module and `reference`, this text imports only `typing` and
can be copied into a generated program.  Source: `deshybrid.observer.tables`.
"""

from typing import NamedTuple


class TabulatedTracker(NamedTuple):
    """`states[i]`: (location, provisional, on_event, candidates, timeout, entry_estimate), as in `TrackerState`."""

    states: tuple[
        tuple[
            int,
            bool,
            tuple[int, ...],
            tuple[tuple[int, int, tuple[int, ...], int], ...],
            int,
            tuple[int, ...],
        ],
        ...,
    ]
    restarts: tuple[int, ...]  # by event

    def known(self, state: int) -> tuple[int, bool]:
        """Return the location where it is identified, else -1, and whether a signature is still due for it."""
        return self.states[state][:2]

    def after_event(self, state: int, event: int, allowed: int = -1) -> int:
        """Return the state after event number `event`, -1 where nothing explains it."""
        return self.states[state][2][event]

    def restart_on(self, event: int, allowed: int = -1) -> int:
        """Return the state after an event that the present state does not explain."""
        return self.restarts[event]

    def candidates(self, state: int, allowed: int = -1) -> tuple[tuple[int, int, tuple[int, ...], int], ...]:
        """Return the signatures that are listened for: (signature, active generator, quiet generators, target)."""
        return self.states[state][3]

    def timeout(self, state: int) -> int:
        """Return the state after a detection window of silence; -1: it goes on waiting, -2: that is inconsistent."""
        return self.states[state][4]

    def entry_estimate(self, state: int) -> tuple[int, ...]:
        """Return the numbers of the locations that may have been entered last, ascending."""
        return self.states[state][5]
