"""The tracker evaluated at run time: what an event, a signature or silence makes of a set of pairs, move by move.

In: the moves of the locations, as `deshybrid.observer.tracker` collects them from a plan.  A tracker state is a bit
mask of pairs (location, signature due): bit q stands for (q, none due), bit `locations` + i for `waiting[i]`.

This is the one meaning of the tracker.  The tabulated tracker asks it for every state that can be reached; where these
are too many, or commands decide what is possible, it is asked for one state after the other while the plant runs.  As
for `reference`, nothing beyond the standard library's `typing` is imported, so that this very text can be copied into a
generated program.

Known commands: the values of all commands are the bits of a mask, those of the first command lowest.  A move may need
certain values: a mask for each command that it depends on, with which `allowed`, the values that may have been on when
the move happened, must have a bit in common.  A move that is not seen is taken for possible under any command.

Cost: one step looks at the moves of one event, and at those of all signatures.  Memory: one bit a pair.
Source: Balluchi et al. (2012), sections 3.1, 4.1 and 4.2; the rules are in the text of `deshybrid.observer.tracker`.
"""

from typing import NamedTuple

NONE = -1  # no location, no state
RESTART = -2  # what was seen is inconsistent
ANY = -1  # all values of all commands

Conditional = tuple[tuple[int, tuple[int, ...]], ...]


class OnlineTracker(NamedTuple):
    """The moves of a location observer that has no table of states.

    Tokens are the events, then the signatures that are heard; each is (the signature that it settles where that is due,
    or -1; {location it leaves: pairs it may lead to}), the invisible moves before it not counted: these are `silent`.
    """

    locations: int
    persistent: tuple[bool, ...]  # by location
    waiting: tuple[tuple[int, int], ...]  # pairs (location, signature due)
    silent: dict[int, tuple[int, ...]]  # by location: the others that it may move to unseen
    events: int
    tokens: tuple[tuple[int, dict[int, tuple[int, ...]]], ...]
    active: tuple[int, ...]  # by signature that is heard: its residual generator, -1 for a negation
    generator: tuple[int, ...]  # by location: its residual generator or -1
    guaranteed: tuple[bool, ...]  # by signature: it comes within the detection window whatever happens
    times_out: bool  # signatures come by themselves and late, not as events
    commands: tuple[int, ...] = ()  # by command: how many values it has
    conditional: tuple[dict[int, Conditional], ...] = ()  # by token, beside its moves: those that need (masks) commands

    @property
    def pairs(self) -> int:
        """The number of pairs that a state may hold."""
        return self.locations + len(self.waiting)

    def known(self, state: int) -> tuple[int, bool]:
        """Return the location where it is identified, else -1, and whether a signature is still due for it."""
        places = self._places(state)
        location = places.bit_length() - 1
        if places == 1 << location and self.persistent[location]:
            return location, False
        return NONE, state >> self.locations != 0

    def entry_estimate(self, state: int) -> tuple[int, ...]:
        """Return the numbers of the locations that may have been entered last, ascending."""
        return tuple(_members(self._places(state)))

    def after_event(self, state: int, event: int, allowed: int = ANY) -> int:
        """Return the state after event number `event`, -1 where nothing explains it."""
        return self.follow(state, self.sources(state), event, allowed)

    def restart_on(self, event: int, allowed: int = ANY) -> int:
        """Return the state after an event that the present state does not explain."""
        everything = (1 << self.locations) - 1
        target = self.after_event(everything, event, allowed)
        return target if target >= 0 else everything

    def candidates(self, state: int, allowed: int = ANY) -> tuple[tuple[int, int, tuple[int, ...], int], ...]:
        """Return the signatures that lead out of a state: (signature, active generator, quiet generators, target).

        A negation without a generator for every alternative, or that leads nowhere else, shows nothing.
        """
        sources = self.sources(state) if self.active else ()
        found = ((s, self.follow(state, sources, self.events + s, allowed)) for s in range(len(self.active)))
        targets = [(signature, target, self._places(target)) for signature, target in found if target >= 0]
        possible = self._places(state)
        for _, _, reached in targets:
            possible |= reached
        result = []
        for signature, target, reached in targets:
            others = [self.generator[location] for location in _members(possible & ~reached)]
            quiet = tuple(sorted(generator for generator in others if generator >= 0))
            own = self.active[signature]
            if own >= 0 or (quiet and len(quiet) == len(others) and target != state):
                result.append((signature, own, quiet, target))
        return tuple(result)

    def timeout(self, state: int) -> int:
        """Return the state after a detection window of silence; -1: it goes on waiting, -2: that is inconsistent."""
        due = state >> self.locations
        if not due or not self.times_out:
            return NONE
        if settled := state & ((1 << self.locations) - 1):
            return settled
        return RESTART if all(self.guaranteed[self.waiting[i][1]] for i in _members(due)) else NONE

    def _places(self, state: int) -> int:
        """The locations of all pairs, as a mask."""
        return state & ((1 << self.locations) - 1) | self._waiting_places(state)

    def _waiting_places(self, state: int) -> int:
        places = 0
        for i in _members(state >> self.locations):
            places |= 1 << self.waiting[i][0]
        return places

    def sources(self, state: int) -> tuple[list[int], ...]:
        """Return where the plant may be now: if no signature is due, and if one is, which then has been missed."""
        turns = state & ((1 << self.locations) - 1), self._waiting_places(state)
        return tuple(self._closed(places) for places in turns)

    def _closed(self, places: int) -> list[int]:
        closed = places
        for location in _members(places):
            for target in self.silent.get(location, ()):
                closed |= 1 << target
        return _members(closed)

    def follow(self, state: int, sources: tuple[list[int], ...], token: int, allowed: int = ANY) -> int:
        """Return the state after a token, -1 for none: from the settled pairs, else from those that wait."""
        answers, moves = self.tokens[token]
        conditional = self.conditional[token] if self.conditional else {}
        due = 0
        for i in _members(state >> self.locations):
            location, signature = self.waiting[i]
            due |= 1 << location if signature == answers else 0
        for turn in sources:
            found = due
            for source in turn:
                for pair in moves.get(source, ()):
                    found |= 1 << pair
                for pair, needed in conditional.get(source, ()):
                    found |= 1 << pair if all(allowed & mask for mask in needed) else 0
            if found:
                return self._forget(found)
        return NONE

    def _forget(self, state: int) -> int:
        """What is due in all pairs, or in pairs of one location, tells nothing and is not waited for."""
        due = state >> self.locations
        if not due or not self.times_out:
            return state
        places, settled = self._places(state), state & ((1 << self.locations) - 1)
        same = not settled and len({self.waiting[i][1] for i in _members(due)}) == 1
        return places if same or places & (places - 1) == 0 else state


def _members(mask: int) -> list[int]:
    """Return the numbers of the bits that are set, ascending."""
    found = []
    while mask:
        lowest = mask & -mask
        found.append(lowest.bit_length() - 1)
        mask ^= lowest
    return found
