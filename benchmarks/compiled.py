"""An observer as its generated C: a function from samples to names, some hundred times as fast as the reference.

In: a `HybridObserver` without events and commands.  Out: a function.  Needs gcc.  The generated code equals the
reference bit for bit, which tests/lockstep shows and the caller may check.
"""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.emit.c import emit_c
from deshybrid.emit.provenance import Provenance
from deshybrid.observer.hybrid import HybridObserver

Namer: TypeAlias = Callable[[NDArray[np.float64]], list[str | None]]

LOOP = r"""
#include "observer.h"

void name_rows(const double *samples, long rows, int32_t *location)
{
    observer_state_t state;
    observer_input_t input = {{0}, {0}, 0};
    observer_output_t output;
    observer_init(&state);
    for (long row = 0; row < rows; ++row) {
        for (int c = 0; c < OBSERVER_N_INPUTS; ++c) input.u[c] = *samples++;
        for (int c = 0; c < OBSERVER_N_OUTPUTS; ++c) input.y[c] = *samples++;
        observer_step(&state, &input, &output);
        location[row] = output.location;
    }
}
"""


def namer(observer: HybridObserver) -> Namer:
    """Return the function that names the location in each row of samples (N, m + p), inputs before outputs.

    ValueError for a model with events or commands, whose rows hold more than that.
    """
    if observer.tables.event_names or observer.tables.commands:
        raise ValueError("the rows of this model hold events or commands, too")
    origin = Provenance(observer.system.name, "benchmark", "none", "none")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in emit_c(observer.tables, prefix="observer", provenance=origin).items():
            (folder / file).write_text(text, encoding="utf-8")
        (folder / "loop.c").write_text(LOOP, encoding="utf-8")
        call = [
            "gcc",
            "-std=c99",
            "-O1",
            "-ffp-contract=off",
            "-shared",
            "-fPIC",
            "-o",
            "loop.so",
            "loop.c",
            "observer.c",
        ]
        subprocess.run(call, cwd=folder, check=True)
        library = ctypes.CDLL(str(folder / "loop.so"))
    names = (*observer.tables.location_names, None)  # -1 is no location

    def named(samples: NDArray[np.float64]) -> list[str | None]:
        rows = np.ascontiguousarray(samples)
        location = np.zeros(len(rows), dtype=np.int32)
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (rows, location))
        library.name_rows(next(pointers), ctypes.c_long(len(rows)), next(pointers))
        return [names[number] for number in location.tolist()]

    return named
