"""The linear dynamics of one location."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array

if TYPE_CHECKING:
    import control


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

    def to_control(self, *, time_step: float | None = None) -> "control.StateSpace":
        """Return A, B, C, D for python-control, which must be installed; `time_step` (s), None for continuous time.

        It goes from the inputs to the outputs: E is left out.  Raises `UsageError` (DH0423) where f or g is not zero.

        >>> from deshybrid.model.load import load
        >>> dynamics = load("models/two_tank.yaml").locations[0].dynamics
        >>> dynamics.to_control().nstates
        2
        """
        import control

        if self.f.any() or self.g.any():
            raise UsageError(diagnostic("DH0423", "the dynamics have a constant part, and a `StateSpace` has none"))
        return control.StateSpace(self.A, self.B, self.C, self.D, time_step or 0)

    @classmethod
    def from_control(cls, system: "control.StateSpace") -> "LinearDynamics":
        """Return the dynamics of a `control.StateSpace`; disturbances enter every state, there is no constant part.

        Whether time is continuous is for the `HybridSystem` to say.

        >>> import control
        >>> LinearDynamics.from_control(control.ss([[-1]], [[2]], [[1]], [[0]])).B.tolist()
        [[2.0]]
        """
        n, p = system.nstates, system.noutputs
        matrices = (system.A, system.B, system.C, system.D, np.eye(n), np.zeros(n), np.zeros(p))
        return cls(*(frozen_array(matrix, np.shape(matrix)) for matrix in matrices))
