"""Sets of locations as bit masks: bit i stands for location number i, in order of declaration.

In and out: masks, numbers, names.  Idea: Python's integers, which join and compare sets word by word.
Cost: linear in the number of members, plus |Q| / 64 a set operation.
"""

from collections.abc import Collection, Iterable, Iterator


def union(masks: Iterable[int]) -> int:
    """Return the union of sets.

    >>> union([0b1, 0b100])
    5
    """
    joined = 0
    for mask in masks:
        joined |= mask
    return joined


def members(mask: int) -> Iterator[int]:
    """Yield the numbers in a set, ascending.

    >>> list(members(0b1101))
    [0, 2, 3]
    """
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


def is_single(mask: int) -> bool:
    """Return whether a set has exactly one member.

    >>> is_single(0b100), is_single(0b101), is_single(0)
    (True, False, False)
    """
    return mask != 0 and mask & (mask - 1) == 0


def mask_of(locations: tuple[str, ...], names: Collection[str]) -> int:
    """Return the set of those `locations` that are among `names`.

    >>> mask_of(("p", "q", "r"), {"r", "p"})
    5
    """
    wanted = set(names)
    return union(1 << number for number, name in enumerate(locations) if name in wanted)


def names_of(locations: tuple[str, ...], mask: int) -> tuple[str, ...]:
    """Return the names in a set, in order of declaration.

    >>> names_of(("p", "q", "r"), 5)
    ('p', 'r')
    """
    return tuple(locations[number] for number in members(mask))


__all__ = ["is_single", "mask_of", "members", "names_of", "union"]
