"""USD through usd-core: one prim a layer, times are frame numbers, metres; the skeleton and its motion where there are.

A clip with a skeleton has the variant set `motion` of two: `points`, every frame's vertices as they are, and `skeleton`, rest
surfaces that UsdSkel moves. An x axis that points upwards is turned to y, which USD can say.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from filecmp import cmp
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Anything
from ..files import copy_file
from .clip import Clip, ClipLayer, ClipSkeleton, rest_surface

ROOT = "/clip"
ENDINGS = (".usdc", ".usda", ".usd")
GREYS = (0.75, 0.55, 0.65, 0.45)  # of layers without texture, in turn
SAVED = 100  # frames after which what is in memory goes to the file


def write_usd(clip: Clip, path: Path, motion: str, progress: Callable[..., None]) -> list[str]:
    """Writes .usd, .usdc or .usda, and the pictures that it names into a folder NAME_textures beside it. UserError: usd-core is not
    there, or cannot write."""
    try:
        from pxr import Tf
    except ImportError:
        raise UserError("--format usd: usd-core is not installed: pip install 'toile[export]'") from None

    try:
        return write_stage(clip, path, motion, progress)
    except Tf.ErrorException as error:
        raise UserError(f"{path}: cannot be written: {error.args[0].commentary}") from None


def write_stage(clip: Clip, path: Path, motion: str, progress: Callable[..., None]) -> list[str]:
    """`write_usd`, which raises usd-core's own errors."""
    from pxr import Usd

    clip = clip.with_y_up() if clip.up == "x" else clip
    stage = Usd.Stage.CreateNew(str(path))
    root = start_stage(stage, clip)
    meshes = [define_mesh(stage, clip, i, path) for i in range(len(clip.layers))]
    variant: Callable[[str], AbstractContextManager[Any]] = lambda name: nullcontext()
    notes = []
    if clip.skeleton is not None:
        define_skeleton(stage, clip, clip.skeleton)
    if clip.skinned:
        variants = root.GetPrim().GetVariantSets().AddVariantSet("motion")

        def variant(name: str) -> AbstractContextManager[Any]:
            variants.AddVariant(name)
            variants.SetVariantSelection(name)
            return variants.GetVariantEditContext()

        with variant("skeleton"):
            notes = [bind_mesh(mesh, clip, layer) for mesh, layer in zip(meshes, clip.layers)]
    with variant("points"):
        for done, frame in enumerate(clip.frames):
            for mesh, layer in zip(meshes, clip.layers):
                set_points(mesh, layer.at(frame), frame)
            if (done + 1) % SAVED == 0:
                stage.Save()
            progress("export", done + 1, len(clip.frames))
    if clip.skinned:
        variants.SetVariantSelection(motion)
    stage.Save()
    return notes


def start_stage(stage: Any, clip: Clip) -> Any:
    """The root prim, and what the stage says of units, axes and times."""
    from pxr import UsdGeom, UsdSkel

    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, {"y": UsdGeom.Tokens.y, "z": UsdGeom.Tokens.z}[clip.up])
    stage.SetTimeCodesPerSecond(clip.fps)
    stage.SetFramesPerSecond(clip.fps)
    stage.SetStartTimeCode(clip.frames[0])
    stage.SetEndTimeCode(clip.frames[-1])
    root = (UsdGeom.Xform if clip.skeleton is None else UsdSkel.Root).Define(stage, ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    return root


def define_mesh(stage: Any, clip: Clip, i: int, path: Path) -> Any:
    """The prim of layer i with all that does not move."""
    from pxr import Sdf, UsdGeom, Vt

    layer = clip.layers[i]
    mesh = UsdGeom.Mesh.Define(stage, f"{ROOT}/{prim_names(clip)[i]}")
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(layer.faces), 3))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(layer.faces, np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateDisplayColorAttr([(GREYS[i % len(GREYS)],) * 3])
    if layer.uv is not None and layer.face_uv is not None:
        kind, corners = Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
        uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, corners)
        uv.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(layer.uv, np.float32)))
        uv.SetIndices(Vt.IntArray.FromNumpy(np.ascontiguousarray(layer.face_uv, np.int32).ravel()))
    if layer.texture is not None:
        define_material(stage, mesh, layer, path)
    return mesh


def prim_names(clip: Clip) -> list[str]:
    """Of each layer its name as USD can spell it, underscores after what is another prim's."""
    from pxr import Tf

    found: list[str] = []
    taken = {"skeleton"}
    for layer in clip.layers:
        own = Tf.MakeValidIdentifier(layer.name)
        while {own, f"{own}_material"} & taken:
            own += "_"
        found.append(own)
        taken |= {own, f"{own}_material"}
    return found


def define_material(stage: Any, mesh: Any, layer: ClipLayer, path: Path) -> None:
    """A UsdPreviewSurface of the layer's picture, which is copied beside the file."""
    from pxr import Sdf, UsdShade

    picture = picture_of(layer, path)
    copy_file(layer.texture, picture)
    kinds, place = Sdf.ValueTypeNames, mesh.GetPath().pathString + "_material"
    material, shaders = UsdShade.Material.Define(stage, place), {}
    for name, kind in {"surface": "PreviewSurface", "texture": "UVTexture", "st": "PrimvarReader_float2"}.items():
        shaders[name] = UsdShade.Shader.Define(stage, f"{place}/{name}")
        shaders[name].CreateIdAttr(f"Usd{kind}")
    shaders["st"].CreateInput("varname", kinds.String).Set("st")
    found = shaders["st"].CreateOutput("result", kinds.Float2)
    shaders["texture"].CreateInput("file", kinds.Asset).Set(f"./{picture.parent.name}/{picture.name}")
    shaders["texture"].CreateInput("sourceColorSpace", kinds.Token).Set("sRGB")
    shaders["texture"].CreateInput("st", kinds.Float2).ConnectToSource(found)
    colour = shaders["texture"].CreateOutput("rgb", kinds.Float3)
    shaders["surface"].CreateInput("diffuseColor", kinds.Color3f).ConnectToSource(colour)
    shaders["surface"].CreateInput("roughness", kinds.Float).Set(1.0)
    material.CreateSurfaceOutput().ConnectToSource(shaders["surface"].CreateOutput("surface", kinds.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def picture_of(layer: ClipLayer, path: Path) -> Path:
    """Where the picture of a layer lies beside the file that names it."""
    assert layer.texture is not None
    return path.with_name(f"{path.stem}_textures") / f"{layer.name}{layer.texture.suffix.lower()}"


def check_pictures(clip: Clip, path: Path) -> None:
    """UserError where a picture would take the place of another one that a file of the same name and another ending names."""
    beside = [other for ending in ENDINGS if (other := path.with_suffix(ending)) != path and other.exists()]
    for layer in clip.layers if beside else ():
        if layer.texture is None:
            continue
        picture = picture_of(layer, path)
        if picture.exists() and not cmp(layer.texture, picture, shallow=False):
            shared = f"{picture.parent.name}/{picture.name}"
            raise UserError(f"{path}: {beside[0].name} has another {shared}: give this one another name")


def set_points(mesh: Any, V: Anything, *time: float) -> None:
    """Points and their extent, at a time or for all."""
    from pxr import Vt

    V = np.ascontiguousarray(V, np.float32)
    mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(V), *time)
    mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(np.stack([V.min(0), V.max(0)])), *time)


def define_skeleton(stage: Any, clip: Clip, skeleton: ClipSkeleton) -> None:
    """ROOT/skeleton, whose axes are the world's at rest, and ROOT/skeleton/motion."""
    from pxr import Gf, UsdSkel, Vt

    prim = UsdSkel.Skeleton.Define(stage, f"{ROOT}/skeleton")
    joints = joint_paths(skeleton)
    moved = lambda places: Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(Gf.Vec3d(*map(float, p))) for p in places])
    prim.CreateJointsAttr(joints)
    prim.CreateJointNamesAttr(list(skeleton.names))
    prim.CreateBindTransformsAttr(moved(np.asarray(skeleton.J)))
    prim.CreateRestTransformsAttr(moved(skeleton.offsets))
    motion = UsdSkel.Animation.Define(stage, f"{ROOT}/skeleton/motion")
    UsdSkel.BindingAPI.Apply(prim.GetPrim()).CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    motion.CreateJointsAttr(joints)
    motion.CreateScalesAttr(Vt.Vec3hArray(len(joints), Gf.Vec3h(1, 1, 1)))
    translations, rotations = motion.CreateTranslationsAttr(), motion.CreateRotationsAttr()
    for frame in clip.frames:
        turns, shift = skeleton.pose(frame)
        places = skeleton.offsets
        places[0] += shift
        translations.Set(Vt.Vec3fArray.FromNumpy(places.astype(np.float32)), frame)
        rotations.Set(quaternions(turns), frame)


def joint_paths(skeleton: ClipSkeleton) -> list[str]:
    """A joint's place in the tree, as UsdSkel names joints."""
    from pxr import Tf

    paths: list[str] = []
    for name, parent in zip(skeleton.names, skeleton.parents):
        own = Tf.MakeValidIdentifier(name)
        path = own if parent < 0 else f"{paths[parent]}/{own}"
        while path in paths:  # names that USD spells alike
            path += "_"
        paths.append(path)
    return paths


def quaternions(rotations: Anything) -> Any:
    """Rotation vectors (K,3) as Gf quaternions, whose real part comes first."""
    from pxr import Gf, Vt
    from scipy.spatial.transform import Rotation

    xyzw = Rotation.from_rotvec(rotations).as_quat(canonical=True).tolist()
    return Vt.QuatfArray([Gf.Quatf(w, x, y, z) for x, y, z, w in xyzw])


def bind_mesh(mesh: Any, clip: Clip, layer: ClipLayer) -> str:
    """The layer at rest, bound to the skeleton; returns how far that lies from the layer."""
    from pxr import UsdSkel, Vt

    assert layer.joints is not None and layer.weights is not None
    rest, off = rest_surface(clip, layer)
    set_points(mesh, rest)
    binding, width = UsdSkel.BindingAPI.Apply(mesh.GetPrim()), layer.joints.shape[1]
    binding.CreateSkeletonRel().SetTargets([f"{ROOT}/skeleton"])
    joints, weights = np.ascontiguousarray(layer.joints, np.int32), np.ascontiguousarray(layer.weights, np.float32)
    binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(joints.ravel()))
    binding.CreateJointWeightsPrimvar(False, width).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    return deviation_line(layer, off)


def deviation_line(layer: ClipLayer, off: Anything) -> str:
    """How far a layer that the skeleton moves lies from the registered one."""
    p50, p95 = 1000 * np.percentile(off, [50, 95])
    return f"{layer.name}, moved by the skeleton: {p50:.1f} mm off the frames at the median, {p95:.1f} mm at 95 %"
