"""Thin faces of the C++ core: coerce, call, return. Only this package imports the compiled module."""

from .._core import InnerSums, InputError, SolveError, set_threads, threads
from .biharmonic import BiharmonicSolver, biharmonic
from .contours import Contours
from .drape import DrapeSolver, drape
from .geometry import (
    CholeskyFactor,
    SurfaceIndex,
    border_vertices,
    boundary_loops,
    cheapest_path,
    cotangent_laplacian,
    face_areas,
    face_neighbours,
    face_normals,
    unique_edges,
    vertex_components,
    vertex_normals,
    voronoi_mass,
)
from .inner import InnerSolver
from .intersect import intersecting_pairs, self_intersections, signed_distance, winding_number
from .mrf import mrf
from .nricp import NricpSolver, nricp
from .nricp_tracker import NricpTracker
from .occlusion import ambient_occlusion
from .paint import paint
from .raster import raster
from .remesh import remesh
from .sight import View, bilinear, evidence_picture, soft_labels, undistorted_view, view_edges, view_odds, visibility
from .skeleton import SkeletonSolver, skeleton
from .stereo import StereoSolver, fuse_depths
from .stop import Stop
from .untangle import UntangleSolver, untangle

__all__ = [
    "BiharmonicSolver",
    "CholeskyFactor",
    "Contours",
    "DrapeSolver",
    "InnerSolver",
    "InnerSums",
    "InputError",
    "NricpSolver",
    "NricpTracker",
    "SkeletonSolver",
    "SolveError",
    "StereoSolver",
    "Stop",
    "SurfaceIndex",
    "UntangleSolver",
    "View",
    "ambient_occlusion",
    "biharmonic",
    "border_vertices",
    "boundary_loops",
    "cheapest_path",
    "cotangent_laplacian",
    "drape",
    "evidence_picture",
    "face_areas",
    "face_neighbours",
    "face_normals",
    "fuse_depths",
    "intersecting_pairs",
    "mrf",
    "nricp",
    "paint",
    "raster",
    "remesh",
    "bilinear",
    "undistorted_view",
    "visibility",
    "self_intersections",
    "set_threads",
    "signed_distance",
    "skeleton",
    "soft_labels",
    "threads",
    "unique_edges",
    "untangle",
    "vertex_components",
    "vertex_normals",
    "view_edges",
    "view_odds",
    "voronoi_mass",
    "winding_number",
]
