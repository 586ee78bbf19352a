"""Kernel signatures group arguments by comments: all arrays that a kernel writes stand under ``# … out``."""

import ast
import re
from pathlib import Path

import pytest

KERNELS = Path(__file__).resolve().parents[3] / "generator" / "drape" / "kernels"
WRITERS = ("atomic_add", "atomic_max", "atomic_min", "atomic_cas", "atomic_exch")
MOST_ARGUMENTS = 14
PASSES = {"add_push": 0, "add_weight": 0, "take_push": 0, "take_contact_weight": 0, "mark": 1, "take_slot": 0}
"""Device function to the index of the argument that it writes."""


def kernels() -> list[tuple[str, ast.FunctionDef, list[str]]]:
    """Name, syntax tree and source lines of every kernel."""
    return [
        (f"{path.stem}.{node.name}", node, path.read_text().splitlines())
        for path in sorted(KERNELS.glob("*.py"))
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and any(ast.unparse(d) == "wp.kernel" for d in node.decorator_list)
    ]


def groups_of(kernel: ast.FunctionDef, lines: list[str]) -> dict[str, str]:
    """The comment above each argument."""
    groups, group, argument_lines = {}, "", {arg.lineno: arg.arg for arg in kernel.args.args}
    for number in range(kernel.lineno, kernel.body[0].lineno):
        if comment := re.fullmatch(r"\s*# (.*)", lines[number - 1]):
            group = comment[1]
        if number in argument_lines:
            groups[argument_lines[number]] = group
    return groups


def root_of(node: ast.expr) -> str:
    """The variable of an expression like ``a.b[i]``."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def written_by(kernel: ast.FunctionDef) -> set[str]:
    """Variables with elements that a kernel writes, directly or by ``atomic_…`` and the functions of ``PASSES``."""
    found = set()
    for node in ast.walk(kernel):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = [target for target in node.targets if isinstance(target, ast.Subscript)]
        elif isinstance(node, ast.AugAssign):
            targets = [node.target] if isinstance(node.target, ast.Subscript | ast.Attribute) else []
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            written = 0 if name in WRITERS else PASSES.get(name)
            targets = [] if written is None else [node.args[written]]
        found |= {root_of(target) for target in targets}
    return found


@pytest.mark.parametrize(("name", "kernel", "lines"), kernels(), ids=[name for name, *_ in kernels()])
def test_written_arguments_stand_under_out(name: str, kernel: ast.FunctionDef, lines: list[str]) -> None:
    groups = groups_of(kernel, lines)
    written = written_by(kernel) & set(groups)
    assert written <= {argument for argument, group in groups.items() if group.endswith("out")}, name
    for argument in written:
        if isinstance(node := next(a for a in kernel.args.args if a.arg == argument).annotation, ast.Name):
            assert node.id not in ("Cloth", "World"), f"{name} writes the model"


@pytest.mark.parametrize(("name", "kernel", "lines"), kernels(), ids=[name for name, *_ in kernels()])
def test_kernels_have_few_arguments(name: str, kernel: ast.FunctionDef, lines: list[str]) -> None:
    assert len(kernel.args.args) <= MOST_ARGUMENTS, f"{name} has {len(kernel.args.args)} arguments"
