"""The tables are the architecture: what each room may import. No circles; stages never import each other."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYTHON, BENCH, CPP = ROOT / "python" / "toile", ROOT / "bench", ROOT / "cpp"
BASE = {"errors", "frame_numbers", "kernels", "kinematics", "scene"}
ROOMS = {  # a room: those that it imports; none of them comes back to it
    "kernels": set(),
    "errors": set(),
    "config": {"errors", "kernels"},
    "lens": {"kernels"},
    "kinematics": {"kernels"},
    "frame_numbers": set(),
    "scene": {"errors", "kernels", "kinematics", "lens"},
    "io": BASE,
    "surface": BASE | {"io"},
    "vision": BASE | {"io", "surface"},
    "prints": BASE | {"surface", "vision"},
    "stages": BASE | {"config", "lens", "prints", "surface", "vision"},
    "pipeline": BASE | {"config", "console", "io", "measure", "prints", "stages", "surface", "vision"},
    "measure": BASE | {"io", "surface", "vision"},
    "align": BASE | {"config", "console", "io", "measure", "pipeline", "prints", "surface", "vision"},
    "avatar": {"config", "errors"},
    "avatar/render": BASE,
    "avatar/model": BASE | {"avatar", "avatar/render", "io", "surface"},
    "avatar/train": BASE | {"avatar", "avatar/model", "io", "measure", "pipeline", "surface", "vision"},
    "avatar/drive": BASE | {"avatar", "avatar/model", "avatar/train", "io", "pipeline", "surface"},
    "avatar/measure": BASE
    | {"avatar", "avatar/drive", "avatar/model", "avatar/render", "avatar/train", "io", "measure", "surface"},
    "avatar/edit": BASE
    | {"avatar", "avatar/drive", "avatar/measure", "avatar/model", "avatar/render", "io", "surface"},
    "studio": BASE | {"config", "io", "pipeline", "surface"},
    "studio/segmenter": BASE | {"studio", "surface"},
    "view": BASE | {"io", "measure"},
    "console": {"errors", "speech"},
    "speech": set(),
}
# files that only parse and call, and the old places of public names: they may import any room
DOORS = {
    "cli",
    "__init__",
    "__main__",
    "capture",
    "avatar/command",
    "studio/command",
    "align/command",
    "config/command",
    "io/command",
    "measure/command",
    "pipeline/commands/pictures",
    "pipeline/commands/register",
    "pipeline/commands/standing",
    "pipeline/commands/tune",
    "view/command",
}
TORCH = {"avatar", "studio"}
HEAVY = {"torch", "anny", "newton", "warp", "mitsuba"}
LAYERS = {
    "base": {"base"},
    "geometry": {"base", "geometry"},
    "kernels": {"base", "geometry"},
    "bind": {"base", "geometry", "kernels", "bind"},
}


def room_of(parts):
    """The room of a module's path: inner folders of avatar and studio are rooms of their own."""
    parts = [p.removesuffix(".py") for p in parts]
    inner = "/".join(parts[:2])
    return inner if inner in ROOMS else parts[0]


def imports(path):
    """(rooms of toile, other top-level modules) that a file imports, at any depth of its functions."""
    own, other, here = set(), set(), path.relative_to(PYTHON).parts
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = list(here[: len(here) - node.level]) + (node.module.split(".") if node.module else [])
            names = [] if node.module else [a.name for a in node.names]
            targets = [[*base, name] for name in names] or [base]
            own |= {room_of(t) for t in targets if (PYTHON / t[0]).exists() or (PYTHON / f"{t[0]}.py").exists()}
        elif isinstance(node, ast.ImportFrom):
            other.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            other |= {a.name.split(".")[0] for a in node.names}
    return own, other


def python_files():
    return sorted(PYTHON.rglob("*.py"))


def name_of(path):
    return str(path.relative_to(PYTHON).with_suffix(""))


@pytest.mark.parametrize("path", python_files(), ids=name_of)
def test_python_imports_follow_the_table(path):
    own, other = imports(path)
    room = room_of(path.relative_to(PYTHON).parts)
    if name_of(path) not in DOORS and path.name != "__init__.py":
        assert own <= ROOMS[room] | {room}, f"{room} imports {own - ROOMS[room] - {room}}"
    assert not other & (HEAVY if room.split("/")[0] not in TORCH else set())


def test_every_room_is_in_the_table_and_the_table_has_no_circle():
    assert {room_of(p.relative_to(PYTHON).parts) for p in python_files()} - DOORS == set(ROOMS)
    left = {room: set(imported) for room, imported in ROOMS.items()}
    while left:
        ground = {room for room, imported in left.items() if not imported & set(left)}
        assert ground, f"a circle among {sorted(left)}"
        left = {room: imported for room, imported in left.items() if room not in ground}


def test_stages_never_import_each_other():
    stages = {p.stem for p in (PYTHON / "stages").glob("[a-z]*.py")}
    for path in (PYTHON / "stages").glob("[a-z]*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == 1:
                named = {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
                assert not named & stages, f"{path.name} imports {named & stages}"


@pytest.mark.parametrize("folder", [PYTHON, BENCH], ids=["toile", "bench"])
def test_no_files_import_one_another_in_a_circle(folder):
    top = "toile" if folder == PYTHON else "bench"
    files = {".".join(p.relative_to(folder).with_suffix("").parts): p for p in folder.rglob("*.py")}
    arrows = {name: modules_of(name, path, files, top) for name, path in files.items()}
    left = dict(arrows)
    while left:
        ground = {name for name, imported in left.items() if not imported & set(left)}
        assert ground, f"a circle among {sorted(left)}"
        left = {name: imported for name, imported in left.items() if name not in ground}


def test_bench_asks_nothing_of_its_inner_room():
    """`bench/paper` builds on the benches, none of them on it."""
    files = {".".join(p.relative_to(BENCH).with_suffix("").parts): p for p in BENCH.rglob("*.py")}
    asked = {name: modules_of(name, path, files, "bench") for name, path in files.items()}
    inner = {name for name in files if name.startswith("paper")}
    assert any(asked[name] - inner for name in inner)
    assert not {name for name in asked.keys() - inner if asked[name] & inner}


def modules_of(name, path, files, top):
    """The files of a folder that one of them imports, at any depth of its functions."""
    found, parts = set(), name.split(".")
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.ImportFrom):
            continue
        if node.level:
            base = parts[: len(parts) - node.level]
        elif node.module.split(".")[0] == top:
            base = []
        else:
            continue
        module = (node.module or "").split(".") if node.level else node.module.split(".")[1:]
        whole = ".".join([*base, *[m for m in module if m]])
        named = {f"{whole}.{a.name}".lstrip(".") for a in node.names}
        found |= (named | {whole}) & set(files)
    return found - {name}


def test_what_a_file_imports_of_another_is_there():
    """Extras are not needed for it, and what a function imports counts too."""
    trees = {path: ast.parse(path.read_text()) for path in [*python_files(), PYTHON / "_core.pyi"]}
    there = {path: defined(tree) for path, tree in trees.items()}
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            target = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            files = target.with_suffix(".py"), target.with_suffix(".pyi"), target / "__init__.py"
            names = set().union(*(there.get(file, ()) for file in files)) | {
                p.stem for p in target.glob("*") if p.is_dir() or p.suffix in (".py", ".pyi")
            }
            missing = {alias.name for alias in node.names} - names
            assert not missing or "__getattr__" in names, f"{name_of(path)} imports {missing} of {name_of(target)}"


def defined(tree):
    """Names that a module has, but for those that a function gives it."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
    return found


def test_only_kernels_import_the_compiled_module():
    users = {p.relative_to(PYTHON).parts[0] for p in PYTHON.rglob("*.py") if re.search(r"\b_core\b", p.read_text())}
    assert users == {"kernels"}


# of the store's arrays those names that are no everyday words: `frames`, `done`, `shape`, `face`, `labels` stand for more
KEY = re.compile(r"(registered\.zarr|(track|inner|pose|garment|confidence)/.*)$")
STORE_FILES = {"io/layout", "io/run", "io/run_writer"}
TRUTH_FILES = {"measure/truth", "studio/make", "studio/sequence", "studio/truth"}  # truth.zarr has a layout of its own
TRUTH_BENCHES = {"clothing", "draping", "pipeline_captures", "posed_captures"}


def store_keys(path):
    """String constants of a file, parts of f-strings too, that name the run's store or an array of it; no docstrings."""
    tree = ast.parse(path.read_text())
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in prose)
    return sorted({node.value for node in found if isinstance(node.value, str) and KEY.match(node.value)})


def test_no_file_but_the_runs_own_names_an_array_of_the_store():
    files = {name_of(p): p for p in python_files() if name_of(p) not in STORE_FILES | TRUTH_FILES}
    files |= {p.stem: p for p in [*BENCH.rglob("*.py"), *(ROOT / "apps").glob("*.py")] if p.stem not in TRUTH_BENCHES}
    assert {name: keys for name, path in files.items() if (keys := store_keys(path))} == {}
    assert all(store_keys(PYTHON / f"{name}.py") for name in STORE_FILES - {"io/run_writer"})  # the test can fail


def test_only_the_runs_own_files_and_the_truths_open_a_store():
    users = {name_of(p) for p in python_files() if "zarr" in imports(p)[1]}
    assert users == {"io/run", "io/run_writer", "measure/truth", "studio/truth"}


def test_kernels_never_include_kernels_and_layers_look_down():
    """A kernel's files are its public header and source and the private folder of its name."""
    for path in sorted(CPP.rglob("*.[hc]*")):
        layer, *rest = path.relative_to(CPP).with_suffix("").parts
        for other, *inside in included(path):
            own = layer == other == "kernels" and rest[0] == inside[0]
            assert other in LAYERS[layer] or own, f"{path.name} includes {other}/{'/'.join(inside)}"


def included(path):
    """The parts, from cpp/ on and without suffix, of the headers of ours that a file includes."""
    for name in re.findall(r'#include "([\w./]+)"', path.read_text()):
        found = next(p for p in (path.parent / name, CPP / name) if p.exists()).resolve()
        yield found.relative_to(CPP).with_suffix("").parts


def test_headers_beside_the_kernels_are_public():
    """Each is included by the binding of its name, and a private header by its own kernel only."""
    public = {p.stem for p in (CPP / "kernels").glob("*.h")}
    assert public == {p.stem for p in (CPP / "kernels").glob("*.cpp")}
    for name in public:
        assert ("kernels", name) in included(CPP / "bind" / f"{name}.cpp")
    for path in sorted(CPP.rglob("*.[hc]*")):
        for layer, *inside in included(path):
            if layer == "kernels" and len(inside) > 1:
                assert path.relative_to(CPP).with_suffix("").parts[:2] == ("kernels", inside[0])


def test_no_class_name_stands_twice():
    places = {}
    for path in python_files():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name_of(path))
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}
