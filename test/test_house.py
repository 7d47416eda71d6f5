# SPDX-License-Identifier: Apache-2.0
"""Only public parts of other packages are used, and no library is loaded but through the binding of the kernels."""

import ast
import builtins
import importlib
from collections.abc import Iterator
from pathlib import Path

from every_case import every_case

ROOT = Path(__file__).parents[1]
FILES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / "src").rglob("*.py"))}
EXCEPTED = {"src/foretouch/base/processes.py": "_result_queue"}
"""Of a pool that is ended at once: without closing it, the pool may wait for the rest of a result. Python 3.14 has a public way."""
OURS = ("foretouch", "foretouch_lab")
NAMED_TUPLE = {"_replace", "_asdict", "_fields", "_make"}
"""Public by Python's documentation, in spite of their names."""


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


def bound_names(tree: ast.AST) -> Iterator[str]:
    """Names that a file gives to anything: functions, classes, variables, attributes of `self`, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr


def imported_modules(tree: ast.AST) -> dict[str, str]:
    """What each imported name of a file stands for, such as `rclpy.node.Node`."""
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {
                alias.asname or alias.name.partition(".")[0]: (alias.asname and alias.name)
                or alias.name.partition(".")[0]
                for alias in node.names
            }
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    return names


def resolved(name: str) -> object:
    """The class that a dotted name stands for, or None where its package is not installed."""
    module, _, last = name.rpartition(".")
    try:
        return getattr(importlib.import_module(module), last, None)
    except ImportError:
        return None


def overridden(tree: ast.AST) -> Iterator[str]:
    """Private methods of other packages' classes that a file's classes override."""
    names = imported_modules(tree)
    for node in ast.walk(tree):
        if not isinstance(node, ast.ClassDef):
            continue
        methods = {one.name for one in node.body if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)}
        own = set(filter(is_private, methods))
        for base in node.bases if own else ():
            first, *rest = ast.unparse(base).partition("[")[0].split(".")
            full = ".".join([names.get(first, f"builtins.{first}" if hasattr(builtins, first) else ""), *rest])
            if full.partition(".")[0] not in ("", *OURS):
                theirs = dir(resolved(full))
                yield from (f"{node.name}.{name} of {full}" for name in own & set(theirs))


def foreign_private(tree: ast.AST, known: set[str]) -> list[str]:
    """What a file takes of other packages that is private there."""
    found = list(overridden(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr) and node.attr not in known | NAMED_TUPLE:
            found.append(f"line {node.lineno}: {ast.unparse(node)}")
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            path = [*node.module.split("."), *(alias.name for alias in node.names)]
            if path[0] not in OURS and any(map(is_private, path)):
                found.append(f"line {node.lineno}: {ast.unparse(node)}")
        elif isinstance(node, ast.Import):
            found += [
                f"line {node.lineno}: {alias.name}"
                for alias in node.names
                if any(map(is_private, alias.name.split(".")))
            ]
    return found


def loads_libraries(tree: ast.AST) -> bool:
    return any(name == "ctypes" or name.startswith("ctypes.") for name in imported_modules(tree).values())


def test_no_private_part_of_another_package_is_used_and_no_ctypes() -> None:
    assert len(FILES) > 300
    known = {name for tree in FILES.values() for name in bound_names(tree)}

    def check(path: str, tree: ast.Module) -> None:
        excepted = EXCEPTED.get(path, "nothing")
        assert [line for line in foreign_private(tree, known) if excepted not in line] == []
        assert not loads_libraries(tree)

    every_case([(path.relative_to(ROOT).as_posix(), tree) for path, tree in FILES.items()], check)


def test_no_class_has_a_name_of_the_other_package() -> None:
    robot, laboratory = (
        {
            node.name
            for path, tree in FILES.items()
            if path.is_relative_to(ROOT / "src" / package)
            for node in ast.walk(tree)
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        }
        for package in OURS
    )
    assert robot & laboratory == set()


def is_text_times_truth(node: ast.AST) -> bool:
    """Whether a text or a list is multiplied by whether something holds, where `x if y else z` would be read."""
    if not isinstance(node, ast.BinOp) or not isinstance(node.op, ast.Mult):
        return False
    texts, truths = (ast.JoinedStr, ast.Tuple, ast.List), (ast.Compare, ast.BoolOp)
    return any(
        (isinstance(text, texts) or (isinstance(text, ast.Constant) and isinstance(text.value, str)))
        and (isinstance(truth, truths) or ast.unparse(truth).startswith(("not ", "bool(")))
        for text, truth in ((node.left, node.right), (node.right, node.left))
    )


def test_no_text_is_multiplied_by_a_truth() -> None:
    assert is_text_times_truth(ast.parse("'s' * (n > 1)", mode="eval").body)
    assert not is_text_times_truth(ast.parse("[0] * n", mode="eval").body)
    found = [
        (path.name, ast.unparse(node))
        for path, tree in FILES.items()
        for node in ast.walk(tree)
        if is_text_times_truth(node)
    ]
    assert found == []


def test_the_check_finds_each_kind() -> None:
    code = (
        "import argparse, numpy as np, rclpy\nfrom rclpy.node import Node\nfrom concurrent.futures import _base\n"
        "class Parser(argparse.ArgumentParser):\n    def _check_value(self, action, value): self._own(self._optionals)\n"
        "    def _own(self, x): return x._replace(a=1)\n"
        "message._data = 3\nmessage._header.stamp\n"
        "def f(group: argparse._ActionsContainer): return np._core\n"
    )
    tree = ast.parse(code)
    found = "\n".join(foreign_private(tree, set(bound_names(tree)) - {"_data"}))
    assert not loads_libraries(tree)
    for name in (
        "Parser._check_value",
        "_base",
        "self._optionals",
        "message._data",
        "message._header",
        "argparse._ActionsContainer",
        "np._core",
    ):
        assert name in found, name
    assert "_own" not in found
    assert "_replace" not in found
    assert loads_libraries(ast.parse("from ctypes import util"))
    assert loads_libraries(ast.parse("import ctypes.util"))
