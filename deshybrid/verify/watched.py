"""Which keys of a file a checker has looked at: what it never reads, it cannot have checked.

In: a JSON tree.  Out: the same tree, read-only, which remembers what was asked of it; then the paths of all keys that
were not, a whole object as one.  Empty values say nothing and are left out.  O(size of the tree).
"""

from collections.abc import Iterator, Mapping

Path = tuple[str | int, ...]


class Watched(Mapping[str, object]):
    """An object of a JSON tree that remembers which of its keys were read; asking whether there is one is no reading.

    >>> tree = Watched({"a": {"b": 1, "c": 2}, "d": [{"e": 1, "f": 2}], "g": 3, "h": None})
    >>> tree["a"]["b"], tree["d"][0]["f"]
    (1, 2)
    >>> list(tree.unread())
    [('a', 'c'), ('d', 0, 'e'), ('g',)]
    """

    def __init__(self, tree: Mapping[str, object]) -> None:
        self._tree = tree
        self._read: dict[str, object] = {}

    def __getitem__(self, key: str) -> object:
        if key not in self._read:
            self._read[key] = _watched(self._tree[key])
        return self._read[key]

    def __contains__(self, key: object) -> bool:
        return key in self._tree

    def __iter__(self) -> Iterator[str]:
        return iter(self._tree)

    def __len__(self) -> int:
        return len(self._tree)

    def unread(self) -> Iterator[Path]:
        """Yield the paths of what was not read, in the order of the tree."""
        for key, value in self._tree.items():
            if value is None or value in ([], {}):
                continue
            if key not in self._read:
                yield (key,)
            else:
                yield from ((key, *path) for path in _unread(self._read[key]))


def _watched(value: object) -> object:
    if isinstance(value, Mapping):
        return Watched(value)
    if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value):
        return [_watched(entry) for entry in value]
    return value


def _unread(value: object) -> Iterator[Path]:
    if isinstance(value, Watched):
        yield from value.unread()
    elif isinstance(value, list):
        for number, entry in enumerate(value):
            if isinstance(entry, Watched):
                yield from ((number, *path) for path in entry.unread())


def paths_in_words(paths: Iterator[Path], names: frozenset[str]) -> tuple[str, ...]:
    """Return paths as they are printed, those that differ in a number or in one of `names` (as `*`) once.

    >>> paths_in_words(iter([("a", 0, "b"), ("a", 2, "b"), ("c", "p"), ("c", "q")]), frozenset("pq"))
    ('`a[0, 2].b`', '`c.*`')
    """
    found: dict[str, list[str]] = {}
    for path in paths:
        words = ["*" if place and part in names else part for place, part in enumerate(path)]
        text = "".join("[#]" if isinstance(word, int) else f".{word}" for word in words)[1:]
        numbers = ", ".join(str(word) for word in words if isinstance(word, int))
        if numbers not in found.setdefault(text, []):
            found[text].append(numbers)
    return tuple(f"`{text.replace('#', ', '.join(numbers))}`" for text, numbers in found.items())


__all__ = ["Watched", "paths_in_words"]
