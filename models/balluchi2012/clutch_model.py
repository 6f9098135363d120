"""Writes `clutch.yaml`: the driveline with a real clutch, as the plant of campaigns whose observer is `driveline.yaml`.

    python models/balluchi2012/clutch_model.py > models/balluchi2012/clutch.yaml

In: nothing; all numbers are below, and those of the car are those of `driveline.yaml`.  Out: the model file.  Each of
six gears has three locations that differ in a few entries only, and a drive needs the speeds at which its gears are
changed; so both are made here.  The speeds follow from a rigid driveline; the plant itself is simulated later.

Physics: x = (alpha, omega_e, omega_p, omega_w, c): torsion, crankshaft, primary shaft of the gearbox, wheels, and the
torque that the clutch can pass, which follows its command within 40 ms.  Slipping, the clutch passes exactly that, with
the sign of the slip.  It locks where the slip reaches zero and friction can hold it, and breaks loose where the torque
through it exceeds what static friction holds (1.15 times as much).  Gears are changed with the clutch open.
"""

import sys
from dataclasses import dataclass, field

GEARS = {"1": "3.58", "2": "2.02", "3": "1.35", "4": "0.98", "5": "0.81", "R": "(-3.31)"}
MASS, RADIUS, J_WHEEL, J_E, J_P, B_E, B_W, FINAL = 1390.0, 0.307, 1.0, 0.235, 0.015, 0.05, 1.0, 3.74
J_W = MASS * RADIUS**2 + 4.0 * J_WHEEL
IDLE = 84.0  # rad/s
CLOSED = 350.0  # N m that the closed clutch can pass
TICK = 0.01  # s, of the rigid driveline that a drive is laid out with

HEAD = """\
format: deshybrid/1
name: clutch
summary: The driveline of a car with a clutch that opens, slips in both directions and locks; a plant for campaigns.
source: >-
  Made by models/balluchi2012/clutch_model.py.  Numbers of the car as in driveline.yaml, its inertia of the crankshaft
  divided into engine and primary shaft; friction of the clutch: typical values.  See
  docs/decisions/0024-a-finer-plant.md.

# x = (alpha, omega_e, omega_p, omega_w, c): torsion, engine, primary shaft, wheels, torque that the clutch can pass.
parameters:
  mass: 1390
  radius: 0.307
  j_wheel: 1.0
  j_w: mass*radius**2 + 4*j_wheel
  j_e: 0.235          # kg m^2, engine with flywheel and cover of the clutch
  j_p: 0.015          # kg m^2, disc of the clutch and primary shaft
  j: j_e + j_p
  b_e: 0.05
  b_p: 0.01           # N m s/rad, gears that turn in oil
  b_w: 1.0
  k_shaft: 6000
  b_shaft: 80
  final: 3.74
  lag: 0.04           # s, actuator of the clutch
  static: 1.15        # friction that holds over friction that slips
"""

CHANNELS = """
time: continuous
state: {alpha: rad, omega_e: rad/s, omega_p: rad/s, omega_w: rad/s, c: N m}
input: {T_e: N m, clutch: N m}
output: {omega_e: rad/s, omega_w: rad/s}
commands: {lever: [1, 2, 3, 4, 5, R, N]}   # for observers that are told; it moves when a gear is asked for
disturbance: {T_w: N m, T_p: N m}     # at the wheels: slope, air, brakes; error of the mean of T_e
defaults:
  C: [[0, 1, 0, 0, 0], [0, 0, 0, 1, 0]]
  B: [[0, 0], [1/j_e, 0], [0, 0], [0, 0], [0, 1/lag]]
  E: [[0, 0], [0, 1/j_e], [0, 0], [-1/j_w, 0], [0, 0]]
  dwell: {min: 0.001}                 # less than that no friction needs to change its sign
  observed_as: qN
"""


def location(gear: str, slip: int) -> str:
    """One gear with the clutch locked (slip 0) or slipping forwards (1) or backwards (-1)."""
    k, b, tau = f"k_{gear}", f"b_{gear}", f"tau_{gear}"
    wheels = f"[{k}/({tau}*j_w), 0, {b}/({tau}*j_w), -(b_w + {b}/{tau}**2)/j_w, 0]"
    if slip == 0:
        shaft = f"[-{k}/j, -b_e/j, -{b}/j, {b}/({tau}*j), 0]"
        rows = [shaft, shaft, wheels, "[0, 0, 0, 0, -1/lag]"]
        rest = [
            "    B: [[0, 0], [1/j, 0], [1/j, 0], [0, 0], [0, 1/lag]]",
            "    E: [[0, 0], [0, 1/j], [0, 1/j], [-1/j_w, 0], [0, 0]]",
            f"    observed_as: q{gear}",
        ]
    else:
        engine = f"[0, -b_e/j_e, 0, 0, {-slip}/j_e]"
        primary = f"[-{k}/j_p, 0, -{b}/j_p, {b}/({tau}*j_p), {slip}/j_p]"
        rows, rest = [engine, primary, wheels, "[0, 0, 0, 0, -1/lag]"], []
    first = f"    A: [[0, 0, 1, -1/{tau}, 0],"
    lines = [f"  {name(gear, slip)}:", first, *(f"        {row}," for row in rows[:-1]), f"        {rows[-1]}]", *rest]
    return "\n".join(lines)


def name(gear: str, slip: int) -> str:
    """The name of a location."""
    return f"{'locked' if slip == 0 else 'ahead' if slip > 0 else 'behind'}_{gear}"


def transitions(gear: str) -> list[str]:
    """The clutch in one gear, and the gear in and out."""
    tau = f"tau_{gear}"
    through = f"j_p/j*(T_e - b_e*omega_e) + j_e/j*(k_{gear}*alpha + b_{gear}*(omega_p - omega_w/{tau}))"
    holds = f"-static*c <= {through} <= static*c"
    common = "[0, j_e/j, j_p/j, 0, 0]"
    lock = f"{{matrix: [[1, 0, 0, 0, 0], {common}, {common}, [0, 0, 0, 1, 0], [0, 0, 0, 0, 1]]}}"
    when = f"when: {{lever: {gear}}}"
    meshed = f"{{matrix: [[0, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 1/{tau}, 0], [0, 0, 0, 1, 0], [0, 0, 0, 0, 1]]}}"
    lines = []
    for slip, relation in ((1, "<="), (-1, ">=")):
        here, there = name(gear, slip), name(gear, -slip)
        met = f"omega_e - omega_p {relation} 0"
        lines += [
            f'  - {{from: {here}, to: {name(gear, 0)}, event: lock, guard: "{met} & {holds}", reset: {lock}}}',
            f'  - {{from: {here}, to: {there}, event: turn, guard: "{met} & !({holds})"}}',
            f'  - {{from: {here}, to: open, event: out, guard: "c <= 2"}}',
        ]
    lines += [
        f'  - {{from: {name(gear, 0)}, to: {name(gear, 1)}, event: break, guard: "{through} > static*c"}}',
        f'  - {{from: {name(gear, 0)}, to: {name(gear, -1)}, event: break, guard: "{through} < -static*c"}}',
        f'  - {{from: open, to: {name(gear, 1)}, event: in_{gear}, guard: "omega_e - omega_w/{tau} >= 0 & c <= 2", '
        f"{when}, reset: {meshed}}}",
        f'  - {{from: open, to: {name(gear, -1)}, event: in_{gear}, guard: "omega_e - omega_w/{tau} < 0 & c <= 2", '
        f"{when}, reset: {meshed}}}",
        f'  - {{from: rest, to: {name(gear, 1)}, event: in_{gear}, guard: "c <= 2", {when}, reset: {meshed}}}',
    ]
    return lines


@dataclass
class Layout:
    """A drive under construction: a rigid driveline on a grid of 10 ms, and what has been asked of it so far."""

    time: float = 0.0
    engine: float = IDLE
    wheels: float = 0.0
    gear: str | None = None
    torque: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, B_E * IDLE)])
    clutch: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])
    load: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])
    requests: list[tuple[float, str]] = field(default_factory=list)

    def go(self, duration: float, *, torque: float, load: float, ramp: float = 0.3) -> None:
        """Drive on with this torque of the engine and this load at the wheels (N m), both reached after `ramp` s."""
        begin, before, weight = self.time, self.torque[-1][1], self.load[-1][1]
        self._point(self.torque, min(ramp, duration), torque)
        self._point(self.load, min(ramp, duration), load)
        while self.time < begin + duration - TICK / 2:
            share = min(1.0, (self.time - begin) / ramp) if ramp else 1.0
            self._tick(before + share * (torque - before), weight + share * (load - weight))
        self._point(self.torque, 0.0, torque)
        self._point(self.load, 0.0, load)

    def open_clutch(self, within: float) -> None:
        """Open the clutch."""
        self._point(self.clutch, 0.0, self.clutch[-1][1])
        self._point(self.clutch, within, 0.0)

    def close_clutch(self, within: float) -> None:
        """Close the clutch."""
        self._point(self.clutch, 0.0, 0.0)
        self._point(self.clutch, within, CLOSED)

    def ask(self, event: str) -> None:
        """Ask for an event now."""
        self.requests.append((round(self.time, 3), event))

    def shift(self, gear: str, *, miss: float = 0.0, close: float = 0.3, load: float | None = None) -> None:
        """Change the gear with the engine missing its new speed by a share of the way, then close within `close` s."""
        weight = self.load[-1][1] if load is None else load
        self.go(0.2, torque=5.0, load=weight, ramp=0.2)
        self.open_clutch(0.1)
        self.go(0.3, torque=0.0, load=weight, ramp=0.1)
        self.gear = None
        self.ask("out")
        wanted = max(IDLE, self.wheels * abs(ratio(gear)))
        wanted += miss * (self.engine - wanted)
        effort = (J_E * (wanted - self.engine) / 0.4 + B_E * (wanted + self.engine) / 2.0) * 0.4 / 0.35
        self.go(0.4, torque=round(min(max(effort, -70.0), 90.0), 1), load=weight, ramp=0.05)
        self.ask(f"in_{gear}")
        self.close_clutch(close)
        self.go(0.2 + close / 2.0, torque=round(B_E * self.engine, 1), load=weight, ramp=0.1)
        self.gear = gear

    def pull_away(self, gear: str, *, torque: float, close: float, load: float) -> None:
        """From rest: gear in, torque up, clutch closed within `close` s."""
        self.ask(f"in_{gear}")
        self.go(0.3, torque=self.torque[-1][1], load=0.0)
        self.close_clutch(close)
        self.go(close / 2.0, torque=torque, load=0.0, ramp=close / 4.0)
        self.gear = gear
        self.go(close / 2.0, torque=torque, load=load)

    def stop(self, load: float) -> None:
        """Brake with the clutch opened at a running speed, then in neutral, until the brakes hold the car."""
        while abs(self.wheels) * RADIUS > 5.5:
            self.go(0.2, torque=-5.0, load=load, ramp=0.2)
        self.open_clutch(0.1)
        self.go(0.4, torque=0.0, load=load / 2.0, ramp=0.1)
        self.gear = None
        self.ask("out")
        sign = 1.0 if self.wheels > 0.0 else -1.0
        while sign * self.wheels > -5.0:  # some more, for the drives that are faster
            self.go(0.2, torque=9.0, load=load, ramp=0.2)
        self.wheels = 0.0
        self.go(0.5, torque=B_E * IDLE, load=0.0)

    def _point(self, points: list[tuple[float, float]], after: float, value: float) -> None:
        when = round(self.time + after, 3)
        if when > points[-1][0]:
            points.append((when, round(value, 2)))
        else:
            points[-1] = (points[-1][0], round(value, 2))

    def _tick(self, torque: float, load: float) -> None:
        if self.gear is None:
            self.engine += TICK * (torque - B_E * self.engine) / J_E
            self.wheels += TICK * (-B_W * self.wheels - load) / J_W
        else:
            inertia = J_W + (J_E + J_P) * ratio(self.gear) ** 2
            push = (torque - B_E * self.wheels * ratio(self.gear)) * ratio(self.gear)
            self.wheels += TICK * (push - B_W * self.wheels - load) / inertia
            self.engine = self.wheels * ratio(self.gear)
        self.time = round(self.time + TICK, 6)


def ratio(gear: str) -> float:
    """Engine over wheels."""
    return FINAL * float(GEARS[gear].strip("()"))


def drive() -> Layout:
    """Pull away, up and down, skip gears, brake hard, let the clutch go abruptly, and back."""
    d = Layout()
    d.go(1.0, torque=B_E * IDLE, load=0.0)
    d.pull_away("1", torque=60.0, close=1.2, load=100.0)
    d.go(2.4, torque=130.0, load=110.0)
    d.shift("2", miss=0.2)
    d.go(3.4, torque=170.0, load=120.0)
    d.shift("3", miss=-0.15)
    d.go(3.8, torque=180.0, load=150.0)
    d.shift("4", miss=0.3, close=0.2)
    d.go(4.0, torque=180.0, load=180.0)
    d.shift("5")
    d.go(2.0, torque=80.0, load=230.0)
    d.shift("3", miss=0.3, close=0.5)  # kick-down, two gears at once
    d.go(3.0, torque=180.0, load=180.0)
    d.shift("5", miss=0.1)
    d.go(2.0, torque=90.0, load=230.0)
    d.go(1.0, torque=-10.0, load=1800.0, ramp=0.15)  # brakes, hard
    d.shift("4", miss=0.2, load=400.0)
    d.go(0.7, torque=-15.0, load=1200.0, ramp=0.15)
    d.shift("3", miss=0.4, load=300.0)
    d.go(0.8, torque=-15.0, load=600.0)
    d.shift("2", miss=0.1, load=200.0)
    d.go(1.6, torque=110.0, load=120.0)
    d.shift("3", miss=0.5, close=0.12)  # abrupt
    d.go(1.2, torque=140.0, load=130.0)
    d.shift("2", miss=1.0, close=0.08)  # the engine is left where it was, and the clutch let go
    d.go(1.2, torque=-15.0, load=300.0)
    d.stop(900.0)
    d.go(0.8, torque=12.0, load=0.0)  # too much torque for rest
    d.pull_away("1", torque=70.0, close=0.25, load=100.0)  # abrupt
    d.go(2.2, torque=130.0, load=110.0)
    d.shift("3", miss=0.2)  # skips second
    d.go(2.0, torque=150.0, load=120.0)
    d.stop(700.0)
    d.pull_away("R", torque=50.0, close=0.8, load=-100.0)
    d.go(2.0, torque=40.0, load=-100.0)
    d.stop(-600.0)
    return d


def points(values: list[tuple[float, float]]) -> str:
    """Points of a signal, some to a line."""
    texts = [f"[{time:g}, {value:g}]" for time, value in values]
    lines = [", ".join(texts[at : at + 8]) for at in range(0, len(texts), 8)]
    return ("," + "\n" + 14 * " ").join(lines)


def simulation(d: Layout) -> str:
    """The section `simulation`."""
    asked = [f"[{time:g}, {event}]" for time, event in d.requests]
    lines = ",\n    ".join(", ".join(asked[at : at + 8]) for at in range(0, len(asked), 8))
    return f"""
# Up and down, two gears at once, hard braking, the clutch let go abruptly, and back.
simulation:
  duration: {d.time:g}
  location: rest
  state: [0, {IDLE:g}, 0, 0, 0]
  requests: [
    {lines}]
  input:
    T_e: {{hold: false, points: [
              {points(d.torque)}]}}
    clutch: {{hold: false, points: [
              {points(d.clutch)}]}}
  unmeasured:
    T_e: {{amplitude: 70, frequency: 73}}         # second engine order of four cylinders at 2200 rpm
  disturbance:
    T_w: {{hold: false, random: 60, period: 0.3, points: [
              {points(d.load)}]}}
    T_p: {{random: 8, period: 0.05}}
  measurement:
    T_e: {{lag: 0.03, bias: 4}}                   # the engine's own estimate of its torque
    omega_e: {{quantum: 0.1047, delay: 0.012}}    # 1 rpm, one sample late
    omega_w: {{quantum: 0.0524, delay: 0.024}}    # 0.5 rpm, two samples late
  variation: {{pace: 0.1, input: 0.1, state: 0.05}}
"""


def main() -> int:
    """Write the model to standard output."""
    parameters = []
    for gear, teeth in GEARS.items():
        parameters.append(f"  tau_{gear}: 1/(final*{teeth})")
        parameters += [f"  {letter}_{gear}: {letter}_shaft*tau_{gear}**2" for letter in "kb"]
    opened = """\
  rest:                                # neutral, and the brakes hold the car
    A: [[-k_shaft/b_shaft, 0, 0, 0, 0],
        [0, -b_e/j_e, 0, 0, 0],
        [0, 0, -b_p/j_p, 0, 0],
        [0, 0, 0, 0, 0],
        [0, 0, 0, 0, -1/lag]]
    E: [[0, 0], [0, 1/j_e], [0, 0], [0, 0], [0, 0]]
  open:                                # neutral, and the clutch open
    A: [[-k_shaft/b_shaft, 0, 0, 0, 0],
        [0, -b_e/j_e, 0, 0, 0],
        [0, 0, -b_p/j_p, 0, 0],
        [0, 0, 0, -b_w/j_w, 0],
        [0, 0, 0, 0, -1/lag]]"""
    places = [opened, *(location(gear, slip) for gear in GEARS for slip in (0, 1, -1))]
    held = "{matrix: [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 1]]}"
    moves = [
        f'  - {{from: open, to: rest, event: stop, guard: "-0.3 <= omega_w <= 0.3", reset: {held}}}',
        *(line for gear in GEARS for line in transitions(gear)),
    ]
    print(HEAD + "\n".join(parameters) + "\n" + CHANNELS, end="")
    print("\nlocations:", *places, "initial: [rest]", "", "transitions:", *moves, sep="\n", end="")
    print(simulation(drive()), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
