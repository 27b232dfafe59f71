#include "geometry/intersect.h"

#include "bind/common.h"
#include "geometry/weld.h"
#include "geometry/winding.h"

namespace toile::bind {

namespace {

Vector winding_numbers(const Vertices& points, const Vertices& V, const Faces& F) {
    check_points("winding_number", "points", points);
    check_mesh("winding_number", V, F);
    return winding_numbers(points, WindingNumber(V, F));
}

Vector signed_distances(const Vertices& points, const Vertices& V, const Faces& F) {
    check_points("signed_distance", "points", points);
    check_mesh("signed_distance", V, F);
    const Faces once = distinct_faces(F, V.rows());
    return signed_distance(points, SurfaceIndex(V, F), WindingNumber(V, once));
}

}  // namespace

void bind_intersect(py::module_& m) {
    const auto free = py::call_guard<Unlocked>();
    m.def("intersecting_pairs", &intersecting_pairs, free);
    m.def("self_intersections", &self_intersections, free);
    m.def("winding_number", &winding_numbers, free);
    m.def("signed_distance", &signed_distances, free);
}

}  // namespace toile::bind
