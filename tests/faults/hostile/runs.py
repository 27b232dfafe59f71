"""Spoilt runs, and folders that a command cannot read or write."""

from tests.faults.hostile.cases import (
    ALIGN,
    DEEP,
    EVALUATE,
    FRAME,
    REGISTER,
    REPORT,
    SAMPLE,
    TEMPLATE,
    TRAIN,
    add,
    damage,
    made_a_file,
    nothing,
    piped,
    written,
)

damage("run", "config.toml", EVALUATE, ("halved",))
damage("run", "registered.zarr/zarr.json", EVALUATE)

for name, spoil in [
    ("no capture", written("config.toml", "frames = [0]\n")),
    ("capture a number", written("config.toml", "capture = 3\n")),
    ("capture gone", written("config.toml", 'capture = "/nowhere/at/all"\n')),
    ("capture null", written("config.toml", 'capture = "a\\u0000b"\n')),
    ("nested", written("config.toml", f"capture = {DEEP}\n")),
]:
    for command in (EVALUATE, REPORT, ALIGN, TRAIN):
        said = "nowhere" if "gone" in name else "config.toml"
        add(f"config.toml {name} {command[0]}", "run", spoil, command, said)
add(
    "register into a garbled run",
    "run",
    written("config.toml", "capture = ["),
    ("register", SAMPLE, "IN"),
    "config.toml",
)
add("register into a capture", "capture", nothing, ("register", "IN", "IN"), "holds no run")
add("register into a file", "capture", nothing, ("register", "IN", "IN/scene.toml"), "scene.toml")
add("register below a file", "capture", nothing, ("register", "IN", "IN/scene.toml/run"), "scene.toml")
add("register into no file system", "capture", nothing, ("register", "IN", "/proc/run"), "/proc/run")
add("register into a long name", "capture", nothing, ("register", "IN", "x" * 300), "xxx")
add("register nothing", "capture", nothing, ("register", "IN/nothing", "OUT"), "nothing")
add("register a file", "capture", nothing, ("register", "IN/scene.toml", "OUT"), "scene.toml")
add("plan a pipe", "capture", lambda f: piped(f / "pipe"), ("plan", "IN/pipe"), "pipe")
add("frames missing", "capture", lambda f: (f / FRAME).rename(f / "frames" / "first"), REGISTER, "no frames")
add("frames a file", "capture", lambda f: (f / FRAME).rename(f / "x") and made_a_file(f / FRAME), REGISTER, "no frames")
for command in (EVALUATE, REPORT, ALIGN, TEMPLATE, TRAIN):
    gone = lambda folder: (folder / "registered.zarr").rename(folder / "elsewhere")
    add(f"no store {command[0]}", "run", gone, command, "registered.zarr")
    add(f"no run {command[0]}", "run", nothing, (command[0], "IN/nothing", *command[2:]), "nothing")
add("report into a file", "run", nothing, (*REPORT, "--out", "IN/config.toml/page.html"), "config.toml", slow=True)
add("report into no file system", "run", nothing, (*REPORT, "--out", "/proc/page.html"), "/proc", slow=True)
add("template below a file", "run", nothing, (*TEMPLATE[:2], "IN/config.toml/x.obj", *TEMPLATE[3:]), "config.toml")
add("template of no label", "run", nothing, (*TEMPLATE[:-1], "cape"), "--label cape")
add("align into its run", "run", nothing, ("align", "IN", "IN"), "folder of its own")
add(
    "align into a folder of others", "run", lambda f: (f / "x").mkdir(), ("align", "IN", "IN/registered.zarr"), "no run"
)
