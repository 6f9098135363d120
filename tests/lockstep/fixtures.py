"""Small hand-made tables of a step, which use every part of a tick: n = 2, m = 1, p = 1, three locations.

The numbers are those of no model; they are chosen so that ordinary samples reach every branch: two residual generators
(of `a` and `b`), a negation (`s_c`), a self-loop that is seen (`s_a` in `a`), two events, resets, a provisional state
with a timeout, an inconsistent timeout, a location without continuous observer.
"""

import numpy as np

from deshybrid.observer.tables import Candidate, FlowTables, GeneratorTables, StepTables, TrackerState

_A, _B, _C = 0, 1, 2
_LEFT, _RIGHT = 0, 1  # events
_S_A, _S_B, _S_C = 0, 1, 2  # signatures
_Z_A, _Z_B = 0, 1  # generators


def _flow() -> FlowTables:
    return FlowTables(
        matrix=np.array([[[0.9, 0.1], [-0.2, 0.7]], [[0.8, 0.05], [-0.1, 0.6]], [[0.0, 0.0], [0.0, 0.0]]]),
        input=np.array([[[0.01], [0.1]], [[0.02], [0.2]], [[0.0], [0.0]]]),
        output=np.array([[[0.1], [0.3]], [[0.2], [0.1]], [[0.0], [0.0]]]),
        offset=np.array([[0.0, 0.001], [0.002, 0.0], [0.0, 0.0]]),
        start=np.array([0.5, -0.25]),
        defined=(True, True, False),
    )


def _generators() -> GeneratorTables:
    return GeneratorTables(
        locations=(_A, _B),
        matrix=np.array([[[0.5, 0.1], [-0.1, 0.4]], [[0.3, 0.0], [0.2, 0.5]]]),
        input=np.array([[[0.01], [0.1]], [[0.02], [-0.1]]]),
        output=np.array([[[0.5], [0.1]], [[0.7], [-0.2]]]),
        offset=np.array([[0.0, 0.0], [0.01, 0.0]]),
        start=np.array([[[1.0], [0.0]], [[1.0], [0.5]]]),
        start_offset=np.array([[0.0, 0.0], [-0.1, 0.0]]),
        residual_state=np.array([[[1.0, 0.0]], [[1.0, 0.0]]]),
        residual_input=np.array([[[0.0]], [[0.05]]]),
        residual_output=-np.ones((2, 1, 1)),
        residual_offset=np.array([[0.0], [0.1]]),
        weight=np.array([[5.0], [4.0]]),
        release=np.array([1.5, 2.0]),
        on_ticks=(3, 2),
        off_ticks=(1, 2),
    )


_ANY, _IN_A, _IN_B, _IN_C, _A_OR_C, _A_OR_B = range(6)
_TRACKER = (
    TrackerState(
        (_A, _B, _C),
        -1,
        False,
        (_IN_A, _A_OR_C),
        (
            Candidate(_S_A, _Z_A, (_Z_B,), _IN_A),
            Candidate(_S_B, _Z_B, (_Z_A,), _IN_B),
            Candidate(_S_C, -1, (_Z_A, _Z_B), _IN_C),
        ),
    ),
    TrackerState(
        (_A,),
        _A,
        False,
        (-1, _A_OR_C),
        (Candidate(_S_A, _Z_A, (_Z_B,), _IN_A), Candidate(_S_B, _Z_B, (_Z_A,), _IN_B)),
    ),
    TrackerState((_B,), _B, False, (_A_OR_B, _IN_B), (Candidate(_S_C, -1, (_Z_B,), _IN_C),)),
    TrackerState((_C,), _C, False, (_IN_A, -1), (Candidate(_S_A, _Z_A, (), _IN_A), Candidate(_S_B, _Z_B, (), _IN_B))),
    TrackerState((_A, _C), -1, True, (_IN_A, -1), (Candidate(_S_A, _Z_A, (), _IN_A),), _IN_C),
    TrackerState(
        (_A, _B),
        -1,
        True,
        (-1, _IN_B),
        (Candidate(_S_A, _Z_A, (_Z_B,), _IN_A), Candidate(_S_B, _Z_B, (_Z_A,), _IN_B)),
        -2,
    ),
)


def small_tables() -> StepTables:
    """Three locations a, b, c with two generators; see the module's text."""
    return StepTables(
        name="small",
        step=0.01,
        location_names=("a", "b", "c"),
        state_names=("x1", "x2"),
        input_names=("u",),
        output_names=("y",),
        event_names=("left", "right"),
        signature_names=("s_a", "s_b", "s_c"),
        flow=_flow(),
        generators=_generators(),
        tracker=_TRACKER,
        initial=_ANY,
        restart=_ANY,
        restart_on_event=(_IN_A, _ANY),
        window_ticks=5,
        reset_index=((1, 0, -1), (1, -1, -1), (-1, -1, -1)),
        reset_matrix=np.array([[[1.0, 0.0], [0.5, 0.9]], [[0.7, 0.0], [0.0, 1.1]]]),
        reset_offset=np.array([[0.0, 0.1], [-0.1, 0.0]]),
    )


def small_trace(length: int, seed: int = 1) -> list[tuple[tuple[float, ...], tuple[float, ...], int]]:
    """Samples (input, output, event code) for every branch: quiet and noisy stretches, events, invalid numbers."""
    random = np.random.default_rng(seed)
    samples = []
    for tick in range(length):
        scale = (0.01, 0.2, 1.0, 0.05)[(tick // 40) % 4]
        y = float(scale * random.normal())
        u = float(0.1 * random.normal())
        if tick % 97 == 96:
            y = (float("nan"), float("inf"), -1e31)[tick % 3]
        event = int(random.integers(1, 3)) if random.random() < 0.06 else 0
        samples.append(((u,), (y,), 9 if tick % 211 == 210 else event))
    return samples
