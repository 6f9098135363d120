"""The verifier accepts what was certified and names the inequality that a changed number breaks."""

import copy
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deshybrid.continuous.cycles import dwell_lower_limit
from deshybrid.continuous.document import design_document
from deshybrid.continuous.dwell import certify_dwell, certify_sampled
from deshybrid.continuous.gains import design_gains
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.diagnostics import LimitReached, UsageError, catalogue
from deshybrid.model.system import HybridSystem
from deshybrid.verify import read_design, verify_design
from tests.switched import driveline, linear, switched, twin

Tree = dict[str, Any]


def document(system: HybridSystem, *, rate: float = 1.0, dwell: float | None = 1.0, step: float = 0.005) -> Tree:
    names = tuple(location.name for location in system.locations)
    gains = design_gains(system, names, rate=rate, dwell=dwell)
    certificates = [certify_dwell(system, gains), certify_dwell(system, gains, delay=0.01)]
    if system.time_step is None:
        certificates.append(certify_sampled(system, gains, step=step))
    tree = design_document(
        system,
        gains,
        certificates,
        ultimate_bound(system, gains),
        lower_limit=dwell_lower_limit(system, gains, longest=1.0),
        detection_delay=dict.fromkeys(names),
    )
    found: Tree = json.loads(json.dumps(tree, allow_nan=False))
    return found


@pytest.fixture(scope="module")
def design() -> Tree:
    return document(driveline())


def test_a_design_is_accepted_after_its_way_through_json(design: Tree) -> None:
    report = verify_design(design)
    assert report.holds, str(report)
    assert [entry["theorem"] for entry in design["certificates"]] == ["B12-6", "B12-7", "B12-6-sampled"]
    assert report.silent == ()
    assert str(report).startswith(f"verified: {len(report.checks)} of {len(report.checks)} inequalities")


def test_the_document_has_the_keys_of_the_contract_first_and_in_order(design: Tree) -> None:
    assert list(design)[:10] == [
        "gains",
        "eigenvalues",
        "condition",
        "certificates",
        "required_dwell",
        "dwell_lower_limit",
        "witness_cycle",
        "ultimate_bound",
        "detection_delay",
        "determinability",
    ]
    assert list(design["certificates"][0])[:6] == ["theorem", "rate", "dwell", "delay", "holds", "P"]


def test_random_certificates_in_continuous_and_discrete_time_are_accepted() -> None:
    rng = np.random.default_rng(1)
    for step in (None, 0.05):
        for n in (1, 2, 4):
            places = {f"q{k}": linear(rng.normal(size=(n, n)), rng.normal(size=(2, n))) for k in range(2)}
            arcs = [(a, b, rng.normal(size=(n, n))) for a in places for b in places if a != b]
            tree = document(switched(places, arcs, step=step), dwell=None, step=1e-3)
            assert verify_design(tree).holds, str(verify_design(tree))


def test_a_certificate_that_claims_nothing_is_not_checked_and_alone_is_no_yes() -> None:
    tree = document(twin(), dwell=1e-3)
    report = verify_design(tree)
    assert [entry["holds"] for entry in tree["certificates"]] == [False, False, False]
    assert not report.holds
    assert len(report.silent) == 3
    assert "no certificate" in str(report)


def _set(*path: str | int) -> Callable[[Tree, object], None]:
    def change(tree: Tree, value: object) -> None:
        place: Any = tree
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value(place[path[-1]]) if callable(value) else value

    return change


FIRST = ("certificates", 0)
TAMPERED: list[tuple[str, tuple[str | int, ...], object, str]] = [
    ("a gain", ("gains", "q1", 1, 0), lambda g: g + 20.0, "Q Fᵀ + F Q <= 2 α Q"),
    ("a gain, slightly", ("gains", "q4", 0, 0), lambda g: g * 1.001 + 0.1, "Q Fᵀ + F Q <= 2 α Q"),
    ("A of the plant", ("system", "locations", "qN", "A", 1, 1), 3.0, "Q Fᵀ + F Q <= 2 α Q"),
    ("a reset", ("system", "resets", 0, "matrix", 0, 0), 1.01, "‖R‖ <= r"),
    ("a basis", (*FIRST, "T", "q1", 0, 0), [0.0, 0.0], "Q"),
    ("a basis that is singular", (*FIRST, "T", "q1", 0), [[0.0, 0.0]] * 3, "κ²"),
    ("a better κ", (*FIRST, "terms", "q1", "kappa"), lambda k: k * (1 - 1e-6), "κ²"),
    ("κ below one", (*FIRST, "terms", "q1", "kappa"), 0.5, "κ²"),
    ("a better α", (*FIRST, "terms", "q1", "alpha"), lambda a: a * (1 + 1e-6), "2 α Q"),
    ("a smaller r", (*FIRST, "terms", "q1", "r"), 0.999, "‖R‖ <= r"),
    ("a negative r", (*FIRST, "terms", "q1", "r"), -1.0, "‖R‖ <= r"),
    ("a faster rate", (*FIRST, "rate"), 50.0, "(20) with the dwell"),
    ("a rate of zero", (*FIRST, "rate"), 0.0, "the rate is positive"),
    ("a shorter dwell time", (*FIRST, "dwell"), 0.01, "(20) with the dwell"),
    ("a negative dwell time", (*FIRST, "dwell"), -1.0, "0 <= delay < dwell"),
    ("a required dwell time", (*FIRST, "required_dwell"), lambda d: d * 0.99, "(20) with the required dwell"),
    ("no required dwell time", (*FIRST, "required_dwell"), None, "required dwell <= dwell"),
    ("a delay under Theorem 6", (*FIRST, "delay"), 0.001, "Theorem 6 is used without delay only"),
    ("a longer delay", ("certificates", 1, "delay"), 0.99, "(20) with the dwell"),
    ("a negative delay", ("certificates", 1, "delay"), -5.0, "0 <= delay < dwell"),
    ("the scale of the norm", (*FIRST, "scale", 0), lambda s: s * 30, "κ²"),
    ("a scale of zero", (*FIRST, "scale", 0), 0.0, "the scale of the norm is positive"),
    ("a theorem", (*FIRST, "theorem"), "B12-8", "is a theorem this verifier knows"),
    ("a step in continuous time", (*FIRST, "step"), 0.01, "a step is stated in sampled time only"),
    ("the sampled step", ("certificates", 2, "step"), 0.02, "M is e^{A h} minus"),
    ("no sampled step", ("certificates", 2, "step"), None, "a step is stated in sampled time only"),
    ("a sampled matrix", ("certificates", 2, "matrices", "q1", 0, 0), lambda m: m + 1e-4, "M is e^{A h} minus"),
    ("a sampled α", ("certificates", 2, "terms", "q1", "alpha"), lambda a: a * (1 + 1e-6), "M Q Mᵀ <= e^{2 α h} Q"),
    ("the sampled dwell time", ("certificates", 2, "dwell"), 0.02, "(20) with the dwell"),
]


@pytest.mark.parametrize(("what", "path", "value", "broken"), TAMPERED, ids=[entry[0] for entry in TAMPERED])
def test_a_changed_number_is_refused_and_the_broken_inequality_named(
    design: Tree, what: str, path: tuple[str | int, ...], value: object, broken: str
) -> None:
    tree = copy.deepcopy(design)
    _set(*path)(tree, value)
    report = verify_design(tree)
    assert not report.holds
    assert any(broken in check.inequality for check in report.refused), str(report)


def test_a_certificate_that_holds_with_equality_is_accepted() -> None:
    """The dwell time stated is the one required: what was rounded was rounded to the safe side."""
    system = driveline()
    gains = design_gains(system, ("q1", "q4", "qN"), rate=1.0, dwell=0.5)
    needed = certify_dwell(system, gains).required_dwell
    tree = json.loads(json.dumps(design_document(system, gains, [certify_dwell(system, gains, dwell=needed)])))
    assert verify_design(tree).holds
    tree["certificates"][0]["dwell"] = tree["certificates"][0]["required_dwell"] = needed * (1 - 1e-7)
    assert not verify_design(tree).holds


def test_a_required_dwell_time_that_is_tiny_beside_the_delay_is_still_proved() -> None:
    """Decoupled modes have κ = 1 up to rounding: less than a nanosecond is needed, and the delay is 0.3 s."""
    system = switched({"p": linear(np.diag([-3.0, -4.0]), [[1, 0]])}, [("p", "p", None)])
    gains = design_gains(system, ("p",), rate=0.5)
    certificates = [certify_dwell(system, gains, delay=0.3), certify_sampled(system, gains, step=0.01, delay=0.3)]
    assert all(entry.required_dwell < 0.3101 for entry in certificates)
    report = verify_design(json.loads(json.dumps(design_document(system, gains, certificates))))
    assert report.holds, str(report)


MALFORMED: list[tuple[tuple[str | int, ...], object]] = [
    (("system",), None),
    (("system", "locations"), []),
    (("system", "locations"), {}),
    (("system", "locations", "q1"), 3),
    (("system", "locations", "q1", "A"), "x"),
    (("system", "locations", "q1", "A"), [[1.0]]),
    (("system", "locations", "q1", "A"), []),
    (("system", "locations", "q1", "C"), [[1.0]]),
    (("system", "resets"), None),
    (("system", "resets", 0), []),
    (("system", "resets", 0, "from"), "nowhere"),
    (("system", "resets", 0, "to"), ["q1"]),
    (("system", "resets", 0, "matrix"), [[1.0]]),
    (("system", "time_step"), "soon"),
    (("gains",), []),
    (("gains", "q1"), None),
    (("gains", "q1"), [[1.0, 2.0]]),
    (("gains", "q1", 0, 0), True),
    (("gains", "q1", 0, 0), float("nan")),
    (("certificates",), {}),
    (("certificates", 0), None),
    ((*FIRST, "theorem"), 6),
    ((*FIRST, "holds"), "yes"),
    ((*FIRST, "rate"), None),
    ((*FIRST, "rate"), float("inf")),
    ((*FIRST, "dwell"), [1]),
    ((*FIRST, "scale"), [1.0]),
    ((*FIRST, "scale"), None),
    ((*FIRST, "terms"), None),
    ((*FIRST, "terms", "q1"), {}),
    ((*FIRST, "T"), None),
    ((*FIRST, "T", "q1"), [[1.0, 0.0]]),
    ((*FIRST, "T", "q1", 0, 0), [1.0]),
    ((*FIRST, "required_dwell"), "a while"),
    (("certificates", 2, "matrices"), None),
    (("certificates", 2, "step"), -1.0),
]


@pytest.mark.parametrize(("path", "value"), MALFORMED, ids=[".".join(map(str, p)) + f"={v}" for p, v in MALFORMED])
def test_a_malformed_design_is_refused_with_a_code(design: Tree, path: tuple[str | int, ...], value: object) -> None:
    tree = copy.deepcopy(design)
    _set(*path)(tree, value)
    with pytest.raises(UsageError, match="DH0511"):
        verify_design(tree)


def test_an_empty_document_is_refused() -> None:
    with pytest.raises(UsageError, match="DH0511"):
        verify_design({})


@pytest.mark.parametrize("value", [1e308, 5e-324, -1e308])
@pytest.mark.parametrize("key", ["rate", "dwell", "delay", "step", "required_dwell"])
def test_numbers_of_any_size_end_at_once_and_only_weaker_claims_are_accepted(key: str, value: float) -> None:
    tree = document(switched({"p": linear([[-3]], [[1]])}, [("p", "p", [[2]])]))
    for entry in tree["certificates"] if key == "rate" else tree["certificates"][:1]:
        entry[key] = value
    if key == "rate":  # of the lower limit a slower rate is the stronger claim, which is not the one tried here
        tree |= {"rate": value, "dwell_lower_limit": 0.0, "witness_cycle": None}
    weaker = (key, value) in {("dwell", 1e308), ("rate", 5e-324)}
    if key == "step" and value < 0:
        with pytest.raises(UsageError, match="DH0511"):
            verify_design(tree)
    else:
        assert verify_design(tree).holds == weaker


OUTSIDE: list[tuple[str, tuple[str | int, ...], object, str]] = [
    ("the required dwell time", ("required_dwell",), lambda d: d / 2, "`required_dwell` is the least"),
    ("no required dwell time", ("required_dwell",), None, "`required_dwell` is the least"),
    ("the rate", ("rate",), lambda r: r * 2, "`rate` is that"),
    ("an eigenvalue", ("eigenvalues", "q1", 0, 0), lambda v: v * 2, "the eigenvalues have the sum"),
    ("an imaginary part", ("eigenvalues", "q1", 0, 1), lambda v: v + 9.0, "the eigenvalues have the sum"),
]


@pytest.mark.parametrize(("what", "path", "value", "broken"), OUTSIDE, ids=[entry[0] for entry in OUTSIDE])
def test_a_changed_number_outside_of_the_certificates_is_refused(
    design: Tree, what: str, path: tuple[str | int, ...], value: object, broken: str
) -> None:
    tree = copy.deepcopy(design)
    _set(*path)(tree, value)
    assert any(broken in check.inequality for check in verify_design(tree).refused), what


@pytest.mark.parametrize(
    "path",
    [
        ("rate",),
        ("required_dwell",),
        ("gains", "q1"),
        ("eigenvalues", "q1"),
        (*FIRST, "T", "q4"),
        (*FIRST, "terms", "qN"),
    ],
)
def test_a_design_from_which_something_was_dropped_or_to_which_a_location_was_added_is_none(
    design: Tree, path: tuple[str | int, ...]
) -> None:
    for change in ("drop", "add"):
        tree: Any = copy.deepcopy(design)
        place = tree
        for key in path[:-1]:
            place = place[key]
        if change == "drop":
            del place[path[-1]]
        elif len(path) > 1:
            place["elsewhere"] = place[path[-1]]
        else:
            continue
        with pytest.raises(UsageError, match="DH0511"):
            verify_design(tree)


def test_the_report_says_what_is_not_checked(design: Tree) -> None:
    report = verify_design(design)
    assert "`condition`" in str(report)
    assert "whether a reset or location was left out" in str(report)
    assert report.record()["unchecked"] == list(report.unchecked)


@pytest.mark.parametrize("path", [("gains", "q1", 0, 0), (*FIRST, "T", "q1", 0, 0, 0), (*FIRST, "rate")])
@pytest.mark.parametrize("value", [10**401, -(10**401), -1e308, 1e308])
def test_a_number_of_any_length_ends_in_a_verdict_or_a_code(
    design: Tree, path: tuple[str | int, ...], value: float
) -> None:
    tree = copy.deepcopy(design)
    _set(*path)(tree, value)
    if isinstance(value, int):
        with pytest.raises(UsageError, match="DH0511"):
            verify_design(tree)
    else:
        assert not verify_design(tree).holds


def test_a_folder_without_a_design_is_refused_by_the_name_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"design\.json` cannot be read"):
        read_design(str(tmp_path))


def test_a_state_too_large_for_exact_numbers_is_a_limit() -> None:
    size = 41
    place = {"A": [[0.0] * size] * size, "C": []}
    tree = {"gains": {"p": [[]] * size}, "system": {"locations": {"p": place}, "resets": []}, "certificates": []}
    with pytest.raises(LimitReached, match="DH0512"):
        verify_design(tree)


def test_a_design_is_read_from_a_file_a_folder_and_standard_input(
    design: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import io

    text = json.dumps(design)
    file = tmp_path / "design.json"
    file.write_text(text, encoding="utf-8")
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    assert read_design(str(file)) == read_design(str(tmp_path)) == read_design("-") == design


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "3",
        '{"gains": NaN}',
        '{"gains": 1e999',
        "[" * 100_000,
        "\ud800",
        '{"a": 1, "a": 2}',
        r'{"a": "\ud800"}',
    ],
)
def test_what_is_no_design_file_is_refused_with_a_code(text: str, tmp_path: Path) -> None:
    file = tmp_path / "design.json"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(UsageError, match="DH0511"):
        read_design(str(file))


def test_a_missing_file_is_refused_with_a_code(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="DH0511"):
        read_design(str(tmp_path / "none.json"))


def test_the_document_has_the_same_bytes_under_two_hash_seeds() -> None:
    code = (
        "import json; from tests.unit.test_verify_design import document; from tests.switched import twin;"
        "print(json.dumps(document(twin())))"
    )
    texts = set()
    for seed in ("0", "12345"):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"PYTHONHASHSEED": seed},
        )
        texts.add(done.stdout)
    assert len(texts) == 1


def test_every_code_of_the_range_is_explained() -> None:
    assert {f"DH05{number:02}" for number in range(1, 15)} <= set(catalogue())


def test_a_system_in_discrete_time_is_its_own_sampled_form() -> None:
    """Its matrices are of one step already, so nothing is exponentiated a second time."""
    system = switched({"p": linear([[0.9]], [[1]]), "q": linear([[0.5]], [[2]])}, [("p", "q", None)], step=0.1)
    gains = design_gains(system, ("p", "q"), rate=0.2, dwell=2.0)
    tree = json.loads(json.dumps(design_document(system, gains, [certify_sampled(system, gains, step=0.1)])))
    assert verify_design(tree).holds, str(verify_design(tree))
    tree["certificates"][0]["matrices"]["p"][0][0] += 1e-4
    assert any("M is A - G C" in check.inequality for check in verify_design(tree).refused)


@pytest.mark.parametrize("speed", [1e-6, 1e6, 1e12])
def test_a_sampled_observer_of_a_very_slow_or_very_fast_plant_is_verified(speed: float) -> None:
    """The units of the states, not those of the model, decide what counts as equal."""
    A = {"p": np.array([[-1.0, 1], [-2, -3]]), "q": np.array([[-2.0, 1], [-1, -2]])}
    system = switched(
        {name: linear(speed * F, [[1, 0]]) for name, F in A.items()}, [("p", "q", None), ("q", "p", None)]
    )
    gains = design_gains(system, ("p", "q"), rate=0.5, dwell=1.0)
    tree = json.loads(json.dumps(design_document(system, gains, [certify_sampled(system, gains, step=0.01)])))
    assert verify_design(tree).holds, str(verify_design(tree))
