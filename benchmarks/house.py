"""The package by numbers: its size, its circles, its types and its constants.

``python benchmarks/house.py [folder]`` reads the code, and runs none of it. With the folder of
another checkout the same is told of that one.
"""

import ast
import sys
from collections import Counter, defaultdict
from pathlib import Path

LONG = 40


def main(root: Path) -> None:
    files = {path: path.read_text() for path in sorted((root / "hybrid").rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in files.items()}
    functions = [node for tree in trees.values() for node in ast.walk(tree) if _is_function(node)]
    said = [each for node in functions for each in _annotations(node)]
    named = constants(trees.values())
    circles = _circles(imports(root / "hybrid", trees))
    rows = {
        "files": len(files),
        "files and folders at the top": len(
            {p.relative_to(root / "hybrid").parts[0] for p in files}
        ),
        "lines": sum(text.count("\n") for text in files.values()),
        "of which code": sum(map(_code, trees.values())),
        "longest file": max(text.count("\n") for text in files.values()),
        f"functions over {LONG} lines, without their docstrings": sum(
            _length(node) > LONG for node in functions
        ),
        "annotations": len(said),
        "of which Any": f"{sum(each == 'Any' for each in said) / len(said):.1%}",
        "class names used twice": len(shared_classes(trees.values())),
        "named constants": sum(map(len, named.values())),
        "names of constants with two values": len(ambiguous(named)),
        "modules in circles of imports, those in functions too": sum(map(len, circles)),
    }
    for what, value in rows.items():
        print(f"{value!s:>8}  {what}")


def _is_function(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)


def _length(node: ast.AST) -> int:
    first = node.body[0]
    told = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    skipped = first.end_lineno - first.lineno + 1 if told else 0
    return node.end_lineno - node.lineno + 1 - skipped


def _annotations(node: ast.AST):
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    given += [each for each in (node.args.vararg, node.args.kwarg) if each]
    yield from (ast.unparse(each.annotation) for each in given if each.annotation)
    if node.returns:
        yield ast.unparse(node.returns)


def _code(tree: ast.Module) -> int:
    """Lines that hold a part of a statement, without docstrings."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        told = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and not told:
            inner = getattr(node, "body", None)
            until = inner[0].lineno - 1 if inner else node.end_lineno
            lines.update(range(node.lineno, max(until, node.lineno) + 1))
    return len(lines)


def shared_classes(trees) -> set[str]:
    """Names of classes that there are two of."""
    nodes = (node for tree in trees for node in ast.walk(tree))
    names = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    return {name for name, count in names.items() if count > 1}


def constants(trees) -> dict[str, list[str]]:
    """Names in capitals at the top of a module, with their values."""
    found = defaultdict(list)
    for tree in trees:
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
                for name, value in _values(node):
                    if name.isupper():
                        found[name].append(value)
    return found


def ambiguous(named: dict[str, list[str]]) -> set[str]:
    """Names of constants that have two values."""
    return {name for name, values in named.items() if len(set(values)) > 1}


def _values(node: ast.Assign | ast.AnnAssign):
    target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
    value = node.value
    if isinstance(target, ast.Name):
        yield target.id, ast.unparse(value)
    elif isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        for each, what in zip(target.elts, value.elts, strict=True):
            yield ast.unparse(each), ast.unparse(what)
    elif isinstance(target, ast.Tuple):  # names of places: range(n)
        for place, each in enumerate(target.elts):
            yield ast.unparse(each), f"{ast.unparse(value)}[{place}]"


def imports(package: Path, trees) -> dict[str, set[str]]:
    """What each module imports, at its top or in functions, but not for types alone."""
    known = {_name(package, path): path for path in trees}
    found = {name: set() for name in known}
    for name, path in known.items():
        here = path.relative_to(package).parts[:-1]
        for node in _imported(trees[path]):
            base = [*here[: len(here) - node.level + 1], *(node.module or "").split(".")]
            module = ".".join(filter(None, base))
            for alias in node.names:
                full = f"{module}.{alias.name}".lstrip(".")
                found[name].add(full if full in known else module or "__init__")
    return {name: {each for each in then if each in known} for name, then in found.items()}


def _name(package: Path, path: Path) -> str:
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def _imported(tree: ast.AST):
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and node.level:
            yield node
        yield from _imported(node)


def _circles(then: dict[str, set[str]]) -> list[set[str]]:
    """Sets of modules each of which is reached from each other one."""
    reached = {name: _reached(then, name) for name in then}
    found = {frozenset(b for b in reached[a] if a in reached[b]) for a in then}
    return [set(each) for each in found if len(each) > 1]


def _reached(then: dict[str, set[str]], name: str) -> set[str]:
    seen, left = set(), [name]
    while left:
        for each in then[left.pop()] - seen:
            seen.add(each)
            left.append(each)
    return seen


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1]))
