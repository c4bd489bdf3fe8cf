"""Puts changed source in place of a module that is loaded already, wherever it is in use."""

from __future__ import annotations

import gc
import sys
from collections import Counter, defaultdict
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


class Functions:
    """All functions of some files, however they are wrapped or registered."""

    def __init__(self, files: set[str]) -> None:
        """Find them among all objects there are."""
        self._found = defaultdict(list)
        for thing in gc.get_objects():
            if type(thing) is FunctionType and thing.__code__.co_filename in files:
                self._found[_place(thing.__code__)].append(thing)

    def change(self, file: str, source: str) -> None:
        """Give them the code of changed source, those before and around the change at least."""
        codes = list(_codes(compile(source, file, "exec")))
        times = Counter(map(_place, codes))
        for code in codes:
            for function in self._found.get(_place(code), ()):
                # Of several lambdas in a line, which is which cannot be told.
                if times[_place(code)] == 1 and function.__code__.co_freevars == code.co_freevars:
                    function.__code__ = code


def _place(code: CodeType) -> tuple[str, str, int]:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def change_values(module: ModuleType, source: str) -> None:
    """Give a module, its classes and its functions' arguments the values of changed source.

    Not changed are the members of enumerations, and what other modules computed of the values when
    they were loaded.
    """
    new = ModuleType(module.__name__)
    for name in ("__file__", "__package__", "__spec__", "__loader__"):
        setattr(new, name, getattr(module, name))
    exec(compile(source, str(module.__file__), "exec"), vars(new))  # noqa: S102
    for name, after in list(vars(new).items()):
        before = getattr(module, name, None)
        if getattr(after, "__module__", None) not in (None, module.__name__):
            continue
        if isinstance(before, type) and isinstance(after, type):
            _change_class(before, after)
        elif isinstance(getattr(before, "__wrapped__", before), FunctionType):
            _change_defaults(before, after)
        elif not name.startswith("__") and not isinstance(after, ModuleType):
            _rebind(name, before, after)


def _change_class(old: type, new: type) -> None:
    for name, after in list(vars(new).items()):
        before = vars(old).get(name)
        if name == "__dataclass_fields__":
            for field, changed in after.items():
                if before[field].default != changed.default:
                    before[field].default = changed.default
        elif isinstance(before, (staticmethod, classmethod)):
            _change_defaults(before.__func__, after.__func__)
        elif isinstance(before, FunctionType):
            _change_defaults(before, after)
        elif isinstance(after, (bool, int, float, str, tuple)) and before != after:
            setattr(old, name, after)


def _change_defaults(old: FunctionType, new: FunctionType) -> None:
    while hasattr(old, "__wrapped__") and hasattr(new, "__wrapped__"):
        old, new = old.__wrapped__, new.__wrapped__
    if old.__defaults__ and new.__defaults__:
        pairs = zip(old.__defaults__, new.__defaults__, strict=False)
        old.__defaults__ = tuple(before if before == after else after for before, after in pairs)
    for name, after in (new.__kwdefaults__ or {}).items():
        if old.__kwdefaults__[name] != after:  # an equal member of an enumeration is not the same
            old.__kwdefaults__[name] = after


def _rebind(name: str, old: object, new: object) -> None:
    if type(new).__module__ == type(old).__module__ and type(new) is not type(old):
        object.__setattr__(new, "__class__", type(old))  # the class that everybody knows
    for module in list(sys.modules.values()):
        if isinstance(module, ModuleType) and vars(module).get(name) is old:
            setattr(module, name, new)
