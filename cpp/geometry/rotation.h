// Small rotations and the matrices about them.
#pragma once
#include <Eigen/Geometry>
#include <Eigen/SVD>

#include "base/types.h"

namespace toile {

/// [a]x, so that [a]x b = a x b.
inline Mat3 cross_matrix(const Vec3& a) {
    Mat3 m;
    m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
    return m;
}

inline Mat3 rotation_of(const Vec3& vector) {
    const double angle = vector.norm();
    return angle > 0 ? Eigen::AngleAxisd(angle, vector / angle).toRotationMatrix() : Mat3::Identity();
}

inline Vec3 rotation_vector(const Mat3& R) {
    const Eigen::AngleAxisd a(R);
    return a.angle() * a.axis();
}

/// The rotation nearest to M; for M = sum (x - x0)(v - v0)' the one that carries v best to x (Arun et al. 1987).
inline Mat3 nearest_rotation(const Mat3& M) {
    const Eigen::JacobiSVD<Mat3> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Mat3 U = svd.matrixU();
    if ((U * svd.matrixV().transpose()).determinant() < 0) U.col(2) *= -1;
    return U * svd.matrixV().transpose();
}

}  // namespace toile
