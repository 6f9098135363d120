"""Build the observers of the families beside other libraries: `python -m benchmarks.observers [word in a name ...]`.

Every library that is installed (`pip install .[bench]`, see `peers`) builds the observer of the same system; the
numbers of states are compared, in the convention of the library: arrival sets (the entry estimates of the papers) or
closed sets.
Times are processor seconds, the best of three, each in a process of its own, which ends after a minute of them.  A peer
starts from its own object in memory, deshybrid from a `DES`, with its names and outputs as texts.
"""

import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection

from benchmarks.families import FAMILIES
from benchmarks.peers import OURS, PEERS, Peer

PATIENCE = 60  # processor seconds
CLOCK = 1e-4  # shorter times are not told apart
Result = tuple[float, int] | str


def measure(prepare: Callable[..., Callable[[], int]], family: str) -> Result:
    """Return processor seconds and the number of states: the best of three, or of one where it takes long."""
    times: list[float] = []
    states = 0
    while len(times) < 3 and sum(times) < PATIENCE / 6:
        try:
            build = prepare(FAMILIES[family]())
        except ImportError:
            return "not installed"
        before = time.process_time()
        states = build()
        times.append(max(time.process_time() - before, CLOCK))
    return min(times), states


def _send(pipe: Connection, peer: Peer, family: str) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE))
    pipe.send(measure(peer.prepare, family))


def alone(peer: Peer, family: str) -> Result:
    """Return `measure` from a process of its own; a text where it comes to nothing."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, peer, family))
    process.start()
    sender.close()
    try:
        result: Result = receiver.recv()
    except EOFError:
        result = f"no end in {PATIENCE} s"
    process.join()
    return result


def check(family: str, results: dict[Peer, Result]) -> None:
    """Stop where numbers of states differ; a peer with one state to start in may have one more, or one less."""
    counted = {peer: result[1] for peer, result in results.items() if not isinstance(result, str)}
    for ours in OURS:
        for peer in PEERS:
            if peer.sets == ours.sets and abs(counted.get(peer, counted[ours]) - counted[ours]) > 1:
                raise SystemExit(f"{family}: {counted[peer]} states by {peer.name}, {counted[ours]} by {ours.name}")


def row(family: str, results: dict[Peer, Result]) -> str:
    """Return a row of the table; the ratio is to the fastest library that keeps the same sets."""
    cells = [family]
    for ours in OURS:
        mine = results[ours]
        peers = [(r[0], peer.name) for peer, r in results.items() if peer.sets == ours.sets and not isinstance(r, str)]
        rivals = [pair for pair in peers if pair[1] != ours.name]
        if isinstance(mine, str):
            cells += ["", mine, ""]
            continue
        ratio = f"{mine[0] / min(rivals)[0]:.2f} ({min(rivals)[1]})" if rivals else "no peer"
        cells += [f"{mine[1]:,}", f"{mine[0]:.3f}", ratio]
    cells += [r if isinstance(r, str) else f"{r[0]:.3f}" for peer, r in results.items() if peer not in OURS]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print one row per family whose name has one of the words given."""
    words = sys.argv[1:] or [""]
    titles = ["family", "arrival sets", "s", "ratio", "closed sets", "s", "ratio"]
    titles += [f"{peer.name} ({peer.sets}), s" for peer in PEERS]
    print("| " + " | ".join(titles) + " |\n" + "|---" * len(titles) + "|", flush=True)
    for family in FAMILIES:
        if any(word in family for word in words):
            results = {peer: alone(peer, family) for peer in (*OURS, *PEERS)}
            check(family, results)
            print(row(family, results), flush=True)


if __name__ == "__main__":
    main()
