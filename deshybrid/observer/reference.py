"""The reference step of a hybrid observer, in plain Python: tables and a state in, a state and an estimate out.

Nothing is changed in place and nothing beyond the standard library's `typing` is imported, so that this very text can
be copied into a generated program.  `tables` is the mapping that `plain_tables` makes of `StepTables`; the text of the
module `tables` says what a tick is, step by step.  `tables["tracker"]` is a `TabulatedTracker` or an `OnlineTracker`:
the step asks it what a state means and where it leads, and takes a state for a number without meaning.

Every sum runs from left to right and starts from its first product, so that a C compiler that neither reorders nor
fuses operations gets the same bits.  (Never the built-in `sum`: since Python 3.12 it compensates rounding errors.)

A tick costs at most n (2 n + m + p) + G (k + p) (k + m + p) multiplications for G residual generators of order k.
Source: Balluchi et al. (2012), section 4.2, (21)-(22), and Figure 15.
"""

from typing import Any, NamedTuple

LARGEST = 1e30  # beyond it a number is taken for no measurement, and a state for a runaway
SEARCHING, IDENTIFIED, PROVISIONAL, INCONSISTENT, INVALID = range(5)

Numbers = tuple[float, ...]
Flags = tuple[bool, ...]
Tables = dict[str, Any]


class State(NamedTuple):
    """All that the observer remembers between two samples."""

    ticks: int  # samples taken
    sample: tuple[Numbers, Numbers] | None  # the last valid (input, output)
    z: tuple[Numbers, ...]  # by generator: its state
    relay: Flags  # by generator: small residual
    debounce: tuple[int, ...]  # by generator: ticks for which relay and activity have differed
    active: Flags  # by generator: the relay after the debounce
    away: tuple[int, ...]  # by generator: valid ticks for which it has not been active, at most `patience`
    evidence: tuple[Numbers, ...]  # by generator: what a test has gathered
    seen: Flags  # by generator: active at the last move or since
    stale: Flags  # by generator: active since before the event that led here
    tracker: int  # state of the location observer, as `tables["tracker"]` counts them
    silence: int  # ticks since the last move, at most `window_ticks`
    fired: int  # the signature that may not fire again yet, or -1
    flow: int  # the location whose continuous observer runs, or -1
    x: Numbers  # the estimate of the continuous state
    command_age: tuple[int, ...]  # by value of a command: ticks since it was on, `window_ticks` + 1 = that is no matter


def start(tables: Tables) -> State:
    """Return the state before the first sample; a location known from the start has its continuous observer running."""
    none = (False,) * len(tables["generators"])
    zeros = (0,) * len(none)
    evidence = (tables["evidence"],) * len(none)
    initial = tables["initial"]
    location = tables["tracker"].known(initial)[0]
    flow = location if location >= 0 and tables["flow_defined"][location] else -1
    ages = (tables["window_ticks"] + 1,) * sum(tables["commands"])
    still = (none, zeros, none, zeros, evidence, none, none)
    return State(0, None, (), *still, initial, 0, -1, flow, tables["start"], ages)


def step(
    tables: Tables,
    state: State,
    sample_input: Numbers,
    sample_output: Numbers,
    event: int,
    *,
    command: tuple[int, ...] = (),
) -> tuple[State, tuple[int, int, int, int, Numbers]]:
    """Return the state after one sample, and the estimate (location, tracker state, signature, status, x).

    `event` is 0 for none, else 1 + the number of the event; location and signature are -1 where there is none.
    `command`: for each command 1 + the number of its value, any other number (0) where it is unknown.
    """
    state = state._replace(command_age=heed(tables, state.command_age, command))
    valid = is_within(sample_input) and is_within(sample_output)
    before = state.active
    state = advance(tables, state)
    if valid:
        state = decide(tables, state, sample_input, sample_output)
    silence = min(state.silence + 1, tables["window_ticks"]) if state.ticks > 0 else 0
    stale = tuple(was and now for was, now in zip(state.stale, state.active, strict=True))
    state = state._replace(ticks=state.ticks + 1, silence=silence, stale=stale)
    state, signature, inconsistent = track(tables, state, event, before)
    state = state._replace(seen=tuple(was or now for was, now in zip(state.seen, state.active, strict=True)))
    location, provisional = tables["tracker"].known(state.tracker)
    if is_doubted(tables, state):
        location, provisional = -1, True
    status = IDENTIFIED if location >= 0 else PROVISIONAL if provisional else SEARCHING
    if inconsistent:
        status = INCONSISTENT
    elif not valid:
        status = INVALID
    return state, (location, state.tracker, signature, status, state.x)


def heed(tables: Tables, ages: tuple[int, ...], command: tuple[int, ...]) -> tuple[int, ...]:
    """Return for how many ticks each value of a command has been off; of an unknown command all values may be on."""
    result: list[int] = []
    for count, code in zip(tables["commands"], command, strict=True):
        for value in range(count):
            on = code == value + 1 or not 1 <= code <= count
            result.append(0 if on else min(ages[len(result)] + 1, tables["window_ticks"] + 1))
    return tuple(result)


def allowed(ages: tuple[int, ...], ticks: int) -> int:
    """Return the values of commands that were on in the last `ticks` ticks or are now, as a mask."""
    mask = 0
    for value, age in enumerate(ages):
        mask |= 1 << value if age <= ticks else 0
    return mask


def is_within(values: Numbers) -> bool:
    """Return whether every number is finite and not beyond LARGEST; false for NaN."""
    return all(-LARGEST <= value <= LARGEST for value in values)


def affine(rows: tuple[Numbers, ...], offset: Numbers, vector: Numbers) -> Numbers:
    """Return rows · vector + offset."""
    result = []
    for row, constant in zip(rows, offset, strict=True):
        total = row[0] * vector[0]
        for column in range(1, len(vector)):
            total = total + row[column] * vector[column]
        result.append(total + constant)
    return tuple(result)


def advance(tables: Tables, state: State) -> State:
    """Move generators and estimate over the past step with the held sample; nothing moves before the first one."""
    if state.sample is None:
        return state
    sample_input, sample_output = state.sample
    z = []
    for generator, value in zip(tables["generators"], state.z, strict=True):
        advanced = affine(generator["rows"], generator["offset"], value + sample_input + sample_output)
        z.append(advanced if is_within(advanced) else start_generator(generator, sample_output))
    if tables["decision"] == "imm":
        z, evidence = interact(tables["chain"], z, state.evidence)
        state = state._replace(evidence=evidence)
    x = state.x
    if state.flow >= 0:
        x = affine(tables["flow_rows"][state.flow], tables["flow_offset"][state.flow], x + sample_input + sample_output)
    return state._replace(z=tuple(z), x=x if is_within(x) else tables["start"])


def interact(
    chain: tuple[Numbers, ...], z: list[Numbers], evidence: tuple[Numbers, ...]
) -> tuple[list[Numbers], tuple[Numbers, ...]]:
    """Predict the probabilities of interacting filters, and start each from the mean of those it may come from."""
    mixed, predicted = [], []
    for own, row in zip(z, chain, strict=True):
        joint = [chance * before[0] for chance, before in zip(row, evidence, strict=True)]
        total = summed(joint)
        predicted.append((total,))
        mixed.append(mean(joint, total, z) if total > 0.0 else own)
    return mixed, tuple(predicted)


def mean(joint: list[float], total: float, z: list[Numbers]) -> Numbers:
    """Return the mean of vectors with these weights, which sum to `total`."""
    weights = [part / total for part in joint]
    return tuple(
        summed([weight * value for weight, value in zip(weights, column, strict=True)])
        for column in zip(*z, strict=True)
    )


def summed(terms: Numbers | list[float]) -> float:
    """Return the sum from left to right."""
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def start_generator(generator: Tables, sample_output: Numbers) -> Numbers:
    """Return the generator's state that explains one output best."""
    return affine(generator["start"], generator["start_offset"], sample_output)


def decide(tables: Tables, state: State, sample_input: Numbers, sample_output: Numbers) -> State:
    """Take a valid sample: residuals, relays with hysteresis or tests, debounce."""
    generators, z = tables["generators"], state.z
    if state.sample is None:
        z = tuple(start_generator(generator, sample_output) for generator in generators)
    found = [residuals(made, own, sample_input, sample_output) for made, own in zip(generators, z, strict=True)]
    relay, evidence = judge(tables, state, found)
    debounce, active, away = list(state.debounce), list(state.active), list(state.away)
    for g, generator in enumerate(generators):
        debounce[g] = debounce[g] + 1 if relay[g] != active[g] else 0
        if debounce[g] >= (generator["on_ticks"] if relay[g] else generator["off_ticks"]):
            active[g], debounce[g] = relay[g], 0
        away[g] = 0 if active[g] else min(away[g] + 1, tables["patience"])
    return state._replace(
        sample=(sample_input, sample_output),
        z=z,
        relay=relay,
        debounce=tuple(debounce),
        active=tuple(active),
        away=tuple(away),
        evidence=evidence,
    )


def residuals(generator: Tables, z: Numbers, sample_input: Numbers, sample_output: Numbers) -> Numbers:
    """Return the residual of one generator, by output; 0 where it has none."""
    return affine(generator["residual_rows"], generator["residual_offset"], z + sample_input + sample_output)


def judge(tables: Tables, state: State, found: list[Numbers]) -> tuple[Flags, tuple[Numbers, ...]]:
    """Return by generator whether its relay is on after these residuals, and what has been gathered since."""
    if tables["decision"] == "imm":
        evidence = weigh_filters(tables, found, state.evidence)
        levels = [0.5 if on else tables["confidence"] for on in state.relay]
        owners = enumerate(tables["owner"])
        return tuple(o == g and likelihood(tables, g, evidence) >= levels[g] for g, o in owners), evidence
    judged = []
    for generator, residual, on, gathered in zip(tables["generators"], found, state.relay, state.evidence, strict=True):
        if tables["decision"] == "sprt":
            judged.append(weigh_sequence(tables, generator, residual, on, gathered))
        elif tables["decision"] == "glr":
            judged.append(weigh_window(tables["limits"], generator, residual, gathered))
        else:
            judged.append((is_quiet(generator, residual, on), gathered))
    return tuple(on for on, _ in judged), tuple(gathered for _, gathered in judged)


def is_quiet(generator: Tables, residual: Numbers, on: bool) -> bool:
    """Return whether all residuals are small: below the upper level of the relay while it is on, else the lower."""
    limit = generator["release"] if on else 1.0
    for value, weight in zip(residual, generator["weight"], strict=True):
        size = value if value >= 0.0 else -value
        if not size * weight <= limit:
            return False
    return True


def square(vector: Numbers) -> float:
    """Return |vector|²."""
    return summed([value * value for value in vector])


def weigh_sequence(
    tables: Tables, generator: Tables, residual: Numbers, on: bool, evidence: Numbers
) -> tuple[bool, Numbers]:
    """Add a sample to the log-likelihood ratio of "not this location" to "this one"; a decision begins it again."""
    slope, offset, lower, upper = generator["test"]
    total = evidence[0] + (slope * square(affine(generator["whitening"], generator["unbiased"], residual)) - offset)
    if not total < upper:
        return False, tables["evidence"]
    return (True, tables["evidence"]) if total <= lower else (on, (total,))


def weigh_window(limits: Numbers, generator: Tables, residual: Numbers, evidence: Numbers) -> tuple[bool, Numbers]:
    """Compare the sums of the last 1, 2, ... residuals with their limits; the evidence is these residuals."""
    width = len(residual)
    recent = affine(generator["whitening"], generator["unbiased"], residual) + evidence[:-width]
    total, quiet = generator["unbiased"], True
    for number, limit in enumerate(limits):
        latest = recent[number * width : (number + 1) * width]
        total = tuple(first + second for first, second in zip(total, latest, strict=True))
        quiet = quiet and square(total) <= limit
    return bool(quiet), recent


def weigh_filters(tables: Tables, found: list[Numbers], evidence: tuple[Numbers, ...]) -> tuple[Numbers, ...]:
    """Return the probabilities of interacting filters after a sample, each by Student's density of its residual."""
    weights: list[float] = []
    for generator, share, residual, before in zip(tables["generators"], tables["share"], found, evidence, strict=True):
        ratio = 1.0 + square(affine(generator["whitening"], generator["unbiased"], residual)) / tables["freedom"]
        power = ratio
        for _ in range(tables["power"] - 1):
            power = power * ratio
        weights.append(share * before[0] / power)
    total = summed(weights)
    return tuple((weight / total,) for weight in weights) if total > 0.0 else evidence


def likelihood(tables: Tables, location: int, evidence: tuple[Numbers, ...]) -> float:
    """Return the probability of a location: of all its filters together."""
    return summed([mu for owner, (mu,) in zip(tables["owner"], evidence, strict=True) if owner == location])


def track(tables: Tables, state: State, event: int, before: Flags) -> tuple[State, int, bool]:
    """Move by event, signature or silence; return also the signature (or -1) and whether nothing explains the event."""
    inconsistent = moved = False
    if event != 0:
        known = 1 <= event <= tables["events"]
        lately = allowed(state.command_age, tables["command_slack"])
        target = tables["tracker"].after_event(state.tracker, event - 1, lately) if known else -1
        if target < 0:
            inconsistent = True
            target = tables["tracker"].restart_on(event - 1, lately) if known else tables["restart"]
        state, moved = settle(tables, move(tables, state, target)), True
        if not tables["tracker"].known(target)[1]:
            stale = tuple(was and now for was, now in zip(before, state.active, strict=True))
            state = state._replace(stale=stale)
    target, signature, fired = listen(tables, state, before)
    state = state._replace(fired=fired)
    timeout = tables["tracker"].timeout(state.tracker)
    if target >= 0:
        state = settle(tables, move(tables, state, target))
    elif not moved and timeout != -1 and state.silence == tables["window_ticks"]:
        inconsistent = timeout < 0
        state = move(tables, state, tables["restart"] if inconsistent else timeout)
    elif not moved and is_refuted(tables, state):
        inconsistent = True
        state = move(tables, state, tables["restart"])
    return state, signature, inconsistent


def listen(tables: Tables, state: State, before: Flags) -> tuple[int, int, int]:
    """Return target and number of the first signature that holds (or -1, -1), and the one that is blocked from now.

    `before` is the activity one tick ago.
    """
    blocked = -1
    lately = allowed(state.command_age, tables["window_ticks"])
    for signature, own, quiet, target in tables["tracker"].candidates(state.tracker, lately):
        holds = are_excluded(tables, state, quiet)
        if own >= 0:
            holds = holds and state.active[own] and not state.stale[own]
            if target == state.tracker:  # a self-loop: the residual was small, left, and has come back just now
                holds = holds and state.seen[own] and not before[own] and state.silence > 0
        elif tables["decision"] == "relay":  # a negation: generators that had no time to become active are no evidence
            settled = state.silence == tables["window_ticks"]
            holds = holds and (settled or any(state.seen[g] for g in quiet))
        elif not is_alone(tables, state, quiet):  # a negation of all others: it has had the time to become active
            named = own_generator(tables, target)
            holds = holds and (named < 0 or state.active[named])
        if holds and signature != state.fired:
            return target, signature, signature
        if holds:
            blocked = signature
    return -1, -1, blocked


def settle(tables: Tables, state: State) -> State:
    """Forget the commands before a transition that is seen now: the next one comes after it."""
    out = tables["window_ticks"] + 1
    ages = tuple(age if age <= tables["command_slack"] else out for age in state.command_age)
    return state._replace(command_age=ages)


def own_generator(tables: Tables, tracker: int) -> int:
    """Return the generator of the location that a tracker state identifies, -1 where there is none."""
    location = tables["tracker"].known(tracker)[0]
    return int(tables["own"][location]) if location >= 0 else -1


def is_alone(tables: Tables, state: State, quiet: tuple[int, ...]) -> bool:
    """Return whether nothing but the identified location need be excluded, which was entered long ago."""
    own = own_generator(tables, state.tracker)
    return len(quiet) == 1 and quiet[0] == own and state.silence >= tables["exclude_ticks"]


def are_excluded(tables: Tables, state: State, quiet: tuple[int, ...]) -> bool:
    """Return whether the plant is in none of the locations of these generators.

    A transient after an entry lasts less than `exclude_ticks`: a generator that has been away for longer has not just
    been entered, and the one of the identified location alone need not be waited for.
    """
    if tables["decision"] == "relay":
        return not any(state.active[g] for g in quiet)
    if is_alone(tables, state, quiet):
        return not state.active[quiet[0]]
    return all(state.away[g] >= tables["exclude_ticks"] for g in quiet)


def is_doubted(tables: Tables, state: State) -> bool:
    """Return whether the identified location explains the samples no more, so that it is not told."""
    own = own_generator(tables, state.tracker)
    if tables["decision"] == "relay" or own < 0 or state.active[own]:
        return False
    return state.seen[own] or state.silence >= tables["exclude_ticks"]


def is_refuted(tables: Tables, state: State) -> bool:
    """Return whether the identified location has been away so long that the way it was left should have shown."""
    own = own_generator(tables, state.tracker)
    settled = tables["decision"] != "relay" and own >= 0 and state.silence == tables["window_ticks"]
    return settled and state.away[own] == tables["patience"]


def move(tables: Tables, state: State, tracker: int) -> State:
    """Enter a tracker state; into an identified location the estimate takes the reset of the transition."""
    location, provisional = tables["tracker"].known(tracker)
    none = (False,) * len(state.active)
    state = state._replace(tracker=tracker, silence=0, seen=state.active, stale=none)
    if location < 0:
        return state if provisional else state._replace(flow=-1)
    x = state.x
    reset = tables["reset_index"][state.flow][location] if state.flow >= 0 and tables["reset_rows"] else -1
    if reset >= 0:
        x = affine(tables["reset_rows"][reset], tables["reset_offset"][reset], x)
    return state._replace(flow=location if tables["flow_defined"][location] else -1, x=x)
