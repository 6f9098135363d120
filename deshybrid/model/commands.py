"""The known commands of a model: discrete actions of a controller that whoever observes the plant is told.

In: the decoded keys `commands` of the file and `when` of a transition.  Out: `Command`s, and the values that a
transition needs; DH0201 for a value that its command does not have, DH0220 for more values than there is room for.
Cost: linear in what is written.  Source: this project.
"""

from collections.abc import Mapping
from math import prod
from types import MappingProxyType

from deshybrid.diagnostics import diagnostic
from deshybrid.model.fields import Field, Fields
from deshybrid.model.problems import Problems, did_you_mean
from deshybrid.model.system import Command

MOST_VALUES = 32  # of all commands together: their sets are one word of the generated code
MOST_TOGETHER = 1024  # combinations of values


def build_commands(model: Fields, problems: Problems) -> tuple[Command, ...]:
    """Return the commands in order of declaration; reports DH0220.

    >>> from deshybrid.model.load import loads
    >>> loads('''{format: deshybrid/1, commands: {lever: [P, D]}, locations: [on],
    ...           transitions: [{from: on, to: on, event: a, when: {lever: D}}]}''').commands
    (Command(name='lever', values=('P', 'D')),)
    """
    written = model.get("commands")
    if written is None:
        return ()
    commands = tuple(Command(name, field.names, field.span) for name, field in written.fields)
    count, together = sum(len(c.values) for c in commands), prod(len(c.values) for c in commands)
    if count > MOST_VALUES or together > MOST_TOGETHER:
        text = f"the commands have {count} values, and {together} combinations of them"
        helps = (f"at most {MOST_VALUES} values and {MOST_TOGETHER} combinations are possible",)
        problems.add(diagnostic("DH0220", text, written.span, helps=helps))
    return commands


def build_when(
    written: Field | None, commands: tuple[Command, ...], problems: Problems
) -> Mapping[str, tuple[str, ...]]:
    """Return the values that each command named under `when` may have, in order of declaration; reports DH0201."""
    known = {command.name: command for command in commands}
    needed = {}
    for name, field in () if written is None else written.fields:
        if name in known:  # an unknown command was reported where the key was read
            given = {text: item for item in field.items or (field,) if (text := item.text) is not None}
            for text, item in given.items():
                check_value(text, item, known[name], problems)
            needed[name] = tuple(value for value in known[name].values if value in given)
    return MappingProxyType(needed)


def check_value(text: str, field: Field, command: Command, problems: Problems) -> None:
    """Report DH0201 where a command does not have that value."""
    if text not in command.values:
        message = f"command `{command.name}` has no value `{text[:80]}`"
        problems.add(diagnostic("DH0201", message, field.span, helps=did_you_mean(text, command.values)))


__all__ = ["MOST_TOGETHER", "MOST_VALUES", "build_commands", "build_when", "check_value"]
