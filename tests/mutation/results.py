"""What the mutants came to, as a file, and as the tables of the documentation.

`results.json` is written by the runs; `reasons.toml` is written by hand: why a survivor changes nothing that can be
seen (`equivalent`), or why no test sees it (`survivor`).
"""

import json
import math
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TypedDict

HERE = Path(__file__).parent
RESULTS, REASONS = HERE / "results.json", HERE / "reasons.toml"


class Entry(TypedDict):
    """One module: how many mutants it has, how many of them were asked about, and what became of these."""

    mutants: int
    asked: int
    killed: int
    survived: list[str]


def results() -> dict[str, Entry]:
    """What was found at last, by module."""
    found: dict[str, Entry] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    return found


def record(module: str, entry: Entry) -> None:
    """Replace what was found about a module."""
    table = results() | {module: entry}
    text = json.dumps(dict(sorted(table.items())), indent=1, ensure_ascii=False)
    RESULTS.write_text(text + "\n", encoding="utf-8")


def reasons() -> dict[str, tuple[str, str]]:
    """For each survivor that was looked into: its kind, and the reason."""
    given = tomllib.loads(REASONS.read_text(encoding="utf-8"))
    return {key: (kind, reason) for kind, table in given.items() for key, reason in table.items()}


def score(entries: Iterable[Entry]) -> tuple[int, int, int]:
    """How many mutants died, how many were asked about, and how many there are."""
    table = list(entries)
    return sum(e["killed"] for e in table), sum(e["asked"] for e in table), sum(e["mutants"] for e in table)


def estimate(entries: Iterable[Entry]) -> float:
    """The share of all mutants that die: each module counts by its size, not by how many were asked about."""
    table = list(entries)
    dead = sum(e["mutants"] * e["killed"] / e["asked"] for e in table if e["asked"])
    return dead / sum(e["mutants"] for e in table if e["asked"])


def interval(share: float, asked: int) -> tuple[float, float]:
    """The 95 % interval of Wilson (1927) for a share that was found in a sample of that size."""
    z = 1.959964
    middle, spread = share + z * z / (2 * asked), z * math.sqrt(share * (1 - share) / asked + (z / (2 * asked)) ** 2)
    return (middle - spread) / (1 + z * z / asked), (middle + spread) / (1 + z * z / asked)


def table() -> str:
    """The result by module, as it stands in the documentation."""
    why, found = reasons(), results()
    lines = ["| module | mutants | asked | killed | equivalent | survived |", "|---|---|---|---|---|---|"]
    for module, entry in found.items():
        kinds = Counter(why.get(key, ("survivor", ""))[0] for key in entry["survived"])
        numbers = (entry["mutants"], entry["asked"], entry["killed"], kinds["equivalent"], kinds["survivor"])
        lines.append(f"| `{module}` | " + " | ".join(str(number) for number in numbers) + " |")
    killed, asked, mutants = score(found.values())
    lines += ["", f"Of {asked} mutants {killed} died: {killed / asked:.1%}, equivalent ones counted as survivors."]
    if asked < mutants:
        share = estimate(found.values())
        low, high = interval(share, asked)
        lines.append(
            f"Some modules were sampled (seeded).  Of all {mutants} an estimated {share:.1%} die, 95 % interval"
        )
        lines.append(f"{low:.1%} to {high:.1%}.")
    lines += ["", "| what survives | why |", "|---|---|"]
    for key in (key for entry in found.values() for key in entry["survived"]):
        kind, reason = why.get(key, ("survivor", "not looked into"))
        lines.append(f"| `` {key.replace('|', chr(92) + '|')} `` | {kind}: {reason} |")
    return "\n".join(lines)


__all__ = ["Entry", "estimate", "interval", "reasons", "record", "results", "score", "table"]
