#include "geometry/body_model.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

void check_body_model(const std::string& kernel, const BodyModel& m) {
    check_mesh(kernel, m.v_template, m.F, "body_model.v_template", "body_model.f");
    const Eigen::Index n = m.v_template.rows(), K = m.joints();
    require(K > 0 && m.parents[0] == -1, kernel + ": body_model.parents[0] must be -1, the root");
    for (Eigen::Index k = 1; k < K; ++k)
        require(m.parents[static_cast<std::size_t>(k)] >= 0 && m.parents[static_cast<std::size_t>(k)] < k,
                kernel + ": body_model.parents[" + std::to_string(k) + "] must lie before its child");
    require(m.J.rows() == K,
            kernel + ": body_model.J has " + std::to_string(m.J.rows()) + " rows, parents " + std::to_string(K));
    check_points(kernel, "body_model.J", m.J);
    require(m.weights_idx.rows() == n && m.weights_val.rows() == n && m.weights_idx.cols() == m.weights_val.cols() &&
                m.weights_idx.cols() > 0,
            kernel + ": body_model.weights_idx and weights_val must both be (" + std::to_string(n) + ", B), B > 0");
    check_finite(kernel, "body_model.weights_val", m.weights_val);
    for (Eigen::Index v = 0; v < n; ++v) {
        for (Eigen::Index b = 0; b < m.weights_idx.cols(); ++b)
            require(m.weights_idx(v, b) >= 0 && m.weights_idx(v, b) < K, kernel + ": body_model.weights_idx[" +
                                                                             std::to_string(v) + "] holds joint " +
                                                                             std::to_string(m.weights_idx(v, b)));
        require(m.weights_val.row(v).minCoeff() >= 0 && std::abs(m.weights_val.row(v).sum() - 1) < 1e-6,
                kernel + ": body_model.weights_val[" + std::to_string(v) + "] is negative or does not sum to 1");
    }
    require(m.shapedirs.rows() == 3 * n && m.J_shapedirs.rows() == 3 * K && m.shapedirs.cols() == m.J_shapedirs.cols(),
            kernel + ": body_model.shapedirs and J_shapedirs do not fit the mesh and its joints");
    check_points(kernel, "body_model.shapedirs", m.shapedirs);
    check_points(kernel, "body_model.J_shapedirs", m.J_shapedirs);
    for (const BodyKeypoint& k : m.keypoints) {
        require(k.joint < K && k.vertices.size() == k.weights.size() && (k.joint >= 0 || !k.vertices.empty()),
                kernel + ": body_model.keypoints '" + k.name + "' has no joint or vertices of the model");
        for (int v : k.vertices)
            require(v >= 0 && v < n,
                    kernel + ": body_model.keypoints '" + k.name + "' holds vertex " + std::to_string(v));
    }
}

namespace {

Vertices displaced(const Vertices& base, const Matrix& directions, const Vector& amounts, const char* what) {
    require(amounts.size() <= directions.cols(), std::string("body model: ") + what + " has " +
                                                     std::to_string(amounts.size()) + " entries, the basis " +
                                                     std::to_string(directions.cols()));
    Vertices out = base;
    if (amounts.size() == 0) return out;
    const Vector d = directions.leftCols(amounts.size()) * amounts;
    out += Eigen::Map<const Vertices>(d.data(), base.rows(), 3);
    return out;
}

}  // namespace

Vertices shaped_vertices(const BodyModel& m, const Vector& shape) {
    return displaced(m.v_template, m.shapedirs, shape, "shape");
}
Vertices shaped_joints(const BodyModel& m, const Vector& shape) {
    return displaced(m.J, m.J_shapedirs, shape, "shape");
}

Mat3 rotation_matrix(const Vec3& r) {
    const double angle = r.norm();
    if (angle < 1e-12) {
        Mat3 K;
        K << 0, -r[2], r[1], r[2], 0, -r[0], -r[1], r[0], 0;
        return Mat3::Identity() + K;
    }
    return Eigen::AngleAxisd(angle, r / angle).toRotationMatrix();
}

std::vector<Mat3> rotation_matrices(const Vertices& rotations) {
    std::vector<Mat3> local;
    for (Eigen::Index k = 0; k < rotations.rows(); ++k) local.push_back(rotation_matrix(rotations.row(k)));
    return local;
}

Posed pose_joints(const std::vector<int>& parents, const Vertices& J, const Vertices& rotations,
                  const Vec3& translation) {
    return pose_joints(parents, J, rotation_matrices(rotations), translation);
}

Posed pose_joints(const std::vector<int>& parents, const Vertices& J, const std::vector<Mat3>& locals,
                  const Vec3& translation) {
    Posed posed;
    posed.rotation.resize(parents.size());
    posed.joints.resize(J.rows(), 3);
    for (std::size_t k = 0; k < parents.size(); ++k) {
        const auto row = static_cast<Eigen::Index>(k);
        const Mat3& local = locals[k];
        if (parents[k] < 0) {
            posed.rotation[k] = local;
            posed.joints.row(row) = J.row(row) + translation.transpose();
            continue;
        }
        const auto p = static_cast<std::size_t>(parents[k]);
        posed.rotation[k] = posed.rotation[p] * local;
        const Vec3 bone = J.row(row) - J.row(parents[k]);
        posed.joints.row(row) = posed.joints.row(parents[k]) + (posed.rotation[p] * bone).transpose();
    }
    return posed;
}

Vertices skin_vertices(const BodyModel& m, const Vertices& rest, const Vertices& J, const Posed& posed) {
    Vertices out(rest.rows(), 3);
    parallel_for(rest.rows(), [&](std::int64_t v) {
        Vec3 sum = Vec3::Zero();
        for (Eigen::Index b = 0; b < m.weights_idx.cols(); ++b) {
            const double w = m.weights_val(v, b);
            if (w == 0) continue;
            const int k = m.weights_idx(v, b);
            const Vec3 local = rest.row(v) - J.row(k);
            sum += w * (posed.rotation[static_cast<std::size_t>(k)] * local + posed.joints.row(k).transpose());
        }
        out.row(v) = sum;
    });
    return out;
}

Vertices unskin_vertices(const BodyModel& m, const Vertices& V, const Vertices& J, const Posed& posed) {
    Vertices out(V.rows(), 3);
    parallel_for(V.rows(), [&](std::int64_t v) {
        Mat3 A = Mat3::Zero();
        Vec3 rest = V.row(v);
        for (Eigen::Index b = 0; b < m.weights_idx.cols(); ++b) {
            const double w = m.weights_val(v, b);
            if (w == 0) continue;
            const int k = m.weights_idx(v, b);
            const Mat3& R = posed.rotation[static_cast<std::size_t>(k)];
            A += w * R;
            rest -= w * (posed.joints.row(k).transpose() - R * J.row(k).transpose());
        }
        out.row(v) = A.inverse() * rest;
    });
    return out;
}

}  // namespace toile
