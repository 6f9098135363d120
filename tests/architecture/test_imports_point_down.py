"""The house's rule: a package imports only what lies below it, and the start of a command stays light."""

import ast
import pathlib
import subprocess
import sys

import deshybrid

ROOT = pathlib.Path(deshybrid.__file__).parent
LEVEL = {
    "diagnostics": 0,
    "des": 1,
    "linear": 1,
    "model": 2,
    "detector": 3,
    "continuous": 3,
    "observer": 4,
    "stochastic": 4,
    "emit": 5,
    "formats": 5,
    "simulate": 5,
    "verify": 5,
    "compiler": 6,
    "replays": 6,
    "bundle": 7,
    "analysis": 7,
    "estimation": 7,
    "filter_bundle": 8,
    "plans": 7,
    "campaigns": 7,
    "options": 8,
    "console": 7,
    "analysis_command": 9,
    "campaign_command": 9,
    "estimate_command": 9,
    "fit": 6,
    "fit_command": 9,
    "run_command": 9,
    "cli": 10,
}
BESIDE = {("detector", "continuous")}  # residual gains are placed by the code that places observer gains


def package_of(path: pathlib.Path) -> str:
    part = path.relative_to(ROOT).parts[0]
    return part.removesuffix(".py")


def imported_packages(path: pathlib.Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("deshybrid."):
            names.add(node.module.split(".")[1])
        elif isinstance(node, ast.Import):
            names |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("deshybrid.")}
    return names


def test_every_import_points_down_the_house() -> None:
    wrong = []
    for path in sorted(ROOT.rglob("*.py")):
        package = package_of(path)
        if package in ("__init__", "__main__"):
            continue
        for other in imported_packages(path) - {package}:
            if LEVEL[other] >= LEVEL[package] and (package, other) not in BESIDE:
                wrong.append(f"{path.relative_to(ROOT)} imports {other}")
    assert wrong == []


def test_the_verifier_imports_nothing_that_makes_certificates() -> None:
    assert {name for path in (ROOT / "verify").glob("*.py") for name in imported_packages(path)} <= {
        "diagnostics",
        "linear",
        "verify",
    }


def test_starting_a_command_loads_neither_scipy_nor_networkx() -> None:
    heavy = ("scipy", "networkx", "pygraphviz", "jinja2")
    code = f"import sys, deshybrid.cli; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_file_of_the_package_is_longer_than_400_lines() -> None:
    long = [
        str(p.relative_to(ROOT)) for p in sorted(ROOT.rglob("*.py")) if p.read_text(encoding="utf-8").count("\n") > 400
    ]
    assert long == []
