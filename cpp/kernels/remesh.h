// Isotropic remeshing: the same surface in triangles of nearly equal sides.
#pragma once
#include "../base/types.h"

namespace toile {

struct RemeshOptions {
    int iterations = 8;          ///< 1 to 100 rounds of splits, collapses, flips and tangential smoothing
    double crease_angle = 1.05;  ///< edges whose two faces' normals differ by more are kept [rad]
};

struct RemeshResult {
    Vertices V;  ///< (k,3) [m]
    Faces F;     ///< (l,3)
};

/// Splits sides longer than 4/3 `edge` [m], collapses those shorter than 4/5 of it, flips towards six neighbours a
/// vertex, relaxes vertices in the surface and projects them back to it (Botsch and Kobbelt 2004; CGAL). Vertices of the
/// border stay on the border's own polyline. Faces keep their orientation; vertices that no face uses are left out.
///
/// Sides shorter than 1e-6 of `edge` shrink to points first.
///
/// InputError for a bad mesh or option, for faces that form no surface (an edge of three faces, two neighbours that run
/// opposite ways, parts that share one vertex only) or whose corners lie on a line, and for an `edge` that would make more
/// than 10 million faces. SolveError where CGAL gives up.
RemeshResult remesh(const Vertices& V, const Faces& F, double edge, const RemeshOptions& options = {});

}  // namespace toile
