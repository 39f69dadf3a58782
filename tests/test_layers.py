"""Each module imports from its own layer, without cycles, and from lower-numbered layers only."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ENTRY = re.compile(r"\w+(/\w+)*(\.py|/)")


@dataclass(frozen=True)
class Import:
    """Module `source` imports module `target`; `runs` when that happens as `source` loads."""

    source: str
    target: str
    runs: bool


def layers_of(page: str) -> dict[str, int]:
    """Return unit → layer from the page's list: `record.py` and `files/` give record and files."""
    block = page.split("## Layers", 1)[1].split("```")[1]
    layers: dict[str, int] = {}
    layer = -1
    for line in block.splitlines():
        if heading := re.match(r"\s+-- (\d+) ", line):
            layer = int(heading[1])
        elif line.startswith(" "):
            for word in line.split():
                if not ENTRY.fullmatch(word):
                    break
                layers[word.removesuffix(".py").removesuffix("/").replace("/", ".")] = layer
    return layers


def modules_of(package: Path) -> dict[str, Path]:
    """Return dotted name below the package → file; the package itself is `__init__`."""
    modules = {}
    for path in sorted(package.rglob("*.py")):
        parts = list(path.relative_to(package).with_suffix("").parts)
        if parts[-1] == "__init__" and len(parts) > 1:
            parts.pop()
        modules[".".join(parts)] = path
    return modules


def unit_of(module: str, layers: dict[str, int]) -> str | None:
    """Return the listed unit that holds the module; a folder of listed files holds its own."""
    parts = module.split(".")
    for length in range(len(parts), 0, -1):
        if (name := ".".join(parts[:length])) in layers:
            return name
    if any(unit.startswith(module + ".") for unit in layers):
        return module
    return None


def layer_of(unit: str, layers: dict[str, int]) -> int:
    """Return a unit's layer; a folder's own is the lowest that may import all it lists."""
    if unit in layers:
        return layers[unit]
    return max(layer for name, layer in layers.items() if name.startswith(unit + "."))


def imports_of(name: str, modules: dict[str, Path], package: str) -> Iterator[Import]:
    """Yield what a module imports from its own package, lazily or for types too."""
    tree = ast.parse(modules[name].read_text(encoding="utf-8"))
    running = set(_running(tree))
    for node in ast.walk(tree):
        for target in _targets(node, name, modules, package):
            if target != name:
                yield Import(name, target, node in running)


def _running(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run when the module loads: no function bodies, no types only."""
    yield node
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        return
    typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    children = node.orelse if typing_only else ast.iter_child_nodes(node)  # type: ignore[attr-defined]
    for child in children:
        yield from _running(child)


def _targets(node: ast.AST, name: str, modules: dict[str, Path], package: str) -> Iterator[str]:
    if isinstance(node, ast.Import):
        for alias in node.names:
            if alias.name.split(".")[0] == package:
                yield _nearest(alias.name.split(".")[1:], modules)
    elif isinstance(node, ast.ImportFrom):
        base = _base(node, name, modules, package)
        if base is not None:
            for alias in node.names:
                yield _nearest([*base, alias.name], modules)


def _base(
    node: ast.ImportFrom, name: str, modules: dict[str, Path], package: str
) -> list[str] | None:
    """Return the parts below the package that `from … import` starts at, None if elsewhere."""
    words = node.module.split(".") if node.module else []
    if node.level == 0:
        return words[1:] if words[0] == package else None
    folder = [] if name == "__init__" else name.split(".")
    if modules[name].name != "__init__.py":
        folder = folder[:-1]
    return folder[: len(folder) - (node.level - 1)] + words


def _nearest(parts: list[str], modules: dict[str, Path]) -> str:
    """Return the deepest module on the way to a name."""
    for length in range(len(parts), 0, -1):
        if (name := ".".join(parts[:length])) in modules:
            return name
    return "__init__"


def cycle_in(edges: set[tuple[str, str]]) -> list[str] | None:
    """Return one cycle of a directed graph, or None."""
    following: dict[str, list[str]] = {}
    for source, target in sorted(edges):
        following.setdefault(source, []).append(target)
    done: set[str] = set()

    def visit(node: str, path: list[str]) -> list[str] | None:
        if node in path:
            return [*path[path.index(node) :], node]
        if node in done:
            return None
        for target in following.get(node, []):
            if found := visit(target, [*path, node]):
                return found
        done.add(node)
        return None

    return next((found for node in following if (found := visit(node, []))), None)


def violations(package: Path, page: str) -> list[str]:
    """Return every breach of the layers as a sentence."""
    layers = layers_of(page)
    modules = modules_of(package)
    units = {name: unit_of(name, layers) for name in modules}
    found = [f"{name} stands in no layer" for name, unit in units.items() if unit is None]
    imports = [edge for name in modules for edge in imports_of(name, modules, package.name)]
    crossing: set[tuple[str, str]] = set()
    for edge in imports:
        source, target = units[edge.source], units[edge.target]
        if source is None or target is None or source == target:
            continue
        low, high = layer_of(source, layers), layer_of(target, layers)
        if high > low:
            found.append(f"{edge.source} (layer {low}) imports {edge.target} (layer {high})")
        elif edge.runs:
            crossing.add((source, target))
    inside = {(e.source, e.target) for e in imports if e.runs}
    for graph in (crossing, inside):
        if cycle := cycle_in(graph):
            found.append("cycle: " + " → ".join(cycle))
    return found


def test_every_module_keeps_to_its_layer() -> None:
    """The package obeys the list in docs/architecture.md."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert violations(ROOT / "vibrid", page) == []


def test_the_page_lists_what_the_package_has() -> None:
    """The list is understood: files, folders, files in folders and several on one line."""
    layers = layers_of((ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"))
    known = {"errors": 0, "record": 0, "gram": 1, "methods.okid": 2, "modes": 3, "files": 4}
    assert known.items() <= layers.items()
    assert layers["plots"] == layers["cli"] == layers["web"] == layers["__init__"] == 5
    assert "tests" not in layers


PAGE = """
## Layers
```
pack/
  -- 0 foundations
  low.py      words, more words
  twin.py     words
  -- 1 methods
  ways/one.py words
  high.py     words
  __init__.py words
tests/
```
"""


@pytest.mark.parametrize(
    ("files", "breach"),
    [
        ({"low.py": "", "high.py": "from .low import x"}, None),
        ({"low/__init__.py": "from .part import x", "low/part.py": "x = 1"}, None),
        ({"low.py": "", "ways/__init__.py": "", "ways/one.py": "from ..low import x"}, None),
        ({"low.py": "def f():\n    from . import twin", "twin.py": "from . import low"}, None),
        ({"other.py": ""}, "other stands in no layer"),
        ({"low.py": "from .high import x", "high.py": ""}, "low (layer 0) imports high (layer 1)"),
        ({"low.py": "import pack.high", "high.py": ""}, "low (layer 0) imports high (layer 1)"),
        (
            {"low.py": "def f():\n    from . import high", "high.py": ""},
            "low (layer 0) imports high (layer 1)",
        ),
        (
            {"low.py": "if TYPE_CHECKING:\n    from .high import X", "high.py": ""},
            "low (layer 0) imports high (layer 1)",
        ),
        ({"low.py": "from . import x"}, "low (layer 0) imports __init__ (layer 1)"),
        (
            {"low/__init__.py": "", "low/part.py": "from ..ways import one", "ways/one.py": ""},
            "low.part (layer 0) imports ways.one (layer 1)",
        ),
        ({"low.py": "from . import twin", "twin.py": "from .low import x"}, "cycle"),
        (
            {
                "low/__init__.py": "",
                "low/a.py": "from .b import x",
                "low/b.py": "from . import a",
            },
            "cycle: low.a → low.b → low.a",
        ),
    ],
)
def test_the_checker_sees_a_breach(
    tmp_path: Path, files: dict[str, str], breach: str | None
) -> None:
    """Each kind of breach is found in a small tree, and a sound tree passes."""
    package = tmp_path / "pack"
    for name, text in {"__init__.py": "", **files}.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text, encoding="utf-8")
    found = violations(package, PAGE)
    if breach is None:
        assert found == []
    else:
        assert any(sentence.startswith(breach) for sentence in found), found
