#include "geometry/body_jacobian.h"

#include <Eigen/Geometry>
#include <cmath>
#include <utility>

namespace toile {

Vec3 rotation_log(const Mat3& R) {
    const Eigen::AngleAxisd a(R);
    return a.angle() * a.axis();
}

Mat3 log_jacobian(const Vec3& r) {
    const double angle = r.norm();
    Mat3 K;
    K << 0, -r[2], r[1], r[2], 0, -r[0], -r[1], r[0], 0;
    const double second = angle < 1e-4 ? 1.0 / 12 : 1 / (angle * angle) - 0.5 / (angle * std::tan(angle / 2));
    return Mat3::Identity() - 0.5 * K + second * K * K;
}

BodyGradient::BodyGradient(const BodyModel& m)
    : values(Vector::Zero(3 * m.joints() + 3 + m.shapes())),
      moment_(static_cast<std::size_t>(m.joints()), Vec3::Zero()), mass_(static_cast<std::size_t>(m.joints()), 0.0),
      marked_(static_cast<std::size_t>(m.joints()), 0) {}

void BodyGradient::clear() {
    for (int k : touched) {
        values.segment<3>(3 * k).setZero();
        marked_[static_cast<std::size_t>(k)] = 0;
    }
    values.tail(values.size() - 3 * static_cast<Eigen::Index>(marked_.size())).setZero();
    touched.clear();
}

PosedBody::PosedBody(const BodyModel& model, std::shared_ptr<const ShapedBody> shaped, BodyState state,
                     bool shape_derivatives)
    : model_(model), state_(std::move(state)), shape_derivatives_(shape_derivatives), shaped_(std::move(shaped)) {
    posed_ = pose_joints(model.parents, shaped_->J, state_.local, state_.translation);
    if (!shape_derivatives) return;
    dx_ = dc_ = Matrix::Zero(model.J_shapedirs.rows(), model.J_shapedirs.cols());
    for (int k = 0; k < model.joints(); ++k) {
        const auto dJ = model.J_shapedirs.middleRows(3 * k, 3);
        const int p = model.parents[static_cast<std::size_t>(k)];
        if (p < 0)
            dx_.middleRows(3 * k, 3) = dJ;
        else
            dx_.middleRows(3 * k, 3) =
                dx_.middleRows(3 * p, 3) + parent_rotation(k) * (dJ - model.J_shapedirs.middleRows(3 * p, 3));
        dc_.middleRows(3 * k, 3) = dx_.middleRows(3 * k, 3) - posed_.rotation[static_cast<std::size_t>(k)] * dJ;
    }
}

const Mat3& PosedBody::parent_rotation(int k) const {
    static const Mat3 identity = Mat3::Identity();
    const int p = model_.parents[static_cast<std::size_t>(k)];
    return p < 0 ? identity : posed_.rotation[static_cast<std::size_t>(p)];
}

Vec3 PosedBody::vertex(int v) const {
    Vec3 sum = Vec3::Zero();
    for (Eigen::Index b = 0; b < model_.weights_idx.cols(); ++b) {
        const double w = model_.weights_val(v, b);
        const int k = model_.weights_idx(v, b);
        const Vec3 local = shaped_->rest.row(v) - shaped_->J.row(k);
        if (w != 0) sum += w * (posed_.rotation[static_cast<std::size_t>(k)] * local + joint(k));
    }
    return sum;
}

Vertices PosedBody::vertices() const { return skin_vertices(model_, shaped_->rest, shaped_->J, posed_); }

void PosedBody::touch(int k, BodyGradient& out) const {
    const auto i = static_cast<std::size_t>(k);
    if (out.marked_[i]) return;
    out.marked_[i] = 1;
    out.touched.push_back(k);
}

void PosedBody::add_vertex(int v, const Vec3& direction, BodyGradient& out) const {
    const Eigen::Index K3 = 3 * model_.joints();
    Mat3 A = Mat3::Zero();
    std::vector<int>& path = out.path_;
    path.clear();
    for (Eigen::Index b = 0; b < model_.weights_idx.cols(); ++b) {
        const double w = model_.weights_val(v, b);
        if (w == 0) continue;
        const int bone = model_.weights_idx(v, b);
        const Mat3& R = posed_.rotation[static_cast<std::size_t>(bone)];
        const Vec3 p = w * (R * (shaped_->rest.row(v) - shaped_->J.row(bone)).transpose() + joint(bone));
        A += w * R;
        if (shape_derivatives_)
            out.values.tail(model_.shapes()) += w * (dc_.middleRows(3 * bone, 3).transpose() * direction);
        for (int k = bone; k >= 0; k = model_.parents[static_cast<std::size_t>(k)]) {
            const auto i = static_cast<std::size_t>(k);
            if (out.mass_[i] == 0) path.push_back(k);  // weights are not negative
            out.mass_[i] += w;
            out.moment_[i] += p;
        }
    }
    for (int k : path) {
        const auto i = static_cast<std::size_t>(k);
        const Vec3 arm = out.moment_[i] - out.mass_[i] * joint(k);
        touch(k, out);
        out.values.segment<3>(3 * k) += parent_rotation(k).transpose() * arm.cross(direction);
        out.mass_[i] = 0;
        out.moment_[i].setZero();
    }
    out.values.segment<3>(K3) += direction;
    if (shape_derivatives_)
        out.values.tail(model_.shapes()) +=
            model_.shapedirs.middleRows(3 * v, 3).transpose() * (A.transpose() * direction);
}

void PosedBody::add_joint(int joint_index, const Vec3& direction, BodyGradient& out) const {
    const Vec3 x = joint(joint_index);
    for (int k = model_.parents[static_cast<std::size_t>(joint_index)]; k >= 0;
         k = model_.parents[static_cast<std::size_t>(k)]) {
        touch(k, out);
        const Vec3 arm = x - joint(k);
        out.values.segment<3>(3 * k) += parent_rotation(k).transpose() * arm.cross(direction);
    }
    out.values.segment<3>(3 * static_cast<Eigen::Index>(model_.joints())) += direction;
    if (shape_derivatives_)
        out.values.tail(model_.shapes()) += dx_.middleRows(3 * joint_index, 3).transpose() * direction;
}

}  // namespace toile
