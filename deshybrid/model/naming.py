"""Which texts may be names, and whether a name that is referred to has been declared.

A name is the text as written (`on`, `1`, `012`), so long as it can be printed on a line and stand in a trace file.
"""

from collections.abc import Mapping

from deshybrid.diagnostics import diagnostic
from deshybrid.model.kinds import Role
from deshybrid.model.problems import MOST_MESSAGES, Problems, did_you_mean
from deshybrid.model.tree import ScalarNode

LONGEST_NAME = 100


def check_declared(node: ScalarNode, role: Role, problems: Problems) -> None:
    """Report DH0117 where a text cannot be a name of that role.

    >>> from deshybrid.model.source import parse_source
    >>> problems = Problems()
    >>> check_declared(parse_source('x: "a|b"').tree.get("x"), "location", problems)
    >>> problems.found[0].labels[0].text
    '`|` separates locations in an estimate'
    """
    text, reason = node.text, ""
    if not text:
        reason = "it is empty"
    elif text != text.strip():
        reason = "it begins or ends with a space"
    elif not text.isprintable():
        reason = "it holds a character that cannot be printed"
    elif len(text) > LONGEST_NAME:
        reason = f"it is longer than {LONGEST_NAME} characters"
    elif role == "location" and "|" in text:
        reason = "`|` separates locations in an estimate"
    if reason:
        problems.add(diagnostic("DH0117", f"`{text[:LONGEST_NAME]}` cannot name a {role}", node.span, reason))


def check_known(node: ScalarNode, role: Role, names: Mapping[Role, Mapping[str, None]], problems: Problems) -> None:
    """Report DH0201 where a name of that role was not declared; nothing where none of that role is.

    >>> from deshybrid.model.source import parse_source
    >>> problems = Problems()
    >>> check_known(parse_source("to: fil").tree.get("to"), "location", {"location": {"fill": None}}, problems)
    >>> problems.found[0].message, problems.found[0].helps
    ('unknown location `fil`', ('did you mean `fill`?',))
    """
    known = names.get(role, {})
    if node.text in known:
        return
    if len(problems.found) >= MOST_MESSAGES:
        helps: tuple[str, ...] = ()  # it will not be listed: spare the comparison
    elif known:
        helps = did_you_mean(node.text, known)
    elif role == "location":
        return  # the mistake is in `locations`, and is reported there
    else:
        helps = (f"the model declares no {role}",)
    problems.add(diagnostic("DH0201", f"unknown {role} `{node.text[:LONGEST_NAME]}`", node.span, helps=helps))


__all__ = ["LONGEST_NAME", "check_declared", "check_known"]
