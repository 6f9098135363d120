"""Mutate `deshybrid/des`, run its tests on each mutant, and keep what survives in `results.json`.

`python -m tests.mutation` asks about every mutant of every module; `--again` only about those that survived before,
after better tests were written; `--table` prints the tables of the documentation.
"""

import argparse
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a child that is forked has no threads

from tests.mutation.results import record, results, table
from tests.mutation.run import SOURCES, chosen, mutants_of, verdicts


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("modules", nargs="*", help="names of modules of deshybrid/des; all where none is given")
    parser.add_argument("--sample", type=int, help="so many mutants of each module at most, seeded")
    parser.add_argument("--again", action="store_true", help="only those that survived the last time")
    parser.add_argument("--table", action="store_true", help="print what is known, run nothing")
    given = parser.parse_args()
    if given.table:
        print(table())
        return
    for module in given.modules or sorted(path.stem for path in SOURCES.glob("*.py") if path.stem != "__init__"):
        ask_about(module, given.sample, again=given.again)


def ask_about(module: str, sample: int | None, *, again: bool) -> None:
    """Run the mutants of one module, say what became of each, and write the sum so far: a stopped run is a sample."""
    every = mutants_of(module)
    before = results().get(module)
    if again and before is not None:
        selected = [mutant for mutant in every if mutant.key in before["survived"]]
        killed, survived = before["killed"], [mutant.key for mutant in selected]
    else:
        selected = chosen(every, sample)
        killed, survived = 0, []
    for mutant, outcome in verdicts(module, selected):
        sys.stdout.write(f"{outcome} line {mutant.line} {mutant.key}\n")
        sys.stdout.flush()
        survived = [key for key in survived if key != mutant.key]
        if outcome == "survived":
            survived.append(mutant.key)
        else:
            killed += 1
        asked = killed + len(survived)
        record(module, {"mutants": len(every), "asked": asked, "killed": killed, "survived": survived})


if __name__ == "__main__":
    main()
