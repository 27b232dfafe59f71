#include "geometry/confidence.h"

#include <cmath>
#include <vector>

#include "base/errors.h"

namespace toile {

void check_confidence(const std::string& kernel, const std::string& name, const Vector& confidence, Eigen::Index n) {
    require(
        confidence.size() == 0 || confidence.size() == n,
        kernel + ": " + name + " has " + std::to_string(confidence.size()) + " entries, expected " + std::to_string(n));
    for (Eigen::Index i = 0; i < confidence.size(); ++i)
        require(confidence[i] >= 0 && std::isfinite(confidence[i]),
                kernel + ": " + name + "[" + std::to_string(i) + "] is not a number >= 0");
}

Faces trusted_faces(const Faces& F, const Vector& confidence) {
    if (confidence.size() == 0) return F;
    std::vector<int> keep;
    for (int f = 0; f < F.rows(); ++f)
        if (confidence[F(f, 0)] > 0 && confidence[F(f, 1)] > 0 && confidence[F(f, 2)] > 0) keep.push_back(f);
    return F(keep, Eigen::all);
}

}  // namespace toile
