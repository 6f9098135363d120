"""Compiles and runs generated code, and compares it with the reference step, for any `StepTables`.

`run_c` feeds a driver, written in C against the public header alone, with a binary file of samples and reads back a
binary file of estimates; `run_python` does the same with the generated Python in a process of its own.
`expected_estimates` gives the bytes that the recorded vectors stand for: equal bytes are equal estimates, bit for bit.
"""

import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from deshybrid.emit.c import emit_c
from deshybrid.emit.ctables import Real, c_tables, cost
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.python import emit_python
from deshybrid.emit.vectors import Vector, record_vectors
from deshybrid.observer.tables import StepTables

ORIGIN = Provenance("small", "models/small.yaml", "3f9c" * 16, "0.1.0", ("Certificate: none needed in a test.",))
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror", "-ffp-contract=off")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
STANDARDS = {
    "c99": ("gcc", "-x", "c", "-std=c99"),
    "c11": ("gcc", "-x", "c", "-std=c11"),
    "c++11": ("g++", "-x", "c++", "-std=c++11"),
    "c++17": ("g++", "-x", "c++", "-std=c++17"),
}

_DRIVER = """\
#include "PREFIX.h"
#include <stdio.h>

int main(int argc, char **argv)
{
    PREFIX_state_t state;
    PREFIX_input_t input;
    PREFIX_output_t output;
    FILE *in = argc > 2 ? fopen(argv[1], "rb") : NULL;
    FILE *out = argc > 2 ? fopen(argv[2], "wb") : NULL;
    int32_t head[4];
    if (in == NULL || out == NULL) {
        return 2;
    }
    PREFIX_init(&state);
    while (fread(head, sizeof head[0], 2, in) == 2) {
        if (fread(input.u, sizeof input.u[0], UPPER_N_INPUTS, in) != UPPER_N_INPUTS ||
            fread(input.y, sizeof input.y[0], UPPER_N_OUTPUTS, in) != UPPER_N_OUTPUTS) {
            return 3;
        }
        input.event = head[0];
#ifdef UPPER_N_COMMANDS
        if (fread(input.command, sizeof input.command[0], UPPER_N_COMMANDS, in) != UPPER_N_COMMANDS) {
            return 3;
        }
#endif
        if (head[1]) {
            PREFIX_reset(&state);
        }
        PREFIX_step(&state, &input, &output);
        head[0] = output.location;
        head[1] = output.signature;
        head[2] = output.status;
        head[3] = output.identified;
        fwrite(head, sizeof head[0], 4, out);
        fwrite(output.entry_estimate, 1, UPPER_N_LOCATIONS, out);
        fwrite(output.x_hat, sizeof output.x_hat[0], UPPER_N_STATES, out);
    }
    fclose(in);
    return fclose(out) == 0 ? 0 : 4;
}
"""

_PYTHON_DRIVER = """\
import struct, sys
sys.path.insert(0, ".")
from {prefix} import COMMANDS, LOCATIONS, TABLES, start, step
inputs, outputs = {inputs}, {outputs}
layout = "=2i%dd%di" % (inputs + outputs, len(COMMANDS))
size = struct.calcsize(layout)
data = open(sys.argv[1], "rb").read()
state = start(TABLES)
with open(sys.argv[2], "wb") as out:
    for at in range(0, len(data), size):
        event, reset, *numbers = struct.unpack_from(layout, data, at)
        if reset:
            state = start(TABLES)
        state, estimate = step(TABLES, state, tuple(numbers[:inputs]), tuple(numbers[inputs:inputs + outputs]), event,
                               command=tuple(numbers[inputs + outputs:]))
        location, tracker, signature, status, x = estimate
        out.write(struct.pack("=4i", location, signature, status, location >= 0))
        entered = set(TABLES["tracker"].entry_estimate(tracker))
        out.write(bytes(index in entered for index in range(len(LOCATIONS))))
        out.write(struct.pack("=%dd" % len(x), *x))
"""


def missing_compiler() -> str:
    """Return why no C can be compiled here, or an empty string."""
    absent = [tool for tool in ("gcc", "g++") if shutil.which(tool) is None]
    return f"no {' and no '.join(absent)} on this machine" if absent else ""


def write_c(folder: Path, tables: StepTables, *, prefix: str = "small", real: str = "double") -> None:
    """Generate the C code into `folder`, with the driver as `driver.c`."""
    for name, text in emit_c(tables, prefix=prefix, real=real, provenance=ORIGIN).items():  # type: ignore[arg-type]
        (folder / name).write_text(text, encoding="ascii")
    driver = _DRIVER.replace("PREFIX", prefix).replace("UPPER", prefix.upper())
    (folder / "driver.c").write_text(driver, encoding="ascii")


def write_python(folder: Path, tables: StepTables, *, prefix: str = "small") -> None:
    """Generate the Python code into `folder`."""
    for name, text in emit_python(tables, prefix=prefix, provenance=ORIGIN).items():
        (folder / name).write_text(text, encoding="utf-8")


def build(folder: Path, program: str, sources: Sequence[str], standard: str = "c99", flags: Sequence[str] = ()) -> Path:
    """Compile with every warning an error; a failure shows the compiler's words."""
    command = [*STANDARDS[standard], *STRICT, *flags, "-o", program, *sources]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / program


def table_bytes(folder: Path) -> int:
    """Return the bytes of all constant tables in the compiled `small.c`, strings not counted."""
    build(folder, "small.o", ["small.c"], flags=["-c", "-O0"])
    symbols = subprocess.run(["nm", "-S", "small.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    entries = [line.split() for line in symbols.splitlines() if line.split()[-2] in "rRdD"]
    return sum(int(size, 16) for _, size, _, name in entries if not name.endswith("_names"))


def assert_stated_bytes(folder: Path, tables: StepTables, *, real: Real = "double") -> str:
    """Generate and build; fail unless the header states the bytes that the compiler uses.  Return the header."""
    price = cost(tables, c_tables(tables, real), real)
    write_c(folder, tables, real=real)
    assert price.table_bytes == table_bytes(folder)
    program = build(folder, "self", ["small.c", "small_selftest.c"])
    spoken = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert f"state of {price.state_bytes} bytes" in spoken
    header = (folder / "small.h").read_text()
    assert f"{price.state_bytes} bytes of state, {price.table_bytes} bytes of tables" in header
    return header


def run_c(folder: Path, program: Path, vectors: Sequence[Vector], *, real: str = "double") -> bytes:
    """Return the estimates that the driver writes for the samples of `vectors`."""
    return _run([str(program)], folder, sample_bytes(vectors, real))


def run_python(folder: Path, prefix: str, tables: StepTables, vectors: Sequence[Vector]) -> bytes:
    """Return the estimates of the generated Python, which lies in `folder` and sees no installed package."""
    driver = _PYTHON_DRIVER.format(prefix=prefix, inputs=len(tables.input_names), outputs=len(tables.output_names))
    (folder / "driver.py").write_text(driver, encoding="ascii")
    return _run([sys.executable, "-S", "-E", "driver.py"], folder, sample_bytes(vectors, "double"))


def sample_bytes(vectors: Sequence[Vector], real: str) -> bytes:
    """The samples of `vectors` as the drivers read them."""
    letter = "d" if real == "double" else "f"
    return b"".join(
        struct.pack("=2i", v.event, v.reset)
        + struct.pack(f"={len(v.input) + len(v.output)}{letter}", *v.input, *v.output)
        + struct.pack(f"={len(v.command)}i", *v.command)
        for v in vectors
    )


def expected_estimates(tables: StepTables, vectors: Sequence[Vector], *, real: str = "double") -> bytes:
    """The estimates of the reference step, as the drivers write them."""
    letter = "d" if real == "double" else "f"
    locations = range(len(tables.location_names))
    return b"".join(
        struct.pack("=4i", v.location, v.signature, v.status, v.location >= 0)
        + bytes(location in entered for location in locations)
        + struct.pack(f"={len(v.x)}{letter}", *v.x)
        for v, entered in ((vector, set(vector.entry_estimate)) for vector in vectors)
    )


def assert_lockstep(folder: Path, tables: StepTables, *, count: int, seed: int = 2012) -> None:
    """Generate, compile and run C and Python in `folder`; fail unless both equal the reference over `count` samples."""
    vectors = record_vectors(tables, seed=seed, count=count, reset_every=-(-count // 4))
    expected = expected_estimates(tables, vectors)
    write_c(folder, tables)
    write_python(folder, tables)
    program = build(folder, "driver", ["small.c", "driver.c"], flags=["-O2"])
    assert run_c(folder, program, vectors) == expected
    assert run_python(folder, "small", tables, vectors) == expected


def _run(command: Sequence[str], folder: Path, samples: bytes) -> bytes:
    (folder / "samples.bin").write_bytes(samples)
    done = subprocess.run(
        [*command, "samples.bin", "estimates.bin"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return (folder / "estimates.bin").read_bytes()
