"""docs/architecture.md names every folder that there is, and functions that exist; no circles."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "depthcli"
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")
ROW = re.compile(r"^\| `(\w+)` \| (.+?) \|", re.MULTILINE)
FILE = re.compile(r"`([\w/]+\.py)`((?:(?:\s+|,\s+|\s+and\s+)`\w+(?:\.\w+)*`)*)")
FOLDER = re.compile(r"`([\w/]+/)`")


def below(folder: Path) -> set[str]:
    """Names of the packages and modules in a folder."""
    files = {path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")}
    return files | {path.parent.name for path in folder.glob("*/__init__.py")}


def defined(path: Path) -> set[str]:
    """Names of a module, and of what is in its classes, as Holder.name."""
    names = set()
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            parts = [part for part in node.body if isinstance(part, ast.FunctionDef)]
            names |= {f"{node.name}.{part.name}" for part in parts}
    return names


def test_every_folder_has_a_row_and_every_row_a_folder() -> None:
    assert {name for name, _ in ROW.findall(PAGE)} == below(PACKAGE)


@pytest.mark.parametrize(("name", "holds"), ROW.findall(PAGE))
def test_the_folders_in_a_folder_are_there(name: str, holds: str) -> None:
    for inner in FOLDER.findall(holds):
        assert (PACKAGE / name / inner).is_dir(), inner


@pytest.mark.parametrize(("file", "names"), sorted(set(FILE.findall(PAGE))))
def test_functions_named_in_the_architecture_exist(file: str, names: str) -> None:
    known = defined(PACKAGE / file)
    assert set(re.findall(r"`([\w.]+)`", names)) <= known


def test_the_contract_has_a_layer_for_every_row() -> None:
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    layers = re.search(r"^layers = \[(.*?)^\]", text, re.MULTILINE | re.DOTALL)
    assert set(re.findall(r"\w+", layers[1])) == below(PACKAGE)


def test_diagram_has_the_imports_between_folders() -> None:
    """An import is an arrow, or a way along arrows; every arrow is an import."""
    graph = grimp.build_graph("depthcli")
    pairs = {
        (name.split(".")[1], used.split(".")[1])
        for name in graph.modules
        for used in graph.find_modules_directly_imported_by(name)
        if name.count(".") > 1 and "." in used
    }
    imports = {(one, other) for one, other in pairs if other not in (one, "_version")}
    arrows = set(re.findall(r"^ +(\w+)(?:\[.+?\])? --> (\w+)", PAGE, re.MULTILINE))
    ways = set(arrows)
    while longer := {(a, d) for a, b in ways for c, d in arrows if b == c} - ways:
        ways |= longer
    assert imports - ways == set()
    assert arrows - imports == set()


def test_imports_have_no_cycle() -> None:
    """Imports for types alone and those within functions count as well."""
    graph = grimp.build_graph("depthcli")
    needs = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    TopologicalSorter(needs).prepare()  # it raises the circle that it finds
