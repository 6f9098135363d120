"""The on-line tracker as C arrays: its moves as lists of (location left, pair entered), and what one step looks at.

In: an `OnlineTracker`.  Out: rows for `ctables`, in the layout that `templates/c/online.c.j2` reads, each in the
narrowest type that holds it.  The pairs that wait begin at a word of their own, so that the settled ones are whole
words.  Memory: two indices a move.  Linear in the moves.  Source: `deshybrid.observer.online`.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate

from deshybrid.observer.online import NONE, OnlineTracker

Rows = tuple[str, str, str, list[list[str]]]
_WORD = 32


@dataclass(frozen=True, slots=True)
class Layout:
    """The sizes of the sets: words of locations and of waiting pairs, and what the code needs to know beside them."""

    location_words: int
    waiting: int
    waiting_words: int
    silent: int
    turns: int
    heard: int
    times_out: bool
    values: int

    @property
    def members(self) -> int:
        """Members of four bytes in the state structure that belong to the location observer."""
        possible = self.location_words if self.heard else 0
        commands = self.values + 1 if self.values else 0
        return (1 + self.turns) * self.location_words + self.waiting_words + possible + 1 + commands


def layout(online: OnlineTracker) -> Layout:
    """Return the sizes of an on-line tracker's sets.

    >>> layout(OnlineTracker(40, (True,) * 40, (), {}, 0, (), (), (-1,) * 40, (), False)).members
    5
    """
    return Layout(
        location_words=-(-online.locations // _WORD),
        waiting=len(online.waiting),
        waiting_words=-(-len(online.waiting) // _WORD),
        silent=sum(map(len, online.silent.values())),
        turns=2 if online.waiting else 1,
        heard=len(online.active),
        times_out=online.times_out,
        values=sum(online.commands),
    )


def words(mask: int, count: int) -> list[str]:
    """Return a set as C constants of 32 bits, the lowest members first.

    >>> words(0b101, 2)
    ['0x5u', '0x0u']
    """
    return [f"{mask >> _WORD * word & 0xFFFFFFFF:#x}u" for word in range(count)]


def online_rows(online: OnlineTracker, initial: int, restart: int) -> Iterator[Rows]:
    """Yield name, type, meaning and rows of every table; what no function reads is left out."""
    sizes = layout(online)
    for name, meaning, mask in (("initial", "at the start", initial), ("restart", "all locations", restart)):
        yield f"{name}_pairs", "uint32_t", meaning, [words(mask, sizes.location_words + sizes.waiting_words)]
    if online.commands:
        yield _numbers("command_values", "by command: how many values it has", online.commands)
    yield _flags("location_persistent", "by location: it can be identified", online.persistent)
    yield _numbers("silent_source", "by silent pair: location", _repeated(online.silent))
    yield _numbers("silent_target", "by silent pair: one that follows unseen", _flat(online.silent.values()))
    yield from _token_rows(online, sizes)
    if online.waiting:
        yield _numbers("waiting_location", "by waiting pair", [location for location, _ in online.waiting])
        yield _numbers("waiting_signature", "by waiting pair: what is due", [due for _, due in online.waiting])
    if online.waiting and online.times_out:
        yield _flags("signature_guaranteed", "by signature: it comes within the window", online.guaranteed)
    if online.active:
        yield _numbers("signature_active", "by signature: its generator, -1 = a negation", online.active)
        yield _numbers("location_generator", "by location: its generator or -1", online.generator)


def _token_rows(online: OnlineTracker, sizes: Layout) -> Iterator[Rows]:
    needs = list(dict.fromkeys(needed for _, _, needed in _conditional(online)))
    moves = [_repeated(targets) for _, targets in online.tokens]
    entered = [_flat(targets.values()) for _, targets in online.tokens]
    permits = [[NONE] * len(found) for found in moves]
    for token, table in enumerate(online.conditional):
        for source, arrivals in table.items():
            moves[token] += [source] * len(arrivals)
            entered[token] += [pair for pair, _ in arrivals]
            permits[token] += [needs.index(needed) for _, needed in arrivals]
    shift = sizes.location_words * _WORD - online.locations
    pairs = [pair if pair < online.locations else pair + shift for pair in _flat(entered)]
    ends = list(accumulate(map(len, moves), initial=0))
    if online.waiting:
        yield _numbers(
            "token_answers", "by token: signature it settles, or -1", [answers for answers, _ in online.tokens]
        )
    yield _numbers("token_end", "moves of token t, an event or a signature: from [t] to [t + 1]", ends)
    yield _numbers("move_source", "by move: location it leaves", _flat(moves))
    yield _numbers("move_target", "by move: bit of the pair it enters", pairs)
    if online.commands:
        yield _numbers("move_need", "by move: what it needs of commands, -1 = nothing", _flat(permits))
        rows = [[f"{mask:#x}u" for mask in _by_command(online.commands, needed)] for needed in needs]
        yield "need_values", "uint32_t", "by need, by command: values of which one is on", rows


def _conditional(online: OnlineTracker) -> Iterator[tuple[int, int, tuple[int, ...]]]:
    """Source, pair and masks of all moves that need commands, token by token."""
    for table in online.conditional:
        for source, arrivals in table.items():
            yield from ((source, pair, needed) for pair, needed in arrivals)


def _by_command(commands: tuple[int, ...], needed: tuple[int, ...]) -> Iterator[int]:
    """A mask for each command: all of its values where nothing of it is needed."""
    first = 0
    for count in commands:
        every = ((1 << count) - 1) << first
        yield next((mask for mask in needed if mask & every), every)
        first += count


def _repeated(targets: dict[int, tuple[int, ...]]) -> list[int]:
    return [source for source, found in targets.items() for _ in found]


def _flat(groups: Iterable[Iterable[int]]) -> list[int]:
    return [value for group in groups for value in group]


def _flags(name: str, meaning: str, values: Sequence[bool]) -> Rows:
    return name, "uint8_t", meaning, [[str(int(value)) for value in values]]


def _numbers(name: str, meaning: str, values: Sequence[int]) -> Rows:
    least, most = min(values, default=0), max(values, default=0)
    if least < 0:
        narrowest = "int16_t" if most < 2**15 else "int32_t"
    else:
        narrowest = "uint8_t" if most < 2**8 else "uint16_t" if most < 2**16 else "int32_t"
    return name, narrowest, meaning, [[str(value) for value in values]]


def memberships(online: OnlineTracker) -> int:
    """Return how often one step looks into a set at most: whether a location or a pair is in it.

    The worst step brings an event that nothing explains, then a signature.

    >>> memberships(OnlineTracker(2, (True, True), (), {}, 1, ((-1, {0: (1,)}),), (), (-1, -1), (), False))
    8
    """
    sizes, tokens = layout(online), [sum(map(len, targets.values())) for _, targets in online.tokens]
    for token, table in enumerate(online.conditional):
        tokens[token] += sum(map(len, table.values()))
    waiting, places = sizes.waiting, online.locations
    forget = places + 2 * waiting if waiting and online.times_out else 0
    follow = [waiting + sizes.turns * moves + forget for moves in tokens]
    heard = follow[online.events :]
    enter = sizes.turns * sizes.silent + 2 * waiting + places + sum(cost + waiting for cost in heard)
    named = sum(cost + waiting + 2 * places for cost in heard) + (enter if heard else 0)
    named += sum(cost + waiting for cost in heard) + waiting if sizes.values else 0  # what is possible, found anew
    event = 2 * max(follow[: online.events], default=0) + 2 * enter
    silence = waiting + enter
    return max(event, silence) + named + places + waiting


__all__ = ["Layout", "layout", "memberships", "online_rows", "words"]
