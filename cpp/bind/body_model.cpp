#include "geometry/body_model.h"

#include "bind/common.h"

namespace toile::bind {

void bind_body_model(py::module_& m) {
    py::class_<BodyKeypoint>(m, "BodyKeypoint")
        .def(py::init([](std::string name, int joint, std::vector<int> vertices, std::vector<double> weights) {
        return BodyKeypoint{std::move(name), joint, std::move(vertices), std::move(weights)};
    }));
    py::class_<BodyModel>(m, "BodyModel")
        .def(
            py::init([](Vertices v_template, Faces F, Vertices J, std::vector<int> parents, Eigen::MatrixXi weights_idx,
                        Matrix weights_val, Matrix shapedirs, Matrix J_shapedirs, std::vector<BodyKeypoint> keypoints) {
        BodyModel model{std::move(v_template), std::move(F),           std::move(J),
                        std::move(parents),    std::move(weights_idx), std::move(weights_val),
                        std::move(shapedirs),  std::move(J_shapedirs), std::move(keypoints)};
        check_body_model("BodyModel", model);
        return model;
    }));
}

}  // namespace toile::bind
