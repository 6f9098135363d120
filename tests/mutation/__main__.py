"""`python -m tests.mutation [modules] [--sample N]`: mutate `deshybrid/des`, run its tests, write what survives."""

import argparse
import os
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a child that is forked has no threads

from tests.mutation.run import SOURCES, verdicts


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("modules", nargs="*", help="names of modules of deshybrid/des; all where none is given")
    parser.add_argument("--sample", type=int, help="so many mutants of each module at most, seeded")
    given = parser.parse_args()
    modules = given.modules or sorted(path.stem for path in SOURCES.glob("*.py") if path.stem != "__init__")
    for module in modules:
        before = time.time()
        for mutant, outcome in verdicts(module, given.sample):
            sys.stdout.write(f"{outcome} {mutant.line} {mutant.key} [{time.time() - before:.1f}]\n")
            sys.stdout.flush()
            before = time.time()


if __name__ == "__main__":
    main()
