#include "base/types.h"

#include "base/errors.h"

namespace toile {

// Messages are put together only where they are thrown: a million of them cost more than the kernel that asks.

void check_finite(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& values) {
    for (Eigen::Index i = 0; i < values.rows(); ++i)
        if (!values.row(i).allFinite())
            throw InputError(kernel + ": " + name + "[" + std::to_string(i) + "] is not finite");
}

void check_mesh(const std::string& kernel, const Vertices& V, const Faces& F, const std::string& name_V,
                const std::string& name_F) {
    require(V.rows() > 0, kernel + ": " + name_V + " is empty");
    require(F.rows() > 0, kernel + ": " + name_F + " is empty");
    check_finite(kernel, name_V, V);
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c)
            if (F(f, c) < 0 || F(f, c) >= V.rows())
                throw InputError(kernel + ": " + name_F + "[" + std::to_string(f) + "] holds vertex " +
                                 std::to_string(F(f, c)) + ", " + name_V + " has " + std::to_string(V.rows()) +
                                 " rows");
}

void check_indices(const std::string& kernel, const std::string& name, const Indices& indices, Eigen::Index n) {
    for (Eigen::Index i = 0; i < indices.size(); ++i)
        if (indices[i] < 0 || indices[i] >= n)
            throw InputError(kernel + ": " + name + "[" + std::to_string(i) + "] is " + std::to_string(indices[i]) +
                             ", expected 0 to " + std::to_string(n - 1));
}

}  // namespace toile
