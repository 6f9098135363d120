"""The linear dynamics of one location."""

from dataclasses import dataclass

from deshybrid.linear.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LinearDynamics:
    """x' = A x + B u + E w + f, y = C x + D u + g (or x(k+1) = ... where the system has a time step).

    Shapes: A (n, n), B (n, m), C (p, n), D (p, m), E (n, r), f (n,), g (p,); m and p are those of the location.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    E: FloatArray
    f: FloatArray
    g: FloatArray
