"""Small faults that can be put into a module, one at a time."""

from __future__ import annotations

import ast
import copy
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

_OTHER: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}

# Arguments that only check, or only save memory.
_NO_RESULT = {"strict", "out", "dst", "copy"}


class Mutant(NamedTuple):
    """A module with one fault.

    Attributes:
        line: where the fault is, from 1.
        function: the line where the outermost function around it begins; 0 where there is none.
        before: the code that was there.
        after: the code that is there now.
        source: the whole module.
    """

    line: int
    function: int
    before: str
    after: str
    source: str


def mutants(source: str) -> Iterator[Mutant]:
    """Every fault that is known here, from the top of a module to its end."""
    data = source.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    tree = ast.parse(source)
    functions = sorted(_functions(tree))
    for node, faulty in _faults(tree):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        new = ast.unparse(faulty)
        if isinstance(faulty, ast.expr) and not isinstance(faulty, ast.Constant):
            new = f"({new})"
        changed = data[:begin] + new.encode() + data[end:]
        within = (first for first, last in functions if first <= node.lineno <= last)
        texts = _line(data[begin:end].decode()), _line(new), changed.decode()
        yield Mutant(node.lineno, next(within, 0), *texts)


def _functions(tree: ast.AST) -> Iterator[tuple[int, int]]:
    """First and last lines of the bodies of all functions, also of those within others."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            yield node.body[0].lineno, node.end_lineno or 0


def _line(code: str) -> str:
    return " ".join(code.split())


def _faults(node: ast.AST) -> Iterator[tuple[ast.expr | ast.stmt, ast.AST]]:
    """Nodes, each with what takes its place."""
    if isinstance(node, (ast.expr, ast.stmt)):
        for faulty in _faulty(node):
            yield node, faulty
    if isinstance(node, ast.If) and isinstance(node.test, (ast.Name, ast.Attribute, ast.Call)):
        yield node.test, ast.UnaryOp(ast.Not(), node.test)
    for child in _behaviour(node):
        yield from _faults(child)


def _behaviour(node: ast.AST) -> Iterator[ast.AST]:
    """The children of a node, without those that only describe."""
    skipped = {"annotation", "returns", "decorator_list", "type_params"}
    if isinstance(node, ast.JoinedStr):  # messages, whose places Python 3.11 does not know
        return
    for name, value in ast.iter_fields(node):
        if name in skipped:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_without_result(child):
                yield child


def _is_without_result(node: ast.AST) -> bool:
    if isinstance(node, ast.keyword):
        return node.arg in _NO_RESULT
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _faulty(node: ast.expr | ast.stmt) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in _OTHER:
            yield _with(node, ops=[_OTHER[type(operator)]()])
        case ast.BinOp(op=operator) | ast.BoolOp(op=operator) if type(operator) in _OTHER:
            yield _with(node, op=_OTHER[type(operator)]())
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=bool() | int() | float() as value):
            yield ast.Constant(_another(value))
        case ast.Call(keywords=keywords):
            for dropped in keywords:
                if dropped.arg not in _NO_RESULT:
                    yield _with(node, keywords=[k for k in keywords if k is not dropped])
        case ast.stmt() if _is_dropped(node):
            yield ast.Pass()


def _is_dropped(node: ast.stmt) -> bool:
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    return isinstance(node, (ast.AugAssign, ast.Raise, ast.Continue, ast.Break))


def _another(value: float) -> float:
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else value * 1.5 or 1.0


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed
