#include "base/types.h"

#include "base/errors.h"

namespace toile {

// Messages are put together only where they are thrown: a million of them cost more than the kernel that asks.

void check_finite(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& values) {
    for (Eigen::Index i = 0; i < values.rows(); ++i)
        if (!values.row(i).allFinite())
            throw InputError(kernel + ": " + name + "[" + std::to_string(i) + "] is not finite");
}

void check_points(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& points) {
    check_finite(kernel, name, points);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        if (!((points.row(i).array().abs() <= largest_coordinate).all()))
            throw InputError(kernel + ": " + name + "[" + std::to_string(i) + "] lies beyond 1e50 from the origin");
}

void check_solved(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& values) {
    if (!values.allFinite())
        throw SolveError(kernel + ": " + name +
                         " of the answer is not finite: sizes or options beyond the range of doubles");
}

void check_mesh(const std::string& kernel, const Vertices& V, const Faces& F, const std::string& name_V,
                const std::string& name_F) {
    require(V.rows() > 0, kernel + ": " + name_V + " is empty");
    require(F.rows() > 0, kernel + ": " + name_F + " is empty");
    check_points(kernel, name_V, V);
    check_faces(kernel, F, V.rows(), name_F, name_V);
}

void check_faces(const std::string& kernel, const Faces& F, Eigen::Index n, const std::string& name_F,
                 const std::string& name_V) {
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c)
            if (F(f, c) < 0 || F(f, c) >= n)
                throw InputError(kernel + ": " + name_F + "[" + std::to_string(f) + "] holds vertex " +
                                 std::to_string(F(f, c)) + ", " +
                                 (name_V.empty() ? "expected 0 to " + std::to_string(n - 1)
                                                 : name_V + " has " + std::to_string(n) + " rows"));
}

void check_indices(const std::string& kernel, const std::string& name, const Indices& indices, Eigen::Index n) {
    for (Eigen::Index i = 0; i < indices.size(); ++i)
        if (indices[i] < 0 || indices[i] >= n)
            throw InputError(kernel + ": " + name + "[" + std::to_string(i) + "] is " + std::to_string(indices[i]) +
                             ", expected 0 to " + std::to_string(n - 1));
}

}  // namespace toile
