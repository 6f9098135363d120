"""Messages on malformed models, compared byte for byte: they are the part of the language that people read most."""

from pathlib import Path

import pytest

from deshybrid.diagnostics import ModelError, render_all
from deshybrid.model.load import load, loads
from deshybrid.model.problems import MOST_MESSAGES


def messages(text: str, name: str = "models/gearbox.yaml") -> str:
    with pytest.raises(ModelError) as caught:
        loads(text, name)
    return render_all(caught.value.diagnostics)


def test_output_map_with_a_column_too_many_shows_where_the_size_of_the_state_comes_from() -> None:
    text = """\
format: deshybrid/1
locations:
  second: {A: [[0, 1], [-8, -6]], C: [[1, 0, 0]]}
transitions: [{from: second, to: second, event: shift}]
state: [slip, speed]
output: [slip_rate]
"""
    expected = """\
error[DH0203]: output map `C` of location `second` has 3 columns, expected 2
 --> models/gearbox.yaml:3:38
  |
3 |   second: {A: [[0, 1], [-8, -6]], C: [[1, 0, 0]]}
  |               ------------------ `A` is (2, 2), so the state has 2 components
  |                                      ^^^^^^^^^^^ shape (1, 3)
  |
  = help: write one column of `C` per state component: `C: [[1, 0]]`"""
    assert messages(text) == expected


def test_output_of_a_transition_is_placed_where_the_paper_of_taste_shows_it() -> None:
    """models/balluchi2012/fig2.yaml:7:39 in STYLE: the silent output of the transition from 2 to 5."""
    place = load("models/balluchi2012/fig2.yaml").transitions[3].output_span
    assert str(place) == "models/balluchi2012/fig2.yaml:7:39"
    assert place is not None
    assert place.length == len("null")


def test_misspelt_key_is_named_once_and_not_also_reported_as_missing() -> None:
    expected = """\
error[DH0111]: unknown key `locatons`
 --> m.yaml:2:1
  |
2 | locatons: [1]
  | ^^^^^^^^
  |
  = help: did you mean `locations`?"""
    assert messages("format: deshybrid/1\nlocatons: [1]\n", "m.yaml") == expected


def test_all_mistakes_of_a_stage_are_reported_together_in_the_order_of_the_file() -> None:
    text = """\
format: deshybrid/1
parameters: {k: 1/(2 - 2), m: 2*k}
locations: [on, off]
transitions:
  - {from: on, to: of, event: a, emit: x}
"""
    expected = """\
error[DH0123]: the expression has no finite value
 --> m.yaml:2:17
  |
2 | parameters: {k: 1/(2 - 2), m: 2*k}
  |                 ^^^^^^^^^ division by zero
  |

error[DH0201]: unknown location `of`
 --> m.yaml:5:20
  |
5 |   - {from: on, to: of, event: a, emit: x}
  |                    ^^
  |
  = help: did you mean `off`?

error[DH0111]: unknown key `emit`
 --> m.yaml:5:34
  |
5 |   - {from: on, to: of, event: a, emit: x}
  |                                  ^^^^
  |
  = help: did you mean `emits`?"""
    assert messages(text, "m.yaml") == expected


def test_matrix_of_the_defaults_that_fits_no_location_is_reported_once() -> None:
    text = """\
format: deshybrid/1
state: [x]
output: [y]
defaults: {A: [[-1]], C: [[1], [1]]}
locations: [a, b, c]
transitions: [{from: a, to: b, event: s}, {from: b, to: c, event: s}, {from: c, to: a, event: s}]
"""
    assert messages(text).count("error[") == 1


def test_both_places_of_a_duplicate_key_are_shown() -> None:
    expected = """\
error[DH0106]: key `event` is written twice
 --> m.yaml:3:42
  |
3 | transitions: [{from: 1, to: 1, event: a, event: b}]
  |                                ----- first written here
  |                                          ^^^^^ and again here
  |"""
    text = "format: deshybrid/1\nlocations: [1]\ntransitions: [{from: 1, to: 1, event: a, event: b}]\n"
    assert messages(text, "m.yaml") == expected


def test_parameter_used_too_early_is_told_to_move() -> None:
    expected = """\
error[DH0122]: unknown name `tau`
 --> m.yaml:2:20
  |
2 | parameters: {k: 2/(tau + 1), tau: 1}
  |                              --- defined here
  |                    ^^^ used here
  |
  = help: define `tau` before `k`"""
    assert messages("format: deshybrid/1\nparameters: {k: 2/(tau + 1), tau: 1}\nlocations: [1]", "m.yaml") == expected


def test_transposed_probabilities_are_recognised() -> None:
    text = """\
format: deshybrid/1
locations: [a, b]
transition_probability:
  a: {a: 0.9, b: 0.3}
  b: {a: 0.1, b: 0.7}
"""
    assert messages(text).count("the columns sum to 1 instead: write {from: {to: p}}, the other way round") == 2


def test_hundreds_of_mistakes_are_cut_to_fifty_messages_and_a_count() -> None:
    text = "format: deshybrid/1\nlocations: [1]\n" + "".join(f"key{i}: 1\n" for i in range(400))
    shown = messages(text)
    assert shown.count("error[") == MOST_MESSAGES
    assert shown.endswith("350 more mistakes were found and are not listed")


@pytest.mark.parametrize(
    ("value", "piece"),
    [
        ("3*(1 - 1/0)", "1/0"),
        ("'sqrt(0 - 1)'", "sqrt(0 - 1)"),
        ('"2 * log(0)"', "log(0)"),
        ("1 + 10**400", "10**400"),
        ("exp(1000)*2", "exp(1000)"),
        ("1 - 1e300*1e300/3", "1e300*1e300"),
    ],
)
def test_smallest_piece_of_an_expression_is_underlined(value: str, piece: str) -> None:
    line = "parameters: {k: " + value + "}"
    with pytest.raises(ModelError) as caught:
        loads(f"format: deshybrid/1\n{line}\nlocations: [1]")
    place = caught.value.diagnostics[0].span
    assert place is not None
    assert caught.value.diagnostics[0].code == "DH0123"
    assert (place.line, place.column, place.length) == (2, line.index(piece) + 1, len(piece))


def test_file_that_does_not_exist_is_refused_with_a_code(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere.yaml", tmp_path, "a\0b"):
        with pytest.raises(ModelError) as caught:
            load(path)
        assert caught.value.diagnostics[0].code == "DH0104"
