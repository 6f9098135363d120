"""The keys of a model file, `format: deshybrid/1`: which there are, what each holds, what each means.

This description is the only one: `decode` checks files against it, `schema` prints it as JSON Schema.
"""

from deshybrid.model.kinds import (
    ByForm,
    Condition,
    Definitions,
    Flag,
    Key,
    Kind,
    ListOf,
    MapOf,
    Matrix,
    Name,
    Number,
    Pole,
    Record,
    Role,
    Row,
    Text,
    Vector,
    Word,
)

FORMAT = "deshybrid/1"
_POSITIVE = Number(above=0.0)
_NOT_NEGATIVE = Number(at_least=0.0)


def _channels(role: Role) -> Kind:
    unit = ByForm(scalar=Text(), null=True)
    return ByForm(sequence=ListOf(Name(role, declares=True), distinct=True), mapping=MapOf(role, unit, declares=True))


def _bound(role: Role) -> Kind:
    return ByForm(scalar=_NOT_NEGATIVE, mapping=MapOf(role, _NOT_NEGATIVE))


DWELL = Record(
    "how long a stay lasts, in seconds",
    (
        Key("min", _NOT_NEGATIVE, "shortest stay"),
        Key("max", _POSITIVE, "longest stay"),
    ),
)
TAILS = Record(
    "rows whose measurement is far worse than usual, at random",
    (
        Key("share", Number(above=0.0, at_most=1.0), "the share of such rows", required=True),
        Key("factor", Number(at_least=1.0), "how many times as large their covariance is", required=True),
    ),
)
NOISE = Record(
    "covariances of the white noises",
    (
        Key("process", Matrix("n", "n"), "covariance of the process noise (n, n)"),
        Key("measurement", Matrix("p", "p"), "covariance of the measurement noise (p, p)"),
        Key("process_by_state", Matrix("n", "n"), "G: each step adds e G x besides, e white with variance 1"),
        Key("measurement_by_state", Matrix("p", "n"), "G: each measurement has e G x in it, e white with variance 1"),
        Key("tails", TAILS, "heavy tails of the measurement noise"),
    ),
)
LOCATION = Record(
    "one location: x' = A x + B u + E w + f, y = C x + D u + g",
    (
        Key("A", Matrix("n", "n"), "dynamics (n, n)", needs_state=True),
        Key("B", Matrix("n", "m"), "input map (n, m)", needs_state=True),
        Key("C", Matrix("p", "n"), "output map (p, n)", needs_state=True),
        Key("D", Matrix("p", "m"), "feedthrough (p, m); zero where not written", needs_state=True),
        Key("E", Matrix("n", "r"), "disturbance map (n, r); the identity where not written", needs_state=True),
        Key("f", Vector("n"), "constant part of x' (n,); zero where not written", needs_state=True),
        Key("g", Vector("p"), "constant part of y (p,); zero where not written", needs_state=True),
        Key("dwell", DWELL, "shortest and longest stay, in seconds"),
        Key("invariant", Condition(), "condition on states and inputs that holds during a stay", needs_state=True),
        Key("output", _channels("output"), "the outputs measured here, if they differ", needs_state=True),
        Key("input", _channels("input"), "the inputs that act here, if they differ", needs_state=True),
        Key("noise", NOISE, "covariances here, if they differ", needs_state=True),
        Key(
            "observed_as",
            Text(),
            "the location of a coarser model that this one is, where a campaign observes it by that",
        ),
    ),
)
RESET = Record(
    "x := matrix x + offset",
    (
        Key("matrix", Matrix("n", "n"), "(n, n); the identity where not written"),
        Key("offset", Vector("n"), "(n,); zero where not written"),
    ),
)
_GAMMA = Name("discrete output", declares=True)
_VALUE = Name("value", declares=True)  # which values a command has depends on the command: `commands` looks
_VALUES = ListOf(_VALUE, distinct=True, least=1)
_WHEN = MapOf("command", ByForm(scalar=_VALUE, sequence=_VALUES))
TRANSITION = Record(
    "one transition",
    (
        Key("from", Name("location"), "the location it leaves", required=True),
        Key("to", Name("location"), "the location it enters", required=True),
        Key("event", Name("event", declares=True), "the input event σ", required=True),
        Key(
            "emits",
            ByForm(
                scalar=_GAMMA,
                sequence=ListOf(ByForm(scalar=_GAMMA, null=True), distinct=True, least=1),
                null=True,
            ),
            "the discrete output γ; null or missing = ε, nothing is seen; a list = any of these",
        ),
        Key("when", _WHEN, "the values of commands that permit it, all of them at once; any where not written"),
        Key("guard", Condition(), "taken where this holds; without it the event comes from outside", needs_state=True),
        Key("reset", RESET, "the jump of the state; none where not written", needs_state=True),
    ),
)
CANDIDATE = Record(
    "the signature of one location",
    (
        Key("cost", _NOT_NEGATIVE, "what its residual generator costs; 1 where not written"),
        Key("by", Word(("residual", "negation")), "how it may be made; either where not written"),
    ),
)
COVERING = Record(
    "one detector for several locations",
    (
        Key(
            "covers",
            ListOf(Name("location"), distinct=True, least=1),
            "the locations whose entry it announces, without saying which",
            required=True,
        ),
        Key("cost", _NOT_NEGATIVE, "what it costs; 1 where not written"),
    ),
)
SIGNATURES = Record(
    "which signatures may be added to make the location observable",
    (
        Key(
            "candidates",
            MapOf("location", ByForm(mapping=CANDIDATE, null=True)),
            "the locations that may have one; all where not written",
        ),
        Key(
            "detectors",
            MapOf("detector", COVERING, declares=True),
            "detectors that announce several locations by one signature; none where not written",
        ),
        Key(
            "forbid",
            ListOf(Row((Name("location"), Name("location")))),
            "pairs [from, to] whose transitions must not be instrumented",
        ),
    ),
)
DETECTOR = Record(
    "the transition detector; what is not written is derived",
    (
        Key("poles", MapOf("location", ListOf(Pole())), "poles of the residual generators, rad/s"),
        Key(
            "threshold",
            ByForm(
                scalar=_POSITIVE,
                mapping=MapOf(
                    "location",
                    ByForm(scalar=_POSITIVE, sequence=ListOf(_POSITIVE), mapping=MapOf("output", _POSITIVE)),
                ),
            ),
            "residual level below which a location counts as matching, in units of the outputs",
        ),
        Key("release", Number(at_least=1.0), "factor from the lower to the upper level of the relay"),
        Key("debounce", _NOT_NEGATIVE, "how long a residual must stay low, in seconds"),
        Key(
            "decision",
            Word(("relay", "exclusion", "sprt", "glr", "imm")),
            "how residuals become decisions; where not written, exclusion if the bounds make it possible",
        ),
        Key(
            "false_alarm",
            _POSITIVE,
            "false alarms in a second for each generator, 1/s: of a test, or of a relay, whose release follows",
        ),
        Key(
            "confidence",
            Number(at_least=0.5, at_most=1.0 - 1e-6),
            "probability from which interacting filters (`imm`) name a location",
        ),
        Key("stay", MapOf("location", _POSITIVE), "mean stay for `imm`, in seconds"),
        Key(
            "entry",
            MapOf("location", Matrix("n", "n")),
            "process noise (n, n) that `imm` adds after an entry into the location",
        ),
        Key("entry_time", _POSITIVE, "how long the noise of an entry lasts in the mean, in seconds"),
        Key("window", _POSITIVE, "how long a signature is waited for after an output, in seconds"),
        Key(
            "design",
            Word(("luenberger", "unknown_input", "h2", "auto")),
            "how residual generators are made; luenberger where not written, white residuals for sprt and glr",
        ),
        Key(
            "decouple",
            ListOf(Name("disturbance"), distinct=True, least=1),
            "disturbances that residuals of the design `unknown_input` must not see; as many as can be, largest first",
        ),
        Key("delay", _bound("output"), "by how much an output is measured late, in seconds; residuals allow for it"),
    ),
)
OBSERVER = Record(
    "what is asked of the observer",
    (
        Key("rate", _POSITIVE, "convergence rate µ of the estimation error, 1/s", needs_state=True),
        Key("dwell", _POSITIVE, "dwell time D to certify for, in seconds"),
        Key("step", _POSITIVE, "sampling step of the compiled observer, in seconds"),
        Key("poles", MapOf("location", ListOf(Pole())), "poles of A - G C, rad/s", needs_state=True),
        Key("gains", MapOf("location", Matrix("n", "p")), "gains G (n, p) to certify as given", needs_state=True),
        Key(
            "coordinates",
            MapOf("location", Matrix("n", "n")),
            "Kalman coordinates T (n, n) in which determinability is measured, rows of what is seen first",
            needs_state=True,
        ),
        Key("initial_state", Vector("n"), "x̂ at the start (n,); zero where not written", needs_state=True),
        Key("detector", DETECTOR, "the transition detector", needs_state=True),
    ),
)
SIGNAL = ByForm(
    scalar=Number(),
    mapping=Record(
        "a test signal: points, plus a sine, plus jitter",
        (
            Key("points", ListOf(Row((Number(), Number())), least=1), "[time, value], times increasing"),
            Key("hold", Flag(), "true: steps between the points, false: straight lines; true where not written"),
            Key("amplitude", Number(), "amplitude of the sine"),
            Key("frequency", _NOT_NEGATIVE, "frequency of the sine, Hz"),
            Key("random", _NOT_NEGATIVE, "the jitter is uniform in plus or minus this"),
            Key("period", _POSITIVE, "the jitter is redrawn every so many seconds; 1 where not written"),
        ),
    ),
)
SENSOR = Record(
    "how a sensor distorts one output or input, in this order",
    (
        Key("lag", _NOT_NEGATIVE, "time constant of its first-order lag, in seconds"),
        Key("delay", _NOT_NEGATIVE, "delay, in seconds"),
        Key("period", _NOT_NEGATIVE, "it takes a value every so many seconds and holds it"),
        Key("bias", Number(), "constant error"),
        Key("noise", _NOT_NEGATIVE, "standard deviation of white noise"),
        Key("quantum", _NOT_NEGATIVE, "rounding to multiples of this"),
    ),
)
_PART = Number(at_least=0.0, at_most=1.0)
VARIATION = Record(
    "how the drives of a campaign differ beside their seeds; half widths of uniform variations",
    (
        Key("requests", _NOT_NEGATIVE, "seconds, added to the time of each request"),
        Key("pace", _PART, "share by which all times of the drive are stretched"),
        Key("input", _PART, "share of the points of an input", needs_state=True),
        Key("disturbance", _PART, "share of the points of a disturbance", needs_state=True),
        Key("state", _PART, "share of each component of the initial state", needs_state=True),
    ),
)
COMPARISON = Record(
    "a comparison of two outputs' ratio, which campaigns put beside the observer",
    (
        Key("numerator", Name("output"), "the output that is divided", required=True),
        Key("denominator", Name("output"), "the output it is divided by", required=True),
        Key("ratio", MapOf("location", Number(), least=1), "the ratio in these locations", required=True),
        Key("otherwise", Name("location"), "what is named while no ratio fits; nothing where not written"),
        Key("band", _POSITIVE, "relative distance within which a ratio fits", required=True),
        Key("debounce", _NOT_NEGATIVE, "how long another answer must last before it is named, in seconds"),
        Key("slowest", _NOT_NEGATIVE, "no ratio fits while the denominator is not larger than this"),
    ),
)
SIMULATION = Record(
    "how `simulate` drives the model",
    (
        Key("duration", _POSITIVE, "seconds"),
        Key("location", Name("location"), "where it starts; the first initial location where not written"),
        Key("state", Vector("n"), "x at the start (n,); zero where not written", needs_state=True),
        Key(
            "requests",
            ListOf(Row((_NOT_NEGATIVE, Name("event")))),
            "[time, event]: taken at that time, or as soon after it as the guard holds",
        ),
        Key(
            "commands",
            MapOf("command", ByForm(scalar=_VALUE, sequence=ListOf(Row((_NOT_NEGATIVE, _VALUE)), least=1))),
            "a value, or [time, value] from which it is held; as the requests need it where not written",
        ),
        Key("input", MapOf("input", SIGNAL), "the inputs", needs_state=True),
        Key("unmeasured", MapOf("input", SIGNAL), "added to inputs, but not written to the trace", needs_state=True),
        Key("disturbance", MapOf("disturbance", SIGNAL), "the disturbances", needs_state=True),
        Key("measurement", MapOf("channel", SENSOR), "the sensors, by output or input", needs_state=True),
        Key("variation", VARIATION, "how the drives of `campaign` differ"),
        Key("comparison", COMPARISON, "what `campaign` compares the observer with", needs_state=True),
    ),
)
BOUNDS = Record(
    "bounds of the absolute value, per channel",
    (
        Key("state", _bound("state"), "of each state"),
        Key("input", _bound("input"), "of each input"),
        Key("disturbance", _bound("disturbance"), "of each disturbance"),
        Key("measurement", _bound("output"), "of the error of each output"),
    ),
)
PRIOR = Record(
    "what is known one step before the first row of a trace",
    (
        Key("mean", Vector("n"), "of the state (n,)", needs_state=True),
        Key("covariance", Matrix("n", "n"), "of the state (n, n)", needs_state=True),
        Key("probability", MapOf("location", Number(at_least=0.0, at_most=1.0)), "of each location; sums to 1"),
    ),
)
REFERENCE = Record(
    "an array in a .npz file inside the model's folder",
    (
        Key("file", Text(), "the file, relative to the model's folder", required=True),
        Key("key", Text(), "the name of the array in it", required=True),
    ),
)
MODEL = Record(
    "a model file of deshybrid",
    (
        Key("format", Word((FORMAT,)), "the version of this language", required=True),
        Key("extends", Text(), "a file of the same folder: this one has all of it that it does not write itself"),
        Key("name", Name("model", declares=True), "a short name; the file's name where not written"),
        Key("summary", Text(), "one sentence"),
        Key("source", Text(), "where the numbers come from"),
        Key("parameters", Definitions(), "names for numbers, or for arithmetic in the names before"),
        Key(
            "tolerance",
            MapOf("parameter", Number(at_least=0.0, at_most=1.0)),
            "by which share of its value a parameter of the plant may be another; detector thresholds allow for it",
            needs_state=True,
        ),
        Key(
            "time",
            ByForm(
                scalar=Word(("continuous",)),
                mapping=Record("discrete time", (Key("step", _POSITIVE, "seconds", required=True),)),
            ),
            "`continuous` (where not written), or {step: h}: then A, B, E and the noise are of one step",
        ),
        Key("state", _channels("state"), "the continuous states; without them the model is purely discrete"),
        Key("input", _channels("input"), "the measured inputs u", needs_state=True),
        Key("output", _channels("output"), "the measured outputs y", needs_state=True),
        Key("disturbance", _channels("disturbance"), "the unknown inputs w", needs_state=True),
        Key("commands", MapOf("command", _VALUES, declares=True), "known discrete actions, each with its values"),
        Key("bounds", BOUNDS, "what states, inputs, disturbances and measurement errors stay below", needs_state=True),
        Key("defaults", LOCATION, "what every location has that does not say otherwise"),
        Key(
            "locations",
            ByForm(
                sequence=ListOf(Name("location", declares=True), distinct=True, least=1),
                mapping=MapOf("location", ByForm(mapping=LOCATION, null=True), declares=True, least=1),
            ),
            "the locations, by name; a list of names where they have no keys",
            required=True,
        ),
        Key("initial", ListOf(Name("location"), distinct=True, least=1), "where a run may start; anywhere if missing"),
        Key("transitions", ListOf(TRANSITION), "the transitions"),
        Key("signatures", SIGNATURES, "which signatures may be added"),
        Key("observer", OBSERVER, "what is asked of the observer"),
        Key("simulation", SIMULATION, "how `simulate` drives the model"),
        Key(
            "transition_probability",
            MapOf("location", MapOf("location", Number(at_least=0.0, at_most=1.0))),
            "{from: {to: p}} for one step; each row sums to 1",
        ),
        Key("noise", NOISE, "covariances in every location that does not say otherwise", needs_state=True),
        Key("prior", PRIOR, "what is known before the first row of a trace"),
    ),
)

__all__ = ["FORMAT", "MODEL", "REFERENCE"]
