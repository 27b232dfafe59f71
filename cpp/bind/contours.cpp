#include "kernels/contours.h"

#include "bind/common.h"

namespace toile::bind {

namespace {

/// One member of all points, as an array.
template <class Member>
auto each(Member ContourPoint::*member) {
    return [member](const Contours& contours) {
        Eigen::Matrix<Member, Eigen::Dynamic, 1> values(static_cast<Eigen::Index>(contours.points().size()));
        for (Eigen::Index e = 0; e < values.size(); ++e) values[e] = contours.points()[e].*member;
        return values;
    };
}

}  // namespace

void bind_contours(py::module_& m) {
    const py::call_guard<Unlocked> free;
    py::class_<Contours>(m, "Contours")
        .def(py::init([](FaceIds face, Matrix depth, Vertices V, Faces F, Faces neighbours, const Mat3& K,
                         double near_plane, PixelMask of) {
        const Unlocked unlocked;
        return Contours(
            {std::move(face), std::move(depth), std::move(V), std::move(F), std::move(neighbours), K, std::move(of)},
            near_plane);
    }))
        .def("gradient", &Contours::gradient, free)
        .def_property_readonly("a", each(&ContourPoint::a))
        .def_property_readonly("b", each(&ContourPoint::b))
        .def_property_readonly("i", each(&ContourPoint::i))
        .def_property_readonly("j", each(&ContourPoint::j))
        .def_property_readonly("share", each(&ContourPoint::share))
        .def_property_readonly("below", each(&ContourPoint::below));
}

}  // namespace toile::bind
