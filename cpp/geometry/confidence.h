// How sure a scan is of its vertices: numbers >= 0, as weights.
#pragma once
#include <string>

#include "../base/types.h"

namespace toile {

/// Throws InputError unless there are none, or n finite numbers >= 0.
void check_confidence(const std::string& kernel, const std::string& name, const Vector& confidence, Eigen::Index n);

/// The faces whose corners all have a confidence above 0; F itself where none is given.
Faces trusted_faces(const Faces& F, const Vector& confidence);

/// At a point of a face. Equal ones stay what they are, to the bit, however the barycentric coordinates were rounded.
inline double confidence_at(const Vector& confidence, const Eigen::RowVector3i& corners, const Vec3& barycentric) {
    const double first = confidence[corners[0]];
    return first + barycentric[1] * (confidence[corners[1]] - first) +
           barycentric[2] * (confidence[corners[2]] - first);
}

}  // namespace toile
