"""Run by Blender's Python: IN.usdc OUT.abc FPS FIRST LAST after `--`."""

import sys

import bpy


def main(usd: str, abc: str, fps: float, first: int, last: int) -> None:
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    bpy.ops.wm.usd_import(filepath=usd, import_skeletons=False, import_materials=False)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = max(round(fps), 1), max(round(fps), 1) / fps
    scene.frame_start, scene.frame_end = first, last
    bpy.ops.wm.alembic_export(filepath=abc, start=first, end=last, as_background_job=False)


if __name__ == "__main__":
    usd, abc, fps, first, last = sys.argv[sys.argv.index("--") + 1 :]
    main(usd, abc, float(fps), int(first), int(last))
