"""Write `turn.csv`: one drawn flight of `turn.yaml`, which turns from 45 s on and flies straight again from 56 s on."""

from pathlib import Path

from deshybrid.model.load import load
from deshybrid.simulate.trace import Trace, write_trace
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.sample import sample

HERE = Path(__file__).parent
ROWS, TURN, END = 100, 45, 56  # seconds; the paper's Figure 3


def flight(seed: int) -> Trace:
    """The trace of one drawn flight, with its truth."""
    model = load(HERE / "turn.yaml")
    system = stochastic_system(model)
    modes = [int(TURN <= k < END) for k in range(ROWS)]
    runs = sample(system, ROWS, seed=seed, modes=modes)
    names = tuple(system.names[number] for number in modes)
    time = [float(k) for k in range(ROWS)]
    return Trace(model, time, [[] for _ in time], runs.z, (), names, runs.x)


if __name__ == "__main__":
    (HERE / "turn.csv").write_text(write_trace(flight(seed=2006)), encoding="utf-8")
