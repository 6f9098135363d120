"""What the documentation prints is what happens: its Python, its command lines, its model files, its lists of keys."""

import doctest
import inspect
import io
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import typer.main
from sybil import Sybil
from sybil.parsers.myst import PythonCodeBlockParser

import deshybrid as dh
from deshybrid import cli, compiler
from deshybrid.formats import reading
from deshybrid.model.kinds import ByForm, Kind, ListOf, MapOf, Record
from deshybrid.model.language import MODEL
from deshybrid.model.load import load, loads

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")))
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
FENCE = re.compile(r"^```(?P<kind>\S*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class Command:
    """A command line of a page, and what the page shows below it."""

    line: str
    shown: str


def blocks(page: str, kind: str) -> list[str]:
    """The fenced blocks of one kind."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [found["text"] for found in FENCE.finditer(text) if found["kind"] == kind]


def commands(page: str) -> Iterator[Command]:
    """The command lines of a page, in order; what follows one up to the next is its output."""
    for block in blocks(page, "console"):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            line, _, shown = part.partition("\n")
            yield Command(line.split("  #")[0].strip(), shown)


PAGES_WITH_COMMANDS = tuple(page for page in PAGES if blocks(page, "console"))
PAGES_WITH_PYTHON = tuple(page for page in PAGES if "```python" in (ROOT / page).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like the checkout to a reader who types what the pages say."""
    folder = tmp_path_factory.mktemp("checkout")
    (folder / "models").symlink_to(ROOT / "models")
    return folder


def shared(function: Callable[..., Any]) -> Callable[..., Any]:
    """A stage that answers a question about the same system only once."""
    kept, signature = cache(function), inspect.signature(function)

    def ask(*arguments: Any, **options: Any) -> Any:
        bound = signature.bind(*arguments, **options)
        bound.apply_defaults()
        return kept(compiler.to_system(bound.arguments.pop("source")), **bound.arguments)

    return ask


@pytest.fixture(scope="module", autouse=True)
def stages_are_shared() -> Iterator[None]:
    """Every value is frozen, so the pages may share what follows from the same file; it saves half of the time."""
    with pytest.MonkeyPatch.context() as patches:
        stages = {name: shared(getattr(compiler, name)) for name in ("recover", "design")}
        for module, (name, stage) in product((dh, compiler), stages.items()):
            patches.setattr(module, name, stage)
        patches.setattr(dh, "load", cache(load))
        kept = cache(reading.read_system)
        for module in (compiler, reading):
            patches.setattr(module, "read_system", kept)
        yield


@pytest.fixture(autouse=True)
def in_the_checkout(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(checkout)


@pytest.mark.parametrize("page", PAGES_WITH_PYTHON)
def test_python_on_a_page_runs_and_shows_what_is_printed(page: str) -> None:
    examples = list(Sybil([PythonCodeBlockParser(doctest_optionflags=FLAGS)]).parse(ROOT / page).examples())
    assert examples
    for example in examples:
        example.evaluate()


@pytest.mark.parametrize("page", PAGES_WITH_COMMANDS)
def test_command_lines_on_a_page_do_what_is_printed(page: str) -> None:
    answered = code = 0
    for command in commands(page):
        if command.line == "echo $?":
            assert command.shown.strip() == str(code), f"{page}: `{command.line}` printed {code}"
            answered = code
            continue
        assert code == answered, f"{page}: exit code {code} before `{command.line}`"
        answered = 0
        code, output = run(command.line)
        if command.shown:
            assert doctest.OutputChecker().check_output(command.shown, output, FLAGS), f"{command.line}\n{output}"
    assert code == answered, f"{page}: exit code {code} at the end"


def run(line: str) -> tuple[int, str]:
    """Exit code and output, both streams, of a command line; `make` targets of the project are only looked up."""
    words = shlex.split(line)
    if Path(words[0]).name == "deshybrid":
        return run_here(*words[1:])
    if words[0] == "make" and len(words) == 2:
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    elif words[0] == "make":  # the generated C; tests/lockstep says so where it cannot be tried
        return run_outside(line) if shutil.which("make") and shutil.which("cc") else (0, "")
    elif words[0] in ("python", "printf"):
        return run_outside(re.sub("^python ", shlex.quote(sys.executable) + " ", line))
    else:
        assert words == [".", ".venv/bin/activate"], f"nothing here knows how to try `{line}`"
    return 0, ""


def run_outside(line: str) -> tuple[int, str]:
    done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False, timeout=120)
    return done.returncode, done.stdout + done.stderr


@cache
def run_here(*words: str) -> tuple[int, str]:
    """Run the command in this process: starting a new one for each line would cost more than the work.

    What stands on several pages is run once: all pages share one folder, and the same words write the same bytes.
    """
    pipe = io.BytesIO()
    stream = io.TextIOWrapper(pipe, encoding="utf-8", write_through=True)
    code = 0
    with patch.object(sys, "argv", ["deshybrid", *words]), redirect_stdout(stream), redirect_stderr(stream):
        try:
            cli.main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
    return code, pipe.getvalue().decode()


def command_table() -> dict[str, Any]:
    return dict(typer.main.get_command(cli.app).commands)  # type: ignore[attr-defined]


def sections(page: str) -> dict[str, str]:
    """The text of each `##` section by every command that its title names."""
    parts = re.split(r"^## ", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    titles = [(re.findall(r"`([a-z]+)\b", part.partition("\n")[0]), part) for part in parts]
    return {name: part for names, part in titles for name in names}


def test_the_page_of_commands_describes_every_command_and_every_option() -> None:
    found = sections("docs/commands.md")
    for name, command in command_table().items():
        assert name in found, f"`{name}` has no section"
        for parameter in command.params:
            options = [option for option in parameter.opts if option.startswith("-")]
            assert not options or any(re.search(rf"{re.escape(o)}\b", found[name]) for o in options), (
                f"{name} {options}"
            )


def test_the_page_of_commands_describes_no_option_that_is_not_there() -> None:
    for name, text in sections("docs/commands.md").items():
        known = {option for parameter in command_table()[name].params for option in parameter.opts}
        assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)) <= known | {"--help"}, name


def test_commands_named_in_running_text_exist() -> None:
    known = set(command_table())
    for page in PAGES:
        text = FENCE.sub("", (ROOT / page).read_text(encoding="utf-8"))
        assert set(re.findall(r"`deshybrid ([a-z]+)", text)) <= known, page


def keys_of(kind: Kind) -> Iterator[str]:
    match kind:
        case Record():
            for key in kind.keys:
                yield key.name
                yield from keys_of(key.kind)
        case ByForm():
            for part in (kind.scalar, kind.sequence, kind.mapping):
                if part is not None:
                    yield from keys_of(part)
        case ListOf():
            yield from keys_of(kind.item)
        case MapOf():
            yield from keys_of(kind.value)


def test_the_page_of_the_model_language_describes_every_key() -> None:
    text = (ROOT / "docs/model-language.md").read_text(encoding="utf-8")
    described = {word for code in re.findall(r"`([^`\n]+)`", FENCE.sub("", text)) for word in re.findall(r"\w+", code)}
    assert set(keys_of(MODEL)) <= described


def with_keys_of(whole: str, part: str) -> str:
    """The model `whole` with the top-level keys of `part` in place of its own."""
    keys: dict[str, list[str]] = {}
    for text in (whole, part):
        fresh: dict[str, list[str]] = {}
        for line in text.splitlines():
            if line[:1] not in ("", " ", "#"):
                fresh[line.partition(":")[0]] = []
            if fresh:
                fresh[next(reversed(fresh))].append(line)
        keys |= fresh
    return "\n".join(line for lines in keys.values() for line in lines) + "\n"


@pytest.mark.parametrize("part", blocks("docs/model-language.md", "yaml"))
def test_every_model_on_the_page_of_the_model_language_loads(part: str, tmp_path: Path) -> None:
    whole = blocks("docs/model-language.md", "yaml")[0]
    (tmp_path / "tank.yaml").write_text(whole, encoding="utf-8")
    system = loads(part if part.startswith("format:") else with_keys_of(whole, part), folder=tmp_path)
    assert system.locations


def test_every_link_between_the_pages_leads_somewhere() -> None:
    for page in PAGES:
        text = FENCE.sub("", (ROOT / page).read_text(encoding="utf-8"))
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text):
            assert (ROOT / page).parent.joinpath(target).exists(), f"{page} links to {target}"


def test_the_picture_of_the_readme_is_what_make_picture_draws() -> None:
    """Graphviz versions differ in coordinates: what is compared is what can be read in the picture."""
    from deshybrid import bundle

    drawn = bundle.drawing(ROOT / "models/balluchi2012/driveline.yaml", "complementary-observer", "svg").decode()
    kept = (ROOT / "docs/driveline-observer.svg").read_text(encoding="utf-8")
    assert sorted(re.findall(r">([^<\n]+)</", kept)) == sorted(re.findall(r">([^<\n]+)</", drawn))


def test_the_pictures_of_detections_are_what_the_commands_of_their_page_draw(checkout: Path) -> None:
    """Fonts differ in widths: what is compared is what can be read in the pictures."""
    shown = re.findall(r"\((detection-(\w+)\.svg)\)", (ROOT / "docs/detection.md").read_text(encoding="utf-8"))
    assert len(shown) == 4
    for command in commands("docs/detection.md"):
        run(command.line)
    for picture, folder in shown:
        drawn, kept = checkout / folder / "timeline.svg", ROOT / "docs" / picture
        words = [re.findall(r">([^<\n]+)</text>", path.read_text(encoding="utf-8")) for path in (drawn, kept)]
        assert words[0] == words[1] != []


def test_every_explanation_of_a_message_is_on_the_page_of_messages() -> None:
    folder = "../deshybrid/diagnostics/explanations/"
    included = re.findall(rf"{{include}} {re.escape(folder)}(\S+)", (ROOT / "docs/messages.md").read_text())
    assert included == sorted(path.name for path in (ROOT / "docs" / folder).glob("*.md"))


def test_docstrings_become_markup_as_the_documentation_promises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import conf

    assert doctest.testmod(conf).attempted > 0
    assert doctest.testmod(conf).failed == 0
