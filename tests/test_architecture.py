"""The table is the architecture: what each part may import. Stages never import each other."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYTHON, CPP = ROOT / "python" / "toile", ROOT / "cpp"
STAGES = {"reconstruct", "track", "segment", "dress", "inner"}
TYPES = {"scene", "kernels"}
ALLOWED = {
    "scene": {"kernels"},
    "colours": set(), "curves": set(), "views": TYPES, "loops": TYPES | {"curves"}, "garment": TYPES, "settle": TYPES,
    "threads": {"kernels"}, "evidence": TYPES | {"threads", "views"}, "ribbon": {"curves"}, "rims": TYPES | {"curves", "loops", "ribbon"},
    "reconstruct": TYPES,
    "track": TYPES | {"settle"},
    "segment": TYPES | {"colours", "curves", "evidence", "ribbon", "views"},
    "dress": TYPES | {"curves", "garment", "loops", "rims", "settle"},
    "layering": {"kernels"},
    "inner": TYPES | {"layering"},
    "template": TYPES | {"garment", "loops"},
    "config": set(),
    "sampling": set(),
    "console": {"scene"},
    "store": set(),
    "workers": TYPES,
    "request": TYPES | {"store", "workers", "__init__"},
    "capture": TYPES | {"io"},
    "budget": TYPES | {"config", "io"},
    "truth": TYPES,
    "page": set(),
    "evaluate": TYPES | {"capture", "io", "store", "truth"},
    "report": TYPES | {"capture", "evaluate", "page", "store"},
    "plan": set(), "layout": TYPES | {"io", "store"},
    "pipeline": TYPES | STAGES | {"capture", "colours", "config", "curves", "io", "layout", "plan", "request", "store", "workers"},
    "avatar": TYPES | {"capture", "config", "io", "layering", "page", "sampling", "store", "truth", "views", "workers"},
    "align": TYPES | {"avatar", "capture", "config", "console", "layering", "page", "plan", "store", "workers", "__init__"},
    "animate": TYPES | {"avatar", "io", "store"},
    "cli": TYPES | {"align", "animate", "avatar", "budget", "capture", "config", "console", "pipeline", "evaluate", "layout", "plan", "report", "template", "studio"},
    "io": {"scene"},
    "__init__": {"kernels"},
}  # fmt: skip
HEAVY = {"torch", "anny", "newton", "warp"}
LAYERS = {"base": {"base"}, "geometry": {"base", "geometry"}, "kernels": {"base", "geometry"}, "bind": {"base", "geometry", "kernels", "bind"}}


def imports(path):
    """(modules of toile, other top-level modules) that a file imports, at any depth of its functions."""
    own, other = set(), set()
    depth = len(path.relative_to(PYTHON).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == depth:
            own |= {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            other.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            other |= {a.name.split(".")[0] for a in node.names}
    return {"__init__" if name == "__version__" else name for name in own}, other


def python_files():
    return [p for p in sorted(PYTHON.rglob("*.py")) if p.relative_to(PYTHON).parts[0] not in ("studio", "kernels")]


def loads_torch(path):
    return path.relative_to(PYTHON).parts[0] in ("avatar", "animate.py")


@pytest.mark.parametrize("path", python_files(), ids=lambda p: str(p.relative_to(PYTHON)))
def test_python_imports_follow_the_table(path):
    own, other = imports(path)
    room = path.relative_to(PYTHON).parts[0].removesuffix(".py")
    assert own <= ALLOWED[room] | {room}, f"{room} imports {own - ALLOWED[room]}"
    assert not other & (HEAVY - {"torch"} if loads_torch(path) else HEAVY)


def test_only_kernels_import_the_compiled_module():
    users = {p.relative_to(PYTHON).parts[0] for p in PYTHON.rglob("*.py") if re.search(r"\b_core\b", p.read_text())}
    assert users == {"kernels"}


def test_kernels_never_include_kernels_and_layers_look_down():
    for path in sorted(CPP.rglob("*.[hc]*")):
        layer = path.relative_to(CPP).parts[0]
        for included in re.findall(r'#include "(\w+)/(\w+)', path.read_text()):
            own_header = layer == "kernels" and included[0] == "kernels" and path.stem.split("_")[0] == included[1].split("_")[0]
            assert included[0] in LAYERS[layer] or own_header, f"{path.name} includes {'/'.join(included)}"
