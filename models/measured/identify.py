"""Identifies the driveline of the measured car from its logs; the numbers of `ralliart.yaml` come from here.

    python models/measured/identify.py fit run2.csv run3.csv          parameters with standard errors, against the model
    python models/measured/identify.py fit run2.csv run3.csv --write  the same, and put them into the model file
    python models/measured/identify.py convert run2.csv trace.csv     a raw log as a trace for `deshybrid run`
    python models/measured/identify.py score run2.csv estimate.csv    an estimate (without one: the ratio comparison)

Method: prediction error.  While a clutch is closed the car is

    alpha' = omega_e - omega_w/tau,   j_e omega_e' = g T_e + T_0 + d - b_e omega_e - T_c,
    j_w omega_w' = T_c/tau - T_w,     T_c = k tau^2 alpha + b tau^2 alpha',

with T_w (grade, drag, brakes) a random walk and d (what the torque estimate gets wrong) a first-order Gauss-Markov
process, both unknown.  The stationary Kalman filter of each gear predicts the next sample of both speeds; parameters
and noise intensities maximise the likelihood of its errors, large errors counting less (Huber).  Standard errors come
from the curvature at the optimum, so they hold for this noise model; where one is about as large as its prior, the
runs say nothing about the parameter.  About half a minute.  Source: Ljung, System Identification, section 7.
"""

import argparse
import csv
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from ralliart_log import FINAL_DRIVE, MODEL, STEP, Drive, GearScore, ratio_names, read_log, score_gears, trace_text
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import minimize

Array = NDArray[np.float64]
MASS, RADIUS, J_WHEEL = 1550.0, 0.32, 1.2  # kg, m, kg m^2: known, and not to be told apart from torque gain and T_w
J_W = MASS * RADIUS**2 + 4 * J_WHEEL
SHORTEST = 25  # samples of a stretch worth using
SKIP = 5  # first errors of a stretch: the filter's start is a guess
HUBER = 3.0  # standard deviations beyond which an error counts linearly


@dataclass(frozen=True, slots=True)
class Parameter:
    """One free number: where the search starts, its natural step, whether it is positive, and a normal prior."""

    name: str
    start: float
    step: float
    positive: bool = False
    prior: tuple[float, float] | None = None

    def encode(self, value: float) -> float:
        """Return the coordinate of the search; positive numbers are searched by their logarithm."""
        return float(np.log(value)) if self.positive else value

    def decode(self, coordinate: float) -> float:
        """Return the number at a coordinate of the search."""
        return float(np.exp(coordinate)) if self.positive else coordinate


PARAMETERS = (
    Parameter("j_e", 0.25, 0.2, True, (0.25, 0.15)),
    Parameter("k_shaft", 4000.0, 0.3, True),
    Parameter("b_shaft", 300.0, 0.3, True),
    Parameter("torque_gain", 1.0, 0.1, False, (1.0, 0.15)),
    Parameter("torque_bias", 0.0, 5.0, False, (0.0, 10.0)),
    Parameter("b_e", 0.02, 0.01, False, (0.02, 0.02)),
    Parameter("ratio_1", 3.70, 0.01),
    Parameter("ratio_2", 2.39, 0.005),
    Parameter("ratio_3", 1.76, 0.005),
    Parameter("ratio_4", 1.32, 0.003),
    Parameter("ratio_5", 0.98, 0.003),
    Parameter("noise_torque", 20.0, 0.2, True),
    Parameter("noise_torque_time", 0.1, 0.2, True),
    Parameter("noise_load", 500.0, 0.2, True),
    Parameter("noise_crank", 0.4, 0.1, True),
    Parameter("noise_wheel", 0.1, 0.1, True),
    Parameter("noise_torsion", 1.0, 0.3, True),
)
IN_MODEL = tuple(p.name for p in PARAMETERS if not p.name.startswith("noise_"))


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A stretch with one clutch closed in gear `gear` (1 to 5)."""

    gear: int
    torque: Array
    speeds: Array  # (N, 2): crank, wheel


def stretches(drives: Sequence[Drive]) -> list[Stretch]:
    """Return the closed stretches of forward gears that are long enough."""
    return [
        Stretch(gear, drive.torque[begin:end], np.column_stack([drive.crank[begin:end], drive.wheel[begin:end]]))
        for drive in drives
        for begin, end, gear in drive.stays()
        if 1 <= gear <= 5 and end - begin >= SHORTEST
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """x := F x + input T_e + offset + K y predicts y = C x; x = (alpha, omega_e, omega_w, T_w, d)."""

    F: Array
    K: Array
    input: Array
    offset: Array
    covariance: Array  # of the prediction error


def predictor(p: dict[str, float], gear: int) -> Predictor:
    """Return the stationary one-step predictor of one gear."""
    tau = 1.0 / (p[f"ratio_{gear}"] * FINAL_DRIVE)
    k, b, j = p["k_shaft"] * tau**2, p["b_shaft"] * tau**2, p["j_e"]
    M = np.zeros((7, 7))  # five states, then the input and the constant 1
    M[0, 1:3] = 1.0, -1.0 / tau
    M[1, :3] = -k / j, -(p["b_e"] + b) / j, b / (tau * j)
    M[2, :3] = k / (tau * J_W), b / (tau * J_W), -b / tau**2 / J_W
    M[2, 3] = -1.0 / J_W
    M[1, 4] = 1.0 / j
    M[4, 4] = -1.0 / p["noise_torque_time"]
    M[1, 5], M[1, 6] = p["torque_gain"] / j, p["torque_bias"] / j
    flow = expm(M * STEP)
    A, C = flow[:5, :5], np.eye(2, 5, 1)
    intensities = [
        p["noise_torsion"],
        0.0,
        0.0,
        p["noise_load"],
        p["noise_torque"] * (2 / p["noise_torque_time"]) ** 0.5,
    ]
    Q = np.diag(np.square(intensities)) * STEP
    R = np.diag(np.square([p["noise_crank"], p["noise_wheel"]]))
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    K = A @ P @ C.T @ np.linalg.inv(S)
    return Predictor(A - K @ C, K, flow[:5, 5], flow[:5, 6], S)


def start_state(p: dict[str, float], stretch: Stretch) -> Array:
    """Return the state in which torsion and load explain the first 0.1 s of a stretch as a steady acceleration."""
    tau = 1.0 / (p[f"ratio_{stretch.gear}"] * FINAL_DRIVE)
    crank, wheel = stretch.speeds[0]
    acceleration = (stretch.speeds[10, 1] - wheel) / (10 * STEP)
    engine = p["torque_gain"] * stretch.torque[0] + p["torque_bias"] - p["b_e"] * crank
    clutch = engine - p["j_e"] * acceleration / tau
    return np.array([clutch / (p["k_shaft"] * tau**2), crank, wheel, clutch / tau - J_W * acceleration, 0.0])


def stretch_cost(p: dict[str, float], stretch: Stretch, model: Predictor) -> float:
    """Return minus the robust log-likelihood of one stretch."""
    x = start_state(p, stretch)
    drive = np.outer(stretch.torque, model.input) + model.offset + stretch.speeds @ model.K.T
    errors = np.empty_like(stretch.speeds)
    for n in range(len(errors)):
        errors[n] = stretch.speeds[n] - x[1:3]
        x = model.F @ x + drive[n]
    white = np.linalg.solve(np.linalg.cholesky(model.covariance), errors[SKIP:].T)
    size = np.sqrt((white**2).sum(axis=0))
    huber = np.where(size < HUBER, size**2, 2 * HUBER * size - HUBER**2)
    return 0.5 * float(huber.sum() + len(huber) * np.log(np.linalg.det(model.covariance)))


def cost(coordinates: Array, data: Sequence[Stretch]) -> float:
    """Return minus the log-posterior of all stretches; 1e9 where the filter does not exist."""
    p = {q.name: q.decode(c) for q, c in zip(PARAMETERS, coordinates.tolist(), strict=True)}
    total = sum(((p[q.name] - q.prior[0]) / q.prior[1]) ** 2 / 2 for q in PARAMETERS if q.prior)
    try:
        models = {gear: predictor(p, gear) for gear in sorted({stretch.gear for stretch in data})}
        return total + sum(stretch_cost(p, stretch, models[stretch.gear]) for stretch in data)
    except (np.linalg.LinAlgError, ValueError):
        return 1e9


@dataclass(frozen=True, slots=True)
class Fit:
    """Estimate and standard error by name; `cost` is minus the log-posterior."""

    values: dict[str, float]
    errors: dict[str, float]
    cost: float


def fit(data: Sequence[Stretch], *, progress: Callable[[str], None] = lambda _: None) -> Fit:
    """Return the best parameters; the search runs twice, because the first one is stopped by its own step lengths."""
    present = {f"ratio_{stretch.gear}" for stretch in data}
    free = [i for i, q in enumerate(PARAMETERS) if not q.name.startswith("ratio_") or q.name in present]
    centre = np.array([q.encode(q.start) for q in PARAMETERS])
    steps = np.array([q.step for q in PARAMETERS])[free]

    def at(z: Array) -> Array:
        moved = centre.copy()
        moved[free] += steps * z
        return moved

    def objective(z: Array) -> float:
        return cost(at(z), data)

    best = minimize(objective, np.zeros(len(free)), method="L-BFGS-B", options={"maxfun": 4000})
    progress(f"first search: cost {best.fun:.2f} after {best.nfev} evaluations")
    best = minimize(objective, best.x, method="L-BFGS-B", options={"maxfun": 4000})
    progress(f"second search: cost {best.fun:.2f} after {best.nfev} evaluations")
    spread = np.sqrt(np.diag(np.linalg.pinv(curvature(objective, best.x), hermitian=True)))
    found = at(best.x)
    values = {q.name: q.decode(c) for q, c in zip(PARAMETERS, found.tolist(), strict=True)}
    errors = dict.fromkeys(values, float("nan"))
    for i, deviation in zip(free, (spread * steps).tolist(), strict=True):
        q = PARAMETERS[i]
        errors[q.name] = deviation * (values[q.name] if q.positive else 1.0)
    return Fit(values, errors, float(best.fun))


def curvature(function: Callable[[Array], float], x: Array, *, width: float = 0.05) -> Array:
    """Return the matrix of second derivatives by central differences of `width`."""
    n = len(x)
    shift = width * np.eye(n)
    H = np.zeros((n, n))
    middle = function(x)
    for i in range(n):
        H[i, i] = (function(x + shift[i]) - 2 * middle + function(x - shift[i])) / width**2
        for j in range(i):
            corners = [function(x + a * shift[i] + b * shift[j]) * a * b for a in (1, -1) for b in (1, -1)]
            H[i, j] = H[j, i] = sum(corners) / (4 * width**2)
    return H


def model_value(text: str, name: str) -> float | None:
    """Return the number that the model file gives a parameter, None where it has none."""
    found = re.search(rf"^  {name}: +([-+.\deE]+)", text, re.MULTILINE)
    return float(found.group(1)) if found else None


def report(result: Fit, text: str) -> str:
    """Return the table: estimate, standard error, prior, and the model file's number."""
    lines = [f"{'parameter':<18}{'estimate':>12}{'std error':>12}{'prior':>16}{'in the model':>14}"]
    for q in PARAMETERS:
        prior = f"{q.prior[0]:g} ± {q.prior[1]:g}" if q.prior else "-"
        stated = model_value(text, q.name)
        shown = "-" if stated is None else f"{stated:g}"
        lines.append(f"{q.name:<18}{result.values[q.name]:>12.5g}{result.errors[q.name]:>12.2g}{prior:>16}{shown:>14}")
    return "\n".join([*lines, f"minus log-posterior: {result.cost:.2f}"])


def with_values(text: str, result: Fit) -> str:
    """Return the model text with the fitted numbers, and the errors that its comments state, in place of its own."""
    for name in IN_MODEL:

        def line(found: re.Match[str], name: str = name) -> str:
            stated = f"  {name}: {result.values[name]:.5g}"
            return f"{stated:<26}# ± {result.errors[name]:.2g}{found.group(1)}"

        text = re.sub(rf"^  {name}: .*# ± [-+.\deE]+(.*)$", line, text, flags=re.MULTILINE)
    return text


def score_text(name: str, result: GearScore) -> str:
    """Return one line of figures."""
    delays = ", ".join("never" if d is None else f"{d:+.2f}" for d in result.delays())
    shares = f"right {100 * result.right:.2f} %, wrong gear {100 * result.wrong:.2f} % of closed samples"
    return f"{name}: {shares}; false naming {100 * result.false:.1f} %; delays of closings >= 0.3 s: {delays} s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the subcommands; returns the exit code."""
    parser = argparse.ArgumentParser(description="Identify the measured car, convert its logs, score estimates.")
    commands = parser.add_subparsers(dest="command", required=True)
    fitting = commands.add_parser("fit", help="parameters with standard errors")
    fitting.add_argument("logs", nargs="+", type=Path)
    fitting.add_argument("--write", action="store_true", help="put the numbers into the model file")
    converting = commands.add_parser("convert", help="a raw log as a trace")
    converting.add_argument("log", type=Path)
    converting.add_argument("trace", type=Path)
    scoring = commands.add_parser("score", help="an estimate, or the ratio comparison")
    scoring.add_argument("log", type=Path)
    scoring.add_argument("estimate", nargs="?", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "convert":
        options.trace.write_text(trace_text(read_log(options.log)), encoding="utf-8")
    elif options.command == "score":
        drive = read_log(options.log)
        named: Sequence[str | None] = ratio_names(drive)
        if options.estimate:
            with options.estimate.open(newline="", encoding="utf-8") as file:
                named = [row["location"] or None for row in csv.DictReader(file)]
        print(score_text(options.log.stem, score_gears(drive, named)))
    else:
        text = MODEL.read_text(encoding="utf-8")
        data = stretches([read_log(path) for path in options.logs])
        result = fit(data, progress=lambda line: print(line, file=sys.stderr, flush=True))
        print(report(result, text))
        if options.write:
            MODEL.write_text(with_values(text, result), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
