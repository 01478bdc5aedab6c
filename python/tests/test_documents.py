"""The examples of modules, of README.md and of docs/python.md run, and types are complete."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import aircomp_uav

MODULES = [module.name for module in pkgutil.iter_modules(aircomp_uav.__path__)]
FENCE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("name", ["", *(f".{name}" for name in MODULES)])
def test_examples_of_modules(name: str) -> None:
    result = doctest.testmod(importlib.import_module(f"aircomp_uav{name}"))
    assert result.failed == 0


@pytest.mark.parametrize("document", ["README.md", "docs/python.md", "python/README.md"])
def test_examples_of_documents(document: str, repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(repository)
    examples = FENCE.findall((repository / document).read_text())
    assert examples
    names: dict[str, object] = {}
    for example in examples:
        exec(compile(example, document, "exec"), names)


def test_stubs_have_what_the_native_module_has() -> None:
    import ast

    from aircomp_uav import _native

    stub = Path(aircomp_uav.__file__).with_name("_native.pyi")
    tree = ast.parse(stub.read_text())
    described: set[str] = set()
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            described.add(node.name)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            described.add(node.target.id)
        if isinstance(node, ast.ClassDef):
            members = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
            public = {name for name in vars(getattr(_native, node.name)) if not name.startswith("_")}
            assert public == {name for name in members if not name.startswith("_")}, node.name
    there = {name for name in vars(_native) if not name.startswith("__") or name == "__version__"}
    assert described == there


def test_the_package_is_typed() -> None:
    assert Path(aircomp_uav.__file__).with_name("py.typed").exists()
