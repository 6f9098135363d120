"""Composed plants of which a few sensors tell little: most of their transitions are silent."""

from collections.abc import Iterator
from itertools import combinations, product

from deshybrid.des.automaton import DES

Row = tuple[str, str, str, str | None]


def ring_of_trains(blocks: int = 24, trains: int = 4, sensors: tuple[int, ...] = (0, 6, 12, 18)) -> DES:
    """Equal trains on a ring of blocks; each moves on where the next block is free, some blocks show that it leaves."""
    rows: list[Row] = []
    for occupied in combinations(range(blocks), trains):
        for block in occupied:
            onto = (block + 1) % blocks
            if onto not in occupied:
                after = sorted({*occupied, onto} - {block})
                shown = f"o{block}" if block in sensors else None
                rows.append((str(occupied), f"leave{block}", str(tuple(after)), shown))
    return DES.from_transitions(rows, name=f"{trains} trains on {blocks} blocks")


def transfer_line(machines: int = 5, visible: tuple[str, ...] = ("load0", "load2", "unload4")) -> DES:
    """Machines that are idle (0), working (1) or down (2), with a buffer for one part between two of them."""
    rows: list[Row] = []
    for state in product(range(3), repeat=machines):
        for buffers in product(range(2), repeat=machines - 1):
            for machine in range(machines):
                for event, after in _events(state, buffers, machine):
                    rows.append((f"{state}{buffers}", event, after, event if event in visible else None))
    return DES.from_transitions(rows, name=f"transfer line of {machines} machines")


def _events(state: tuple[int, ...], buffers: tuple[int, ...], machine: int) -> Iterator[tuple[str, str]]:
    """What may happen to one machine: the event and the location that it leads to."""

    def after(status: int, buffer: int | None = None, parts: int = 0) -> str:
        changed = list(buffers)
        if buffer is not None and 0 <= buffer < len(buffers):
            changed[buffer] = parts
        return f"{(*state[:machine], status, *state[machine + 1 :])}{tuple(changed)}"

    if state[machine] == 0 and (machine == 0 or buffers[machine - 1]):
        yield f"load{machine}", after(1, machine - 1, 0)
    if state[machine] == 1:
        if machine == len(state) - 1 or not buffers[machine]:
            yield f"unload{machine}", after(0, machine, 1)
        yield f"break{machine}", after(2)
    if state[machine] == 2:
        yield f"repair{machine}", after(0)
