// Ambient occlusion of a mesh's vertices: what share of the light of an even sky reaches each.
#pragma once
#include <cstdint>

#include "../base/types.h"

namespace toile {

struct OcclusionOptions {
    int rays = 64;                  ///< per vertex; the error falls as 1 / rays
    std::uint64_t seed = 0;         ///< turns every vertex's fan of rays by an angle of its own
    double relative_offset = 1e-4;  ///< share of the mesh's diagonal: rays start so far off the vertex along its normal
    double reach = 1e30;            ///< what is farther away casts no shade [m]
};

/// Openness (n,) in 0..1 of each vertex: the share of `rays` cosine-weighted directions about its area-weighted normal
/// that meet no face within `reach`, so 1 under an open sky. Both sides of a face cast shade. A vertex without a normal
/// (of no face, or of faces without area) is open. The rays of a vertex are a Hammersley set, turned by `seed` and the
/// vertex' index alone: the same bits for any number of threads.
/// `of` (k,): the vertices that are asked for, the answer then (k,); all where it is empty.
/// Throws InputError for a bad mesh, indices out of range, rays not in 1..65536, or relative_offset and reach that are not positive and finite.
/// Source: S. Zhukov, A. Iones, G. Kronin, An ambient light illumination model, EGWR 1998.
Vector ambient_occlusion(const Vertices& V, const Faces& F, const OcclusionOptions& options = {},
                         const Indices& of = {});

}  // namespace toile
