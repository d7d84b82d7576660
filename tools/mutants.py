"""The changes of a module that tools/mutate tries: one number, comparison, clause or statement."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import CodeType
from typing import Any, Final, NamedTuple

SMALL: Final = 100
"""Whole numbers below it become one more and one less."""
SWAPS: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


class Mutant(NamedTuple):
    """One change of a module."""

    path: str
    line: str
    """The line of the source that it begins in."""
    change: str
    code: Callable[[], CodeType]
    """Compiles the module with the change."""
    lines: range
    """Lines of the statement; empty if it runs when the module is imported."""

    @property
    def row(self) -> tuple[str, str, str]:
        """What tells it from others, whatever line it is in."""
        return self.path, self.line, self.change


def numbers(value: float) -> Sequence[float]:
    """Return what a number becomes."""
    if isinstance(value, int) and value < SMALL:
        return value + 1, value - 1
    twice, half = 2 * value, value // 2 if isinstance(value, int) else value / 2
    return (twice, half) if value else (1.0,)


def variants(node: ast.AST) -> Iterator[ast.expr]:
    """Yield what an expression becomes."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            yield from map(ast.Constant, numbers(value))
        case ast.Compare():
            for at, operator in enumerate(node.ops):
                ops = [*node.ops[:at], SWAPS[type(operator)](), *node.ops[at + 1 :]]
                yield ast.Compare(node.left, ops, node.comparators)
        case ast.BoolOp(op, clauses):
            for at in range(len(clauses)):
                rest = [*clauses[:at], *clauses[at + 1 :]]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(op, rest)
        case ast.UnaryOp(ast.Not(), operand):
            yield operand


def removals(node: ast.AST) -> Iterator[ast.stmt]:
    """Yield `pass` for a call or another expression that stands alone, and for an assignment."""
    match node:
        case ast.Expr(ast.Constant()):
            return
        case ast.Expr() | ast.Assign() | ast.AugAssign() | ast.AnnAssign(value=ast.expr()):
            yield ast.Pass()


class _Replaced(ast.NodeTransformer):
    """Puts one expression or statement in the place of another."""

    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self._old, self._new = old, new

    def visit(self, node: ast.AST) -> Any:
        return self._new if node is self._old else self.generic_visit(node)


def parts(
    node: ast.AST, lines: range, inside: bool = False
) -> Iterator[tuple[ast.expr | ast.stmt, range]]:
    """Yield every expression but annotations, and every statement inside of a function.

    With each come the lines that its statement is told by.
    """
    if isinstance(node, ast.stmt):
        body: list[ast.stmt] = getattr(node, "body", [])
        end = body[0].lineno if body else (node.end_lineno or node.lineno) + 1
        lines = range(node.lineno, max(end, node.lineno + 1)) if inside else range(0)
        if inside:
            yield node, lines
    if isinstance(node, ast.expr):
        yield node, lines
    inner = inside or isinstance(node, ast.FunctionDef)
    for name, field in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for child in field if isinstance(field, list) else [field]:
            if isinstance(child, ast.AST):
                yield from parts(child, lines, inner)


def _compiled(tree: ast.Module, old: ast.AST, new: ast.AST, path: str) -> CodeType:
    # A deep copy in which both stand: the tree itself is for the next.
    tree, old, new = copy.deepcopy((tree, old, new))
    return compile(_Replaced(old, new).visit(tree), path, "exec")


def mutants_of(path: Path, *, statements: bool = False) -> list[Mutant]:
    """List the changes of a module: of its values, or the removals of its statements."""
    changes: Callable[[ast.AST], Iterator[ast.AST]] = removals if statements else variants
    source = path.read_text(encoding="utf-8")
    tree, rows = ast.parse(source, str(path)), source.splitlines()
    mutants = []
    for old, lines in parts(tree, range(0)):
        for new in changes(old):
            ast.fix_missing_locations(ast.copy_location(new, old))
            code = partial(_compiled, tree, old, new, str(path))
            change = f"{ast.unparse(old)} -> {ast.unparse(new)}"
            line = rows[old.lineno - 1].strip()
            mutants.append(Mutant(path.as_posix(), line, change, code, lines))
    return mutants
