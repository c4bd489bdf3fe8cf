"""The layers of the code, its errors, the names of the API, the tests' own rules."""

import ast
import pickle
import re
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import depthcli
from depthcli.errors import DepthcliError, InputError, Message, UsageError

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "depthcli"
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")
HALVES = {
    "product": ("depthcli", PAGE.split("## The product")[1].split("\n## ")[0]),
    "laboratory": ("depthcli.lab", PAGE.split("## The laboratory")[1].split("\n## ")[0]),
}
ROW = re.compile(r"^\| `(\w+)` \| (.+?) \|", re.MULTILINE)
FILE = re.compile(r"`([\w/]+\.py)`((?:(?:\s+|,\s+|\s+and\s+)`\w+(?:\.\w+)*`)*)")
FOLDER = re.compile(r"`([\w/]+/)`")


def below(package: str) -> set[str]:
    """Names of the packages and modules in a package; the product's are without the laboratory."""
    folder = ROOT / package.replace(".", "/")
    files = {path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")}
    return (files | {path.parent.name for path in folder.glob("*/__init__.py")}) - {"lab"}


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


@pytest.fixture(params=HALVES)
def half(request: pytest.FixtureRequest) -> tuple[str, str]:
    """A half of the package, and the section of the page about it."""
    return HALVES[request.param]


def test_every_folder_has_a_row_and_every_row_a_folder(half: tuple[str, str]) -> None:
    package, page = half
    assert {name for name, _ in ROW.findall(page)} == below(package)


def test_the_folders_in_a_folder_are_there(half: tuple[str, str]) -> None:
    package, page = half
    for name, holds in ROW.findall(page):
        for inner in FOLDER.findall(holds):
            places = (ROOT / package.replace(".", "/") / name, PACKAGE)
            assert any((place / inner).is_dir() for place in places), inner


@pytest.mark.parametrize(("file", "names"), sorted(set(FILE.findall(PAGE))))
def test_functions_named_in_the_architecture_exist(file: str, names: str) -> None:
    functions = defined(PACKAGE / file)
    assert set(re.findall(r"`([\w.]+)`", names)) <= functions


def test_diagram_has_the_imports_between_folders(half: tuple[str, str]) -> None:
    """An import is an arrow, or a way along arrows; every arrow is an import."""
    package, page = half
    graph, depth = grimp.build_graph("depthcli"), package.count(".") + 1
    pairs = {
        (name.split(".")[depth], used.split(".")[depth])
        for name in graph.modules
        for used in graph.find_modules_directly_imported_by(name)
        if name.startswith(f"{package}.") and used.startswith(f"{package}.")
    }
    folders = below(package) - {"_version"}
    imports = {(pair, other) for pair, other in pairs if pair != other and {pair, other} <= folders}
    arrows = set(re.findall(r"^ +(\w+)(?:\[.+?\])? --> (\w+)", page, re.MULTILINE))
    ways = set(arrows)
    while longer := {(a, d) for a, b in ways for c, d in arrows if b == c} - ways:
        ways |= longer
    assert imports - ways == set()
    assert arrows - imports == set()


def test_the_product_names_the_laboratory_in_the_table_of_commands_alone() -> None:
    files = [path for path in PACKAGE.rglob("*.py") if PACKAGE / "lab" not in path.parents]
    naming = [path.name for path in files if re.search(r"\blab[./]", path.read_text("utf-8"))]
    assert naming == ["table.py"]


def test_imports_have_no_cycle() -> None:
    """Imports for types alone and those within functions count as well."""
    graph = grimp.build_graph("depthcli")
    needs = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    TopologicalSorter(needs).prepare()  # it raises the circle that it finds


BY_STRING = {
    "cli/table.py": "the table of commands",
    "io/formats/table.py": "the table of formats",
    "__init__.py": "the table of public names",
    "lab/datasets/base.py": "the table of data sets",
    "lab/training/methods/registry.py": "the table of methods",
    "lab/training/plugins.py": "modules of the user",
    "lab/training/loggers.py": "packages of others, one for each tracker",
    "jobs/doctor.py": "packages of others, which are checked",
}
"""Files that import what a string names, and why; a contract cannot see these imports."""


def test_only_tables_import_by_string() -> None:
    call = re.compile(r"\b(resolve_name|import_module|__import__)\(")
    files = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if call.search(path.read_text("utf-8"))
    }
    assert files == set(BY_STRING)


@pytest.mark.parametrize("name", depthcli.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(depthcli, name) is not None
    assert name in dir(depthcli)


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        depthcli.nonsense  # noqa: B018 - looking is the test


def test_every_error_is_public() -> None:
    from depthcli import errors  # noqa: PLC0415

    names = {name for name in vars(errors) if name.endswith("Error")}
    assert names <= set(depthcli.__all__)


FILES = sorted(Path(__file__).parent.rglob("*.py"))


def test_no_test_imports_a_conftest() -> None:
    """Each folder has its own module of that name; the last one loaded would be imported."""
    shared = re.compile(r"^\s*(from|import) conftest\b", re.MULTILINE)
    assert [file for file in FILES if shared.search(file.read_text())] == []


def test_names_of_modules_are_unique() -> None:
    names = Counter(file.stem for file in FILES if file.stem != "conftest")
    assert [name for name, count in names.items() if count > 1] == []


def flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


@pytest.mark.parametrize(
    ("error", "text", "of_command"),
    [
        (
            InputError("{a}.png has 9 pixels", "raise {max_pixels} if you trust it"),
            "{a}.png has 9 pixels; raise max_pixels if you trust it",
            "{a}.png has 9 pixels; raise --max-pixels if you trust it",
        ),
        (
            UsageError("3/2 is not I/N", option="shard"),
            "shard: 3/2 is not I/N",
            "--shard: 3/2 is not I/N",
        ),
        (UsageError("bad", "{int8} is none"), "bad; int8 is none", "bad; --int8 is none"),
    ],
)
def test_error_names_parameters_and_the_command_line_its_options(
    error: DepthcliError, text: str, of_command: str
) -> None:
    assert (str(error), error.message.worded(flag)) == (text, of_command)


def test_message_keeps_its_facts_in_another_process_and_another_error() -> None:
    message = Message("flat", "give {anchor}", option="anchors").about("a.png")
    copy = pickle.loads(pickle.dumps(InputError(message)))  # noqa: S301 - its own
    assert copy.message == message == "anchors: a.png: flat; give anchor"
    assert copy.message.advice == "give {anchor}"
