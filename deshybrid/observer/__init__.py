"""The hybrid observer and its reference step."""

MAX_TABLE = 2_000  # states of a tabulated tracker: as many as `check` is ready to build, some 100 kB for 25 events
