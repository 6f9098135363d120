"""Names of a model in generated text: prefixes, identifiers, string literals, comments and constants.

In: text as the user wrote it, which may hold anything.  Out: ASCII that is safe at its place in C, C++, Python or
Markdown and means the same there.  A name of the model is never used as an identifier before `unique_identifiers`.

Source: ISO C99, 5.1.1.2 (trigraphs), 6.4.1 (keywords), 6.4.5 (string literals); ISO C++17, 5.11 (keywords).
"""

import keyword
import re
import struct
import sys
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic, raise_all

LONGEST_PREFIX = 40
LONGEST_NAME = 255

_C_KEYWORDS = """
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    asm alignas alignof and and_eq bitand bitor bool catch char16_t char32_t class compl const_cast constexpr decltype
    delete dynamic_cast explicit export false friend mutable namespace new noexcept not not_eq nullptr operator or or_eq
    private protected public reinterpret_cast static_assert static_cast template this thread_local throw true try typeid
    typename using virtual wchar_t xor xor_eq
"""
_TAKEN_FILE_NAMES = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool stddef stdint
    stdio stdlib string tgmath time wchar wctype stdalign stdatomic stdnoreturn threads uchar
    con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
    all clean help install package test
"""


def check_prefix(prefix: str) -> None:
    """Raise UsageError DH0811 unless `prefix` can begin every generated name and every generated file's name.

    It must be an identifier of C, C++ and Python without a leading or double underscore, no keyword, no name of a
    standard header, standard Python module, device or build target, and at most 40 characters long, so that every name
    built from it stays within the 63 characters that C tells apart.

    >>> check_prefix("gearbox")
    """
    problem = _prefix_problem(prefix)
    if problem:
        helps = ("choose letters, digits and single underscores, beginning with a letter: `gearbox`",)
        raise UsageError(diagnostic("DH0811", f"prefix `{ascii_text(prefix)}` {problem}", helps=helps))


def _prefix_problem(prefix: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        return "is no identifier of C"
    if "__" in prefix or prefix.endswith("_"):
        return "ends in an underscore or doubles one, which C++ reserves"
    if prefix in _C_KEYWORDS.split() or keyword.iskeyword(prefix):
        return "is a keyword of C, C++ or Python"
    if prefix.lower() in _TAKEN_FILE_NAMES.split() or prefix in sys.stdlib_module_names:
        return "is the name of a standard header, a standard Python module, a device or a build target"
    if len(prefix) > LONGEST_PREFIX:
        return f"has {len(prefix)} characters, at most {LONGEST_PREFIX} are possible"
    return ""


def identifier(name: str) -> str:
    """Return a usable prefix made from a model's name: what `check_prefix` accepts, as near to the name as possible.

    >>> identifier("two tanks"), identifier("class"), identifier("2nd")
    ('two_tanks', 'observer_class', 'observer_2nd')
    """
    plain = unique_identifiers([name])[0]
    return f"observer_{plain}"[:LONGEST_PREFIX].rstrip("_") if _prefix_problem(plain) else plain


def check_names(kind: str, names: Sequence[str]) -> None:
    """Raise UsageError DH0812 for every name that a C string cannot hold: with a NUL, or above 255 bytes in UTF-8.

    >>> check_names("location", ["q1", "ω"])
    """
    found = []
    for name in names:
        size = len(_utf8(name))
        if "\0" in name:
            found.append(diagnostic("DH0812", f"{kind} name `{ascii_text(name)}` holds a NUL character"))
        elif size > LONGEST_NAME:
            short = ascii_text(name[:20])
            message = (
                f"{kind} name `{short}...` has {size} bytes, at most {LONGEST_NAME} are possible in generated code"
            )
            found.append(diagnostic("DH0812", message))
    raise_all(found, UsageError)


def unique_identifiers(names: Iterable[str], reserved: Iterable[str] = ()) -> tuple[str, ...]:
    """Return one distinct suffix for an identifier per name: ASCII letters, digits, single underscores.

    Letter case is kept; what no identifier can hold becomes an underscore; collisions, among themselves or with
    `reserved`, are numbered in the order of declaration.

    >>> unique_identifiers(["q1", "q 1", "q-1", "ω", "unknown"], reserved=["unknown"])
    ('q1', 'q_1', 'q_1_2', 'x', 'unknown_2')
    """
    taken = set(reserved)
    result = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:LONGEST_PREFIX] or "x"
        candidate, number = plain, 1
        while candidate in taken:
            number += 1
            candidate = f"{plain.rstrip('_')}_{number}"
        taken.add(candidate)
        result.append(candidate)
    return tuple(result)


def c_string(text: str) -> str:
    r"""Return a C string literal of the UTF-8 bytes of `text`, in ASCII, without trigraphs.

    Octal escapes end after three digits, so that a digit may follow them.

    >>> print(c_string('a"b??/ω1'))
    "a\"b\?\?/\317\2111"
    """
    return '"' + "".join(_c_character(byte) for byte in _utf8(text)) + '"'


def _c_character(byte: int) -> str:
    if byte in b'"\\?':
        return "\\" + chr(byte)
    return chr(byte) if 32 <= byte < 127 else f"\\{byte:03o}"


def ascii_text(text: str) -> str:
    r"""Return `text` on one line in printable ASCII, other characters as Python escapes.

    >>> print(ascii_text("ω\n1"))
    \u03c9\n1
    """
    escaped = text.encode("unicode_escape", "surrogatepass").decode("ascii")
    return escaped.replace("\\\\", "\\")


def c_comment(text: str) -> str:
    r"""Return `text` as it may stand inside a C comment: one line, ASCII, no comment marks, no trigraphs.

    >>> c_comment("end */ of /* it ??/")
    'end * / of / * it ? ?/'
    """
    plain = ascii_text(text)
    for mark in ("*/", "/*", "??"):
        while mark in plain:
            plain = plain.replace(mark, f"{mark[0]} {mark[1]}")
    return plain


def markdown_code(text: str) -> str:
    """Return `text` as a Markdown code span: one line, ASCII, backticks shown as apostrophes.

    >>> markdown_code("q`1")
    "`q'1`"
    """
    return "`" + ascii_text(text).replace("`", "'") + "`"


def c_real(value: float, real: Literal["double", "float"]) -> str:
    """Return the shortest C constant that reads back as the same number of type `real`.

    UsageError DH0813 where the number is not finite, or so large or small that a float loses it.

    >>> c_real(0.1, "double"), c_real(0.1, "float"), c_real(-2.0, "double")
    ('0.1', '0.1f', '-2.0')
    """
    number = value if real == "double" else single(value)
    if not _is_finite(number) or (number == 0.0 and value != 0.0):
        message = f"the constant {value!r} cannot be written as a `{real}`"
        raise UsageError(diagnostic("DH0813", message, helps=("choose `double`, or other units in the model",)))
    return repr(float(value)) if real == "double" else str(np.float32(value)) + "f"


def single(value: float) -> float:
    """Return the IEEE 754 single-precision number nearest to `value`; infinite where it is beyond the range.

    >>> single(0.1)
    0.10000000149011612
    """
    try:
        number: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
    return number


def _is_finite(value: float) -> bool:
    return abs(value) <= sys.float_info.max


def _utf8(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
